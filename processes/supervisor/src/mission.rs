//! The mission: publishes the goal, watches how the flight goes.

use crate::ladder::{Ladder, LadderConfig, Step};
use crate::mission_config::{AtGoal, MissionConfig};
use crate::observation::Observation;
use crate::orders::{Directive, LinkConfig, Orders};
use crate::summary::{Place, Recorder, Summary};
use crate::supervision::ChildStatus;
use ipc_types::messages::{Command, Health, Order, PlanMode, Rung, Task, Trajectory, VehicleState, WorldTruth};
use ipc_types::topics::{
    Answers, Commands, DepthFrames, Disparity, Expanded, Goals, HealthReports, Keyframes, MissionStates, Plan, Rungs,
    Setpoints, State, StereoFrames, Truth,
};
use ipc_types::wire::{Header, Stamp, Text};
use ipc_types::{FlightTime, Point, ProcessId, Vector, World};
use runtime::{Connect, Message, Ports, Process, Report};
use serde::{Deserialize, Serialize};
use std::time::Duration;

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
/// Commands judged in one step: what comes in does not keep it from the rest.
const MOST_COMMANDS: usize = 16;
/// Heartbeats and outputs that nobody has taken yet.
const MOST_UNREAD: usize = 4096;
/// Between goal messages.
const GOAL_INTERVAL: Duration = Duration::from_millis(500);

/// How far a mission is: what a successor goes on from.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Progress {
    orders: Orders,
    /// As it is flown, where an operator asked for something else than was configured.
    flown: Option<MissionConfig>,
    hovers: bool,
    passed: usize,
    until_s: Option<f64>,
}

/// What was asked for, in a line.
fn note(command: &Command, refused: Option<&String>) -> Text {
    let order = Order::from_wire(command.order).map_or("an unknown order", Order::name);
    let operator = command.operator.to_string_lossy();
    Text::from(
        match refused {
            Some(reason) => format!("{operator}: {order}: refused: {reason}"),
            None => format!("{operator}: {order}"),
        }
        .as_str(),
    )
}

/// Watches a flight as one more process of the graph.
#[derive(Debug)]
pub struct Mission {
    /// As it is flown: as configured, until an operator asks for something else.
    config: MissionConfig,
    /// Within what operators may ask.
    configured: MissionConfig,
    link: LinkConfig,
    orders: Orders,
    /// Told to hover.
    hovers: bool,
    /// The flight may take until then, s.
    until_s: f64,
    has_news: bool,
    /// What was last asked for.
    note: Text,
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
    next_mission: FlightTime,
    recorder: Recorder,
    report: Report,
}

