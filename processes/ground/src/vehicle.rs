//! One vehicle, as it is known on the ground.

use crate::obstacles::{ObstacleCells, Obstacles};
use ipc_types::ProcessId;
use ipc_types::messages::{Health, HealthLevel, PlanMode, Rung, Setpoint, SetpointMode, VehicleState};
use ipc_types::rig::CameraMount;
use ipc_types::topics::TopicInfo;
use ipc_types::wire::Wire;
use serde::Serialize;
use serde_json::{Map, Value, json};
use std::collections::{BTreeMap, HashMap, VecDeque};
use std::time::Instant;

/// Places of the path that are kept.
const MOST_PLACES: usize = 2000;
/// Between them, m.
const APART_M: f64 = 0.25;
/// Samples of the strips, and of the latency.
const MOST_SAMPLES: usize = 600;
/// Answers that are kept.
const MOST_ANSWERS: usize = 50;
/// States this much older than the newest are of another flight, ns.
const ANOTHER_FLIGHT_NS: i64 = 2_000_000_000;
/// A vehicle that is silent for so long is not connected, s.
pub(crate) const SILENT_S: f64 = 2.0;

/// The newest message of a topic.
#[derive(Debug)]
struct Newest {
    at: Instant,
    value: Value,
}

/// What is known of a vehicle.
#[derive(Debug)]
pub(crate) struct Vehicle {
    topics: HashMap<&'static str, Newest>,
    processes: BTreeMap<ProcessId, (Instant, Health)>,
    images: HashMap<String, (Instant, Vec<u8>)>,
    path: VecDeque<[f64; 3]>,
    /// Flight time (s), speed (m/s), allowed speed (m/s), exposure to command (ms), nearest thing seen (m).
    strip: VecDeque<[Option<f64>; 5]>,
    answers: VecDeque<Value>,
    obstacles: Obstacles,
    mount: CameraMount,
    /// Flight time of the newest state, ns, and when it came.
    clock: Option<(i64, Instant)>,
    latency_ms: f64,
    heard: Instant,
    refused: u64,
    /// When messages came lately: for the rate.
    arrivals: VecDeque<(Instant, usize)>,
}

/// A vehicle, to be shown.
#[derive(Clone, Debug, Serialize)]
pub struct VehicleView {
    /// Its name.
    pub name: String,
    /// Whether it was heard lately.
    pub connected: bool,
    /// Since something was heard of it, s.
    pub age_s: f64,
    /// Flight time of the newest state, s.
    pub flight_s: f64,
    /// Where it is, m.
    pub position_m: Option<[f64; 3]>,
    /// Heading from east, degrees.
    pub heading_deg: f64,
    /// How fast, m/s.
    pub speed_mps: f64,
    /// What the planner does.
    pub mode: String,
    /// A pilot flies it.
    pub piloted: bool,
    /// It stands on the ground.
    pub landed: bool,
    /// Where it stands on the ladder, and why.
    pub rung: String,
    /// Why.
    pub rung_reason: String,
    /// What of the speed is left.
    pub speed_share: f64,
    /// The mission, as told.
    pub mission: Value,
    /// Its processes.
    pub processes: Vec<ProcessView>,
    /// What cannot be overlooked.
    pub alarms: Vec<String>,
    /// Ages of everything that is known, s, by topic.
    pub ages_s: BTreeMap<String, f64>,
    /// What comes in, kbit/s.
    pub kbit_s: f64,
    /// From exposure to command, ms.
    pub latency_ms: f64,
    /// What was no message.
    pub refused: u64,
}

/// A process of a vehicle, to be shown.
#[derive(Clone, Debug, Serialize)]
pub struct ProcessView {
    /// Its name.
    pub name: &'static str,
    /// Its number.
    pub pid: u32,
    /// How it does.
    pub level: &'static str,
    /// Times it was restarted.
    pub restarts: u32,
    /// Since its last heartbeat, s.
    pub age_s: f64,
    /// Last step, ms.
    pub step_ms: f64,
    /// Messages dropped.
    pub dropped: u64,
    /// Messages missed.
    pub missed: u64,
    /// What it says.
    pub note: String,
}

impl Vehicle {
    pub(crate) fn new(mount: CameraMount) -> Self {
        let heard = Instant::now();
        Self {
            topics: HashMap::new(),
            processes: BTreeMap::new(),
            images: HashMap::new(),
            path: VecDeque::new(),
            strip: VecDeque::new(),
            answers: VecDeque::new(),
            obstacles: Obstacles::new(),
            mount,
            clock: None,
            latency_ms: 0.0,
            heard,
            refused: 0,
            arrivals: VecDeque::new(),
        }
    }

    /// Something came in.
    pub(crate) fn hear(&mut self, bytes: usize) {
        self.heard = Instant::now();
        self.arrivals.push_back((self.heard, bytes));
        while self.arrivals.front().is_some_and(|(at, _)| at.elapsed().as_secs_f64() > 2.0) {
            self.arrivals.pop_front();
        }
    }

