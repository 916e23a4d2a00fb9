//! The mission: publishes the goal, watches how the flight goes.

use crate::ladder::{Ladder, LadderConfig, Step};
use crate::observation::Observation;
use crate::summary::{Recorder, Summary};
use crate::supervision::ChildStatus;
use ipc_types::bounds::Bounds;
use ipc_types::limits::Fence;
use ipc_types::messages::{Health, PlanMode, Rung, Task, Trajectory, VehicleState, WorldTruth};
use ipc_types::topics::{
    DepthFrames, Disparity, Expanded, Goals, HealthReports, Keyframes, Plan, Rungs, Setpoints, State, StereoFrames,
    Truth,
};
use ipc_types::wire::{Header, Stamp, Text};
use ipc_types::{FlightTime, Point, ProcessId, Vector, World};
use runtime::{Connect, Message, Ports, Process, Report};
use serde::{Deserialize, Serialize};
use std::time::Duration;

/// A cylinder around the take-off place, declared free: no image sees what is beside a vehicle on the ground.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HomeConfig {
    /// Its radius, m. Take-off may drift so far.
    pub radius_m: f64,
    /// Its height above the take-off place, m.
    pub height_m: f64,
}

/// What ends a mission.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum AtGoal {
    /// Hovering.
    Hover,
    /// Landing: whoever asks for it declares the column below the goal free.
    Land,
}

/// Where to fly.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MissionConfig {
    /// Take-off place (x, y), m.
    pub start_m: [f64; 2],
    /// Heading at take-off, degrees from east.
    pub start_heading_deg: f64,
    /// Places to pass on the way, within 2.5 m (x, y, z), m.
    pub waypoints_m: Vec<[f64; 3]>,
    /// Where to hover at last (x, y, z), m.
    pub goal_m: [f64; 3],
    /// Whether to hover or to land there.
    pub at_goal: AtGoal,
    /// Highest speed on the way, m/s.
    pub cruise_speed_mps: f64,
    /// Height to fly at above the take-off place, m.
    pub cruise_height_m: f64,
    /// The cylinder around the take-off place that the operator declares free.
    pub home: HomeConfig,
    /// Geofence and altitude limits.
    pub fence: Fence,
    /// The flight has failed when it takes longer, s.
    pub time_limit_s: f64,
}

impl MissionConfig {
    /// Reports values out of range.
    pub fn check(&self, bounds: &mut Bounds) {
        self.start_m.iter().for_each(|&value| bounds.range("start_m", value, -1e5..=1e5));
        self.waypoints_m.iter().flatten().for_each(|&value| bounds.range("waypoints_m", value, -1e5..=1e5));
        self.goal_m.iter().for_each(|&value| bounds.range("goal_m", value, -1e5..=1e5));
        bounds.range("start_heading_deg", self.start_heading_deg, -360.0..=360.0);
        bounds.range("cruise_speed_mps", self.cruise_speed_mps, 0.2..=20.0);
        bounds.range("cruise_height_m", self.cruise_height_m, 0.5..=100.0);
        bounds.section("home", |bounds| {
            bounds.range("radius_m", self.home.radius_m, 0.3..=20.0);
            bounds.range("height_m", self.home.height_m, 0.0..=100.0);
            bounds.require(
                self.home.height_m >= self.cruise_height_m,
                "height_m",
                format_args!(
                    "is {}, must be at least cruise_height_m = {}: take-off climbs there",
                    self.home.height_m, self.cruise_height_m
                ),
            );
        });
        let heights = self.fence.least_m[2]..self.fence.most_m[2];
        bounds.require(
            heights.contains(&self.cruise_height_m),
            "cruise_height_m",
            format_args!("is {}, must be within the fence's heights, {heights:?} m", self.cruise_height_m),
        );
        bounds.range("time_limit_s", self.time_limit_s, 1.0..=36_000.0);
        bounds.section("fence", |bounds| self.fence.check(bounds));
        let places = self.waypoints_m.iter().map(|place| ("waypoints_m", place)).chain([("goal_m", &self.goal_m)]);
        for (name, place) in places {
            bounds.require(
                self.fence.contains(Point::from_array(*place)),
                name,
                format_args!("is {place:?}, must lie inside the fence {:?}", self.fence),
            );
        }
    }

    /// Take-off place, at ground level zero.
    pub fn start(&self) -> Point<World> {
        Point::new(self.start_m[0], self.start_m[1], 0.0)
    }

