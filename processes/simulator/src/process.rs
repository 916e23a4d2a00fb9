//! The simulator process: setpoints in; clock, state, stereo frames and truth out.

use crate::camera::{CameraConfig, StereoCamera, camera_pose};
use crate::collider::{Clearance, Collider};
use crate::estimator::{Estimator, EstimatorConfig};
use crate::noise_camera::{NoiseCamera, NoiseCameraConfig};
use crate::pilot::{Piloted, sticks};
use crate::sensor_faults::{BadSight, SensorFaults};
use crate::trouble::{Trouble, Troubles};
use crate::vehicle::{Vehicle, VehicleConfig};
use crate::world::World;
use ipc_types::bounds::Bounds;
use ipc_types::messages::SetpointMode;
use ipc_types::rig::CameraMount;
use ipc_types::topics::{Clock, DepthFrames, Setpoints, State, StereoFrames, Truth};
use ipc_types::{Body, Camera, FlightTime, HostTime, Point, Pose, ProcessId, StereoRig, Vector, World as WorldFrame};
use runtime::faults::Fault;
use runtime::{Connect, Message, Ports, Process, Report};
use serde::{Deserialize, Serialize};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::time::Duration;

/// Step of the dynamics.
const STEP: Duration = Duration::from_millis(5);
/// Steps between states.
const STEPS_PER_STATE: u64 = 2;
/// Flight time that may be caught up at once; beyond it flight time slows down instead.
const LONGEST_CATCH_UP: Duration = Duration::from_millis(50);
/// Frames being rendered beyond which flight time waits.
const FRAMES_IN_WORK: usize = 1;

/// What of the vehicle the simulator imitates.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SimulatorConfig {
    /// Dynamics and flight control unit.
    pub vehicle: VehicleConfig,
    /// Optics and sensor.
    pub camera: CameraConfig,
    /// What the noise-model camera takes the place of camera and matcher with.
    pub noise_camera: NoiseCameraConfig,
    /// State estimate.
    pub estimator: EstimatorConfig,
}

impl SimulatorConfig {
    /// Reports values out of range.
    pub fn check(&self, bounds: &mut Bounds) {
        bounds.section("vehicle", |bounds| self.vehicle.check(bounds));
        bounds.section("camera", |bounds| self.camera.check(bounds));
        bounds.section("noise_camera", |bounds| self.noise_camera.check(bounds));
        bounds.section("estimator", |bounds| self.estimator.check(bounds));
    }
}

/// Everything a simulator is made from.
#[derive(Clone, Debug)]
pub struct SimulatorSetup {
    /// Parameters.
    pub config: SimulatorConfig,
    /// Camera geometry.
    pub rig: StereoRig,
    /// Where the camera sits.
    pub mount: CameraMount,
    /// The world.
    pub world: Arc<World>,
    /// Take-off place; its height is the ground's.
    pub start: Point<WorldFrame>,
    /// Heading at take-off, rad.
    pub start_yaw_rad: f64,
    /// Drives all noise.
    pub seed: u64,
    /// Whether disparity is delivered by a model of the camera's and the matcher's errors, instead of rendered pairs.
    pub noise_camera: bool,
    /// What the flight is troubled with.
    pub trouble: Trouble,
    /// When a pilot flies.
    pub pilot: Vec<Piloted>,
    /// What is injected; those that concern sensors and clock.
    pub faults: Vec<Fault>,
}

/// Who renders: this thread, so that everything repeats, or another, so that the dynamics never wait.
enum Eyes {
    Inline(Optics),
    Thread { orders: SyncSender<Order>, frames: Receiver<Frame>, in_work: usize },
}

struct Order {
    exposure: FlightTime,
    world_from_camera: Pose<WorldFrame, Camera>,
    image: Image,
}

/// What a camera delivers.
enum Image {
    /// The left image, then the right one.
    Pair(Vec<u8>),
    /// Disparity of the left image.
    Disparity(Vec<u16>),
}

/// What makes images of the world.
enum Optics {
    Rendered(Box<StereoCamera>),
    Modelled(Box<NoiseCamera>),
}

impl Optics {
    fn new(setup: &SimulatorSetup) -> Self {
        let (world, config, seed) = (Arc::clone(&setup.world), &setup.config, setup.seed ^ 1);
        match setup.noise_camera {
            false => Self::Rendered(Box::new(StereoCamera::new(world, setup.rig, config.camera, seed))),
            true => Self::Modelled(Box::new(NoiseCamera::new(world, setup.rig, config.noise_camera, seed))),
        }
    }

