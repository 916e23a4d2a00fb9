//! `sparrowhawk status`: the processes of a running flight, as a live table.

use crate::run_record::{ProcessRecord, RunRecord};
use crate::say::tell;
use clap::Args;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use ipc_types::HostTime;
use runtime::host_now;
use runtime::run_dir::RunDir;
use std::error::Error;
use std::fmt::Write;
use std::io::IsTerminal;
use std::process::ExitCode;
use std::time::Duration;

/// What to watch.
#[derive(Clone, Debug, Args)]
pub(crate) struct StatusArguments {
    /// Name of the run; the only one if not given.
    #[arg(long, value_name = "NAME")]
    run: Option<String>,
    /// Show it once and end, as when the output is no terminal.
    #[arg(long)]
    once: bool,
    /// One JSON object, for scripts; once.
    #[arg(long)]
    json: bool,
}

/// Between two redraws.
const INTERVAL: Duration = Duration::from_millis(250);
/// A record that is older than this is of a supervisor that died or hangs, s.
const OLD_S: f64 = 1.0;

/// Shows the status of a run. Ends when the run does; the exit code says whether there was one.
pub(crate) fn status(arguments: &StatusArguments) -> Result<ExitCode, Box<dyn Error>> {
    let run = find(arguments.run.as_deref())?;
    let record = RunRecord::read(&run)?;
    if arguments.json {
        tell!("{}", serde_json::to_string_pretty(&record)?);
        return Ok(ExitCode::SUCCESS);
    }
    if arguments.once || !std::io::stdout().is_terminal() {
        tell!("{}", table(&record).trim_end());
        return Ok(ExitCode::SUCCESS);
    }
    let screen = ProgressBar::with_draw_target(None, ProgressDrawTarget::stdout());
    screen.set_style(ProgressStyle::with_template("{msg}")?);
    let stop = std::sync::Arc::new(std::sync::atomic::AtomicBool::new(false));
    crate::cli::stop_on_signals(&stop)?;
    while !stop.load(std::sync::atomic::Ordering::Relaxed) {
        match RunRecord::read(&run) {
            Ok(record) => screen.set_message(table(&record)),
            Err(_) => break, // The run is over.
        }
        std::thread::sleep(INTERVAL);
    }
    screen.finish();
    Ok(ExitCode::SUCCESS)
}

/// The run of that name, or the only one that has a record.
fn find(name: Option<&str>) -> Result<RunDir, Box<dyn Error>> {
    if let Some(name) = name {
        return Ok(RunDir::named(name)?);
    }
    let mut runs: Vec<_> = RunDir::all().into_iter().filter(|run| run.read_record().is_ok()).collect();
    match (runs.pop(), runs.len()) {
        (Some(only), 0) => Ok(only),
        (None, _) => Err("no run is under way".into()),
        (Some(last), _) => {
            let names: Vec<_> = runs.iter().map(RunDir::name).chain([last.name()]).collect();
            Err(format!("several runs are under way, choose one with --run: {}", names.join(", ")).into())
        }
    }
}

/// The record as text.
fn table(record: &RunRecord) -> String {
    let mut text = String::new();
    // Writing to a string cannot fail.
    let age_s = record.age_s();
    let is_old = age_s > OLD_S;
    let _ = writeln!(
        text,
        "run {}   {:.1} s   {}   rung: {}{}{}   supervisor {}{}",
        record.run,
        record.flight_s,
        record.mode,
        record.rung,
        if record.reason.is_empty() { "" } else { ", " },
        record.reason,
        record.supervisor,
        if is_old { format!("   SILENT FOR {age_s:.1} S: what follows is as old") } else { String::new() },
    );
    let _ = writeln!(
        text,
        "{:<14}{:>8}  {:<12}{:>9}{:>9}{:>8}{:>9}{:>9}{:>8}{:>9}{:>7}{:>9}{:>5}  health",
        "process",
        "pid",
        "state",
        "restarts",
        "beat ms",
        "rate Hz",
        "p50 ms",
        "p99 ms",
        "missed",
        "refused",
        "CPU %",
        "memory",
        "fds"
    );
    for process in &record.processes {
        let _ = writeln!(text, "{}", line(process));
    }
    text
}

fn line(process: &ProcessRecord) -> String {
    let beat = process
        .beat_ns
        .map_or("-".to_owned(), |at| format!("{:.0}", 1e3 * host_now().seconds_since(HostTime::from_nanos(at))));
    let of = |value: f64, count: u64| if count > 0 { format!("{value:.1}") } else { "-".to_owned() };
    let latency = process.latency;
    let usage = process.usage.map_or(["-".to_owned(), "-".to_owned(), "-".to_owned()], |usage| {
        let resident_mib = usage.resident_bytes as f64 / f64::from(1 << 20);
        [format!("{:.0}", 100.0 * usage.cpu), format!("{resident_mib:.0} MiB"), usage.descriptors.to_string()]
    });
    format!(
        "{:<14}{:>8}  {:<12}{:>9}{:>9}{:>8.1}{:>9}{:>9}{:>8}{:>9}{:>7}{:>9}{:>5}  {}{}{}",
        process.process,
        process.pid.map_or("-".to_owned(), |pid| pid.to_string()),
        process.state,
        process.restarts,
        beat,
        process.rate_hz,
        of(latency.p50_ms, latency.count),
        of(latency.p99_ms, latency.count),
        process.missed,
        process.refused,
        usage[0],
        usage[1],
        usage[2],
        process.health,
        if process.note.is_empty() { "" } else { ": " },
        process.note
    )
}