    /// Places that the way leads to, in order: the waypoints, then the goal.
    pub fn places(&self) -> impl Iterator<Item = Point<World>> {
        self.waypoints_m.iter().chain([&self.goal_m]).map(|&place| Point::from_array(place))
    }

    /// Distance of a place from the straight line that leads by the waypoints to the goal, seen from above, m.
    fn deviation_m(&self, place: Point<World>) -> f64 {
        let (mut from, mut nearest_m) = (self.start(), f64::INFINITY);
        for to in self.places() {
            let (way, off) = (to - from, place - from);
            let share = (off.x * way.x + off.y * way.y) / way.horizontal_norm().powi(2).max(1e-12);
            nearest_m = nearest_m.min((off - way * share.clamp(0.0, 1.0)).horizontal_norm());
            from = to;
        }
        nearest_m
    }

    /// Length of that line, m.
    pub(crate) fn straight_line_m(&self) -> f64 {
        let mut from = self.start();
        self.places().map(|to| std::mem::replace(&mut from, to).distance(to)).sum()
    }

    /// Distance of a place from the goal, m; from the column below it, where that is to be landed on.
    pub(crate) fn to_goal_m(&self, place: Point<World>) -> f64 {
        let off = self.goal() - place;
        if self.at_goal == AtGoal::Land { off.horizontal_norm() } else { off.norm() }
    }

    /// The goal.
    pub fn goal(&self) -> Point<World> {
        Point::from_array(self.goal_m)
    }
}

/// How a flight ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Outcome {
    /// Hovers within a metre of the goal, or has landed there.
    Arrived,
    /// Touched something.
    Collided,
    /// The planner found no way and hovers.
    GaveUp,
    /// The time limit passed.
    TimedOut,
    /// A signal ended it.
    Interrupted,
    /// A process that cannot be spared was given up: the vehicle hovered, and was left to the flight control unit.
    HandedBack,
    /// The world died.
    ProcessLost,
}

/// Arrived means this close, m.
const ARRIVED_M: f64 = 1.0;
/// Hovering means slower than this, m/s.
const HOVERING_MPS: f64 = 0.3;
/// For this long.
const HOVERING_FOR: Duration = Duration::from_secs(1);
/// Longest time between two looks at the topics: images wait in none of them.
pub const ATTENTION: Duration = Duration::from_millis(10);
/// A waypoint is passed this close, m: near enough to go on to the next one without slowing down for it.
const PASSED_M: f64 = 2.5;
/// Heartbeats and outputs that nobody has taken yet.
const MOST_UNREAD: usize = 4096;
/// Between goal messages.
const GOAL_INTERVAL: Duration = Duration::from_millis(500);

/// Watches a flight as one more process of the graph.
#[derive(Debug)]
pub struct Mission {
    config: MissionConfig,
    next_goal: FlightTime,
    /// Waypoints passed.
    passed: usize,
    is_taken_over: bool,
    now: FlightTime,
    hovering_since: Option<FlightTime>,
    given_up_since: Option<FlightTime>,
    outcome: Option<Outcome>,
    truth: Option<WorldTruth>,
    state: Option<VehicleState>,
    plan: Option<Trajectory>,
    heartbeats: Vec<Health>,
    outputs: Vec<Stamp>,
    ladder: Ladder,
    observation: Observation,
    next_rung: FlightTime,
    recorder: Recorder,
    report: Report,
}

impl Mission {
    /// A mission that has not begun.
    pub fn new(config: MissionConfig, ladder: LadderConfig) -> Self {
        Self {
            outputs: Vec::new(),
            ladder: Ladder::new(ladder),
            observation: Observation::default(),
            next_rung: FlightTime::ZERO,
            recorder: Recorder::new(),
            config,
            next_goal: FlightTime::ZERO,
            passed: 0,
            is_taken_over: false,
            now: FlightTime::ZERO,
            hovering_since: None,
            given_up_since: None,
            outcome: None,
            truth: None,
            state: None,
            plan: None,
            heartbeats: Vec::new(),
            report: Report::waiting("starting"),
        }
    }

    /// How the flight ended, once it has.
    pub fn outcome(&self) -> Option<Outcome> {
        self.outcome
    }

    /// Ends the flight from outside, unless it has ended already.
    pub fn end(&mut self, outcome: Outcome) {
        self.outcome.get_or_insert(outcome);
    }

    /// Flight time of the last step.
    pub fn now(&self) -> FlightTime {
        self.now
    }

    /// The newest truth.
    pub fn truth(&self) -> Option<&WorldTruth> {
        self.truth.as_ref()
    }

