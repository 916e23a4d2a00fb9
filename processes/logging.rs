//! The run's log: what happened, one JSON object a line, with run, process and incarnation; flight time where there is one.
//!
//! Every process appends to the same file in the run directory. A line is written at once and whole, so lines of different
//! processes do not mix. When the disk is full the flight goes on without.

use crate::run_files::EVENTS;
use ipc_types::ProcessId;
use std::fs::OpenOptions;
use std::io::{self, LineWriter};
use std::path::Path;
use std::sync::Mutex;
use tracing::span::EnteredSpan;

/// Begins to log what this process does; what is returned is to be kept for as long as it does.
///
/// # Errors
/// The file cannot be opened.
pub(crate) fn begin(folder: &Path, run: &str, process: ProcessId, incarnation: u32) -> io::Result<EnteredSpan> {
    let file = OpenOptions::new().create(true).append(true).open(folder.join(EVENTS))?;
    let subscriber = tracing_subscriber::fmt()
        .json()
        .flatten_event(true)
        .with_target(false)
        .with_span_list(false)
        // It would complain on standard error, which may be on the same full disk.
        .log_internal_errors(false)
        .with_writer(Mutex::new(LineWriter::new(file)))
        .finish();
    // Another flight of this very process has begun one already: a test's, say.
    let _ = tracing::subscriber::set_global_default(subscriber);
    Ok(tracing::info_span!("process", run, process = process.name(), incarnation).entered())
}
