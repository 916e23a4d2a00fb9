//! One process of the graph, as the supervisor spawns it.

use crate::config::FlightConfig;
use crate::crash;
use crate::graph;
use crate::log_files::open_logs;
use crate::log_replay::reruns;
use crate::logging;
use crate::replay_input::{self, DEFAULT_RATE_HZ};
use crate::run_files::{CONFIG, LOG, VERSION};
use crate::say::say;
use clap::Args;
use ipc_types::ProcessId;
use recorder::{Feed, Inputs, LogPlayer, RecorderProcess};
use runtime::ipc::{DriveOptions, drive};
use runtime::run_dir::RunDir;
use simulator::SimulatorProcess;
use std::error::Error;
use std::path::PathBuf;
use std::time::Duration;
use stereo_ingest::{CameraProcess, Player, Sequence};

/// What a child needs to know.
#[derive(Clone, Debug, Args)]
pub struct ChildArguments {
    /// Which process.
    #[arg(value_parser = parse_process)]
    process: ProcessId,
    /// Name of the run.
    #[arg(long)]
    run: String,
    /// The run's folder, with its configuration.
    #[arg(long)]
    run_dir: PathBuf,
    /// Process number of the supervisor.
    #[arg(long)]
    supervisor: u32,
    /// Which restart this is.
    #[arg(long, default_value_t = 0)]
    incarnation: u32,
    /// Makes its messages others than they are: for showing that such a process is refused.
    #[arg(long, default_value_t = 0)]
    schema_salt: u64,
    /// What the player shows: files or folders; nothing for the vehicle alone.
    #[arg(long)]
    play: Vec<PathBuf>,
    /// Frames per second, where the files do not say when they were exposed.
    #[arg(long, default_value_t = DEFAULT_RATE_HZ)]
    rate: f64,
    /// What the player plays instead: logs of a flight, in their order.
    #[arg(long)]
    play_log: Vec<PathBuf>,
    /// Of that, disparity instead of frames.
    #[arg(long)]
    play_disparity: bool,
    /// Flight time per time.
    #[arg(long, default_value_t = 1.0)]
    playback_rate: f64,
    /// From that flight time on, s ...
    #[arg(long, default_value_t = 0.0)]
    from: f64,
    /// ... until that.
    #[arg(long, default_value_t = f64::INFINITY)]
    until: f64,
}

fn parse_process(name: &str) -> Result<ProcessId, String> {
    ProcessId::from_name(name)
        .ok_or_else(|| format!("no process of that name; there are {:?}", ProcessId::ALL.map(ProcessId::name)))
}

/// Runs the process until it is told to stop.
///
/// # Errors
/// The configuration cannot be read, or the run's services cannot be opened.
pub fn run(arguments: &ChildArguments) -> Result<(), Box<dyn Error>> {
    let path = arguments.run_dir.join(CONFIG);
    let config = FlightConfig::load_snapshot(&path)?;
    let run = RunDir::named(&arguments.run)?;
    let lease = Duration::from_secs_f64(config.graph.lease_s);
    let (process, incarnation) = (arguments.process, arguments.incarnation);
    crash::report_panics(&run, &arguments.run_dir, process, incarnation);
    let _log = logging::begin(&arguments.run_dir, &arguments.run, process, incarnation);
    for refused in config.graph.resources(process).apply() {
        tracing::warn!(refused, "not permitted");
        say(format_args!("{process}: {refused}"));
    }
    let options = DriveOptions {
        incarnation,
        supervisor: arguments.supervisor,
        lease,
        faults: config.faults.clone(),
        schema_salt: arguments.schema_salt,
    };
    let rig = &config.vehicle.rig;
    match arguments.process {
        ProcessId::StereoIngest => drive(graph::stereo_ingest(&config), &run, rig, options)?,
        ProcessId::Expansion => drive(graph::expansion(&config), &run, rig, options)?,
        ProcessId::Memory => drive(graph::memory(&config), &run, rig, options)?,
        ProcessId::Planner => drive(graph::planner(&config), &run, rig, options)?,
        ProcessId::Controller => drive(graph::controller(&config), &run, rig, options)?,
        ProcessId::Simulator => drive(SimulatorProcess::threaded(graph::simulator(&config)?), &run, rig, options)?,
        ProcessId::Player if !arguments.play_log.is_empty() => {
            let feed = if arguments.play_disparity { Feed::Disparity } else { Feed::Frames };
            let inputs = Inputs::of(&open_logs(&arguments.play_log)?, &(arguments.from..=arguments.until), feed)?;
            // The recorder, too: what it does not hear is not compared.
            let awaited = reruns(feed).iter().copied().chain([ProcessId::Recorder]).collect();
            let player = LogPlayer::new(inputs.inputs, arguments.playback_rate, awaited);
            drive(player, &run, rig, options)?;
        }
        ProcessId::Player => {
            let content = replay_input::content(&config.vehicle.source);
            let sequence = match arguments.play.is_empty() {
                true => None,
                false => Some(Sequence::open(&arguments.play, content, arguments.rate)?),
            };
            let awaited = config.graph.digesting().map(|member| member.process).collect();
            drive(Player::new(sequence, (rig.width_px, rig.height_px), awaited), &run, rig, options)?;
        }
        ProcessId::Camera => {
            let camera = config.vehicle.camera.clone().ok_or("the vehicle has no camera")?;
            drive(CameraProcess::open(camera, &config.vehicle.source, rig)?, &run, rig, options)?;
        }
        ProcessId::Recorder => {
            let snapshot = config.snapshot();
            let attachments = [(CONFIG, snapshot.as_str()), ("version.txt", VERSION)];
            let recording = graph::recording(&config, &attachments);
            // A restarted recorder begins a new file: the old one ends where its writer was killed.
            let name = match arguments.incarnation {
                0 => LOG.to_owned(),
                restart => format!("log.{restart}.mcap"),
            };
            let log = arguments.run_dir.join(name);
            let recorder = match arguments.incarnation {
                0 => RecorderProcess::create(&log, &recording)?,
                // The disk that its predecessor died of may be full still.
                _ => RecorderProcess::resume(&log, &recording),
            };
            drive(recorder, &run, rig, options)?;
        }
        ProcessId::Bridge => drive(graph::bridge(&config, &arguments.run_dir), &run, rig, options)?,
        ProcessId::Supervisor => return Err("the supervisor is `sparrowhawk fly`".into()),
    }
    Ok(())
}