    /// The newest state estimate.
    pub fn state(&self) -> Option<&VehicleState> {
        self.state.as_ref()
    }

    /// What the planner is doing.
    pub fn plan_mode(&self) -> PlanMode {
        self.plan.map_or(PlanMode::Waiting, |plan| PlanMode::from_wire(plan.mode))
    }

    /// Heartbeats that arrived since the last call.
    pub fn take_heartbeats(&mut self) -> Vec<Health> {
        std::mem::take(&mut self.heartbeats)
    }

    /// Stamps of what the processes published since the last call: the outputs that others wait for.
    pub fn take_outputs(&mut self) -> Vec<Stamp> {
        std::mem::take(&mut self.outputs)
    }

    /// Looks at the processes: which are away.
    pub fn see_processes(&mut self, children: &[ChildStatus]) {
        self.observation.processes(self.now, children);
    }

    /// Where the flight stands on the degradation ladder.
    pub fn rung(&self) -> &Step {
        self.ladder.present()
    }

    /// Waypoints passed.
    pub fn passed(&self) -> usize {
        self.passed
    }

    /// Goes on with a flight that was taken over: after so many waypoints, on that rung. Nothing is said before the flight's
    /// time is known.
    pub fn resume(&mut self, passed: usize, step: Step) {
        self.passed = passed.min(self.config.waypoints_m.len());
        self.ladder.resume(step);
        self.is_taken_over = true;
    }

    /// The account so far.
    pub fn summary(&self) -> Summary {
        let outcome = self.outcome.unwrap_or(Outcome::Interrupted);
        self.recorder.summary(&self.config, outcome, self.now, self.truth.as_ref(), self.plan.as_ref())
    }

    /// The account, where it is kept while flying.
    pub fn recorder(&self) -> &Recorder {
        &self.recorder
    }

    fn watch(&mut self, truth: WorldTruth) {
        let now = FlightTime::from_nanos(truth.stamp.valid_ns);
        let position = Point::<World>::from_array(truth.position_m);
        self.recorder.truth(&truth, self.config.deviation_m(position));
        let speed = Vector::<World>::from_array(truth.velocity_mps).norm();
        let is_last = self.passed == self.config.waypoints_m.len();
        let ends = is_last && speed < HOVERING_MPS;
        let lasting = |since: &mut Option<FlightTime>, holds: bool| {
            *since = if holds { since.or(Some(now)) } else { None };
            since.is_some_and(|since| now.saturating_since(since) >= HOVERING_FOR)
        };
        let mode = self.plan_mode();
        let has_arrived = match self.config.at_goal {
            AtGoal::Hover => mode == PlanMode::Arrived,
            AtGoal::Land => mode == PlanMode::Landed && truth.airborne == 0,
        } && self.config.to_goal_m(position) < ARRIVED_M;
        let arrived = lasting(&mut self.hovering_since, ends && has_arrived);
        let gave_up = lasting(&mut self.given_up_since, mode == PlanMode::GivenUp && speed < HOVERING_MPS);
        let ended = [
            (truth.collided != 0, Outcome::Collided),
            (arrived, Outcome::Arrived),
            (gave_up, Outcome::GaveUp),
            (now.as_secs_f64() > self.config.time_limit_s, Outcome::TimedOut),
        ];
        if let Some((_, outcome)) = ended.into_iter().find(|(holds, _)| *holds) {
            self.end(outcome);
        }
        self.truth = Some(truth);
    }

    /// Publishes the next place, at once when one was passed.
    fn say_where_to(&mut self, ports: &mut impl Ports) {
        let in_flight = self.state.filter(|state| state.landed == 0);
        let (at, waypoints) = (in_flight.map(|state| state.position()), &self.config.waypoints_m);
        let is_passed = |waypoint: &[f64; 3]| at.is_some_and(|at| at.distance(Point::from_array(*waypoint)) < PASSED_M);
        if waypoints.get(self.passed).is_some_and(is_passed) {
            self.passed += 1;
            self.next_goal = self.now;
        }
        if self.now < self.next_goal {
            return;
        }
        self.next_goal = self.now + GOAL_INTERVAL;
        let (waypoint, config) = (waypoints.get(self.passed), &self.config);
        let step = self.ladder.present();
        let task = match config.at_goal {
            _ if step.rung >= Rung::Hover => Task::Stay,
            AtGoal::Land if waypoint.is_none() => Task::Land,
            _ => Task::Hover,
        };
        // To stay is a task of its own; the speed only has to be one.
        let share = if step.speed_share > 0.0 { step.speed_share } else { 1.0 };
        ports.publish::<Goals>(self.now, 0, |goal, _| {
            goal.position_m = *waypoint.unwrap_or(&config.goal_m);
            (goal.cruise_speed_mps, goal.task) = (config.cruise_speed_mps * share, task as u32);
        });
    }

