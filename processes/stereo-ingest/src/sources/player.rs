//! The player process: feeds the graph from image files instead of cameras.

use super::sequence::{FrameImage, Sequence, SequenceFrame};
use ipc_types::messages::{FlightClock, VehicleState};
use ipc_types::topics::{Clock, DepthFrames, HealthReports, State, StereoFrames};
use ipc_types::{FlightTime, HostTime, ProcessId};
use runtime::{Connect, Message, Ports, Process, Report, host_now};
use std::time::Duration;

/// What the player's health says once every frame has been shown.
pub const ALL_SHOWN: &str = "all frames shown";

/// Between two showings of the last frame.
const AGAIN_INTERVAL: Duration = Duration::from_millis(500);
/// Between two states.
const STATE_INTERVAL: Duration = Duration::from_millis(10);

/// Shows the frames of a sequence, each at its exposure, seen by a vehicle at rest at the world's origin; then the last
/// one again and again. Without a sequence it is the vehicle alone, for live cameras to look from.
///
/// It begins when every process that it was told of has been heard: one that is still starting would miss frames. Files
/// that cannot be read are told, counted and left out.
#[derive(Debug)]
pub struct Player {
    sequence: Option<Sequence>,
    size_px: (u32, u32),
    awaited: Vec<ProcessId>,
    started: HostTime,
    next_state: FlightTime,
    /// When the first frame is shown, once that is known.
    begins: Option<FlightTime>,
    /// The frame to be shown next, and its image, read ahead.
    next: usize,
    ahead: Option<FrameImage>,
    /// Whether it has not been shown yet.
    is_ahead: bool,
    /// When the last one is shown again, once all have been shown.
    again: Option<FlightTime>,
    report: Report,
}

impl Player {
    /// For images of a size, to begin when the `awaited` processes are there.
    pub fn new(sequence: Option<Sequence>, size_px: (u32, u32), awaited: Vec<ProcessId>) -> Self {
        let mut report = Report::waiting("waiting for the other processes");
        report.dropped = sequence.as_ref().map_or(0, |sequence| sequence.unpaired as u64);
        Self {
            sequence,
            size_px,
            awaited,
            started: host_now(),
            next_state: FlightTime::ZERO,
            begins: None,
            next: 0,
            ahead: None,
            is_ahead: false,
            again: None,
            report,
        }
    }

    fn publish_vehicle(&mut self, ports: &mut impl Ports) {
        let now = ports.now();
        let host_ns = (self.started + now.saturating_since(FlightTime::ZERO)).as_nanos();
        ports.publish::<Clock>(now, 0, |clock: &mut FlightClock, _| {
            (clock.flight_ns, clock.host_ns, clock.rate) = (now.as_nanos(), host_ns, 1.0);
        });
        ports.publish::<State>(now, 0, |state: &mut VehicleState, _| state.orientation = [1.0, 0.0, 0.0, 0.0]);
    }

    /// Reads the next frame ahead; leaves it out if it cannot be read or is of another size. One file at a time, so that the
    /// vehicle goes on meanwhile.
    fn read_ahead(&mut self, now: FlightTime) {
        let Some(frame) = self.frame() else { return };
        let problem = match frame.load() {
            Ok(image) if image.size_px() == self.size_px => {
                (self.ahead, self.is_ahead) = (Some(image), true);
                return;
            }
            Ok(image) => {
                let ((width, height), (expected_width, expected_height)) = (image.size_px(), self.size_px);
                let path = frame.left.display();
                format!("{path}: is {width} x {height} px, expected {expected_width} x {expected_height} px")
            }
            Err(error) => error.to_string(),
        };
        eprintln!("sparrowhawk: left out: {problem}");
        self.report.dropped += 1;
        self.next += 1;
        self.again = self.frame().is_none().then_some(now);
    }

    /// The frame to be shown next; none once all have been.
    fn frame(&self) -> Option<&SequenceFrame> {
        self.sequence.as_ref()?.frames.get(self.next)
    }

    /// Whether it has still to be read.
    fn must_read(&self) -> bool {
        self.begins.is_some() && self.frame().is_some() && !self.is_ahead
    }

    /// Exposure of the next frame, or of the next showing of the last.
    fn due(&self) -> Option<FlightTime> {
        let begins = self.begins?;
        match self.frame() {
            Some(frame) => Some(FlightTime::from_nanos(begins.as_nanos().saturating_add(frame.at_ns))),
            None => self.again,
        }
    }

    fn show(&mut self, ports: &mut impl Ports, exposure: FlightTime) {
        match &self.ahead {
            Some(FrameImage::Pair(pair)) => {
                ports.publish::<StereoFrames>(exposure, pair.pixels.len(), |frame, pixels| {
                    (frame.width_px, frame.height_px) = (pair.width_px, pair.height_px);
                    pixels.copy_from_slice(&pair.pixels);
                })
            }
            Some(FrameImage::Depth(depth)) => {
                ports.publish::<DepthFrames>(exposure, depth.values.len(), |frame, values| {
                    (frame.width_px, frame.height_px) = (depth.width_px, depth.height_px);
                    values.copy_from_slice(&depth.values);
                })
            }
            None => {}
        }
        // The image stays until another one is read: the last of them is shown again.
        if !std::mem::replace(&mut self.is_ahead, false) {
            self.again = Some(exposure + AGAIN_INTERVAL);
        } else {
            self.next += 1;
            self.again = self.frame().is_none().then(|| exposure + AGAIN_INTERVAL);
        }
    }
}

impl Process for Player {
    const ID: ProcessId = ProcessId::Player;

    fn connect(&self, connect: &mut impl Connect) {
        connect.writes::<Clock>();
        connect.writes::<State>();
        connect.writes::<StereoFrames>();
        connect.writes::<DepthFrames>();
        connect.reads::<HealthReports>();
    }

    fn step<P: Ports>(&mut self, ports: &mut P) -> Report {
        let now = ports.now();
        let mut did = false;
        if now >= self.next_state {
            self.next_state = now + STATE_INTERVAL;
            self.publish_vehicle(ports);
            did = true;
        }
        while let Some(health) = ports.receive::<HealthReports>() {
            let heard = ProcessId::from_wire(health.header().stamp.producer);
            self.awaited.retain(|&process| Some(process) != heard);
        }
        if self.awaited.is_empty() && self.begins.is_none() {
            self.begins = Some(ports.now() + STATE_INTERVAL);
        }
        if self.must_read() {
            self.read_ahead(now);
            did = true;
        } else if let Some(exposure) = self.due().filter(|&exposure| exposure <= now) {
            self.show(ports, exposure);
            did = true;
        }
        if self.begins.is_none() {
            return self.report.idle();
        }
        let report = if did { self.report.worked() } else { self.report.idle() };
        Report { note: if self.again.is_some() { ALL_SHOWN } else { report.note }, ..report }
    }

    fn next_wake(&self) -> Option<FlightTime> {
        let next = if self.must_read() { Some(FlightTime::ZERO) } else { self.due() };
        Some(next.map_or(self.next_state, |next| next.min(self.next_state)))
    }

    fn flight_time(&mut self, host: HostTime) -> Option<FlightTime> {
        Some(FlightTime::ZERO + host.saturating_since(self.started))
    }
}
