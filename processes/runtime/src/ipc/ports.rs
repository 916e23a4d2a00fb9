//! A process' publishers, subscribers and bell.

use super::black_box::BlackBox;
use super::bus::{ElementOf, HeaderOf, bell_name, config, node, opening, schema, topic_builder};
use super::clock::ClockFollower;
use super::injection::{Fate, Injection};
use super::{IpcError, While};
use crate::images::ImageStore;
use crate::missed::Missed;
use crate::ports::{Connect, Message, Ports, host_now};
use crate::run_dir::RunDir;
use bytemuck::{TransparentWrapper, Zeroable};
use iceoryx2::port::listener::Listener;
use iceoryx2::port::notifier::Notifier;
use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::port::update_connections::UpdateConnections;
use iceoryx2::prelude::*;
use iceoryx2::sample::Sample;
use ipc_types::topics::{Clock, RECORDER_DEPTH, RECORDER_IMAGE_DEPTH, TOPICS, Topic};
use ipc_types::wire::{Header, Stamp};
use ipc_types::{FlightTime, HostTime, ProcessId, StereoRig};
use std::any::Any;
use std::collections::{HashMap, VecDeque};
use std::mem::MaybeUninit;
use std::time::Duration;

/// A message held in shared memory, where its producer wrote it.
#[derive(Debug)]
pub struct IpcMessage<T: Topic>(Sample<ipc::Service, [ElementOf<T>], HeaderOf<T>>);

impl<T: Topic> Message<T> for IpcMessage<T> {
    fn header(&self) -> &T::Header {
        &self.0.user_header().0
    }
    fn elements(&self) -> &[T::Element] {
        TransparentWrapper::peel_slice(self.0.payload())
    }
}

struct Outgoing<T: Topic> {
    publisher: Publisher<ipc::Service, [ElementOf<T>], HeaderOf<T>>,
    bells: Vec<Notifier<ipc::Service>>,
    sequence: u64,
    /// Messages that an injected fault holds back, and until when.
    late: VecDeque<(HostTime, T::Header, Vec<T::Element>)>,
}

struct Incoming<T: Topic> {
    subscriber: Subscriber<ipc::Service, [ElementOf<T>], HeaderOf<T>>,
    /// Its place in the table of topics.
    index: usize,
}

/// A type-erased publisher, for the calls that do not depend on the topic.
trait Connected: Any {
    fn serve_late_subscribers(&self);
    /// Sends what was held back until now.
    fn release(&mut self, now: HostTime) -> Result<(), IpcError>;
    fn as_any(&mut self) -> &mut dyn Any;
}

impl<T: Topic> Connected for Outgoing<T> {
    fn serve_late_subscribers(&self) {
        // A connection that fails now is tried again at the next heartbeat.
        let _ = self.publisher.update_connections();
    }
    fn release(&mut self, now: HostTime) -> Result<(), IpcError> {
        while let Some((_, header, elements)) = self.late.pop_front_if(|(due, ..)| *due <= now) {
            self.send_copy(&header, &elements)?;
        }
        Ok(())
    }
    fn as_any(&mut self) -> &mut dyn Any {
        self
    }
}

impl<T: Topic> Outgoing<T> {
    /// Rings the bells of those whom a message wakes.
    fn ring(&self) {
        for bell in &self.bells {
            // A consumer that is being restarted has no listener; it drains its topics when it starts.
            let _ = bell.notify();
        }
    }

    /// Sends a message that was made before: only injected faults do.
    fn send_copy(&mut self, header: &T::Header, elements: &[T::Element]) -> Result<(), IpcError> {
        let name = T::INFO.name;
        let mut sample = self.publisher.loan_slice(elements.len()).doing(format!("loan a message of {name}"))?;
        for (slot, element) in sample.payload_mut().iter_mut().zip(elements) {
            slot.0 = *element;
        }
        sample.user_header_mut().0 = *header;
        sample.send().doing(format!("send on {name}"))?;
        self.ring();
        Ok(())
    }
}

