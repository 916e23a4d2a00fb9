//! The player process: feeds the graph from image files instead of cameras.

use crate::StereoPair;
use ipc_types::messages::{FlightClock, VehicleState};
use ipc_types::topics::{Clock, State, StereoFrames};
use ipc_types::{FlightTime, HostTime, ProcessId};
use runtime::{Connect, Ports, Process, Report, host_now};
use std::time::Duration;

/// Between two showings of the pair.
const FRAME_INTERVAL: Duration = Duration::from_millis(500);
/// Between two states.
const STATE_INTERVAL: Duration = Duration::from_millis(10);

/// Shows one rectified pair again and again, seen by a vehicle at rest at the world's origin.
///
/// It is shown more than once because a process that is still starting misses what came before.
#[derive(Debug)]
pub struct PairPlayer {
    pair: StereoPair,
    started: HostTime,
    next_state: FlightTime,
    next_frame: FlightTime,
    report: Report,
}

impl PairPlayer {
    /// For a pair already read and checked.
    pub fn new(pair: StereoPair) -> Self {
        Self {
            pair,
            started: host_now(),
            next_state: FlightTime::ZERO,
            next_frame: FlightTime::ZERO,
            report: Report::waiting("starting"),
        }
    }
}

impl Process for PairPlayer {
    const ID: ProcessId = ProcessId::Player;

    fn connect(&self, connect: &mut impl Connect) {
        connect.writes::<Clock>();
        connect.writes::<State>();
        connect.writes::<StereoFrames>();
    }

    fn step<P: Ports>(&mut self, ports: &mut P) -> Report {
        let now = ports.now();
        if now < self.next_state {
            return self.report.idle();
        }
        self.next_state = now + STATE_INTERVAL;
        let host_ns = (self.started + now.saturating_since(FlightTime::ZERO)).as_nanos();
        ports.publish::<Clock>(now, 0, |clock: &mut FlightClock, _| {
            (clock.flight_ns, clock.host_ns, clock.rate) = (now.as_nanos(), host_ns, 1.0);
        });
        ports.publish::<State>(now, 0, |state: &mut VehicleState, _| state.orientation = [1.0, 0.0, 0.0, 0.0]);
        if now >= self.next_frame {
            self.next_frame = now + FRAME_INTERVAL;
            let pair = &self.pair;
            ports.publish::<StereoFrames>(now, pair.pixels.len(), |frame, pixels| {
                (frame.width_px, frame.height_px) = (pair.width_px, pair.height_px);
                pixels.copy_from_slice(&pair.pixels);
            });
        }
        self.report.worked()
    }

    fn next_wake(&self) -> Option<FlightTime> {
        Some(self.next_state)
    }

    fn flight_time(&mut self, host: HostTime) -> Option<FlightTime> {
        Some(FlightTime::ZERO + host.saturating_since(self.started))
    }
}