    /// An image for the optics of a setup to write to.
    fn image(setup: &SimulatorSetup) -> Image {
        match setup.noise_camera {
            false => Image::Pair(vec![0; 2 * setup.rig.pixels()]),
            true => Image::Disparity(vec![0; setup.rig.pixels()]),
        }
    }

    fn expose(&mut self, world_from_camera: Pose<WorldFrame, Camera>, image: &mut Image) {
        match (self, image) {
            (Self::Rendered(camera), Image::Pair(pixels)) => camera.expose(world_from_camera, pixels),
            (Self::Modelled(camera), Image::Disparity(disparity)) => camera.expose(world_from_camera, disparity),
            // Images are made by `image` of the same optics.
            (Self::Rendered(_), Image::Disparity(_)) | (Self::Modelled(_), Image::Pair(_)) => {}
        }
    }
}

type Frame = Order;

/// The world as a process.
pub struct SimulatorProcess {
    setup: SimulatorSetup,
    vehicle: Vehicle,
    estimator: Estimator,
    collider: Collider,
    troubles: Troubles,
    faults: SensorFaults,
    bad_sight: BadSight,
    eyes: Eyes,
    /// Frames rendered and not yet due, oldest first.
    ready: Vec<Frame>,
    spare: Vec<Image>,
    stepped: FlightTime,
    steps: u64,
    next_exposure: FlightTime,
    frames: u64,
    clearance: Clearance,
    collided: bool,
    clock: PacedClock,
    /// Host time of this step; zero in lockstep, whose log would not repeat otherwise.
    host: HostTime,
    report: Report,
}

impl std::fmt::Debug for SimulatorProcess {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "SimulatorProcess at {:.3} s", self.stepped.as_secs_f64())
    }
}

/// Flight time paced to the host's, slowed when the simulation cannot keep up.
#[derive(Debug)]
struct PacedClock {
    started: Option<HostTime>,
    lost: Duration,
}

impl PacedClock {
    /// Flight time at `host`, given how far the simulation has come and whether it must wait for a frame.
    fn at(&mut self, host: HostTime, stepped: FlightTime, must_wait: bool) -> FlightTime {
        let started = *self.started.get_or_insert(host);
        let wanted = FlightTime::ZERO + host.saturating_since(started).saturating_sub(self.lost);
        let allowed = stepped + if must_wait { Duration::ZERO } else { LONGEST_CATCH_UP };
        self.lost += wanted.saturating_since(allowed);
        wanted.min(allowed).max(stepped)
    }

    fn ratio(&self, now: FlightTime) -> f64 {
        let flight_s = now.as_secs_f64();
        let host_s = flight_s + self.lost.as_secs_f64();
        if host_s > 0.0 { flight_s / host_s } else { 1.0 }
    }
}

impl SimulatorProcess {
    /// Renders in the calling thread: for lockstep.
    pub fn inline(setup: SimulatorSetup) -> Self {
        let optics = Optics::new(&setup);
        Self::new(setup, Eyes::Inline(optics))
    }

    /// Renders in a thread of its own: for real time.
    pub fn threaded(setup: SimulatorSetup) -> Self {
        let mut optics = Optics::new(&setup);
        let (orders, incoming) = sync_channel::<Order>(FRAMES_IN_WORK);
        let (outgoing, frames) = sync_channel::<Frame>(FRAMES_IN_WORK + 1);
        std::thread::spawn(move || {
            while let Ok(mut order) = incoming.recv() {
                optics.expose(order.world_from_camera, &mut order.image);
                if outgoing.send(order).is_err() {
                    return; // The process is ending.
                }
            }
        });
        Self::new(setup, Eyes::Thread { orders, frames, in_work: 0 })
    }

    fn new(mut setup: SimulatorSetup, eyes: Eyes) -> Self {
        let vehicle = setup.config.vehicle;
        let ground_m = setup.world.ground_height_m(setup.start.x, setup.start.y);
        setup.start.z = ground_m + vehicle.hull_height_m / 2.0;
        Self {
            vehicle: Vehicle::new(vehicle, setup.start, setup.start_yaw_rad),
            estimator: Estimator::new(
                EstimatorConfig {
                    delay_ms: setup.config.estimator.delay_ms + setup.trouble.lag_ms,
                    ..setup.config.estimator
                },
                setup.seed,
            ),
            troubles: Troubles::new(setup.trouble, setup.seed),
            faults: SensorFaults::new(&setup.faults),
            bad_sight: BadSight::new(setup.seed),
            collider: Collider::new(&setup.world, vehicle.hull_radius_m, vehicle.hull_height_m),
            eyes,
            ready: Vec::new(),
            spare: Vec::new(),
            stepped: FlightTime::ZERO,
            steps: 0,
            next_exposure: FlightTime::ZERO,
            frames: 0,
            clearance: Clearance { obstacles_m: 0.0, ground_m: 0.0 },
            collided: false,
            clock: PacedClock { started: None, lost: Duration::ZERO },
            host: HostTime::ZERO,
            report: Report::waiting("starting"),
            setup,
        }
    }