/// Ports over iceoryx2.
pub struct IpcPorts {
    process: ProcessId,
    incarnation: u32,
    rig: StereoRig,
    node: Node<ipc::Service>,
    bell: Listener<ipc::Service>,
    outgoing: HashMap<&'static str, Box<dyn Connected>>,
    incoming: HashMap<&'static str, Box<dyn Any>>,
    clock: ClockFollower,
    /// Its own subscriber: a process that reads the clock's topic as well must find every message there.
    clock_port: Option<Incoming<Clock>>,
    /// Set by the process that makes flight time; others follow.
    own_time: Option<FlightTime>,
    now: FlightTime,
    images: ImageStore,
    failures: u64,
    missed: Missed,
    first_error: Option<IpcError>,
    black_box: Option<BlackBox>,
    injection: Injection,
    schema_salt: u64,
}

impl std::fmt::Debug for IpcPorts {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "IpcPorts({})", self.process)
    }
}

impl IpcPorts {
    /// Joins a run whose services exist, and opens the topics that `connect` declares.
    ///
    /// # Errors
    /// The run does not exist, or was created by another version.
    pub fn open(
        run: &RunDir,
        process: ProcessId,
        incarnation: u32,
        rig: &StereoRig,
        connect: impl FnOnce(&mut Self),
    ) -> Result<Self, IpcError> {
        Self::open_salted(run, process, incarnation, rig, 0, connect)
    }

    /// [`open`](Self::open) as a process whose messages are others, unless the salt is 0.
    pub(super) fn open_salted(
        run: &RunDir,
        process: ProcessId,
        incarnation: u32,
        rig: &StereoRig,
        schema_salt: u64,
        connect: impl FnOnce(&mut Self),
    ) -> Result<Self, IpcError> {
        let node = node(&config(run, false)?, process)?;
        let bell = node
            .service_builder(&bell_name(process)?)
            .event()
            .open()
            .doing(format!("open the bell of {process}; is the run \"{}\" alive?", run.name()))?;
        let bell = bell.listener_builder().create().doing("listen to the bell")?;
        let mut ports = Self {
            process,
            incarnation,
            rig: *rig,
            node,
            bell,
            outgoing: HashMap::new(),
            incoming: HashMap::new(),
            clock: ClockFollower::default(),
            clock_port: None,
            own_time: None,
            now: FlightTime::ZERO,
            images: ImageStore::Folder(run.images()),
            failures: 0,
            missed: Missed::default(),
            first_error: None,
            black_box: None,
            injection: Injection::new(&[], process, incarnation),
            schema_salt,
        };
        connect(&mut ports);
        match ports.first_error.take() {
            Some(error) => Err(error),
            None => Ok(ports),
        }
    }

    /// Notes, from now on, what is received, where it outlives this process. Where that cannot be, there is no such account.
    pub(super) fn keep_black_box(&mut self, run: &RunDir) {
        self.black_box = BlackBox::create(run, self.process).ok();
    }

    /// Whether injected faults let the process take a step; some of them do not let it go on at all.
    pub(super) fn may_step(&mut self) -> bool {
        self.injection.may_step(self.now)
    }

    /// What is to go wrong from now on.
    pub(super) fn inject(&mut self, injection: Injection) {
        self.injection = injection;
    }

    /// Messages that could not be published or received because shared memory refused, since start.
    pub fn failures(&self) -> u64 {
        self.failures
    }

    /// Messages that should have woken the process and that it never saw, since start.
    pub fn missed(&self) -> u64 {
        self.missed.count()
    }

    /// Sleeps until the bell rings, a signal arrives, or `timeout` passes.
    pub(super) fn sleep(&mut self, timeout: Duration) {
        // Shorter waits are rounded to "for ever" by the socket underneath.
        let timeout = timeout.max(Duration::from_micros(100));
        // An interrupted or failed wait is a wake-up like any other: all topics are drained afterwards.
        let _ = self.bell.timed_wait(|_| {}, timeout);
    }

    /// Brings `now` up to date: from the flight clock, or from `own_time` in the process that makes it.
    pub fn refresh(&mut self) {
        if let Some(own) = self.own_time {
            self.now = own;
            return;
        }
        follow_clock(&mut self.clock, self.clock_port.as_ref());
        self.now = self.clock.at(host_now());
        self.release_late();
    }

