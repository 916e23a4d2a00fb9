//! Logs as a command line names them.

use crate::run_files::CONFIG;
use recorder::Log;
use std::path::{Path, PathBuf};

/// Opens the files of a recording, in their order.
pub(crate) fn open_logs(paths: &[PathBuf]) -> Result<Vec<Log>, String> {
    let open = |path: &PathBuf| Log::open(path).map_err(|error| format!("{}: {error}", path.display()));
    paths.iter().map(open).collect()
}

/// The configuration that was flown, as text (RON): it is attached to every log.
pub(crate) fn attached_config(log: &Log, path: &Path) -> Result<String, String> {
    let attached = log.attachment(CONFIG).map_err(|error| format!("{}: {error}", path.display()))?;
    attached.ok_or_else(|| format!("{}: it has no {CONFIG} attached: is it a log of ours?", path.display()))
}
