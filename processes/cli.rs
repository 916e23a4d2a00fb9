//! The command line.

use crate::calibrate::{self, CalibrateArguments};
use crate::child::{self, ChildArguments};
use crate::config::FlightConfig;
use crate::curves::{CurvesArguments, curves};
use crate::evaluate::{EvaluateArguments, evaluate};
use crate::expand::{ExpandArguments, expand};
use crate::faults::{FaultsArguments, faults};
use crate::fly::{FlyArguments, fly};
use crate::ground_station::{GroundArguments, ground};
use crate::map::{MapArguments, map};
use crate::recover::{RecoverArguments, recover};
use crate::refly::{ReflyArguments, refly};
use crate::replay::{ReplayArguments, replay};
use crate::report::{ReportArguments, report};
use crate::run_files::VERSION;
use crate::say::tell;
use crate::soak::{SoakArguments, soak};
use crate::status::{StatusArguments, status};
use crate::stereo::{StereoArguments, stereo};
use clap::{Args, Parser, Subcommand};
use std::error::Error;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// Flies a micro air vehicle through clutter on stereo cameras alone.
///
/// Without a command it flies the default mission: takes off in a simulated forest, finds its way between trees that
/// it sees only through a rendered stereo pair, and hovers at a goal 65 m away.
#[derive(Debug, Parser)]
#[command(name = "sparrowhawk", version = VERSION, args_conflicts_with_subcommands = true)]
struct CommandLine {
    #[command(subcommand)]
    command: Option<Command>,
    #[command(flatten)]
    fly: FlyArguments,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Fly in the simulator. Exit status 0 only when the goal was reached without a collision.
    Fly(FlyArguments),
    /// Fly many seeds, speeds, worlds and configurations in lockstep on all cores: a table, and what it comes to.
    Evaluate(EvaluateArguments),
    /// Feed the graph with real images, from files or live: disparity, configuration space and occupancy.
    Replay(Box<ReplayArguments>),
    /// Match one pair of images: disparity as a file, error figures, time.
    Stereo(StereoArguments),
    /// Inflate one disparity image by the vehicle: configuration space as files and pictures, time.
    Expand(ExpandArguments),
    /// Make a map of depth images with poses: a voxel grid as pictures and as a list of points.
    Map(MapArguments),
    /// Plot what a sensor's votes weigh by distance: probability mass and confidence.
    Curves(CurvesArguments),
    /// Calibrate a stereo pair from chessboards, or check a calibration; measure the disparity error.
    Calibrate(CalibrateArguments),
    /// Fly many flights with injected faults, over real processes: a table of what followed from which fault.
    Faults(FaultsArguments),
    /// Fly to and fro for as long as is asked for, with faults: does memory grow?
    Soak(SoakArguments),
    /// Watch a flight that is under way: its processes, as a live table.
    Status(StatusArguments),
    /// See vehicles from the ground, and command them: a page, a table, lines for scripts, or one order.
    Ground(GroundArguments),
    /// Make a page (HTML) of a flight's log: path, height, speed, clearance, latencies, health.
    Report(ReportArguments),
    /// Fly a lockstep flight's log again and compare the two, topic by topic.
    Refly(ReflyArguments),
    /// Make a log that was cut off whole: all that can be read of it, with the index that viewers want.
    Recover(RecoverArguments),
    /// Check a configuration: every value, and how they fit each other.
    Check(CheckArguments),
    /// One process of a run; the supervisor starts these.
    #[command(hide = true)]
    Process(ChildArguments),
}

#[derive(Debug, Args)]
struct CheckArguments {
    /// Flight: default, fast, forest_100, behind, corridor, corner, cul_de_sac, canopy, hedge, thesis_large, thesis_small, thicket, or a file (RON); default if not given.
    config: Option<PathBuf>,
    /// World: forest, long_forest, field, wall, corridor, corner, cul_de_sac, canopy, hedge, thicket, or a RON file.
    #[arg(long, value_name = "NAME|FILE")]
    world: Option<String>,
}

/// Reads the command line and does what it says.
///
/// # Errors
/// One message that says what was wrong, where, and what was expected.
pub fn run() -> Result<ExitCode, Box<dyn Error>> {
    let command_line = CommandLine::parse();
    match command_line.command.unwrap_or(Command::Fly(command_line.fly)) {
        Command::Fly(arguments) => fly(&arguments),
        Command::Evaluate(arguments) => evaluate(&arguments),
        Command::Replay(arguments) => replay(&arguments),
        Command::Stereo(arguments) => stereo(&arguments),
        Command::Expand(arguments) => expand(&arguments),
        Command::Map(arguments) => map(&arguments),
        Command::Curves(arguments) => curves(&arguments),
        Command::Calibrate(arguments) => calibrate::run(&arguments),
        Command::Faults(arguments) => faults(&arguments),
        Command::Soak(arguments) => soak(&arguments),
        Command::Status(arguments) => status(&arguments),
        Command::Ground(arguments) => ground(&arguments),
        Command::Report(arguments) => report(&arguments),
        Command::Refly(arguments) => refly(&arguments),
        Command::Recover(arguments) => recover(&arguments),
        Command::Check(arguments) => check(&arguments),
        Command::Process(arguments) => child::run(&arguments).map(|()| ExitCode::SUCCESS),
    }
}

fn check(arguments: &CheckArguments) -> Result<ExitCode, Box<dyn Error>> {
    let config = FlightConfig::load(arguments.config.as_deref(), arguments.world.as_deref())?;
    config.check()?;
    let vehicle = &config.vehicle;
    tell!(
        "{}: possible",
        arguments.config.as_ref().map_or("config/default.ron".into(), |path| path.display().to_string())
    );
    tell!("vehicle                {}, inflated by {} m", vehicle.name, vehicle.expansion.radius_m);
    tell!("sensor good for        {:.1} m (standard deviation of depth below the radius)", config.sensing_range_m());
    tell!(
        "stopping distance      {:.1} m from {} m/s, latency included",
        vehicle.planner.stopping_distance_m(config.mission.cruise_speed_mps),
        config.mission.cruise_speed_mps
    );
    tell!("manoeuvres             {}", vehicle.planner.library.size);
    Ok(ExitCode::SUCCESS)
}

/// Sets `stop` on SIGINT, SIGTERM and SIGHUP.
pub(crate) fn stop_on_signals(stop: &Arc<AtomicBool>) -> std::io::Result<()> {
    for signal in [signal_hook::consts::SIGINT, signal_hook::consts::SIGTERM, signal_hook::consts::SIGHUP] {
        signal_hook::flag::register(signal, Arc::clone(stop))?;
    }
    Ok(())
}
