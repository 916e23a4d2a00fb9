//! The bridge process: topics to the network, as often as configured, and commands from it.

use crate::BridgeConfig;
use crate::budget::{Budget, Class};
use crate::link::Link;
use crate::preview;
use crate::refusals;
use encoding::{View, Viewer};
use ipc_types::messages::{DisparityImage, StereoFrame};
use ipc_types::rig::CameraMount;
use ipc_types::topics::{
    Answers, Commands, Disparity, Goals, HealthReports, Keyframes, MissionStates, Path, Plan, Rungs, Setpoints, State,
    StereoFrames, Topic,
};
use ipc_types::wire::Header;
use ipc_types::{FlightTime, HostTime, ProcessId, StereoRig};
use runtime::{Connect, Message, Ports, Process, Report, host_now};
use serde_json::Value;
use std::any::Any;
use std::collections::{BTreeMap, HashMap};
use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use zenoh::bytes::Encoding;

/// Flight time between two looks at the topics.
const INTERVAL: Duration = Duration::from_millis(10);
/// Host time between two attempts to open a session.
const AGAIN: Duration = Duration::from_secs(2);
/// Commands handed on in one step.
const MOST_AT_ONCE: usize = 4;
/// A process that was not heard for so long is not alive.
const SILENT: Duration = Duration::from_secs(1);

/// What can be asked about a run.
#[derive(Clone, Debug)]
pub struct About {
    /// The schema of all messages.
    pub schema: Vec<u8>,
    /// The configuration.
    pub config: String,
    /// Where its files are.
    pub folder: PathBuf,
    /// The last heartbeat of each process, as JSON.
    pub status: Arc<Mutex<BTreeMap<ProcessId, Value>>>,
}

/// Connects a run to a network.
#[derive(Debug)]
pub struct BridgeProcess {
    config: BridgeConfig,
    about: About,
    most_disparity_px: f32,
    viewer: Viewer,
    link: Link,
    tried: HostTime,
    budget: Budget,
    /// When something may be sent again, by what and of whom.
    next: HashMap<(&'static str, u32), HostTime>,
    /// When processes were heard last.
    heard: HashMap<ProcessId, HostTime>,
    /// Incarnation and level of processes, as they were told last.
    told: HashMap<ProcessId, (u32, u32)>,
    /// Not sent for want of budget.
    withheld: u64,
    /// Not taken by the network.
    untaken: u64,
    /// Refused by the network.
    unauthorised: u64,
    wake: FlightTime,
    report: Report,
}

impl BridgeProcess {
    /// For a vehicle's camera, whose disparities are at most so large.
    pub fn new(config: BridgeConfig, about: About, rig: StereoRig, mount: CameraMount, most_disparity_px: f32) -> Self {
        Self {
            viewer: Viewer::new(rig, mount),
            budget: Budget::new(config.budget_kbit_s, host_now()),
            link: Link::begin(&config),
            tried: host_now(),
            config,
            about,
            most_disparity_px,
            next: HashMap::new(),
            heard: HashMap::new(),
            told: HashMap::new(),
            withheld: 0,
            untaken: 0,
            unauthorised: 0,
            wake: FlightTime::ZERO,
            report: Report::waiting("opening a session"),
        }
    }

    /// Whether something is due: at most so often.
    fn is_due(&mut self, what: &'static str, whose: u32, rate_hz: f64) -> bool {
        if rate_hz <= 0.0 {
            return false;
        }
        let now = host_now();
        let next = self.next.entry((what, whose)).or_insert(now);
        if now < *next {
            return false;
        }
        // Kept to the rate over time, without making up for what was missed.
        let interval = Duration::from_secs_f64(1.0 / rate_hz);
        *next = (*next + interval).max(now);
        true
    }

