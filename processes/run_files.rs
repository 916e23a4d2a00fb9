//! The run directory: configuration, log and summary of one run.

use crate::config::FlightConfig;
use serde::Serialize;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

/// The configuration's snapshot.
pub(crate) const CONFIG: &str = "config.ron";
/// What happened, as JSON lines.
pub(crate) const EVENTS: &str = "events.jsonl";
/// The MCAP log.
pub(crate) const LOG: &str = "log.mcap";
/// The summary.
const SUMMARY: &str = "summary.json";
/// Version and commit.
pub(crate) const VERSION: &str = concat!(env!("CARGO_PKG_VERSION"), " (", env!("SPARROWHAWK_COMMIT"), ")");

/// A run's files cannot be written.
#[derive(Debug, thiserror::Error)]
#[error("{path}: {source}")]
pub(crate) struct FileError {
    path: String,
    source: io::Error,
}

fn at(path: &Path) -> impl FnOnce(io::Error) -> FileError {
    let path = path.display().to_string();
    move |source| FileError { path, source }
}

/// A run's folder.
#[derive(Debug)]
pub(crate) struct RunFiles {
    folder: PathBuf,
    summary_copy: Option<PathBuf>,
}

/// A name for a run that was not given one: unlike any other on this machine.
pub(crate) fn fresh_name() -> String {
    let since_epoch = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    format!("r{}-{}", since_epoch.as_secs(), std::process::id())
}

impl RunFiles {
    /// Makes `parent/name` and puts the configuration there. The summary will be written there too, and to
    /// `summary_copy`, which must be writable now: not only after the flight.
    pub(crate) fn create(
        parent: &Path,
        name: &str,
        config: &FlightConfig,
        summary_copy: Option<&Path>,
    ) -> Result<Self, FileError> {
        let folder = parent.join(name);
        if folder.to_str().is_none() {
            let problem = "is not UTF-8, which the processes' command lines need";
            return Err(at(&folder)(io::Error::new(io::ErrorKind::InvalidInput, problem)));
        }
        fs::create_dir_all(parent).map_err(at(parent))?;
        fs::create_dir(&folder).map_err(|error| match error.kind() {
            io::ErrorKind::AlreadyExists => {
                let advice =
                    "exists already, and no run overwrites another's files: choose another --run, or remove it";
                at(&folder)(io::Error::new(error.kind(), advice))
            }
            _ => at(&folder)(error),
        })?;
        // Children run elsewhere; a relative path would mean another place to them.
        let folder = folder.canonicalize().map_err(at(&folder))?;
        if let Some(copy) = summary_copy {
            // What an older run left there is not this run's.
            fs::File::create(copy).map_err(at(copy))?;
        }
        let path = folder.join(CONFIG);
        fs::write(&path, config.snapshot()).map_err(at(&path))?;
        Ok(Self { folder, summary_copy: summary_copy.map(Path::to_owned) })
    }

    /// The folder of a run that was taken over.
    pub(crate) fn reopen(folder: &Path, summary_copy: Option<&Path>) -> Self {
        Self { folder: folder.to_owned(), summary_copy: summary_copy.map(Path::to_owned) }
    }

    pub(crate) fn folder(&self) -> &Path {
        &self.folder
    }

    pub(crate) fn log(&self) -> PathBuf {
        self.folder.join(LOG)
    }

    /// Writes the summary.
    pub(crate) fn write_summary(&self, summary: &impl Serialize) -> Result<(), FileError> {
        let own = self.folder.join(SUMMARY);
        write_json(&own, summary)?;
        self.summary_copy.as_deref().map_or(Ok(()), |copy| write_json(copy, summary))
    }
}

fn write_json(path: &Path, value: &impl Serialize) -> Result<(), FileError> {
    let text = serde_json::to_string_pretty(value).map_err(io::Error::from).map_err(at(path))?;
    fs::write(path, text + "\n").map_err(at(path))
}