    /// Host time that passes until a flight time.
    pub(super) fn host_until(&self, at: FlightTime) -> Duration {
        // It may be very far away.
        Duration::try_from_secs_f64(at.seconds_since(self.now).max(0.0) / self.clock.rate()).unwrap_or(Duration::MAX)
    }

    /// Sends what injected faults have held back until now.
    fn release_late(&mut self) {
        if self.injection.is_none() {
            return;
        }
        let now = host_now();
        let failed = self.outgoing.values_mut().filter_map(|port| port.release(now).err()).count();
        self.failures += failed as u64;
    }

    /// Declares that this process follows the flight clock. To be called while opening.
    pub fn follow_flight_clock(&mut self) {
        match self.create_subscriber::<Clock>() {
            Ok(port) => self.clock_port = Some(port),
            Err(error) => drop(self.first_error.get_or_insert(error)),
        }
    }

    /// Declares this process the maker of flight time, and sets it.
    pub(super) fn set_own_time(&mut self, now: FlightTime) {
        self.own_time = Some(now);
        self.now = now;
        self.release_late();
    }

    /// Lets subscribers that came after the last message have it.
    pub fn serve_late_subscribers(&self) {
        self.outgoing.values().for_each(|port| port.serve_late_subscribers());
    }

    fn create_publisher<T: Topic>(&self) -> Result<Outgoing<T>, IpcError> {
        let (key, value) = schema::<T>(self.schema_salt)?;
        let verifier = AttributeVerifier::new().require(&key, &value).doing("ask for the schema hash")?;
        let service = topic_builder::<T>(&self.node)?.open_with_attributes(&verifier).doing(opening(&T::INFO))?;
        let publisher = service
            .publisher_builder()
            .initial_max_slice_len(T::max_elements(&self.rig).max(1))
            .max_loaned_samples(2)
            .create()
            .doing(format!("publish on {}", T::INFO.name))?;
        let mut bells = Vec::new();
        for consumer in T::INFO.consumers.iter().filter(|consumer| consumer.wakes) {
            let bell = self.node.service_builder(&bell_name(consumer.process)?).event().open();
            let bell = bell.doing(format!("open the bell of {}", consumer.process))?;
            bells.push(bell.notifier_builder().create().doing(format!("ring the bell of {}", consumer.process))?);
        }
        Ok(Outgoing { publisher, bells, sequence: 0, late: VecDeque::new() })
    }

    fn create_subscriber<T: Topic>(&self) -> Result<Incoming<T>, IpcError> {
        let (key, value) = schema::<T>(self.schema_salt)?;
        let verifier = AttributeVerifier::new().require(&key, &value).doing("ask for the schema hash")?;
        let service = topic_builder::<T>(&self.node)?.open_with_attributes(&verifier).doing(opening(&T::INFO))?;
        let depth = match (self.process, T::INFO.is_image) {
            (ProcessId::Recorder, true) => RECORDER_IMAGE_DEPTH,
            (ProcessId::Recorder, false) => RECORDER_DEPTH,
            _ => T::INFO.depth,
        };
        let subscriber = service.subscriber_builder().buffer_size(depth).create();
        let index = TOPICS.iter().position(|topic| topic.name == T::INFO.name).unwrap_or(TOPICS.len());
        Ok(Incoming { subscriber: subscriber.doing(format!("subscribe to {}", T::INFO.name))?, index })
    }

