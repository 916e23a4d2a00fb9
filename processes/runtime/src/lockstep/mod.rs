//! The driver that repeats: all processes in one thread, in a fixed order, seeded, without shared memory.
//!
//! It is not a world without latency. A step that publishes takes as long as [`Latency`] draws for its process:
//! until then its messages are not delivered and the process is busy, so frames that arrive meanwhile overwrite
//! each other as they do in flight. Same seed, same flight, to the bit; the log hash proves it.

mod bus;
mod latency;

pub use bus::{LockstepMessage, LockstepPorts};
pub use latency::{Latency, LatencyModel};

use crate::images::ImageStore;
use crate::ports::{Connect, Ports, Process, Report};
use bus::Bus;
use hdrhistogram::Histogram;
use ipc_types::topics::HealthReports;
use ipc_types::wire::Text;
use ipc_types::{FlightTime, ProcessId};
use std::cell::RefCell;
use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::rc::Rc;
use std::time::{Duration, Instant};

/// A process in the lockstep graph, whatever its type.
trait Node {
    fn id(&self) -> ProcessId;
    fn step(&mut self) -> Report;
    fn next_wake(&self) -> Option<FlightTime>;
    fn ports(&mut self) -> &mut LockstepPorts;
}

struct NodeOf<P: Process> {
    process: Rc<RefCell<P>>,
    ports: LockstepPorts,
}

impl<P: Process> Node for NodeOf<P> {
    fn id(&self) -> ProcessId {
        P::ID
    }
    fn step(&mut self) -> Report {
        self.process.borrow_mut().step(&mut self.ports)
    }
    fn next_wake(&self) -> Option<FlightTime> {
        self.process.borrow().next_wake()
    }
    fn ports(&mut self) -> &mut LockstepPorts {
        &mut self.ports
    }
}

struct Slot {
    node: Box<dyn Node>,
    latency: Latency,
    busy_until: FlightTime,
    /// Earliest wake-up already in the queue.
    wake_at: Option<FlightTime>,
    next_beat: FlightTime,
    steps: u64,
    /// Host time of the steps that had work, µs. It influences nothing.
    step_times_us: Histogram<u64>,
}

/// Longer steps are not told apart, µs.
const LONGEST_STEP_US: u64 = 60_000_000;

fn step_times() -> Histogram<u64> {
    // Constant bounds that are valid.
    Histogram::new_with_max(LONGEST_STEP_US, 2).unwrap_or_else(|_| unreachable!("bounds are valid"))
}

/// Flight time between heartbeats.
const HEARTBEAT: Duration = Duration::from_millis(100);

#[derive(PartialEq, Eq, PartialOrd, Ord)]
enum Event {
    /// Message number `n` of the bus arrives.
    Deliver(u64),
    /// The process in slot `n` is stepped.
    Wake(usize),
}

/// A graph of processes in one thread.
pub struct Lockstep {
    bus: Rc<RefCell<Bus>>,
    slots: Vec<Slot>,
    queue: BinaryHeap<Reverse<(FlightTime, u64, Event)>>,
    order: u64,
    now: FlightTime,
    seed: u64,
    model: LatencyModel,
    images: ImageStore,
}

impl std::fmt::Debug for Lockstep {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Lockstep({} processes at {:.3} s)", self.slots.len(), self.now.as_secs_f64())
    }
}

impl Lockstep {
    /// An empty graph. `seed` drives the latency model alone.
    pub fn new(seed: u64, model: LatencyModel) -> Self {
        Self {
            bus: Rc::default(),
            slots: Vec::new(),
            queue: BinaryHeap::new(),
            order: 0,
            now: FlightTime::ZERO,
            seed,
            model,
            images: ImageStore::in_memory(),
        }
    }

