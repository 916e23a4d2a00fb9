//! `sparrowhawk refly`: a lockstep flight, flown again from its log, and compared with it topic by topic.

use crate::config::FlightConfig;
use crate::graph::{self, Flight};
use crate::run_files::{CONFIG, VERSION};
use clap::Args;
use recorder::{Log, Record, RecorderProcess};
use std::collections::BTreeMap;
use std::error::Error;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// What to fly again.
#[derive(Debug, Args)]
pub(crate) struct ReflyArguments {
    /// The log (MCAP) of a flight in lockstep: its configuration and seed are attached to it.
    log: PathBuf,
    /// Where the new log goes; beside the old one, `again.mcap`, if not given.
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
}

/// Messages of a topic, as they were written.
type Messages = Vec<(Vec<u8>, Vec<u8>)>;

/// Exit status 0 only if every message of every topic is the same to the bit.
pub(crate) fn refly(arguments: &ReflyArguments) -> Result<ExitCode, Box<dyn Error>> {
    let path = arguments.log.display();
    let log = Log::open(&arguments.log).map_err(|error| format!("{path}: {error}"))?;
    let attached = log.attachment(CONFIG).map_err(|error| format!("{path}: {error}"))?;
    let attached = attached.ok_or_else(|| format!("{path}: it has no {CONFIG} attached: is it a log of ours?"))?;
    let config = FlightConfig::parse_snapshot(&format!("{path}: {CONFIG}"), &attached)?;
    let out = arguments.out.clone().unwrap_or_else(|| arguments.log.with_file_name("again.mcap"));
    let snapshot = config.snapshot();
    let attachments = [(CONFIG, snapshot.as_str()), ("version.txt", VERSION)];
    let recorder = RecorderProcess::create(&out, &graph::recording(&config, &attachments))?;
    Flight::new(&config, Some(recorder))?.fly(|_| true);
    let (before, after) = (by_topic(&log, &arguments.log)?, by_topic(&Log::open(&out)?, &out)?);
    let mut differences = 0;
    for topic in before.keys().chain(after.keys().filter(|topic| !before.contains_key(*topic))) {
        let none = Messages::new();
        let [then, now] = [&before, &after].map(|log| log.get(topic).unwrap_or(&none));
        let verdict = compare(then, now);
        differences += u32::from(verdict.is_some());
        println!("{topic:<18}{:>8} messages  {}", then.len(), verdict.unwrap_or_else(|| "the same".to_owned()));
    }
    println!("{}: {differences} topics differ", out.display());
    Ok(if differences == 0 { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

fn by_topic(log: &Log, path: &Path) -> Result<BTreeMap<&'static str, Messages>, String> {
    let mut topics: BTreeMap<_, Messages> = BTreeMap::new();
    let read =
        log.each(|Record { topic, header, elements }| topics.entry(topic.name).or_default().push((header, elements)));
    read.map(|_| topics).map_err(|error| format!("{}: {error}", path.display()))
}

/// How two recordings of a topic differ, if they do.
fn compare(then: &Messages, now: &Messages) -> Option<String> {
    match then.iter().zip(now).position(|(a, b)| a != b) {
        Some(index) => Some(format!("differ from the {}th on, of {} now", index + 1, now.len())),
        None if then.len() == now.len() => None,
        None => Some(format!("{} now; the same as far as both go", now.len())),
    }
}
