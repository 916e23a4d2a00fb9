//! From configuration to processes.

use crate::config::{FlightConfig, VehicleConfig};
use crate::run_files::{CONFIG, VERSION};
use bridge::{About, BridgeProcess};
use controller::ControllerProcess;
use expansion::{ExpansionProcess, Reach};
use ipc_types::topics::TOPICS;
use ipc_types::{FlightTime, ProcessId};
use memory::{MapModel, MemoryProcess};
use planner::{PlannerProcess, TakeOff};
use recorder::{Feed, LogError, LogPlayer, RecorderProcess, Recording};
use runtime::lockstep::Lockstep;
use simulator::{SimulatorProcess, SimulatorSetup, World, WorldError};
use std::cell::RefCell;
use std::path::Path;
use std::rc::Rc;
use std::sync::Arc;
use stereo_ingest::{Source, StereoProcess};
use supervisor::{LatencySummary, Mission, Outcome, Summary};

/// The stereo-ingest process of a configuration.
pub fn stereo_ingest(config: &FlightConfig) -> StereoProcess {
    let vehicle = &config.vehicle;
    let source = if config.noise_camera { Source::Matched } else { vehicle.source };
    StereoProcess::new(vehicle.rig, &source, vehicle.stereo, config.rectifier())
}

/// How near the vehicle's sensor measures.
pub fn reach(vehicle: &VehicleConfig) -> Reach {
    match vehicle.source {
        Source::Stereo | Source::Matched => Reach::Matched { most_px: vehicle.stereo.max_disparity_px as f32 },
        Source::Depth { nearest_m, .. } => Reach::Ranged { nearest_m },
        Source::Disparity { most_px, .. } => Reach::Matched { most_px: most_px as f32 },
    }
}

/// The expansion process of a configuration.
pub fn expansion(config: &FlightConfig) -> ExpansionProcess {
    let vehicle = &config.vehicle;
    ExpansionProcess::new(vehicle.rig, &vehicle.noise, reach(vehicle), vehicle.expansion)
}

/// The memory process of a configuration.
pub fn memory(config: &FlightConfig) -> MemoryProcess {
    let mut memory = config.vehicle.memory;
    memory.free_space.swept_radius_m = config.free_space().swept_radius_m;
    let (vehicle, expansion) = (&config.vehicle, &config.vehicle.expansion);
    MemoryProcess::new(expansion.layout(&vehicle.rig), expansion.radius_m, vehicle.mount, memory)
}

/// What a vehicle's map is made with.
pub fn map_model(vehicle: &VehicleConfig) -> MapModel {
    MapModel {
        rig: vehicle.rig,
        noise: vehicle.noise,
        layout: vehicle.expansion.layout(&vehicle.rig),
        radius_m: vehicle.expansion.radius_m,
        inference: vehicle.memory.inference,
        forget_s: vehicle.memory.forget_s,
    }
}

/// Share of the home cylinder's radius within which a vehicle takes off without asking a map, and at most, m: what it
/// does there must end inside the cylinder.
const TAKE_OFF_SHARE: f64 = 0.6;
const TAKE_OFF_M: f64 = 1.0;

/// The planner process of a configuration.
pub fn planner(config: &FlightConfig) -> PlannerProcess {
    let (vehicle, mission) = (&config.vehicle, &config.mission);
    let rule = config.free_space();
    let take_off = TakeOff {
        from: mission.start(),
        radius_m: (TAKE_OFF_SHARE * rule.home_radius_m).min(TAKE_OFF_M),
        height_m: mission.cruise_height_m,
    };
    let (model, planner, cruise_mps) = (map_model(vehicle), vehicle.planner.clone(), mission.cruise_speed_mps);
    let planner = PlannerProcess::new(model, rule, planner, mission.fence, take_off, cruise_mps);
    if config.avoidance { planner } else { planner.without_avoidance() }
}

/// The controller process of a configuration.
pub fn controller(config: &FlightConfig) -> ControllerProcess {
    ControllerProcess::new(config.vehicle.controller, config.mission.fence)
}

/// The world of a configuration.
///
/// # Errors
/// Its OctoMap file is none.
pub fn world(config: &FlightConfig) -> Result<World, WorldError> {
    let kept: Vec<_> = std::iter::once(config.mission.start()).chain(config.mission.places()).collect();
    World::grow(&config.world, config.seed, &kept)
}

/// What the simulator of a configuration is made from.
///
/// # Errors
/// There is no such world.
pub fn simulator(config: &FlightConfig) -> Result<SimulatorSetup, WorldError> {
    Ok(SimulatorSetup {
        config: config.vehicle.simulator,
        rig: config.vehicle.rig,
        mount: config.vehicle.mount,
        world: Arc::new(world(config)?),
        start: config.mission.start(),
        start_yaw_rad: config.mission.start_heading_deg.to_radians(),
        seed: config.seed,
        noise_camera: config.noise_camera,
        trouble: config.trouble,
        pilot: config.pilot.clone(),
        faults: config.faults.clone(),
    })
}