    /// The vehicle's true pose.
    pub fn world_from_body(&self) -> Pose<WorldFrame, Body> {
        self.vehicle.world_from_body()
    }

    /// The world that it flies in.
    pub fn world(&self) -> &Arc<World> {
        &self.setup.world
    }

    /// One step of the dynamics, up to `now`.
    fn advance(&mut self, now: FlightTime) {
        if let Some(velocity) = sticks(&self.setup.pilot, now) {
            self.vehicle.command(now, velocity, 0.0);
        }
        let (before, was_airborne) = (self.vehicle.world_from_body(), self.vehicle.airborne());
        let comes_down = self.vehicle.comes_down();
        let place = self.vehicle.position();
        let ground_m = self.setup.world.ground_height_m(place.x, place.y);
        let wind = self.troubles.wind(STEP.as_secs_f64());
        self.vehicle.step(now, STEP.as_secs_f64(), ground_m, wind);
        let after = self.vehicle.world_from_body();
        if self.vehicle.airborne() || was_airborne {
            // The ground counts once the vehicle has cleared it.
            let cleared = place.z - self.setup.start.z > 0.5 || self.collided;
            // On a slope the rim meets it first.
            let touches_down = comes_down || !self.vehicle.airborne();
            let ground = (cleared || place.distance(self.setup.start) > 1.0) && !touches_down;
            self.collided |= self.collider.collides(before, after, ground);
        }
        self.stepped = now;
        self.steps += 1;
    }

    fn publish_state(&mut self, ports: &mut impl Ports) {
        let (now, pose) = (self.stepped, self.vehicle.world_from_body());
        let believed =
            Pose { translation: pose.translation + self.setup.trouble.jump(now) + self.faults.jump(now), ..pose };
        self.estimator.measure(now, believed, self.vehicle.velocity());
        let ratio = self.clock.ratio(now);
        let host_ns = self.host.as_nanos();
        let piloted = sticks(&self.setup.pilot, now).is_some();
        let landed = u32::from(!self.vehicle.airborne());
        // Of this instant: the dynamics lag behind it by part of a step.
        let reading_ns = ports.now().max(now).as_nanos() + self.faults.clock_step_ns(now);
        ports.publish::<Clock>(now, 0, |clock, _| {
            (clock.flight_ns, clock.host_ns, clock.rate) = (reading_ns, host_ns, 1.0);
        });
        while let Some(estimate) = self.estimator.deliver(now) {
            ports.publish::<State>(estimate.valid, 0, |state, _| {
                state.position_m = estimate.world_from_body.origin().to_array();
                state.velocity_mps = estimate.velocity.to_array();
                state.orientation = estimate.world_from_body.rotation.to_wxyz();
                (state.piloted, state.landed) = (u32::from(piloted), landed);
            });
        }
        self.clearance = self.collider.clearance(pose);
        ports.publish::<Truth>(now, 0, |truth, _| {
            truth.position_m = pose.origin().to_array();
            truth.velocity_mps = self.vehicle.velocity().to_array();
            truth.orientation = pose.rotation.to_wxyz();
            truth.clearance_m = self.clearance.obstacles_m.min(self.clearance.ground_m);
            truth.obstacle_clearance_m = self.clearance.obstacles_m;
            truth.collided = u32::from(self.collided);
            truth.airborne = u32::from(self.vehicle.airborne());
            truth.frames = self.frames;
            truth.clock_ratio = ratio;
        });
    }

    fn expose(&mut self) {
        let interval = Duration::from_secs_f64(1.0 / self.setup.config.camera.rate_hz);
        let exposure = self.stepped;
        self.next_exposure = exposure + interval;
        let image = self.spare.pop().unwrap_or_else(|| Optics::image(&self.setup));
        let world_from_camera = camera_pose(self.vehicle.world_from_body(), self.setup.mount.body_from_camera());
        let mut order = Order { exposure, world_from_camera, image };
        match &mut self.eyes {
            Eyes::Inline(optics) => {
                optics.expose(world_from_camera, &mut order.image);
                self.ready.push(order);
            }
            // A renderer that died would be noticed as missing frames: nothing can be rendered without it.
            Eyes::Thread { orders, in_work, .. } => *in_work += usize::from(orders.send(order).is_ok()),
        }
    }

