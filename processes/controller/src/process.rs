//! The controller process: trajectory and state in, velocity setpoints out.

use crate::{Config, Reference, Tracker};
use ipc_types::limits::Fence;
use ipc_types::messages::{PlanMode, SetpointMode, VehicleState};
use ipc_types::topics::{Plan, Setpoints, State};
use ipc_types::{FlightTime, ProcessId};
use runtime::{Connect, Message, Ports, Process, Report};
use std::time::Duration;

/// Connects a [`Tracker`] to its topics.
#[derive(Debug)]
pub struct ControllerProcess {
    tracker: Tracker,
    state: Option<VehicleState>,
    reference: Option<Reference>,
    interval: Duration,
    next: FlightTime,
    report: Report,
}

impl ControllerProcess {
    /// With gains and limits.
    pub fn new(config: Config, fence: Fence) -> Self {
        Self {
            tracker: Tracker::new(config, fence),
            state: None,
            reference: None,
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
            let (header, points) = (plan.header(), plan.elements());
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
            } else {
                self.report.refuse("trajectory is out of order or not finite");
            }
        }
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
