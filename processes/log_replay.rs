//! `sparrowhawk replay LOG.mcap`: what a recorded flight saw, through the graph again, and what comes of it this time.
//!
//! Nothing is flown: the vehicle moves as it did. So what differs was made by what is here now, another version or another
//! configuration; or, over processes, by time, which no two runs have alike.

use crate::config::FlightConfig;
use crate::flight_run::command;
use crate::graph;
use crate::log_compare::{Comparison, Scope, compare, look_through};
use crate::log_files::{attached_config, open_logs};
use crate::run_files::{CONFIG, RunFiles, fresh_name};
use crate::say::{say, tell};
use clap::{Args, ValueEnum};
use indicatif::{ProgressBar, ProgressStyle};
use ipc_types::topics::{Clock, HealthReports};
use ipc_types::{FlightTime, ProcessId};
use recorder::{ALL_PLAYED, Feed, Input, Inputs, Log, LogPlayer};
use runtime::ipc::{IpcPorts, Services};
use runtime::run_dir::RunDir;
use runtime::{Connect, Message, Ports};
use serde::Serialize;
use std::collections::BTreeMap;
use std::error::Error;
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};
use supervisor::{ATTENTION, ChildCommand, Happening, SignalWatch, Supervision};

/// What of a log is replayed, and how fast.
#[derive(Clone, Debug, Args)]
#[command(next_help_heading = "Logs (MCAP)")]
pub(crate) struct LogArguments {
    /// Flight time per time at which a log is replayed over processes: 1 as it was flown; or `fast`: as fast as possible, in
    /// one thread, which leaves nothing out.
    #[arg(long, value_name = "TIMES|fast", default_value = "1", value_parser = parse_playback_rate)]
    playback_rate: PlaybackRate,
    /// Flight time from which on it is replayed, s.
    #[arg(long, value_name = "S", default_value_t = 0.0, value_parser = parse_time)]
    from: f64,
    /// Flight time until which it is replayed, s; its end if not given.
    #[arg(long, value_name = "S", value_parser = parse_time)]
    until: Option<f64>,
    /// What the graph is fed with: what the cameras delivered, or the disparity that was found in it.
    #[arg(long, value_enum, default_value = "frames")]
    feed: FeedName,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum FeedName {
    Frames,
    Disparity,
}

impl From<FeedName> for Feed {
    fn from(name: FeedName) -> Self {
        match name {
            FeedName::Frames => Self::Frames,
            FeedName::Disparity => Self::Disparity,
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum PlaybackRate {
    Times(f64),
    Fast,
}

impl LogArguments {
    /// The first of its options that was given, if any: they are for logs alone.
    pub(crate) fn given(&self) -> Option<&'static str> {
        let given = [
            (self.playback_rate != PlaybackRate::Times(1.0), "--playback-rate"),
            (self.from > 0.0, "--from"),
            (self.until.is_some(), "--until"),
            (self.feed != FeedName::Frames, "--feed"),
        ];
        given.into_iter().find(|(is_given, _)| *is_given).map(|(_, name)| name)
    }
}

fn parse_playback_rate(text: &str) -> Result<PlaybackRate, String> {
    let times = || text.parse().ok().filter(|times| (0.05..=20.0).contains(times)).map(PlaybackRate::Times);
    let rate = if text == "fast" { Some(PlaybackRate::Fast) } else { times() };
    rate.ok_or_else(|| format!("is \"{text}\", allowed are 0.05 to 20, and fast"))
}

fn parse_time(text: &str) -> Result<f64, String> {
    let time_s = text.parse().ok().filter(|time_s| (0.0..=1e6).contains(time_s));
    time_s.ok_or_else(|| format!("is \"{text}\", allowed are 0 to 1000000 s"))
}

/// What else `replay` was told, of what concerns logs.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Told<'a> {
    pub(crate) config: Option<&'a Path>,
    pub(crate) record_images: bool,
    pub(crate) run: Option<&'a str>,
    pub(crate) run_dir: &'a Path,
    pub(crate) summary: Option<&'a Path>,
}

/// After the last input, so that what follows from it is made, flight time.
const LINGERS: Duration = Duration::from_millis(500);
/// Longest wait for the processes.
const PATIENCE: Duration = Duration::from_secs(60);

/// A recording and what of it is replayed.
struct Recording<'a> {
    paths: &'a [PathBuf],
    arguments: &'a LogArguments,
    images: usize,
    /// Whether it was flown in lockstep.
    in_lockstep: bool,
    /// Compared until then, s: all topics of the recording are complete until the last state.
    range_s: RangeInclusive<f64>,
}

/// What came of a replay.
#[derive(Debug, Serialize)]
struct ReplaySummary {
    from_s: f64,
    until_s: f64,
    images: usize,
    topics: BTreeMap<&'static str, Comparison>,
}

/// Exit status 0 only if, as fast as possible, the same came of it.
pub(crate) fn replay(given: &[PathBuf], arguments: &LogArguments, told: Told<'_>) -> Result<ExitCode, Box<dyn Error>> {
    let paths = if let [first] = given { Log::parts(first) } else { given.to_vec() };
    let logs = open_logs(&paths)?;
    let mut config = configuration(&attached_config(&logs[0], &paths[0])?, &paths[0], told.config)?;
    config.record_images = told.record_images;
    let (recording, inputs) = Recording::read(&paths, &logs, arguments, &config)?;
    // What is compared is read again; they may be large.
    drop(logs);
    let name = told.run.map_or_else(fresh_name, str::to_owned);
    let run = RunDir::named(&name)?;
    let lock = run.take()?;
    let files = RunFiles::create(told.run_dir, &name, &config, told.summary)?;
    match arguments.playback_rate {
        PlaybackRate::Fast => recording.in_lockstep(&config, &files, inputs)?,
        PlaybackRate::Times(rate) => {
            // Its player reads them itself.
            drop(inputs);
            recording.over_processes(&config, &run, &files, rate, SignalWatch::begin()?)?;
        }
    }
    drop(lock);
    let topics = recording.compare(&files.log())?;
    let (from_s, until_s) = recording.range_s.clone().into_inner();
    tell!("replayed           {} images of {from_s:.1} to {until_s:.1} s", recording.images);
    topics.iter().for_each(|(topic, comparison)| tell!("{topic:<18}{comparison}"));
    let others = topics.values().filter(|comparison| !comparison.is_same()).count();
    tell!("{others} topics differ");
    tell!("run directory      {}", files.folder().display());
    files.write_summary(&ReplaySummary { from_s, until_s, images: recording.images, topics })?;
    Ok(if others == 0 || arguments.playback_rate != PlaybackRate::Fast { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

/// The configuration that was flown, or another one for the same camera.
fn configuration(attached: &str, path: &Path, other: Option<&Path>) -> Result<FlightConfig, Box<dyn Error>> {
    let path = path.display();
    let flown = FlightConfig::parse_snapshot(&format!("{path}: {CONFIG}"), attached)?;
    let Some(other) = other else {
        flown.check()?;
        // What was injected then is in what was seen already; what processes did to themselves is not to happen again.
        return Ok(FlightConfig { faults: Vec::new(), ..flown });
    };
    let mut config = FlightConfig::load(Some(other), None)?;
    (config.seed, config.noise_camera) = (flown.seed, flown.noise_camera);
    if (config.vehicle.rig, config.vehicle.mount) != (flown.vehicle.rig, flown.vehicle.mount) {
        let message = format!("{}: its camera is not the one that {path} was flown with", other.display());
        return Err(message.into());
    }
    config.check()?;
    Ok(config)
}

impl<'a> Recording<'a> {
    fn read(
        paths: &'a [PathBuf],
        logs: &[Log],
        arguments: &'a LogArguments,
        config: &FlightConfig,
    ) -> Result<(Self, Vec<Input>), Box<dyn Error>> {
        let path = paths[0].display();
        let wanted_s = arguments.from..=arguments.until.unwrap_or(f64::INFINITY);
        let of_file = |error| format!("{path}: {error}");
        let inputs = Inputs::of(logs, &wanted_s, arguments.feed.into()).map_err(of_file)?;
        for (path, reading) in paths.iter().zip(&inputs.readings) {
            if !reading.damage.is_none() || reading.no_messages > 0 {
                let (damage, no_messages) = (&reading.damage, reading.no_messages);
                say(format_args!("{}: {damage}; {no_messages} messages are none", path.display()));
            }
        }
        let pixels = 2 * config.vehicle.rig.pixels();
        if let Some(other) = inputs.inputs.iter().find(|input| ![0, pixels].contains(&input.elements.len())) {
            let (found, topic) = (other.elements.len() / 2, other.topic);
            return Err(format!("{path}: an image of {topic} has {found} px, the camera {}", pixels / 2).into());
        }
        let images = inputs.images();
        if images == 0 {
            let advice = "record with --record-images, or look at --from and --until";
            let (incomplete, feed) = (inputs.incomplete, arguments.feed);
            return Err(format!("{path}: no {feed:?} to replay ({incomplete} without pixels): {advice}").into());
        }
        if inputs.incomplete > 0 {
            say(format_args!("{path}: {} images lack pixels, and are left out", inputs.incomplete));
        }
        let known = look_through(logs).map_err(of_file)?;
        let range_s = arguments.from..=known.last_state_s.min(*wanted_s.end());
        Ok((Self { paths, arguments, images, in_lockstep: known.in_lockstep, range_s }, inputs.inputs))
    }

    fn feed(&self) -> Feed {
        self.arguments.feed.into()
    }

    fn in_lockstep(&self, config: &FlightConfig, files: &RunFiles, inputs: Vec<Input>) -> Result<(), Box<dyn Error>> {
        let stop = Arc::new(AtomicBool::new(false));
        crate::cli::stop_on_signals(&stop)?;
        let recorder = graph::begin_recording(config, &files.log())?;
        let player = LogPlayer::new(inputs, 1.0, Vec::new());
        let until = FlightTime::from_secs_f64(*self.range_s.end()) + LINGERS;
        let bar = bar(&self.range_s);
        graph::rerun(config, player, recorder, self.feed(), |now| {
            bar.set_position(now.as_nanos().max(0) as u64 / 1_000_000);
            now >= until || stop.load(Ordering::Relaxed)
        });
        bar.finish_and_clear();
        if stop.load(Ordering::Relaxed) { Err("interrupted".into()) } else { Ok(()) }
    }

    /// Over processes and shared memory, as it was flown.
    fn over_processes(
        &self,
        config: &FlightConfig,
        run: &RunDir,
        files: &RunFiles,
        rate: f64,
        signals: SignalWatch,
    ) -> Result<(), Box<dyn Error>> {
        let commands = self.commands(config, run, files.folder(), rate)?;
        run.name_supervisor(std::process::id())?;
        let services = Services::hold(run)?;
        let mut ports = IpcPorts::open(run, ProcessId::Supervisor, 0, &config.vehicle.rig, |ports| {
            ports.reads::<HealthReports>();
            ports.reads::<Clock>();
        })?;
        let mut supervision = Supervision::start(run, commands, signals, &[]);
        let (bar, mut played, mut progress) = (bar(&self.range_s), None, Instant::now());
        let lingers = LINGERS.div_f64(rate).max(LINGERS);
        while played.is_none_or(|at: Instant| at.elapsed() < lingers) {
            for happening in supervision.attend(&services, ATTENTION) {
                match happening {
                    Happening::Signal(_) => return Err("interrupted".into()),
                    Happening::RunEnded(process, how) => return Err(format!("{process} {how}").into()),
                    Happening::Died(process, how, _) => say(format_args!("{process} {how}: restarting it")),
                    Happening::GaveUp(process, how) => return Err(format!("{process} {how}: given up").into()),
                    Happening::Started(..) | Happening::Ended(..) | Happening::Recovered(..) => {}
                }
            }
            if let Some(clock) = ports.latest::<Clock>().filter(|clock| clock.header().rate > 0.0) {
                progress = Instant::now();
                bar.set_position(clock.header().flight_ns.max(0) as u64 / 1_000_000);
            }
            while let Some(health) = ports.receive::<HealthReports>() {
                supervision.heard(health.header());
                let is_player = health.header().stamp.producer == ProcessId::Player as u32;
                if is_player && health.header().note.to_string_lossy() == ALL_PLAYED {
                    played.get_or_insert_with(Instant::now);
                }
            }
            if progress.elapsed() > PATIENCE {
                let waiting: Vec<String> = supervision.status().iter().filter_map(crate::display::complaint).collect();
                return Err(format!("nothing was played for {} s: {}", PATIENCE.as_secs(), waiting.join("; ")).into());
            }
        }
        bar.finish_and_clear();
        supervision.stop(&services);
        Ok(())
    }

    /// The graph, with a player that stands for world and vehicle.
    fn commands(
        &self,
        config: &FlightConfig,
        run: &RunDir,
        folder: &Path,
        rate: f64,
    ) -> Result<Vec<ChildCommand>, Box<dyn Error>> {
        let members = &config.graph.processes;
        let player = config.graph.in_place_of_the_world(ProcessId::Player);
        let rerun = members.iter().filter(|member| reruns(self.feed()).contains(&member.process));
        let recorder = members.iter().filter(|member| member.process == ProcessId::Recorder);
        let members = recorder.chain(rerun).cloned().chain(player);
        let mut commands: Vec<_> = members.map(|member| command(run, folder, &member)).collect::<Result<_, _>>()?;
        for command in commands.iter_mut().filter(|command| command.process == ProcessId::Player) {
            for path in self.paths {
                let path = path.canonicalize()?;
                let path =
                    path.to_str().ok_or("the log's path is not UTF-8, which the processes' command lines need")?;
                command.arguments.extend(["--play-log".to_owned(), path.to_owned()]);
            }
            let (from, until) = (self.arguments.from, *self.range_s.end());
            for (name, value) in [("--playback-rate", rate), ("--from", from), ("--until", until)] {
                command.arguments.extend([name.to_owned(), value.to_string()]);
            }
            command.arguments.extend((self.feed() == Feed::Disparity).then(|| "--play-disparity".to_owned()));
        }
        Ok(commands)
    }

    /// What is the same and what is not, topic by topic.
    fn compare(&self, made: &Path) -> Result<BTreeMap<&'static str, Comparison>, Box<dyn Error>> {
        // Instants and counts are the same only from the beginning, and where no host's time is in them.
        let times =
            self.arguments.playback_rate == PlaybackRate::Fast && self.arguments.from == 0.0 && self.in_lockstep;
        let scope = Scope { producers: reruns(self.feed()).to_vec(), range_s: self.range_s.clone(), times };
        Ok(compare(&open_logs(self.paths)?, &open_logs(&Log::parts(made))?, &scope)?)
    }
}

/// The processes that make something of what is fed to them.
pub(crate) fn reruns(feed: Feed) -> &'static [ProcessId] {
    use ProcessId::{Controller, Expansion, Memory, Planner, StereoIngest};
    match feed {
        Feed::Frames => &[StereoIngest, Expansion, Memory, Planner, Controller],
        Feed::Disparity => &[Expansion, Memory, Planner, Controller],
    }
}

fn bar(range_s: &RangeInclusive<f64>) -> ProgressBar {
    let bar = ProgressBar::new((range_s.end() * 1e3) as u64);
    // The template is ours and known to be good; the default one would do.
    if let Ok(style) = ProgressStyle::with_template("{bar:40} {pos}/{len} ms of flight, {eta} left") {
        bar.set_style(style);
    }
    bar
}
