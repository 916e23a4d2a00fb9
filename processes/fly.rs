//! `sparrowhawk fly`: a flight in the simulator, over processes or in lockstep.

use crate::config::FlightConfig;
use crate::display::Display;
use crate::draw::Pictures;
use crate::fault_file::FaultFile;
use crate::flight_report::report;
use crate::flight_run;
use crate::graph::{self, Flight};
use crate::numbers::parse_numbers;
use crate::run_files::{CONFIG, RunFiles, fresh_name};
use crate::run_record::RunRecord;
use crate::say::{say, tell};
use crate::troubles::TroubleArguments;
use clap::Args;
use runtime::run_dir::{RunDir, RunLock};
use simulator::Piloted;
use std::error::Error;
use std::path::PathBuf;
use std::process::ExitCode;
use supervisor::{AtGoal, Outcome, SignalWatch, Summary};

/// Options of a flight.
#[derive(Clone, Debug, Args)]
pub(crate) struct FlyArguments {
    /// Flight: default, fast, forest_100, behind, corridor, corner, cul_de_sac, canopy, hedge, thesis_large, thesis_small, thicket, or a file (RON); default if not given.
    #[arg(long, value_name = "NAME|FILE")]
    pub(crate) config: Option<PathBuf>,
    /// World: forest, long_forest, field, wall, corridor, corner, cul_de_sac, canopy, hedge, thicket, or a RON file.
    #[arg(long, value_name = "NAME|FILE")]
    pub(crate) world: Option<String>,
    /// Seed of the world and of all noise.
    #[arg(long, default_value_t = 7)]
    pub(crate) seed: u64,
    /// Goal, in metres of the world: x,y,z.
    #[arg(long, value_name = "X,Y,Z", value_parser = parse_numbers::<3>, allow_hyphen_values = true)]
    pub(crate) goal: Option<[f64; 3]>,
    /// Place to pass on the way, x,y,z; instead of the flight file's. Repeat for more.
    #[arg(long, value_name = "X,Y,Z", value_parser = parse_numbers::<3>, allow_hyphen_values = true)]
    pub(crate) waypoint: Vec<[f64; 3]>,
    /// Land at the goal; the column below it is declared free.
    #[arg(long)]
    pub(crate) land: bool,
    /// A pilot takes over at this flight time, s, for so long, s, and flies at this velocity, m/s: what the vehicle would do
    /// is recorded, not followed. Repeat for more. For the whole flight: shadow mode.
    #[arg(long, value_name = "FROM,FOR,VX,VY,VZ", value_parser = parse_numbers::<5>, allow_hyphen_values = true)]
    pub(crate) pilot: Vec<[f64; 5]>,
    /// Highest speed on the way, m/s.
    #[arg(long, value_name = "M/S")]
    pub(crate) speed: Option<f64>,
    /// Give up after this much flight time, s.
    #[arg(long, value_name = "S")]
    pub(crate) time_limit: Option<f64>,
    /// All processes in one thread, repeatable to the bit, as fast as the machine can.
    #[arg(long)]
    pub(crate) lockstep: bool,
    /// At these flight times, s, draw the map, the plan and the keyframes: from above and over the camera's view (PNG in
    /// the run directory). Repeat, or separate by commas.
    #[arg(long, value_name = "S", value_delimiter = ',', requires = "lockstep")]
    pub(crate) draw: Vec<f64>,
    /// Fly without looking: shows what avoidance is worth.
    #[arg(long)]
    pub(crate) no_avoidance: bool,
    /// Model what the stereo camera and its matcher get wrong instead of rendering and matching pairs: faster.
    #[arg(long)]
    pub(crate) noise_camera: bool,
    #[command(flatten)]
    pub(crate) trouble: TroubleArguments,
    /// Inject the faults of this file (RON) into the processes of the flight, its messages, sensors and machine.
    #[arg(long, value_name = "FILE", conflicts_with = "lockstep")]
    pub(crate) faults: Option<PathBuf>,
    /// Take over the run of that name if its supervisor has died and its processes still fly; all else is as that run was
    /// started. If there is none, start it, with a run directory of its own each time: what a service does.
    #[arg(long, requires = "run", conflicts_with = "lockstep")]
    pub(crate) adopt: bool,
    /// Record images too.
    #[arg(long)]
    pub(crate) record_images: bool,
    /// Let the ground see it, and command it: listen here, tcp/127.0.0.1:7447, or tls/ADDRESS:PORT with the certificates that the
    /// graph's file names. Repeat for more.
    #[arg(long, value_name = "ENDPOINT", conflicts_with = "lockstep")]
    pub(crate) listen: Vec<String>,
    /// Connect to a router or to the ground.
    #[arg(long, value_name = "ENDPOINT", conflicts_with = "lockstep")]
    pub(crate) connect: Vec<String>,
    /// What the vehicle is called on the network, where not as its graph's file says.
    #[arg(long, value_name = "NAME")]
    pub(crate) vehicle: Option<String>,
    /// Name of the run; two runs at a time need two names.
    #[arg(long, value_name = "NAME")]
    pub(crate) run: Option<String>,
    /// Where run directories go.
    #[arg(long, value_name = "DIR", default_value = "runs")]
    pub(crate) run_dir: PathBuf,
    /// Write the summary to this file as well.
    #[arg(long, value_name = "FILE")]
    pub(crate) summary: Option<PathBuf>,
}

