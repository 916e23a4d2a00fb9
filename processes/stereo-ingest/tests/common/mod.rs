//! What several tests need.

use std::path::PathBuf;

/// The folder of test data that nobody here made, or `None`, loudly, where it is absent.
pub(crate) fn data() -> Option<PathBuf> {
    let fallback = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data");
    let folder = std::env::var_os("SPARROWHAWK_DATA").map_or(fallback, PathBuf::from);
    if !folder.is_dir() {
        eprintln!("SKIPPED: no test data in {}; set SPARROWHAWK_DATA", folder.display());
        return None;
    }
    Some(folder)
}