impl Mission {
    /// A mission that has not begun.
    pub fn new(config: MissionConfig, ladder: LadderConfig, link: LinkConfig) -> Self {
        Self {
            configured: config.clone(),
            link,
            orders: Orders::default(),
            hovers: false,
            until_s: config.time_limit_s,
            has_news: false,
            note: Text::from(""),
            next_mission: FlightTime::ZERO,
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

    /// Goes on with a flight that was taken over: with what was asked for, after so many waypoints, on that rung. Nothing is
    /// said before the flight's time is known.
    pub fn resume(&mut self, progress: Progress, step: Step) {
        let Progress { orders, flown, hovers, passed, until_s } = progress;
        self.until_s = until_s.unwrap_or(self.until_s);
        if let Some(flown) = flown {
            self.config = flown;
        }
        (self.orders, self.hovers) = (orders, hovers);
        self.passed = passed.min(self.config.waypoints_m.len());
        self.ladder.resume(step);
        self.is_taken_over = true;
    }

    /// How far it is, for a successor.
    pub fn progress(&self) -> Progress {
        let flown = (self.config != self.configured).then(|| self.config.clone());
        let (orders, until_s) = (self.orders.clone(), Some(self.until_s));
        Progress { orders, flown, hovers: self.hovers, passed: self.passed, until_s }
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
        let is_last = self.passed == self.config.waypoints_m.len();
        self.recorder.truth(&truth, &Place::new(&self.config, position, is_last));
        let speed = Vector::<World>::from_array(truth.velocity_mps).norm();
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
        // Whoever commands decides what then.
        let is_alone = self.orders.commander().is_none() || self.orders.is_link_lost();
        let gives_up = is_alone && mode == PlanMode::GivenUp && speed < HOVERING_MPS;
        let gave_up = lasting(&mut self.given_up_since, gives_up);
        let ended = [
            (truth.collided != 0, Outcome::Collided),
            (arrived, Outcome::Arrived),
            (gave_up, Outcome::GaveUp),
            (now.as_secs_f64() > self.until_s, Outcome::TimedOut),
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
            _ if step.rung >= Rung::Hover || self.hovers => Task::Stay,
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

    /// Hears what operators ask for, and answers.
    fn obey(&mut self, ports: &mut impl Ports) {
        for _ in 0..MOST_COMMANDS {
            let Some(message) = ports.receive::<Commands>() else { break };
            let (command, places) = (*message.header(), message.elements().to_vec());
            let (orders, state) = (&mut self.orders, self.state.as_ref());
            let verdict = orders.judge(self.now, &command, &places, state, &self.configured, &self.link);
            if command.order == Order::Present as u32 && verdict.directive.is_ok() {
                continue;
            }
            let reason = verdict.directive.as_ref().err().map_or("", String::as_str);
            ports.publish::<Answers>(self.now, 0, |answer, _| {
                (answer.number, answer.order, answer.operator) = (command.number, command.order, command.operator);
                answer.accepted = u32::from(verdict.directive.is_ok());
                answer.reason = Text::from(reason);
            });
            if !verdict.is_repeated {
                self.note = note(&command, verdict.directive.as_ref().err());
                verdict.directive.into_iter().for_each(|directive| self.follow(directive));
            }
        }
        let leads_to_landing = self.config.at_goal == AtGoal::Land;
        let lost = self.orders.look(self.now, &self.link, &self.configured);
        if let Some(directive) = lost.filter(|_| !leads_to_landing) {
            self.note = Text::from("the operator is not heard any more");
            self.follow(directive);
        }
    }

    fn follow(&mut self, directive: Directive) {
        match directive {
            Directive::Nothing => {}
            Directive::Hover => self.hovers = true,
            Directive::Resume => self.hovers = false,
            Directive::Speed(speed_mps) => self.config.cruise_speed_mps = speed_mps,
            Directive::Route(places, speed_mps) => {
                self.lead(places, AtGoal::Hover);
                self.config.cruise_speed_mps = speed_mps.unwrap_or(self.config.cruise_speed_mps);
            }
            Directive::Land(place) => self.lead(vec![place], AtGoal::Land),
        }
        (self.next_goal, self.next_mission) = (self.now, self.now);
        self.has_news = true;
    }

    /// Whether an order was followed since the last call: what a successor must know.
    pub fn take_news(&mut self) -> bool {
        std::mem::take(&mut self.has_news)
    }

    /// Another way than before.
    fn lead(&mut self, mut places: Vec<[f64; 3]>, at_goal: AtGoal) {
        if let Some(goal) = places.pop() {
            (self.config.goal_m, self.config.waypoints_m, self.config.at_goal) = (goal, places, at_goal);
            (self.passed, self.hovers, self.hovering_since, self.given_up_since) = (0, false, None, None);
            self.until_s = self.now.as_secs_f64() + self.configured.time_limit_s;
        }
    }

    /// Tells how far it is.
    fn say_how_it_stands(&mut self, ports: &mut impl Ports) {
        if self.now < self.next_mission {
            return;
        }
        self.next_mission = self.now + GOAL_INTERVAL;
        let config = &self.config;
        let places: Vec<_> =
            config.waypoints_m.iter().chain([&config.goal_m]).copied().take(Command::MOST_PLACES).collect();
        let (passed, hovers, note) = (self.passed as u32, u32::from(self.hovers), self.note);
        let commander = Text::from(self.orders.commander().unwrap_or(""));
        ports.publish::<MissionStates>(self.now, places.len(), |mission, elements| {
            (mission.speed_mps, mission.passed, mission.hovers) = (config.cruise_speed_mps, passed, hovers);
            (mission.commander, mission.note) = (commander, note);
            elements.iter_mut().zip(&places).for_each(|(element, place)| element.position_m = *place);
        });
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
        connect.writes::<Answers>();
        connect.writes::<MissionStates>();
        connect.reads::<Commands>();
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
            self.obey(ports);
            self.say_how_far(ports);
            self.say_where_to(ports);
            self.say_how_it_stands(ports);
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
            if state.header().landed == 0 {
                self.orders.note_place(state.header().position());
            }
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
