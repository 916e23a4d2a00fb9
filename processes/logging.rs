//! The run's log: what happened, one JSON object a line, with run, process and incarnation; flight time where there is one.
//!
//! Every process appends to the same file in the run directory, by a thread of its own: no step waits for a disk. A line is
//! written whole, so lines of different processes do not mix. When the disk is full, or so slow that a hundred thousand lines wait,
//! the flight goes on without them. Of the network's own lines ten a second are written; whom it refuses, the bridge is told.

use crate::run_files::EVENTS;
use crate::say::say;
use bridge::RefusalLayer;
use ipc_types::ProcessId;
use std::fs::OpenOptions;
use std::path::Path;
use std::sync::{Mutex, PoisonError};
use std::time::Instant;
use tracing::span::EnteredSpan;
use tracing::subscriber::Interest;
use tracing::{Level, Metadata};
use tracing_appender::non_blocking::WorkerGuard;
use tracing_subscriber::Layer as _;
use tracing_subscriber::filter::{dynamic_filter_fn, filter_fn};
use tracing_subscriber::layer::SubscriberExt as _;

/// A log under way; ends, written out, when dropped.
#[derive(Debug)]
pub(crate) struct Log {
    _span: EnteredSpan,
    _worker: WorkerGuard,
}

/// Begins to log what this process does; what is returned is to be kept for as long as it does. Where the file cannot be opened
/// the process does without, and says so.
pub(crate) fn begin(folder: &Path, run: &str, process: ProcessId, incarnation: u32) -> Option<Log> {
    let path = folder.join(EVENTS);
    let opened = OpenOptions::new().create(true).append(true).open(&path);
    let file = opened.inspect_err(|error| say(format_args!("{process}: no log: {}: {error}", path.display()))).ok()?;
    let (writer, worker) = tracing_appender::non_blocking(file);
    let lines = tracing_subscriber::fmt::layer()
        .json()
        .flatten_event(true)
        .with_target(false)
        .with_span_list(false)
        // It would complain on standard error, which may be on the same full disk.
        .log_internal_errors(false)
        .with_writer(writer)
        .with_filter(
            dynamic_filter_fn(|event, _| *event.level() <= Level::INFO && !is_too_much(event)).with_callsite_filter(
                // What is never written is not asked about again.
                |event| if *event.level() <= Level::INFO { Interest::sometimes() } else { Interest::never() },
            ),
        );
    let refusals = RefusalLayer.with_filter(filter_fn(RefusalLayer::hears));
    let subscriber = tracing_subscriber::registry().with(lines).with(refusals);
    // Another flight of this very process has begun one already: a test's, say.
    let _ = tracing::subscriber::set_global_default(subscriber);
    let span = tracing::info_span!("process", run, process = process.name(), incarnation).entered();
    Some(Log { _span: span, _worker: worker })
}

/// Lines a second of the network's, at most: whoever can reach it could fill the disk.
const MOST_LINES_S: u32 = 10;

/// Whether an event is one of the network's, and one of too many within a second.
fn is_too_much(event: &Metadata<'_>) -> bool {
    static SECOND: Mutex<Option<(Instant, u32)>> = Mutex::new(None);
    if !event.is_event() || !event.target().starts_with("zenoh") {
        return false;
    }
    let mut second = SECOND.lock().unwrap_or_else(PoisonError::into_inner);
    let (began, lines) = second.filter(|(began, _)| began.elapsed().as_secs() < 1).unwrap_or((Instant::now(), 0));
    *second = Some((began, lines + 1));
    lines >= MOST_LINES_S
}