/// The bridge of a configuration, for a run whose files are in that folder.
pub(crate) fn bridge(config: &FlightConfig, folder: &Path) -> BridgeProcess {
    let messages: Vec<_> = TOPICS.iter().map(|topic| (topic.header, topic.element)).collect();
    let about = About {
        schema: encoding::descriptor_set(&messages),
        config: config.snapshot(),
        folder: folder.to_owned(),
        status: Arc::default(),
    };
    let VehicleConfig { rig, mount, .. } = config.vehicle;
    let most_px = match reach(&config.vehicle) {
        Reach::Matched { most_px } => most_px,
        Reach::Ranged { nearest_m } => rig.disparity_px(nearest_m) as f32,
    };
    BridgeProcess::new(config.graph.bridge.clone(), about, rig, mount, most_px)
}

/// What is recorded of a flight, with texts attached (name, content).
pub(crate) fn recording<'a>(config: &FlightConfig, attachments: &'a [(&'a str, &'a str)]) -> Recording<'a> {
    let (rig, mount) = (config.vehicle.rig, config.vehicle.mount);
    Recording { attachments, images: config.record_images, rig, mount, config: config.graph.recorder }
}

/// Begins to record a flight to a file.
///
/// # Errors
/// The file cannot be created.
pub(crate) fn begin_recording(config: &FlightConfig, path: &Path) -> Result<RecorderProcess, LogError> {
    let snapshot = config.snapshot();
    RecorderProcess::create(path, &recording(config, &[(CONFIG, snapshot.as_str()), ("version.txt", VERSION)]))
}

/// What of a flight in lockstep may be looked at between two steps.
#[derive(Clone, Debug)]
pub struct Scene {
    /// With its map and its plan.
    pub planner: Rc<RefCell<PlannerProcess>>,
    /// With the world and the vehicle.
    pub simulator: Rc<RefCell<SimulatorProcess>>,
}

/// A whole flight in lockstep.
#[derive(Debug)]
pub struct Flight {
    lockstep: Lockstep,
    mission: Rc<RefCell<Mission>>,
    planner: Rc<RefCell<PlannerProcess>>,
    simulator: Rc<RefCell<SimulatorProcess>>,
}

impl Flight {
    /// Connects the graph; records if given a recorder.
    ///
    /// # Errors
    /// There is no world to fly in.
    pub fn new(config: &FlightConfig, recorder: Option<RecorderProcess>) -> Result<Self, WorldError> {
        let mut lockstep = Lockstep::new(config.seed, config.graph.latency.clone());
        let mission = lockstep.add(Mission::new(config.mission.clone(), config.graph.ladder, config.graph.link));
        let simulator = lockstep.add(SimulatorProcess::inline(simulator(config)?));
        lockstep.add(stereo_ingest(config));
        lockstep.add(expansion(config));
        lockstep.add(memory(config));
        let planner = lockstep.add(planner(config).prepared());
        lockstep.add(controller(config));
        recorder.map(|recorder| lockstep.add(recorder));
        Ok(Self { lockstep, mission, planner, simulator })
    }

    /// How long the planner's steps took on this machine.
    pub fn planning_times(&self) -> LatencySummary {
        self.lockstep.step_times_us(ProcessId::Planner).map(LatencySummary::of_us).unwrap_or_default()
    }

    /// What may be looked at while it flies: the planner and the world, for drawing them.
    pub fn scene(&self) -> Scene {
        Scene { planner: Rc::clone(&self.planner), simulator: Rc::clone(&self.simulator) }
    }

    /// Flies to the end. `watch` is called as flight time passes; when it returns false the flight is interrupted.
    pub fn fly(&mut self, mut watch: impl FnMut(&Mission) -> bool) -> Summary {
        let mission = Rc::clone(&self.mission);
        self.lockstep.run(|_| {
            let mut mission = mission.borrow_mut();
            if !watch(&mission) {
                mission.end(Outcome::Interrupted);
            }
            mission.outcome().is_some()
        });
        let mut summary = self.mission.borrow().summary();
        summary.log_hash = Some(format!("{:032x}", self.lockstep.log_hash()));
        summary.clock_ratio = 1.0;
        summary
    }
}

/// Feeds the graph with a recorded flight, in lockstep, until `stop` says so.
pub(crate) fn rerun(
    config: &FlightConfig,
    player: LogPlayer,
    recorder: RecorderProcess,
    feed: Feed,
    stop: impl FnMut(FlightTime) -> bool,
) {
    let mut lockstep = Lockstep::new(config.seed, config.graph.latency.clone());
    lockstep.add(player);
    if feed == Feed::Frames {
        lockstep.add(stereo_ingest(config));
    }
    lockstep.add(expansion(config));
    lockstep.add(memory(config));
    lockstep.add(planner(config).prepared());
    lockstep.add(controller(config));
    lockstep.add(recorder);
    lockstep.run(stop);
}
