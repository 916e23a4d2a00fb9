//! Topics of the lockstep driver: queues in one thread, with a hash over all that was said.

use crate::images::ImageStore;
use crate::missed::Missed;
use crate::ports::{Connect, Message, Ports};
use bytemuck::Zeroable;
use ipc_types::topics::{RECORDER_DEPTH, RECORDER_IMAGE_DEPTH, Topic, TopicInfo};
use ipc_types::wire::{Header, Stamp};
use ipc_types::{FlightTime, ProcessId};
use std::any::Any;
use std::cell::RefCell;
use std::collections::{BTreeMap, HashMap, VecDeque};
use std::rc::Rc;
use xxhash_rust::xxh3::Xxh3;

/// A message shared by its consumers.
#[derive(Debug)]
pub struct LockstepMessage<T: Topic>(Rc<(T::Header, Vec<T::Element>)>);

impl<T: Topic> Message<T> for LockstepMessage<T> {
    fn header(&self) -> &T::Header {
        &self.0.0
    }
    fn elements(&self) -> &[T::Element] {
        &self.0.1
    }
}

struct Subscription {
    process: ProcessId,
    depth: usize,
    wakes: bool,
    queue: VecDeque<Rc<dyn Any>>,
}

#[derive(Default)]
pub(super) struct Bus {
    subscriptions: BTreeMap<&'static str, Vec<Subscription>>,
    in_flight: HashMap<u64, (&'static str, Rc<dyn Any>)>,
    messages: u64,
    hash: Xxh3,
}

impl Bus {
    pub(super) fn log_hash(&self) -> u128 {
        self.hash.digest128()
    }

    /// Puts a message into its consumers' queues, the oldest giving way, and returns whom it wakes.
    pub(super) fn deliver(&mut self, message: u64) -> Vec<ProcessId> {
        let Some((topic, content)) = self.in_flight.remove(&message) else {
            return Vec::new();
        };
        let mut woken = Vec::new();
        for subscription in self.subscriptions.get_mut(topic).into_iter().flatten() {
            if subscription.queue.len() == subscription.depth {
                subscription.queue.pop_front();
            }
            subscription.queue.push_back(Rc::clone(&content));
            if subscription.wakes {
                woken.push(subscription.process);
            }
        }
        woken
    }

    /// A message that the latency model loses.
    pub(super) fn lose(&mut self, message: u64) {
        self.in_flight.remove(&message);
    }

    fn subscribe(&mut self, info: &TopicInfo, process: ProcessId) {
        let depth = match (process, info.is_image) {
            (ProcessId::Recorder, true) => RECORDER_IMAGE_DEPTH,
            (ProcessId::Recorder, false) => RECORDER_DEPTH,
            _ => info.depth,
        };
        let wakes = info.consumers.iter().any(|consumer| consumer.process == process && consumer.wakes);
        let subscription = Subscription { process, depth, wakes, queue: VecDeque::with_capacity(depth) };
        self.subscriptions.entry(info.name).or_default().push(subscription);
    }
}

/// Ports of one process in lockstep.
pub struct LockstepPorts {
    bus: Rc<RefCell<Bus>>,
    process: ProcessId,
    now: FlightTime,
    done: FlightTime,
    sequences: HashMap<&'static str, u64>,
    published: Vec<(FlightTime, u64)>,
    images: ImageStore,
    missed: Missed,
}

impl std::fmt::Debug for LockstepPorts {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "LockstepPorts({})", self.process)
    }
}

impl LockstepPorts {
    pub(super) fn new(bus: Rc<RefCell<Bus>>, process: ProcessId) -> Self {
        Self {
            bus,
            process,
            now: FlightTime::ZERO,
            done: FlightTime::ZERO,
            sequences: HashMap::new(),
            published: Vec::new(),
            images: ImageStore::in_memory(),
            missed: Missed::default(),
        }
    }

    /// Shares the image store of another process' ports.
    pub(super) fn share_images(&mut self, images: ImageStore) {
        self.images = images;
    }

    /// Messages that should have woken the process and that it never saw, since start.
    pub(super) fn missed(&self) -> u64 {
        self.missed.count()
    }

    /// Starts a step at `now` whose messages arrive at `done`.
    pub(super) fn begin(&mut self, now: FlightTime, done: FlightTime) {
        (self.now, self.done) = (now, done);
    }

    pub(super) fn take_published(&mut self) -> Vec<(FlightTime, u64)> {
        std::mem::take(&mut self.published)
    }
}

impl Connect for LockstepPorts {
    fn reads<T: Topic>(&mut self) {
        self.bus.borrow_mut().subscribe(&T::INFO, self.process);
    }
    fn writes<T: Topic>(&mut self) {
        self.sequences.insert(T::INFO.name, 0);
    }
}

impl Ports for LockstepPorts {
    type Message<T: Topic> = LockstepMessage<T>;

    fn now(&self) -> FlightTime {
        self.now
    }

    fn receive<T: Topic>(&mut self) -> Option<LockstepMessage<T>> {
        let mut bus = self.bus.borrow_mut();
        let subscriptions = bus.subscriptions.get_mut(T::INFO.name)?;
        let subscription = subscriptions.iter_mut().find(|subscription| subscription.process == self.process)?;
        let content = subscription.queue.pop_front()?;
        let message: LockstepMessage<T> = content.downcast().ok().map(LockstepMessage)?;
        self.missed.received(&T::INFO, self.process, message.header().stamp());
        Some(message)
    }

    fn publish<T: Topic>(
        &mut self,
        valid: FlightTime,
        elements: usize,
        fill: impl FnOnce(&mut T::Header, &mut [T::Element]),
    ) {
        let Some(sequence) = self.sequences.get_mut(T::INFO.name) else {
            debug_assert!(false, "{} publishes on {} without declaring it", self.process, T::INFO.name);
            return;
        };
        *sequence += 1;
        let mut content = (T::Header::zeroed(), vec![T::Element::zeroed(); elements]);
        fill(&mut content.0, &mut content.1);
        *content.0.stamp_mut() = Stamp {
            sequence: *sequence,
            valid_ns: valid.as_nanos(),
            published_ns: self.done.as_nanos(),
            incarnation: 0,
            producer: self.process as u32,
        };
        let mut bus = self.bus.borrow_mut();
        bus.hash.update(T::INFO.name.as_bytes());
        bus.hash.update(bytemuck::bytes_of(&content.0));
        bus.hash.update(bytemuck::cast_slice(&content.1));
        bus.messages += 1;
        let message = bus.messages;
        bus.in_flight.insert(message, (T::INFO.name, Rc::new(content)));
        self.published.push((self.done, message));
    }

    fn images(&mut self) -> &mut ImageStore {
        &mut self.images
    }
}
