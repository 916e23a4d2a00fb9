//! Segments that were created and never given a size.
//!
//! iceoryx2 0.10 creates a segment, sizes it, fills it in. Who opens one that has no size yet waits until it has one:
//! for good, if its creator was killed between the first two steps (`posix_shared_memory.rs`, `MappingSizeIsZero` has
//! no deadline). That stops whoever connects, and it stops the cleaner as well, who is the supervisor. So the cleaner
//! removes such segments first; an opener that waits goes on then, since it asks for the name again every time.
//!
//! A segment whose creator lives is left: between both steps he holds it open, and the kernel says who does. Asked are only
//! the processes of the run, who have said their numbers before they create anything.

use crate::run_dir::RunDir;
use ipc_types::ProcessId;
use std::fs;
use std::io::ErrorKind;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Looks at who holds a segment. Who waits for its size has it open for a small part of the time.
const LOOKS: usize = 20;
const BETWEEN_LOOKS: Duration = Duration::from_millis(1);

/// Removes segments of the run that were left without a size; whether none is left. It takes as long as listing a
/// folder where there is none, and some 20 ms per segment that somebody holds.
pub(super) fn remove(run: &RunDir) -> bool {
    let stays = |segment: &PathBuf| inode_of_empty(segment).is_some() && !removed(run, segment);
    run.segments().filter(stays).count() == 0
}

/// Which file lies there, if it has no size.
fn inode_of_empty(segment: &Path) -> Option<u64> {
    let metadata = fs::symlink_metadata(segment).ok()?;
    (metadata.is_file() && metadata.size() == 0).then(|| metadata.ino())
}

/// Removes a segment that nobody will finish; whether none without a size is left there.
fn removed(run: &RunDir, segment: &Path) -> bool {
    for look in 0..LOOKS {
        if look > 0 {
            std::thread::sleep(BETWEEN_LOOKS);
        }
        // In this order: a creator that had closed it before he was looked for had given it a size before.
        let Some(before) = inode_of_empty(segment) else { return true };
        if !is_held(run, segment) && inode_of_empty(segment) == Some(before) {
            return fs::remove_file(segment).is_ok();
        }
    }
    inode_of_empty(segment).is_none()
}

/// Whether a process of the run has the file open, or may have.
fn is_held(run: &RunDir, segment: &Path) -> bool {
    let children = ProcessId::ALL.into_iter().filter_map(|process| run.living(process)).map(|(number, _)| number);
    children.chain([std::process::id()]).any(|number| match fs::read_dir(format!("/proc/{number}/fd")) {
        Ok(descriptors) => {
            descriptors.flatten().any(|open| fs::read_link(open.path()).is_ok_and(|path| path == segment))
        }
        // Dead meanwhile; of one that lives and does not show what it holds, nothing is known.
        Err(error) => error.kind() != ErrorKind::NotFound,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs::File;

    #[test]
    fn what_nobody_will_finish_goes_and_what_somebody_may_finish_stays() {
        let run = RunDir::named(&format!("half-made-{}", std::process::id())).expect("a good name");
        let lock = run.take().expect("free");
        let segment = |name: &str| Path::new("/dev/shm").join(format!("{}{name}", run.prefix()));
        fs::write(segment("sized"), [1]).expect("writable");
        assert!(remove(&run));
        drop(File::create(segment("left")).expect("writable"));
        let creator = File::create(segment("held")).expect("writable");
        assert!(!remove(&run), "one is held");
        assert!(!segment("left").exists() && segment("held").exists() && segment("sized").exists());
        // He gives it a size after all, or dies.
        creator.set_len(1).expect("writable");
        assert!(remove(&run) && segment("held").exists());
        creator.set_len(0).expect("writable");
        drop(creator);
        assert!(remove(&run) && !segment("held").exists());
        drop(lock);
    }
}