    /// Where the flight stands on the ladder: published, and acted on by the goal.
    fn say_how_far(&mut self, ports: &mut impl Ports) {
        let seen = self.observation.observed(self.now, self.state.as_ref());
        let before = self.ladder.present().clone();
        let step = self.ladder.look(self.now, &seen).clone();
        let changed = (before.rung, before.speed_share) != (step.rung, step.speed_share);
        if before.rung != step.rung {
            self.recorder.rung(self.now, &step);
        }
        if changed {
            (self.next_goal, self.next_rung) = (self.now, self.now);
        }
        if self.now >= self.next_rung {
            self.next_rung = self.now + GOAL_INTERVAL;
            ports.publish::<Rungs>(self.now, 0, |message, _| {
                (message.rung, message.speed_share) = (step.rung as u32, step.speed_share);
                message.reason = Text::from(step.reason.as_str());
            });
        }
        if step.rung == Rung::HandBack {
            self.end(Outcome::HandedBack);
        }
    }

    fn published(&mut self, stage: &'static str, stamp: &Stamp) {
        self.recorder.published(stage, stamp);
        self.note_output(stamp);
    }

    /// For whoever supervises; where nobody does, as in lockstep, nobody takes them.
    fn note_output(&mut self, stamp: &Stamp) {
        if self.outputs.len() < MOST_UNREAD {
            self.outputs.push(*stamp);
        }
    }

    /// Follows an image through the stages by its exposure.
    fn time_stages(&mut self, ports: &mut impl Ports) {
        while let Some(message) = ports.receive::<StereoFrames>() {
            self.observation.frame(message.header().stamp());
            self.published("camera", message.header().stamp());
        }
        while let Some(message) = ports.receive::<DepthFrames>() {
            self.observation.frame(message.header().stamp());
            self.published("camera", message.header().stamp());
        }
        while let Some(message) = ports.receive::<Disparity>() {
            self.published("stereo-ingest", message.header().stamp());
        }
        while let Some(message) = ports.receive::<Expanded>() {
            self.published("expansion", message.header().stamp());
        }
        while let Some(message) = ports.receive::<Keyframes>() {
            self.observation.map(self.now, message.header(), message.elements().len());
            self.published("memory", message.header().stamp());
        }
    }
}

impl Process for Mission {
    const ID: ProcessId = ProcessId::Supervisor;

    fn connect(&self, connect: &mut impl Connect) {
        connect.writes::<Goals>();
        connect.writes::<Rungs>();
        connect.reads::<Truth>();
        connect.reads::<State>();
        connect.reads::<StereoFrames>();
        connect.reads::<DepthFrames>();
        connect.reads::<Disparity>();
        connect.reads::<Expanded>();
        connect.reads::<Keyframes>();
        connect.reads::<Plan>();
        connect.reads::<Setpoints>();
        connect.reads::<HealthReports>();
    }

    fn step<P: Ports>(&mut self, ports: &mut P) -> Report {
        self.now = ports.now();
        self.time_stages(ports);
        if !self.is_taken_over || self.now > FlightTime::ZERO {
            self.say_how_far(ports);
            self.say_where_to(ports);
        }
        while let Some(plan) = ports.receive::<Plan>() {
            self.recorder.plan(plan.header());
            self.note_output(plan.header().stamp());
            self.plan = Some(*plan.header());
        }
        while let Some(setpoint) = ports.receive::<Setpoints>() {
            self.recorder.setpoint(setpoint.header());
            self.note_output(setpoint.header().stamp());
        }
        while let Some(state) = ports.receive::<State>() {
            self.state = Some(*state.header());
        }
        while let Some(health) = ports.receive::<HealthReports>() {
            self.recorder.health(health.header());
            if self.heartbeats.len() < MOST_UNREAD {
                self.heartbeats.push(*health.header());
            }
        }
        while let Some(truth) = ports.receive::<Truth>() {
            if self.outcome.is_none() {
                self.watch(*truth.header());
            }
        }
        self.report.worked()
    }

    fn next_wake(&self) -> Option<FlightTime> {
        Some(self.now + ATTENTION)
    }
}
