//! `sparrowhawk refly`: a lockstep flight, flown again from its log, and compared with it topic by topic.

use crate::config::FlightConfig;
use crate::graph::{self, Flight};
use crate::log_compare::{Scope, compare};
use crate::log_files::{attached_config, open_logs};
use crate::run_files::CONFIG;
use crate::say::tell;
use clap::Args;
use recorder::Log;
use std::error::Error;
use std::path::PathBuf;
use std::process::ExitCode;

/// What to fly again.
#[derive(Debug, Args)]
pub(crate) struct ReflyArguments {
    /// The log (MCAP) of a flight in lockstep, the first part if there are several: its configuration and seed are attached to it.
    log: PathBuf,
    /// Where the new log goes; beside the old one, `again.mcap`, if not given.
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
}

/// Exit status 0 only if every message of every topic is the same to the bit.
pub(crate) fn refly(arguments: &ReflyArguments) -> Result<ExitCode, Box<dyn Error>> {
    let (path, logs) = (arguments.log.display(), open_logs(&Log::parts(&arguments.log))?);
    let attached = attached_config(&logs[0], &arguments.log)?;
    let config = FlightConfig::parse_snapshot(&format!("{path}: {CONFIG}"), &attached)?;
    let out = arguments.out.clone().unwrap_or_else(|| arguments.log.with_file_name("again.mcap"));
    if out.exists() {
        return Err(format!("{}: exists already: choose another with --out, or remove it", out.display()).into());
    }
    let recorder = graph::begin_recording(&config, &out)?;
    Flight::new(&config, Some(recorder))?.fly(|_| true);
    let scope = Scope { producers: Vec::new(), range_s: f64::NEG_INFINITY..=f64::INFINITY, times: true };
    let topics = compare(&logs, &open_logs(&Log::parts(&out))?, &scope).map_err(|error| format!("{path}: {error}"))?;
    topics.iter().for_each(|(topic, comparison)| tell!("{topic:<18}{comparison}"));
    let differences = topics.values().filter(|comparison| !comparison.is_same()).count();
    tell!("{}: {differences} topics differ", out.display());
    Ok(if differences == 0 { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}