    fn publish_frames(&mut self, ports: &mut impl Ports) {
        if let Eyes::Thread { frames, in_work, .. } = &mut self.eyes {
            while let Ok(frame) = frames.try_recv() {
                *in_work -= 1;
                self.ready.push(frame);
            }
        }
        let latency = Duration::from_secs_f64(self.setup.config.camera.latency_ms * 1e-3);
        while self.ready.first().is_some_and(|frame| frame.exposure + latency <= self.stepped) {
            let frame = self.ready.remove(0);
            if self.troubles.loses(frame.exposure) {
                self.spare.push(frame.image);
                continue;
            }
            let (rig, sight, bad_sight) = (self.setup.rig, self.faults.sight(frame.exposure), &mut self.bad_sight);
            match &frame.image {
                Image::Pair(pair) => ports.publish::<StereoFrames>(frame.exposure, pair.len(), |header, pixels| {
                    (header.width_px, header.height_px) = (rig.width_px, rig.height_px);
                    pixels.copy_from_slice(pair);
                    bad_sight.pair(sight, pixels);
                }),
                Image::Disparity(disparity) => {
                    ports.publish::<DepthFrames>(frame.exposure, disparity.len(), |header, pixels| {
                        (header.width_px, header.height_px) = (rig.width_px, rig.height_px);
                        pixels.copy_from_slice(disparity);
                        bad_sight.disparity(sight, pixels);
                    });
                }
            }
            self.frames += 1;
            self.spare.push(frame.image);
        }
    }
}

impl Process for SimulatorProcess {
    const ID: ProcessId = ProcessId::Simulator;

    fn connect(&self, connect: &mut impl Connect) {
        connect.reads::<Setpoints>();
        connect.writes::<Clock>();
        connect.writes::<State>();
        match self.setup.noise_camera {
            false => connect.writes::<StereoFrames>(),
            true => connect.writes::<DepthFrames>(),
        }
        connect.writes::<Truth>();
    }

    fn step<P: Ports>(&mut self, ports: &mut P) -> Report {
        if let Some(setpoint) = ports.latest::<Setpoints>() {
            let setpoint = setpoint.header();
            // By the time of receipt: the flight control unit has no other clock. What is only to be recorded it does not follow.
            if SetpointMode::from_wire(setpoint.mode) != SetpointMode::Shadow {
                let velocity = Vector::from_array(setpoint.velocity_mps);
                self.vehicle.command(self.stepped, velocity, setpoint.yaw_rate_radps);
            }
        }
        while self.stepped + STEP <= ports.now() {
            self.advance(self.stepped + STEP);
            if self.steps.is_multiple_of(STEPS_PER_STATE) {
                self.publish_state(ports);
            }
            if self.stepped >= self.next_exposure {
                self.expose();
            }
        }
        self.publish_frames(ports);
        self.report.worked()
    }

    fn next_wake(&self) -> Option<FlightTime> {
        Some(self.stepped + STEP)
    }

    fn flight_time(&mut self, host: HostTime) -> Option<FlightTime> {
        let busy = match &self.eyes {
            Eyes::Inline(_) => false,
            // A frame is still being rendered when the next is due: flight time waits for it, nothing else does.
            Eyes::Thread { in_work, .. } => *in_work >= FRAMES_IN_WORK && self.stepped + STEP >= self.next_exposure,
        };
        self.host = host;
        Some(self.clock.at(host, self.stepped, busy))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn flight_time_slows_down_instead_of_jumping() {
        let mut clock = PacedClock { started: None, lost: Duration::ZERO };
        let host = HostTime::from_secs_f64;
        assert_eq!(clock.at(host(100.0), FlightTime::ZERO, false), FlightTime::ZERO);
        assert_eq!(clock.at(host(100.02), FlightTime::ZERO, false).as_secs_f64(), 0.02);
        // The simulation was stuck for a second: it may catch up 50 ms, the rest is lost.
        let now = clock.at(host(101.02), FlightTime::from_secs_f64(0.02), false);
        assert!((now.as_secs_f64() - 0.07).abs() < 1e-9);
        assert!(clock.ratio(now) < 0.1);
        assert_eq!(clock.at(host(101.5), now, true), now, "waits for a frame");
    }
}