    pub(crate) fn refuse(&mut self) {
        self.refused += 1;
    }

    pub(crate) fn take_image(&mut self, name: &str, bytes: Vec<u8>) {
        self.images.insert(name.to_owned(), (Instant::now(), bytes));
    }

    pub(crate) fn image(&self, name: &str) -> Option<Vec<u8>> {
        self.images.get(name).map(|(_, bytes)| bytes.clone())
    }

    pub(crate) fn take_cloud(&mut self, bytes: &[u8]) -> bool {
        self.obstacles.take_cloud(bytes, &self.mount)
    }

    pub(crate) fn take_mount(&mut self, mount: CameraMount) {
        self.mount = mount;
    }

    /// Takes a message of a topic: header and elements.
    pub(crate) fn take(&mut self, topic: &'static TopicInfo, header: &[u8], elements: &[u8]) {
        let value = encoding::to_json(topic.header, header, topic.element, elements);
        if topic.header == VehicleState::KIND {
            self.take_state(&bytemuck::pod_read_unaligned(header));
        } else if topic.header == Health::KIND {
            let health: Health = bytemuck::pod_read_unaligned(header);
            if let Some(process) = ProcessId::from_wire(health.stamp.producer) {
                self.processes.insert(process, (Instant::now(), health));
            }
        } else if topic.header == Setpoint::KIND {
            let setpoint: Setpoint = bytemuck::pod_read_unaligned(header);
            if setpoint.image_valid_ns > 0 {
                self.latency_ms = (setpoint.stamp.published_ns - setpoint.image_valid_ns) as f64 * 1e-6;
            }
        } else if topic.name == "answer" {
            self.answers.push_back(value.clone());
            if self.answers.len() > MOST_ANSWERS {
                self.answers.pop_front();
            }
        }
        self.topics.insert(topic.name, Newest { at: Instant::now(), value });
    }

    /// Whether a state begins another flight: time does not go back in one.
    pub(crate) fn is_over(&self, state: &VehicleState) -> bool {
        self.clock.is_some_and(|(last_ns, _)| state.stamp.valid_ns < last_ns - ANOTHER_FLIGHT_NS)
    }

    /// The same vehicle, of which nothing is known yet.
    pub(crate) fn anew(&self) -> Self {
        Self::new(self.mount)
    }

    fn take_state(&mut self, state: &VehicleState) {
        self.clock = Some((state.stamp.valid_ns, Instant::now()));
        self.obstacles.take_state(state, &self.mount);
        let at = state.position();
        let off = |last: &[f64; 3]| ipc_types::Point::from_array(*last).distance(at);
        if at.is_finite() && self.path.back().is_none_or(|last| off(last) > APART_M) {
            self.path.push_back(state.position_m);
        }
        let at_s = state.stamp.valid_ns as f64 * 1e-9;
        let nearest_m = self.obstacles.nearest_m(at);
        let known = [at_s, state.velocity().norm(), self.allowed_mps(), self.latency_ms].map(Some);
        self.strip.push_back([known[0], known[1], known[2], known[3], nearest_m]);
        let too_many = |length: usize, most: usize| length > most;
        if too_many(self.path.len(), MOST_PLACES) {
            self.path.pop_front();
        }
        if too_many(self.strip.len(), MOST_SAMPLES) {
            self.strip.pop_front();
        }
    }

    fn field(&self, topic: &str, name: &str) -> Option<&Value> {
        self.topics.get(topic).map(|newest| &newest.value[name])
    }

    fn number(&self, topic: &str, name: &str) -> Option<f64> {
        self.field(topic, name).and_then(Value::as_f64)
    }

    fn allowed_mps(&self) -> f64 {
        self.number("goal", "cruise_speed_mps").unwrap_or(0.0)
    }

    /// Flight time of the vehicle by now, ns, if it was heard.
    pub(crate) fn flight_ns(&self) -> Option<i64> {
        self.clock.map(|(ns, at)| ns + at.elapsed().as_nanos() as i64)
    }

    /// The answer to a command, if it came.
    pub(crate) fn answer(&self, operator: &str, number: u64) -> Option<(bool, String)> {
        let is_it = |answer: &&Value| answer["operator"] == operator && answer["number"].as_u64() == Some(number);
        let answer = self.answers.iter().rev().find(is_it)?;
        let reason = answer["reason"].as_str().unwrap_or_default().to_owned();
        Some((answer["accepted"].as_u64() == Some(1), reason))
    }

    /// Whether that operator commands it, as it says itself: also when he began anew since.
    pub(crate) fn is_commanded_by(&self, operator: &str) -> bool {
        self.field("mission", "commander").is_some_and(|commander| commander == operator)
    }