    fn send(&mut self, path: &str, bytes: Vec<u8>, encoding: Encoding, class: Class) {
        let Link::Open(link) = &self.link else { return };
        if !self.budget.spend(host_now(), class, bytes.len()) {
            self.withheld += 1;
        } else if !link.send(path, bytes, encoding, class == Class::Vital) {
            self.untaken += 1;
        }
    }

    /// Sends the messages of a topic that are due.
    fn forward<T: Topic>(&mut self, ports: &mut impl Ports, rate_hz: f64, class: Class) {
        while let Some(message) = ports.receive::<T>() {
            let header = message.header();
            let whose = header.stamp().producer;
            if !self.is_due(T::INFO.name, whose, rate_hz) {
                continue;
            }
            let mut bytes = Vec::new();
            encoding::encode_message::<T>(header, message.elements(), &mut bytes);
            self.send(&format!("topic/{}", T::INFO.name), bytes, Encoding::APPLICATION_PROTOBUF, class);
        }
    }

    /// Sends previews of images that are due, and the points of a disparity image.
    fn show<T: Topic>(&mut self, ports: &mut impl Ports) {
        while let Some(message) = ports.receive::<T>() {
            let header: &dyn Any = message.header();
            let bytes: &[u8] = bytemuck::cast_slice(message.elements());
            if let Some(frame) = header.downcast_ref::<StereoFrame>() {
                if self.is_due("left", 0, self.config.rates.image_hz) {
                    let left = preview::grey(frame.width_px as usize, &bytes[..bytes.len() / 2]);
                    left.into_iter().for_each(|left| self.send("image/left", left, Encoding::IMAGE_JPEG, Class::Bulk));
                }
                continue;
            }
            if self.is_due(View::Obstacles.topic(), 0, self.config.rates.obstacles_hz) {
                let mut cloud = None;
                self.viewer.views::<T>(message.header(), message.elements(), false, |_, bytes| cloud = Some(bytes));
                let path = format!("view{}", View::Obstacles.topic());
                cloud.into_iter().for_each(|c| self.send(&path, c, Encoding::APPLICATION_PROTOBUF, Class::Bulk));
            }
            if let Some(found) = header.downcast_ref::<DisparityImage>()
                && self.is_due("disparity", 0, self.config.rates.image_hz)
            {
                let pixels: Vec<u16> = bytes.as_chunks().0.iter().map(|&pixel| u16::from_ne_bytes(pixel)).collect();
                let shown = preview::disparity(found.width_px as usize, &pixels, self.most_disparity_px);
                shown.into_iter().for_each(|s| self.send("image/disparity", s, Encoding::IMAGE_JPEG, Class::Bulk));
            }
        }
    }

    /// Hands on what has come in. Whoever keeps the mission judges it.
    fn hand_on(&mut self, ports: &mut impl Ports) {
        let Link::Open(link) = &self.link else { return };
        for _ in 0..MOST_AT_ONCE {
            let Some((command, places)) = link.command() else { break };
            ports.publish::<Commands>(ports.now(), places.len(), |out, elements| {
                let stamp = out.stamp;
                *out = command;
                out.stamp = stamp;
                elements.copy_from_slice(&places);
            });
        }
    }

    fn forward_all(&mut self, ports: &mut impl Ports) {
        let rates = self.config.rates;
        // As many as commands that are handed on.
        self.forward::<Answers>(ports, f64::INFINITY, Class::Vital);
        self.forward::<State>(ports, rates.state_hz, Class::Vital);
        self.forward::<MissionStates>(ports, rates.health_hz, Class::Vital);
        self.forward::<Rungs>(ports, rates.health_hz, Class::Vital);
        self.forward::<Goals>(ports, rates.plan_hz, Class::Useful);
        self.forward::<Setpoints>(ports, rates.plan_hz, Class::Useful);
        self.forward::<Plan>(ports, rates.plan_hz, Class::Useful);
        self.forward::<Path>(ports, rates.health_hz, Class::Useful);
        self.forward::<Keyframes>(ports, rates.health_hz, Class::Useful);
        self.show::<StereoFrames>(ports);
        self.show::<Disparity>(ports);
    }

