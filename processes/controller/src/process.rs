//! The controller process: trajectory and state in, velocity setpoints out.

use crate::{Config, Reference, Tracker};
use bytemuck::Zeroable;
use ipc_types::estates::ControllerEstate;
use ipc_types::limits::Fence;
use ipc_types::messages::{PlanMode, SetpointMode, Trajectory, TrajectoryPoint, VehicleState};
use ipc_types::topics::{Plan, Setpoints, State};
use ipc_types::{FlightTime, Point, ProcessId, Vector};
use runtime::estate::{inherit, leave};
use runtime::{Connect, Message, Ports, Process, Report};
use std::time::Duration;

/// Connects a [`Tracker`] to its topics.
#[derive(Debug)]
pub struct ControllerProcess {
    tracker: Tracker,
    state: Option<VehicleState>,
    reference: Option<Reference>,
    /// Header of the reference, as it was received.
    trajectory: Trajectory,
    interval: Duration,
    next: FlightTime,
    started: bool,
    /// When it could first have asked for anything.
    first: Option<FlightTime>,
    estate: Vec<u16>,
    report: Report,
}

/// An estate that is older than this is not gone on from, s: the vehicle has been braked meanwhile.
const LAPSES_S: f64 = 1.0;
/// So long a first state is waited for, s.
const AWAITED_S: f64 = 0.1;
/// So long a flight control unit surely goes on with the last setpoint, s.
const FOLLOWED_S: f64 = 0.2;

impl ControllerProcess {
    /// With gains and limits.
    pub fn new(config: Config, fence: Fence) -> Self {
        Self {
            tracker: Tracker::new(config, fence),
            state: None,
            reference: None,
            trajectory: Trajectory::zeroed(),
            started: false,
            first: None,
            estate: Vec::new(),
            interval: Duration::from_secs_f64(1.0 / config.rate_hz),
            next: FlightTime::ZERO,
            report: Report::waiting("waiting for a trajectory"),
        }
    }

    fn take_inputs(&mut self, ports: &mut impl Ports) {
        if let Some(state) = ports.latest::<State>() {
            self.state = Some(*state.header());
        }
        if let Some(plan) = ports.latest::<Plan>() {
            self.take_plan(plan.header(), plan.elements());
        }
    }

    fn take_plan(&mut self, header: &Trajectory, points: &[TrajectoryPoint]) {
        let ordered = points.windows(2).all(|pair| pair[0].t_s < pair[1].t_s);
        let finite = points.iter().all(|point| {
            point
                .position_m
                .iter()
                .chain(&point.velocity_mps)
                .chain([&point.t_s, &point.yaw_rad])
                .all(|v| v.is_finite())
        });
        if ordered && finite {
            self.reference = Some(Reference {
                start: FlightTime::from_nanos(header.stamp.valid_ns),
                published: FlightTime::from_nanos(header.stamp.published_ns),
                image: FlightTime::from_nanos(header.image_valid_ns),
                mode: PlanMode::from_wire(header.mode),
                points: points.to_vec(),
            });
            self.trajectory = *header;
        } else {
            self.report.refuse("trajectory is out of order or not finite");
        }
    }

    /// Takes up what a predecessor left, so that nothing jumps.
    fn inherit(&mut self, ports: &mut impl Ports) {
        let now = ports.now();
        let Some((estate, points)) = inherit::<ControllerEstate, TrajectoryPoint>(ports.images(), Self::ID) else {
            return;
        };
        let at = FlightTime::from_nanos(estate.commanded_ns);
        let command = Vector::from_array(estate.command_mps);
        let hover_at = (estate.hovers != 0).then(|| Point::from_array(estate.hover_m));
        let is_sane = command.is_finite() && hover_at.is_none_or(Point::is_finite);
        let age_s = now.seconds_since(at);
        if !is_sane || !(0.0..=LAPSES_S).contains(&age_s) {
            return;
        }
        // The flight control unit has followed the last command until it began to brake by itself: from then on only the
        // state tells how fast the vehicle is.
        let state = self.state.filter(|state| state.velocity().is_finite());
        let command = if age_s <= FOLLOWED_S { Some(command) } else { state.map(|state| state.velocity()) };
        if let Some(command) = command {
            self.tracker.resume(command, now.max(at), hover_at);
        }
        if !points.is_empty() && self.reference.is_none() {
            self.take_plan(&estate.trajectory, &points);
        }
    }

    /// Leaves to a successor what it needs. Where that cannot be stored, a successor begins by braking.
    fn leave(&mut self, ports: &mut impl Ports) {
        let (command, at, hover_at) = self.tracker.last();
        let Some(at) = at else { return };
        let estate = ControllerEstate {
            trajectory: self.trajectory,
            commanded_ns: at.as_nanos(),
            command_mps: command.to_array(),
            hover_m: hover_at.unwrap_or(Point::ZERO).to_array(),
            hovers: u64::from(hover_at.is_some()),
        };
        let points = self.reference.as_ref().map_or(&[][..], |reference| &reference.points);
        let _ = leave(ports.images(), Self::ID, &estate, points, &mut self.estate);
    }
}

impl Process for ControllerProcess {
    const ID: ProcessId = ProcessId::Controller;

    fn connect(&self, connect: &mut impl Connect) {
        connect.reads::<State>();
        connect.reads::<Plan>();
        connect.writes::<Setpoints>();
    }

    fn step<P: Ports>(&mut self, ports: &mut P) -> Report {
        let now = ports.now();
        self.take_inputs(ports);
        if now < self.next || now == FlightTime::ZERO {
            return self.report.idle();
        }
        if !self.started {
            // The flight control unit goes on with what a predecessor asked for last; a state is here in a moment.
            let first = *self.first.get_or_insert(now);
            if self.state.is_none() && now.seconds_since(first) < AWAITED_S {
                return self.report.idle();
            }
            self.started = true;
            self.inherit(ports);
        }
        // On the beat, unless one was missed altogether.
        let due = self.next + self.interval;
        self.next = if due > now { due } else { now + self.interval };
        let command = self.tracker.step(now, self.state.as_ref(), self.reference.as_ref());
        let has_landed = self.reference.as_ref().is_some_and(|reference| reference.mode == PlanMode::Landed);
        let image = self.reference.as_ref().map_or(FlightTime::ZERO, |reference| reference.image);
        ports.publish::<Setpoints>(now, 0, |setpoint, _| {
            setpoint.velocity_mps = command.velocity.to_array();
            setpoint.yaw_rate_radps = command.yaw_rate_radps;
            setpoint.image_valid_ns = image.as_nanos();
            setpoint.mode = command.mode as u32;
        });
        self.leave(ports);
        match command.mode {
            SetpointMode::Track => self.report.worked(),
            SetpointMode::Idle if has_landed => self.report.worked(),
            SetpointMode::Idle => self.report.degraded("waiting for a trajectory"),
            SetpointMode::Brake => self.report.degraded("input is stale: braking"),
            SetpointMode::Shadow => self.report.degraded("a pilot flies: commands are not followed"),
            SetpointMode::Hover => self.report.degraded("input is stale: hovering"),
        }
    }

    fn next_wake(&self) -> Option<FlightTime> {
        Some(self.next)
    }
}
