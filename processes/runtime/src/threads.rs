//! Threads of a core that divides its work among several.

use rayon::{ThreadPool, ThreadPoolBuilder};

/// A pool of so many threads; `None` for one, which needs no pool, and where the system starts no more: then one does all,
/// later, and with the same result.
pub fn thread_pool(threads: usize) -> Option<ThreadPool> {
    (threads > 1).then(|| ThreadPoolBuilder::new().num_threads(threads).build().ok()).flatten()
}