    /// Adds a process and returns a handle to look at it while it flies. The order of additions is the order of
    /// steps that fall on the same instant.
    pub fn add<P: Process + 'static>(&mut self, process: P) -> Rc<RefCell<P>> {
        let mut ports = LockstepPorts::new(Rc::clone(&self.bus), P::ID);
        process.connect(&mut ports);
        ports.writes::<HealthReports>();
        ports.share_images(self.images.clone());
        let process = Rc::new(RefCell::new(process));
        let slot = self.slots.len();
        self.slots.push(Slot {
            node: Box::new(NodeOf { process: Rc::clone(&process), ports }),
            latency: Latency::new(self.model.of(P::ID), self.seed ^ (P::ID as u64) << 32),
            busy_until: FlightTime::ZERO,
            wake_at: None,
            next_beat: FlightTime::ZERO,
            steps: 0,
            step_times_us: step_times(),
        });
        self.wake(slot, FlightTime::ZERO);
        process
    }

    /// Flight time.
    pub fn now(&self) -> FlightTime {
        self.now
    }

    /// How long the steps of a process that had work took on this machine, µs.
    pub fn step_times_us(&self, process: ProcessId) -> Option<&Histogram<u64>> {
        self.slots.iter().find(|slot| slot.node.id() == process).map(|slot| &slot.step_times_us)
    }

    /// Hash of every message published so far: topic, header and elements, in order.
    pub fn log_hash(&self) -> u128 {
        self.bus.borrow().log_hash()
    }

    /// Runs until `stop` says so (asked after every step) or nothing is left to happen.
    pub fn run(&mut self, mut stop: impl FnMut(FlightTime) -> bool) {
        while let Some(Reverse((at, _, event))) = self.queue.pop() {
            self.now = at;
            match event {
                Event::Deliver(message) => {
                    let woken = self.bus.borrow_mut().deliver(message);
                    for process in woken {
                        if let Some(slot) = self.slots.iter().position(|slot| slot.node.id() == process) {
                            self.wake(slot, at);
                        }
                    }
                }
                Event::Wake(slot) => {
                    self.step(slot);
                    if stop(at) {
                        return;
                    }
                }
            }
        }
    }

    fn push(&mut self, at: FlightTime, event: Event) {
        self.order += 1;
        self.queue.push(Reverse((at, self.order, event)));
    }

    /// Queues a wake-up, no earlier than the process is free, unless one is queued already that is no later.
    fn wake(&mut self, slot: usize, at: FlightTime) {
        let at = at.max(self.slots[slot].busy_until);
        if self.slots[slot].wake_at.is_none_or(|queued| at < queued) {
            self.slots[slot].wake_at = Some(at);
            self.push(at, Event::Wake(slot));
        }
    }

    fn step(&mut self, index: usize) {
        let now = self.now;
        let slot = &mut self.slots[index];
        if slot.wake_at != Some(now) {
            return; // An earlier wake-up took its place.
        }
        slot.wake_at = None;
        let taken = slot.latency.draw();
        slot.node.ports().begin(now, now + taken);
        let began = Instant::now();
        let report = slot.node.step();
        slot.steps += u64::from(report.worked);
        if report.worked {
            let us = u64::try_from(began.elapsed().as_micros()).unwrap_or(LONGEST_STEP_US);
            slot.step_times_us.saturating_record(us);
            slot.busy_until = now + taken;
        }
        if now >= slot.next_beat {
            slot.next_beat = now + HEARTBEAT;
            let steps = slot.steps;
            beat(slot.node.ports(), now, steps, &report);
        }
        let dropped = slot.latency.drops();
        let published = slot.node.ports().take_published();
        let next_wake = slot.node.next_wake();
        for (at, message) in published {
            if dropped {
                self.bus.borrow_mut().lose(message);
            } else {
                self.push(at, Event::Deliver(message));
            }
        }
        if let Some(next) = next_wake {
            self.wake(index, next.max(now + Duration::from_nanos(1)));
        }
    }
}

fn beat(ports: &mut LockstepPorts, now: FlightTime, steps: u64, report: &Report) {
    let missed = ports.missed();
    // Host time and process numbers stay out: they would make the log unrepeatable.
    ports.publish::<HealthReports>(now, 0, |health, _| {
        health.level = report.level as u32;
        health.steps = steps;
        health.dropped = report.dropped;
        health.missed = missed;
        health.note = Text::from(report.note);
    });
}
