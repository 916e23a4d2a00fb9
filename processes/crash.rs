//! Crash reports: what is known of a process that died, in the run directory.
//!
//! A panic writes its message and backtrace itself. What a signal has killed says nothing any more: for it the supervisor
//! writes down how it ended, its last heartbeat and, from its black box, what it had received last.

use ipc_types::ProcessId;
use ipc_types::messages::HealthLevel;
use runtime::ipc::last_inputs;
use runtime::run_dir::RunDir;
use std::backtrace::Backtrace;
use std::fmt::Write as _;
use std::fs::OpenOptions;
use std::io::{self, Write as _};
use std::path::{Path, PathBuf};
use supervisor::ChildStatus;

fn path(folder: &Path, process: ProcessId, incarnation: u32) -> PathBuf {
    folder.join(format!("crash-{process}-{incarnation}.txt"))
}

fn append(path: &Path, text: &str) -> io::Result<()> {
    OpenOptions::new().create(true).append(true).open(path)?.write_all(text.as_bytes())
}

/// Has panics of this process reported.
pub(crate) fn report_panics(run: &RunDir, folder: &Path, process: ProcessId, incarnation: u32) {
    let (run, path) = (run.clone(), path(folder, process, incarnation));
    let before = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |info| {
        run.note_dying(process);
        // First what takes no time. The disk may be full; there is nobody else to tell.
        let _ = append(&path, &format!("{info}\n\n"));
        let _ = append(&path, &format!("backtrace:\n{}\n", Backtrace::force_capture()));
        before(info);
    }));
}

/// Adds what the supervisor knows of a death.
///
/// # Errors
/// The report cannot be written.
pub(crate) fn report_death(
    run: &RunDir,
    folder: &Path,
    died: &ChildStatus,
    how: &str,
    flight_s: f64,
) -> io::Result<()> {
    let mut text = format!("{} (incarnation {}) {how}, at {flight_s:.3} s of flight\n", died.process, died.incarnation);
    // Writing to a string cannot fail.
    if let Some(health) = died.health {
        let level = match HealthLevel::from_wire(health.level) {
            HealthLevel::Ok => "ok",
            HealthLevel::Degraded => "degraded",
            HealthLevel::Faulted => "faulted",
        };
        let _ = writeln!(
            text,
            "last heartbeat: {level} \"{}\", {} steps, longest {:.1} ms, {} refused, {} missed",
            health.note.to_string_lossy(),
            health.steps,
            health.longest_step_ns as f64 * 1e-6,
            health.dropped,
            health.missed
        );
    }
    for input in last_inputs(run, died.process) {
        let valid_s = input.valid_ns as f64 * 1e-9;
        let _ = writeln!(text, "last {}: sequence {}, valid at {valid_s:.3} s", input.topic, input.sequence);
    }
    append(&path(folder, died.process, died.incarnation), &text)
}