fn piloted(&[from_s, for_s, x, y, z]: &[f64; 5]) -> Piloted {
    Piloted { from_s, for_s, velocity_mps: [x, y, z] }
}

impl FlyArguments {
    /// The configuration with the command line's wishes, checked.
    fn configuration(&self) -> Result<FlightConfig, Box<dyn Error>> {
        let mut config = FlightConfig::load_for_simulator(self.config.as_deref(), self.world.as_deref())?;
        config.seed = self.seed;
        config.avoidance = !self.no_avoidance;
        config.record_images = self.record_images;
        config.noise_camera = self.noise_camera;
        config.trouble = self.trouble.trouble();
        config.pilot = self.pilot.iter().map(piloted).collect();
        config.faults = self.faults.as_deref().map(FaultFile::load).transpose()?.unwrap_or_default().faults;
        if !self.waypoint.is_empty() {
            config.mission.waypoints_m.clone_from(&self.waypoint);
        }
        if self.land {
            config.mission.at_goal = AtGoal::Land;
        }
        config.mission.goal_m = self.goal.unwrap_or(config.mission.goal_m);
        config.mission.cruise_speed_mps = self.speed.unwrap_or(config.mission.cruise_speed_mps);
        config.mission.time_limit_s = self.time_limit.unwrap_or(config.mission.time_limit_s);
        let bridge = &mut config.graph.bridge;
        bridge.listen.extend_from_slice(&self.listen);
        bridge.connect.extend_from_slice(&self.connect);
        self.vehicle.iter().for_each(|name| bridge.vehicle.clone_from(name));
        config.check()?;
        Ok(config)
    }
}

/// Exit status when a run could not be taken over.
const NOT_TAKEN_OVER: u8 = 3;

/// Flies; the exit code says whether it arrived.
pub(crate) fn fly(arguments: &FlyArguments) -> Result<ExitCode, Box<dyn Error>> {
    let signals = SignalWatch::begin()?;
    let name = arguments.run.clone().unwrap_or_else(fresh_name);
    let run = RunDir::named(&name)?;
    if arguments.adopt {
        // Before the configuration is read: what flies does not depend on what it says today. And with another exit status than
        // that of a flight that is over, so that whoever restarts this tries again.
        let refused = |error: Box<dyn Error>| {
            say(format_args!("cannot take over run \"{name}\": {error}"));
            Ok(ExitCode::from(NOT_TAKEN_OVER))
        };
        match run.take_over() {
            Ok(Some(lock)) => return take_over(arguments, &run, lock, signals).or_else(refused),
            Ok(None) => {}
            Err(error) => return refused(error.into()),
        }
    }
    let config = arguments.configuration()?;
    let lock = run.take()?;
    // A service flies again and again under one name: every flight has a folder of its own.
    let folder = if arguments.adopt { format!("{name}-{}", fresh_name()) } else { name.clone() };
    let files = RunFiles::create(&arguments.run_dir, &folder, &config, arguments.summary.as_deref())?;
    let summary = match arguments.lockstep {
        true => fly_in_lockstep(&config, &files, &arguments.draw)?,
        false => flight_run::fly(&config, &run, &files, signals, None)?,
    };
    conclude(lock, &files, &summary)
}

/// Goes on with a flight whose supervisor has died, as it was configured.
fn take_over(
    arguments: &FlyArguments,
    run: &RunDir,
    mut lock: RunLock,
    signals: SignalWatch,
) -> Result<ExitCode, Box<dyn Error>> {
    // Until the flight has ended nothing of it is swept, whatever goes wrong here.
    let record = RunRecord::read(run)?;
    let config = FlightConfig::load_snapshot(&record.folder.join(CONFIG))?;
    let files = RunFiles::reopen(&record.folder, arguments.summary.as_deref());
    say(format_args!("taking over run \"{}\", whose supervisor {} has died", run.name(), record.supervisor));
    let summary = flight_run::fly(&config, run, &files, signals, Some(&record))?;
    lock.end();
    conclude(lock, &files, &summary)
}

fn conclude(lock: RunLock, files: &RunFiles, summary: &Summary) -> Result<ExitCode, Box<dyn Error>> {
    drop(lock);
    tell!("{}", report(summary, files.folder()).trim_end());
    files.write_summary(summary)?;
    Ok(if summary.outcome == Outcome::Arrived { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

fn fly_in_lockstep(config: &FlightConfig, files: &RunFiles, draw: &[f64]) -> Result<Summary, Box<dyn Error>> {
    let stop = std::sync::Arc::new(std::sync::atomic::AtomicBool::new(false));
    crate::cli::stop_on_signals(&stop)?;
    let recorder = graph::begin_recording(config, &files.log())?;
    let mut display = Display::new(config.mission.goal());
    let mut flight = Flight::new(config, Some(recorder))?;
    let mut pictures = Pictures::new(config, flight.scene(), draw, files.folder());
    let mut failed = None;
    let summary = flight.fly(|mission| {
        display.show(mission, &[]);
        failed = failed.take().or(pictures.draw_due(mission.now()).err());
        !stop.load(std::sync::atomic::Ordering::Relaxed)
    });
    display.clear();
    failed.map_or(Ok(summary), Err)
}
