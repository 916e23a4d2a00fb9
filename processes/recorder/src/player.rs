//! The player process for logs: feeds the graph with what a recorded flight's was fed with.

use crate::inputs::Input;
use ipc_types::topics::{Answers, Clock, DepthFrames, Disparity, Goals, HealthReports, State, StereoFrames, Topic};
use ipc_types::{FlightTime, HostTime, ProcessId};
use runtime::{Connect, Message, Ports, Process, Report};
use std::time::Duration;

/// What the player's health says once everything has been played.
pub const ALL_PLAYED: &str = "all of the log played";

/// Between two looks at what is due, unless something is due before: as the simulator steps, so that a lockstep graph is stepped
/// in the order that it was flown in.
const STEP: Duration = Duration::from_millis(5);
/// Between two readings of the clock.
const CLOCK_INTERVAL: Duration = Duration::from_millis(10);

/// Publishes every message at the flight time at which it was published, by a clock of its own that runs at a playback rate, flight time per host time: 1 is as it
/// was flown.
///
/// It begins when every process that it was told of has been heard: one that is still starting would miss something. In
/// lockstep it is told of none, and time is not its own.
#[derive(Debug)]
pub struct LogPlayer {
    inputs: Vec<Input>,
    next: usize,
    awaited: Vec<ProcessId>,
    playback_rate: f64,
    /// Flight time at which it begins, and host time at which it began.
    from: FlightTime,
    began: Option<HostTime>,
    host: HostTime,
    next_clock: HostTime,
    stepped: FlightTime,
    report: Report,
}

impl LogPlayer {
    /// For what is to be played, in the order published, at a playback rate, to begin when the `awaited` processes are there.
    pub fn new(inputs: Vec<Input>, playback_rate: f64, awaited: Vec<ProcessId>) -> Self {
        let from = inputs.first().map_or(FlightTime::ZERO, Input::published);
        Self {
            inputs,
            next: 0,
            awaited,
            playback_rate,
            from,
            began: None,
            host: HostTime::ZERO,
            next_clock: HostTime::ZERO,
            stepped: FlightTime::ZERO,
            report: Report::waiting("waiting for the other processes"),
        }
    }

    fn publish_clock(&self, ports: &mut impl Ports) {
        let now = ports.now();
        let (host_ns, rate) = (self.host.as_nanos(), if self.began.is_some() { self.playback_rate } else { 0.0 });
        ports.publish::<Clock>(now, 0, |clock, _| {
            (clock.flight_ns, clock.host_ns, clock.rate) = (now.as_nanos(), host_ns, rate);
        });
    }
}

fn publish(input: &Input, ports: &mut impl Ports) {
    match input.topic {
        name if name == State::INFO.name => publish_on::<State>(input, ports),
        name if name == Goals::INFO.name => publish_on::<Goals>(input, ports),
        name if name == Answers::INFO.name => publish_on::<Answers>(input, ports),
        name if name == StereoFrames::INFO.name => publish_on::<StereoFrames>(input, ports),
        name if name == DepthFrames::INFO.name => publish_on::<DepthFrames>(input, ports),
        _ => publish_on::<Disparity>(input, ports),
    }
}

/// As it was published, but for the stamp, which is the player's.
fn publish_on<T: Topic>(input: &Input, ports: &mut impl Ports) {
    let count = input.elements.len() / size_of::<T::Element>().max(1);
    let valid = FlightTime::from_nanos(input.stamp.valid_ns);
    ports.publish::<T>(valid, count, |header, elements| {
        *header = bytemuck::pod_read_unaligned(&input.header);
        let bytes: &mut [u8] = bytemuck::cast_slice_mut(elements);
        let length = bytes.len();
        bytes.copy_from_slice(&input.elements[..length]);
    });
}

impl Process for LogPlayer {
    const ID: ProcessId = ProcessId::Player;

    fn connect(&self, connect: &mut impl Connect) {
        connect.writes::<Clock>();
        connect.writes::<State>();
        connect.writes::<Goals>();
        connect.writes::<Answers>();
        connect.writes::<StereoFrames>();
        connect.writes::<DepthFrames>();
        connect.writes::<Disparity>();
        connect.reads::<HealthReports>();
    }

    fn step<P: Ports>(&mut self, ports: &mut P) -> Report {
        while let Some(health) = ports.receive::<HealthReports>() {
            let heard = ProcessId::from_wire(health.header().stamp.producer);
            self.awaited.retain(|&process| Some(process) != heard);
        }
        let now = ports.now();
        self.stepped = now;
        if self.host >= self.next_clock {
            self.next_clock = self.host + CLOCK_INTERVAL;
            self.publish_clock(ports);
        }
        if !self.awaited.is_empty() {
            return self.report.idle();
        }
        let due = self.inputs[self.next..].iter().take_while(|input| input.published() <= now).count();
        for input in &self.inputs[self.next..self.next + due] {
            publish(input, ports);
        }
        self.next += due;
        let report = if due > 0 { self.report.worked() } else { self.report.idle() };
        Report { note: if self.next == self.inputs.len() { ALL_PLAYED } else { report.note }, ..report }
    }

    fn next_wake(&self) -> Option<FlightTime> {
        let due = self.inputs.get(self.next).filter(|_| self.awaited.is_empty()).map(Input::published);
        let wait = due.map_or(STEP, |due| due.saturating_since(self.stepped).min(STEP));
        // Whoever makes time is woken by host time.
        Some(self.stepped + wait.div_f64(self.playback_rate))
    }

    fn flight_time(&mut self, host: HostTime) -> Option<FlightTime> {
        self.host = host;
        if self.awaited.is_empty() {
            self.began.get_or_insert(host);
        }
        let played =
            self.began.map_or(Duration::ZERO, |began| host.saturating_since(began).mul_f64(self.playback_rate));
        Some(self.from + played)
    }
}