    /// What is drawn: path, plan, keyframes, obstacles, strips, answers.
    pub(crate) fn drawing(&self) -> Value {
        let newest = |topic: &str| self.topics.get(topic).map_or(Value::Null, |newest| newest.value.clone());
        json!({
            "path": self.path,
            "plan": newest("trajectory")["elements"],
            "keyframes": newest("keyframe_set")["elements"],
            "goal": newest("goal")["position_m"],
            "cells": self.obstacles.cells().collect::<Vec<_>>(),
            "cell_m": ObstacleCells::SIDE_M,
            "strip": self.strip,
            "answers": self.answers,
            "images": self.images.iter().map(|(name, (at, _))| (name.clone(), json!(at.elapsed().as_secs_f64()))).collect::<Map<_, _>>(),
        })
    }

    pub(crate) fn view(&self, name: &str) -> VehicleView {
        let state = self.topics.get("vehicle_state").map(|newest| &newest.value);
        let triple = |name: &str| -> Option<[f64; 3]> {
            let values: Vec<f64> = state?[name].as_array()?.iter().filter_map(Value::as_f64).collect();
            values.try_into().ok()
        };
        let flag = |name: &str| state.is_some_and(|state| state[name].as_u64() == Some(1));
        let age_s = self.heard.elapsed().as_secs_f64();
        let rung = Rung::from_wire(self.number("degradation", "rung").unwrap_or(0.0) as u32);
        let text =
            |topic: &str, name: &str| self.field(topic, name).and_then(Value::as_str).unwrap_or_default().to_owned();
        let kbit_s = self.arrivals.iter().map(|(_, bytes)| *bytes as f64).sum::<f64>() * 8e-3 / 2.0;
        let mut view = VehicleView {
            name: name.to_owned(),
            connected: age_s < SILENT_S,
            age_s,
            flight_s: self.clock.map_or(0.0, |(ns, _)| ns as f64 * 1e-9),
            position_m: triple("position_m"),
            heading_deg: state.map_or(0.0, heading_deg),
            speed_mps: triple("velocity_mps").map_or(0.0, |v| v.iter().map(|v| v * v).sum::<f64>().sqrt()),
            mode: PlanMode::from_wire(self.number("trajectory", "mode").unwrap_or(0.0) as u32).to_string(),
            piloted: flag("piloted"),
            landed: flag("landed"),
            rung: rung.to_string(),
            rung_reason: text("degradation", "reason"),
            speed_share: self.number("degradation", "speed_share").unwrap_or(1.0),
            mission: self.topics.get("mission").map_or(Value::Null, |newest| newest.value.clone()),
            processes: self
                .processes
                .iter()
                .map(|(process, (at, health))| process_view(*process, *at, health))
                .collect(),
            alarms: Vec::new(),
            ages_s: self.topics.iter().map(|(name, n)| ((*name).to_owned(), n.at.elapsed().as_secs_f64())).collect(),
            kbit_s,
            latency_ms: self.latency_ms,
            refused: self.refused,
        };
        view.alarms = self.alarms(&view, rung);
        view
    }

    /// What an operator must not overlook.
    fn alarms(&self, view: &VehicleView, rung: Rung) -> Vec<String> {
        let mut alarms = Vec::new();
        if !view.connected {
            alarms.push(format!("NOT HEARD for {:.0} s: everything shown is old", view.age_s));
        }
        if view.piloted {
            alarms.push("A PILOT FLIES: what would move the vehicle is rejected until he hands back".to_owned());
        }
        if rung >= Rung::Hover {
            alarms.push(format!("{}: {}", rung.name().to_uppercase(), view.rung_reason));
        }
        let mode = SetpointMode::from_wire(self.number("setpoint", "mode").unwrap_or(0.0) as u32);
        if mode == SetpointMode::Brake && !view.landed {
            alarms.push("BRAKING: without a plan".to_owned());
        }
        for process in view.processes.iter().filter(|process| process.age_s > 1.0) {
            alarms.push(format!("{}: no heartbeat for {:.1} s", process.name, process.age_s));
        }
        for process in view.processes.iter().filter(|process| process.level == "faulted") {
            alarms.push(format!("{}: {}", process.name, process.note));
        }
        alarms
    }
}

fn process_view(process: ProcessId, at: Instant, health: &Health) -> ProcessView {
    ProcessView {
        name: process.name(),
        pid: health.pid,
        level: match HealthLevel::from_wire(health.level) {
            HealthLevel::Ok => "well",
            HealthLevel::Degraded => "degraded",
            HealthLevel::Faulted => "faulted",
        },
        restarts: health.stamp.incarnation,
        age_s: at.elapsed().as_secs_f64(),
        step_ms: health.last_step_ns as f64 * 1e-6,
        dropped: health.dropped,
        missed: health.missed,
        note: health.note.to_string_lossy(),
    }
}

/// Of a state as JSON.
fn heading_deg(state: &Value) -> f64 {
    let q: Vec<f64> = state["orientation"].as_array().into_iter().flatten().filter_map(Value::as_f64).collect();
    let Ok([w, x, y, z]) = <[f64; 4]>::try_from(q) else { return 0.0 };
    (2.0 * (w * z + x * y)).atan2(1.0 - 2.0 * (y * y + z * z)).to_degrees()
}