    fn send<T: Topic>(
        &mut self,
        valid: FlightTime,
        elements: usize,
        fill: impl FnOnce(&mut T::Header, &mut [T::Element]),
    ) -> Result<(), IpcError> {
        let name = T::INFO.name;
        let (process, incarnation, own_time) = (self.process, self.incarnation, self.own_time);
        let fate = if self.injection.is_none() { Fate::default() } else { self.injection.fate(&T::INFO, self.now) };
        let port = self.outgoing.get_mut(name).and_then(|port| port.as_any().downcast_mut::<Outgoing<T>>());
        let Some(port) = port else {
            return Err(IpcError::new(format!("publish on {name}"))(&"the process did not declare it"));
        };
        let mut sample = port.publisher.loan_slice_uninit(elements).doing(format!("loan a message of {name}"))?;
        let slots: &mut [MaybeUninit<ElementOf<T>>] = sample.payload_mut();
        // SAFETY: the slots lie in a mapped shared-memory segment, which the kernel zeroed and only plain old data
        // was ever written to, so every byte is initialised; `Carrier` is transparent over a `Pod` type, for which
        // every bit pattern is valid; the slice borrows the sample exclusively.
        let slice = unsafe { std::slice::from_raw_parts_mut(slots.as_mut_ptr().cast::<T::Element>(), slots.len()) };
        let mut header = T::Header::zeroed();
        fill(&mut header, slice);
        port.sequence += 1;
        // The step may have taken longer than the clock may be extrapolated.
        follow_clock(&mut self.clock, self.clock_port.as_ref());
        let published = own_time.unwrap_or_else(|| self.clock.at(host_now()));
        *header.stamp_mut() = Stamp {
            sequence: port.sequence,
            valid_ns: valid.as_nanos(),
            published_ns: published.as_nanos(),
            incarnation,
            producer: process as u32,
        };
        if fate.is_damaged {
            // Not its stamp, by which receivers and accounts name it.
            self.injection.damage(&mut bytemuck::bytes_of_mut(&mut header)[size_of::<Stamp>()..]);
            self.injection.damage(bytemuck::cast_slice_mut(slice));
        }
        if fate.is_doubled || fate.late_by > Duration::ZERO {
            port.late.push_back((host_now() + fate.late_by, header, slice.to_vec()));
        }
        if fate.is_lost || fate.late_by > Duration::ZERO {
            return Ok(());
        }
        sample.user_header_mut().0 = header;
        // SAFETY: as above, every element is initialised.
        unsafe { sample.assume_init() }.send().doing(format!("send on {name}"))?;
        port.ring();
        Ok(())
    }
}

/// Reads what the flight clock has said since.
fn follow_clock(clock: &mut ClockFollower, port: Option<&Incoming<Clock>>) {
    while let Some(Ok(Some(reading))) = port.map(|port| port.subscriber.receive()) {
        clock.read(&reading.user_header().0, host_now());
    }
}

impl Connect for IpcPorts {
    fn reads<T: Topic>(&mut self) {
        if self.first_error.is_none() && !self.incoming.contains_key(T::INFO.name) {
            match self.create_subscriber::<T>() {
                Ok(port) => drop(self.incoming.insert(T::INFO.name, Box::new(port))),
                Err(error) => self.first_error = Some(error),
            }
        }
    }

    fn writes<T: Topic>(&mut self) {
        if self.first_error.is_none() && !self.outgoing.contains_key(T::INFO.name) {
            match self.create_publisher::<T>() {
                Ok(port) => drop(self.outgoing.insert(T::INFO.name, Box::new(port))),
                Err(error) => self.first_error = Some(error),
            }
        }
    }
}

impl Ports for IpcPorts {
    type Message<T: Topic> = IpcMessage<T>;

    fn now(&self) -> FlightTime {
        self.now
    }

    fn receive<T: Topic>(&mut self) -> Option<IpcMessage<T>> {
        let port = self.incoming.get(T::INFO.name)?.downcast_ref::<Incoming<T>>()?;
        match port.subscriber.receive() {
            Ok(sample) => {
                let message: IpcMessage<T> = sample.map(IpcMessage)?;
                self.missed.received(&T::INFO, self.process, message.header().stamp());
                if let Some(black_box) = &mut self.black_box {
                    black_box.note(port.index, message.header().stamp());
                }
                Some(message)
            }
            Err(_) => {
                self.failures += 1;
                None
            }
        }
    }

    fn publish<T: Topic>(
        &mut self,
        valid: FlightTime,
        elements: usize,
        fill: impl FnOnce(&mut T::Header, &mut [T::Element]),
    ) {
        if self.send::<T>(valid, elements, fill).is_err() {
            self.failures += 1;
        }
    }

    fn images(&mut self) -> &mut ImageStore {
        &mut self.images
    }
}