    /// Health is seen by whoever is in the network twice: as messages, and as tokens of those that live.
    fn forward_health(&mut self, ports: &mut impl Ports) {
        while let Some(message) = ports.receive::<HealthReports>() {
            let health = *message.header();
            let Some(process) = ProcessId::from_wire(health.stamp.producer) else { continue };
            self.heard.insert(process, host_now());
            // A restart, or another level, is told at once.
            let now = (health.stamp.incarnation, health.level);
            let is_news = self.told.insert(process, now) != Some(now);
            let is_due = self.is_due(HealthReports::INFO.name, health.stamp.producer, self.config.rates.health_hz);
            if is_due || is_news {
                let kinds = (HealthReports::INFO.header, HealthReports::INFO.element);
                let status = encoding::to_json(kinds.0, bytemuck::bytes_of(&health), kinds.1, &[]);
                self.about.status.lock().unwrap_or_else(PoisonError::into_inner).insert(process, status);
                let mut bytes = Vec::new();
                encoding::encode_message::<HealthReports>(&health, &[], &mut bytes);
                self.send("topic/health", bytes, Encoding::APPLICATION_PROTOBUF, Class::Vital);
            }
        }
        if let Link::Open(link) = &mut self.link {
            for (process, at) in &self.heard {
                link.show_process(*process, host_now().saturating_since(*at) < SILENT);
            }
        }
    }

    /// Tells whom the network refused, at most once a second: it is counted, whoever floods.
    fn tell_refusals(&mut self) {
        if self.is_due("refusals", 0, 1.0)
            && let Some((times, last)) = refusals::take()
        {
            self.unauthorised += times;
            tracing::warn!(times, last, "refused: his certificate does not let him");
        }
    }

    fn attend_link(&mut self) -> Option<&'static str> {
        self.link.advance(&self.config, &self.about);
        match &self.link {
            Link::Opening(_) => Some("opening a session"),
            Link::Open(_) => None,
            Link::Failed(reason) => {
                if host_now().saturating_since(self.tried) > AGAIN {
                    tracing::warn!(reason, "no session");
                    (self.tried, self.link) = (host_now(), Link::begin(&self.config));
                }
                Some("no session: see the run's log")
            }
        }
    }
}

impl Process for BridgeProcess {
    const ID: ProcessId = ProcessId::Bridge;

    fn connect(&self, connect: &mut impl Connect) {
        connect.reads::<State>();
        connect.reads::<StereoFrames>();
        connect.reads::<Disparity>();
        connect.reads::<Keyframes>();
        connect.reads::<Path>();
        connect.reads::<Goals>();
        connect.reads::<Plan>();
        connect.reads::<Setpoints>();
        connect.reads::<HealthReports>();
        connect.reads::<Rungs>();
        connect.reads::<Answers>();
        connect.reads::<MissionStates>();
        connect.writes::<Commands>();
    }

    fn step<P: Ports>(&mut self, ports: &mut P) -> Report {
        if ports.now() < self.wake {
            return self.report.idle();
        }
        self.wake = ports.now() + INTERVAL;
        let waiting = self.attend_link();
        self.hand_on(ports);
        self.forward_health(ports);
        self.forward_all(ports);
        let refused = if let Link::Open(link) = &self.link { link.refused() } else { 0 };
        self.tell_refusals();
        self.report.dropped = refused + self.withheld + self.untaken + self.unauthorised;
        match waiting {
            Some(note) => self.report.degraded(note),
            None => self.report.worked(),
        }
    }

    fn finish<P: Ports>(&mut self, _: &mut P) {
        std::mem::replace(&mut self.link, Link::Failed(String::new())).close();
    }

    fn next_wake(&self) -> Option<FlightTime> {
        Some(self.wake)
    }
}
