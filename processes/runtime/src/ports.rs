//! What a process sees of the world: topics in, topics out, the time, and the image store.

use crate::images::ImageStore;
use ipc_types::messages::HealthLevel;
use ipc_types::topics::Topic;
use ipc_types::{FlightTime, HostTime, ProcessId};
use rustix::time::{ClockId, clock_gettime};

/// A received message, held where it lies.
pub trait Message<T: Topic> {
    /// Fixed-size part.
    fn header(&self) -> &T::Header;
    /// The slice: pixels, points, or nothing.
    fn elements(&self) -> &[T::Element];
}

/// A process' connection to the rest of the graph.
pub trait Ports {
    /// How this driver holds a received message.
    type Message<T: Topic>: Message<T>;

    /// Flight time of this step.
    fn now(&self) -> FlightTime;

    /// The oldest message not yet received, if any.
    fn receive<T: Topic>(&mut self) -> Option<Self::Message<T>>;

    /// The newest message not yet received, if any; older ones are dropped.
    fn latest<T: Topic>(&mut self) -> Option<Self::Message<T>> {
        let mut newest = None;
        while let Some(message) = self.receive::<T>() {
            newest = Some(message);
        }
        newest
    }

    /// Publishes a message with `elements` elements, written in place. The header starts as zeros except for its
    /// stamp, which the driver fills; the elements' initial content is unspecified and must all be written.
    fn publish<T: Topic>(
        &mut self,
        valid: FlightTime,
        elements: usize,
        fill: impl FnOnce(&mut T::Header, &mut [T::Element]),
    );

    /// Images that outlive their writer.
    fn images(&mut self) -> &mut ImageStore;
}

/// Declares which topics a process reads and writes.
pub trait Connect {
    /// The process reads this topic.
    fn reads<T: Topic>(&mut self);
    /// The process writes this topic.
    fn writes<T: Topic>(&mut self);
}

/// A pure core with its topics attached. Reads no clock, opens no file, starts no thread, draws no unseeded number; but for
/// those at the graph's edge, which stand for the world: simulator, player, camera and recorder.
pub trait Process {
    /// Which node of the graph this is.
    const ID: ProcessId;

    /// Declares the topics. Called once, before the first step.
    fn connect(&self, connect: &mut impl Connect);

    /// Takes what has arrived and publishes what follows from it. Called at every wake-up, also spurious ones.
    fn step<P: Ports>(&mut self, ports: &mut P) -> Report;

    /// When to be stepped next even if nothing arrives.
    fn next_wake(&self) -> Option<FlightTime> {
        None
    }

    /// For the process that makes flight time (a simulator, an aircraft's clock): flight time at a host time.
    fn flight_time(&mut self, _host: HostTime) -> Option<FlightTime> {
        None
    }

    /// Called once, after the last step, when the process was told to stop.
    fn finish<P: Ports>(&mut self, _ports: &mut P) {}

    /// Host-time housekeeping of what is not pure, such as flushing a file. Never called in lockstep.
    fn housekeep(&mut self) {}
}

/// What a step reports: the process' health, kept from step to step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Report {
    /// Grade.
    pub level: HealthLevel,
    /// What is wrong or awaited; empty when all is well.
    pub note: &'static str,
    /// Messages refused since start.
    pub dropped: u64,
    /// Whether this step did work, rather than find nothing to do.
    pub worked: bool,
}

impl Report {
    /// Nothing has arrived yet.
    pub const fn waiting(note: &'static str) -> Self {
        Self { level: HealthLevel::Degraded, note, dropped: 0, worked: false }
    }

    /// A step with nothing to do: health is as before.
    pub fn idle(&mut self) -> Self {
        self.worked = false;
        *self
    }

    /// A step that did its work.
    pub fn worked(&mut self) -> Self {
        *self = Self { level: HealthLevel::Ok, note: "", dropped: self.dropped, worked: true };
        *self
    }

    /// A step that did its work with less than it should have.
    pub fn degraded(&mut self, note: &'static str) -> Self {
        *self = Self { level: HealthLevel::Degraded, note, dropped: self.dropped, worked: true };
        *self
    }

    /// A message was refused.
    pub fn refuse(&mut self, note: &'static str) -> Self {
        *self = Self { level: HealthLevel::Faulted, note, dropped: self.dropped + 1, worked: false };
        *self
    }
}

/// The machine's monotonic clock.
pub fn host_now() -> HostTime {
    let now = clock_gettime(ClockId::Monotonic);
    HostTime::from_nanos(now.tv_sec * 1_000_000_000 + now.tv_nsec)
}
