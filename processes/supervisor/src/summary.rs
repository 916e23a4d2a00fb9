//! The account of a flight: what the report prints and the JSON summary carries.

use crate::ladder::Step;
use crate::mission::Outcome;
use crate::mission_config::MissionConfig;
use crate::policy::Phase;
use crate::supervision::ChildStatus;
use hdrhistogram::Histogram;
use ipc_types::messages::{Health, Setpoint, SetpointMode, Trajectory, WorldTruth};
use ipc_types::wire::Stamp;
use ipc_types::{FlightTime, Point, ProcessId, Vector, World};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Everything worth knowing about a flight, units in the names.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Summary {
    /// How it ended.
    pub outcome: Outcome,
    /// Flight time from start to end, s.
    pub flight_time_s: f64,
    /// Length of the path flown, m.
    pub path_length_m: f64,
    /// Mean distance of the path from the straight line that leads by the waypoints to the goal, seen from above, m.
    pub mean_deviation_m: f64,
    /// That line's length, m.
    pub straight_line_m: f64,
    /// Distance from the goal at the end, m; if it was to land there, from above it.
    pub distance_to_goal_m: f64,
    /// Least distance from the hull to an obstacle, m; absent when it never came within 5 m.
    pub min_clearance_m: Option<f64>,
    /// Highest speed, m/s.
    pub max_speed_mps: f64,
    /// Mean speed while airborne, m/s.
    pub mean_speed_mps: f64,
    /// Mean speed on the way, m/s: without taking off and settling, from a metre beside the place of take-off until a metre
    /// from the goal, where that was reached.
    pub way_speed_mps: f64,
    /// Highest mean speed over 3 s, m/s.
    pub cruise_speed_mps: f64,
    /// Plans chosen anew.
    pub replans: u64,
    /// Setpoints that were recorded, not followed, because a pilot flew.
    pub shadow_setpoints: u64,
    /// Stereo pairs published.
    pub frames: u64,
    /// Stereo pairs that led to no map.
    pub frames_without_map: u64,
    /// Duration of each stage, from its input's publication to its output's.
    pub stages: BTreeMap<String, LatencySummary>,
    /// From exposure to the first setpoint that rests on the image.
    pub exposure_to_command: LatencySummary,
    /// Flight seconds per host second.
    pub clock_ratio: f64,
    /// The processes; empty in lockstep.
    pub processes: Vec<ProcessSummary>,
    /// Messages lost, by process; those that lost none are left out.
    pub losses: BTreeMap<String, Losses>,
    /// Restarts of all processes.
    pub restarts: u32,
    /// How often another supervisor has taken the run over; figures are of the time since the last takeover.
    pub takeovers: u32,
    /// Where the flight stood on the degradation ladder, from when on, and why.
    pub degradation: Vec<RungSummary>,
    /// Deaths of processes, in order.
    pub deaths: Vec<DeathSummary>,
    /// Faults that were injected.
    pub faults: Vec<FaultSummary>,
    /// Hash of every message, in lockstep.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub log_hash: Option<String>,
}

/// A step on the degradation ladder.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RungSummary {
    /// Flight time, s.
    pub at_s: f64,
    /// Name of the rung.
    pub rung: String,
    /// Share of the cruise speed that it allows.
    pub speed_share: f64,
    /// Why.
    pub reason: String,
}

/// The death of a process.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DeathSummary {
    /// Flight time at which it was reaped, s.
    pub at_s: f64,
    /// Its name.
    pub process: String,
    /// How it died, or why it was ended.
    pub how: String,
    /// From then to its successor's first output (the recorder's first heartbeat), ms.
    pub recovered_ms: Option<f64>,
}

/// An injected fault.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FaultSummary {
    /// Flight time at which it came, s.
    pub at_s: f64,
    /// Its name.
    pub fault: String,
    /// What it befell.
    pub victim: String,
    /// Flight time per host time within the second after it; absent when the run ended before.
    pub clock_ratio: Option<f64>,
}

/// Percentiles of a latency.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LatencySummary {
    /// How many were measured.
    pub count: u64,
    /// Median, ms.
    pub p50_ms: f64,
    /// 99th percentile, ms.
    pub p99_ms: f64,
    /// Longest, ms.
    pub max_ms: f64,
}

impl LatencySummary {
    /// Of latencies in µs.
    pub fn of_us(histogram: &Histogram<u64>) -> Self {
        let ms = |us: u64| us as f64 * 1e-3;
        Self {
            count: histogram.len(),
            p50_ms: ms(histogram.value_at_quantile(0.5)),
            p99_ms: ms(histogram.value_at_quantile(0.99)),
            max_ms: ms(histogram.max()),
        }
    }
}

/// Messages that a process could not use, over all its incarnations.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Losses {
    /// Refused: malformed, late or unusable, or shared memory was full.
    pub dropped: u64,
    /// Gave way to newer ones before they were received, or were lost on the way.
    pub missed: u64,
}

/// A process at the end of the flight.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ProcessSummary {
    /// Name.
    pub name: String,
    /// Operating-system number of its last incarnation.
    pub pid: Option<u32>,
    /// Restarts.
    pub restarts: u32,
    /// Longest time from a death to the successor's first output of a later instant (the recorder's first heartbeat), ms.
    pub longest_recovery_ms: Option<f64>,
    /// Why it was given up, if it was.
    pub given_up: Option<String>,
    /// Longest step that published, ms.
    pub longest_step_ms: f64,
}

impl ProcessSummary {
    /// The supervisor itself.
    pub fn supervisor() -> Self {
        Self {
            name: ProcessId::Supervisor.name().to_owned(),
            pid: Some(std::process::id()),
            restarts: 0,
            longest_recovery_ms: None,
            given_up: None,
            longest_step_ms: 0.0,
        }
    }

    /// From the supervisor's last view of a child, and all deaths of the run.
    pub fn of(status: &ChildStatus, deaths: &[DeathSummary]) -> Self {
        let of_it = deaths.iter().filter(|death| death.process == status.process.name());
        Self {
            name: status.process.name().to_owned(),
            pid: status.pid,
            restarts: status.restarts,
            longest_recovery_ms: of_it.filter_map(|death| death.recovered_ms).reduce(f64::max),
            given_up: match &status.phase {
                Phase::GivenUp(why) => Some(why.clone()),
                _ => None,
            },
            longest_step_ms: status.health.map_or(0.0, |health| health.longest_step_ns as f64 * 1e-6),
        }
    }
}

/// Latencies up to this are told apart, µs.
const LONGEST_US: u64 = 60_000_000;
/// Window of the cruise speed, s.
const CRUISE_WINDOW_S: f64 = 3.0;
/// The way begins so far beside the place of take-off, and ends so far from the goal, m.
const WAY_ENDS_M: f64 = 1.0;
/// Steps on the ladder that are remembered.
const MOST_STEPS: usize = 1000;
/// The stages an image passes, in order.
const STAGES: [&str; 5] = ["camera", "stereo-ingest", "expansion", "memory", "planner"];

/// The part of a flight between take-off and goal.
#[derive(Debug, Default)]
struct Way {
    begun: bool,
    ended: bool,
    length_m: f64,
    duration_s: f64,
}

impl Way {
    /// A stretch flown, and where that was.
    fn add(&mut self, length_m: f64, duration_s: f64, at: &Place) {
        self.begun |= at.from_start_m > WAY_ENDS_M;
        self.ended |= self.begun && at.to_goal_m < WAY_ENDS_M;
        if self.begun && !self.ended {
            self.length_m += length_m;
            self.duration_s += duration_s;
        }
    }

    fn speed_mps(&self) -> f64 {
        if self.duration_s > 0.0 { self.length_m / self.duration_s } else { 0.0 }
    }
}

/// Where the vehicle is, relative to the mission.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Place {
    /// Distance from the straight line, m.
    pub(crate) off_m: f64,
    /// Level distance from the place of take-off, m.
    pub(crate) from_start_m: f64,
    /// Distance from the goal, m; infinite while there are waypoints to pass before it.
    pub(crate) to_goal_m: f64,
}

impl Place {
    /// `is_last`: whether the goal is what it flies to.
    pub(crate) fn new(config: &MissionConfig, position: Point<World>, is_last: bool) -> Self {
        Self {
            off_m: config.deviation_m(position),
            from_start_m: (position - config.start()).horizontal_norm(),
            to_goal_m: if is_last { config.to_goal_m(position) } else { f64::INFINITY },
        }
    }
}

/// Gathers the account while flying.
#[derive(Debug)]
pub struct Recorder {
    stages: BTreeMap<&'static str, Histogram<u64>>,
    exposure_to_command: Histogram<u64>,
    /// Publication by exposure, of the last few images: the previous stage's is where the next one's time begins.
    publications: BTreeMap<i64, [Option<i64>; STAGES.len()]>,
    commanded: i64,
    shadow_setpoints: u64,
    frames: u64,
    maps: u64,
    path_length_m: f64,
    /// Sum over the path of its distance from the straight line, m².
    deviation_m2: f64,
    last: Option<(FlightTime, Point<World>)>,
    window: std::collections::VecDeque<(FlightTime, f64)>,
    airborne_s: f64,
    way: Way,
    min_clearance_m: f64,
    max_speed_mps: f64,
    cruise_speed_mps: f64,
    degradation: Vec<RungSummary>,
    /// By process and incarnation, whose counts begin at zero.
    losses: BTreeMap<(u32, u32), Losses>,
}

impl Recorder {
    pub(crate) fn new() -> Self {
        Self {
            stages: STAGES.iter().map(|&stage| (stage, histogram())).collect(),
            exposure_to_command: histogram(),
            publications: BTreeMap::new(),
            commanded: 0,
            shadow_setpoints: 0,
            frames: 0,
            maps: 0,
            path_length_m: 0.0,
            deviation_m2: 0.0,
            last: None,
            window: std::collections::VecDeque::new(),
            airborne_s: 0.0,
            way: Way::default(),
            min_clearance_m: f64::INFINITY,
            max_speed_mps: 0.0,
            cruise_speed_mps: 0.0,
            degradation: Vec::new(),
            losses: BTreeMap::new(),
        }
    }

    /// Where the flight stands from now on.
    pub(crate) fn rung(&mut self, now: FlightTime, step: &Step) {
        let summary = RungSummary {
            at_s: now.as_secs_f64(),
            rung: step.rung.name().to_owned(),
            speed_share: step.speed_share,
            reason: step.reason.clone(),
        };
        if self.degradation.len() < MOST_STEPS {
            self.degradation.push(summary);
        }
    }

    pub(crate) fn health(&mut self, health: &Health) {
        let losses = Losses { dropped: health.dropped, missed: health.missed };
        self.losses.insert((health.stamp.producer, health.stamp.incarnation), losses);
    }

    fn losses(&self) -> BTreeMap<String, Losses> {
        let mut sums = BTreeMap::<String, Losses>::new();
        for ((producer, _), losses) in self.losses.iter().filter(|(_, losses)| **losses != Losses::default()) {
            let name = ProcessId::from_wire(*producer).map_or("unknown", ProcessId::name);
            let sum = sums.entry(name.to_owned()).or_default();
            sum.dropped = sum.dropped.saturating_add(losses.dropped);
            sum.missed = sum.missed.saturating_add(losses.missed);
        }
        sums
    }

    /// A stage published what it made of an image.
    pub(crate) fn published(&mut self, stage: &'static str, stamp: &Stamp) {
        let Some(index) = STAGES.iter().position(|&name| name == stage) else { return };
        self.frames += u64::from(stage == "camera");
        self.maps += u64::from(stage == "memory");
        let entry = self.publications.entry(stamp.valid_ns).or_default();
        entry[index] = Some(stamp.published_ns);
        let begun = if index == 0 { Some(stamp.valid_ns) } else { entry[index - 1] };
        // A publisher that has not heard the flight's time yet has none.
        let is_timed = |begun: &i64| stamp.published_ns > 0 && (index == 0 || *begun > 0);
        if let (Some(begun), Some(histogram)) = (begun.filter(is_timed), self.stages.get_mut(stage)) {
            record(histogram, stamp.published_ns - begun);
        }
        while self.publications.len() > 32 {
            self.publications.pop_first();
        }
    }

    pub(crate) fn plan(&mut self, plan: &Trajectory) {
        let stamp = Stamp { valid_ns: plan.image_valid_ns, ..plan.stamp };
        self.published("planner", &stamp);
    }

    pub(crate) fn setpoint(&mut self, setpoint: &Setpoint) {
        self.shadow_setpoints += u64::from(SetpointMode::from_wire(setpoint.mode) == SetpointMode::Shadow);
        if setpoint.image_valid_ns > self.commanded {
            self.commanded = setpoint.image_valid_ns;
            record(&mut self.exposure_to_command, setpoint.stamp.published_ns - setpoint.image_valid_ns);
        }
    }

    pub(crate) fn truth(&mut self, truth: &WorldTruth, at: &Place) {
        let (now, position) = (FlightTime::from_nanos(truth.stamp.valid_ns), Point::from_array(truth.position_m));
        let speed = Vector::<World>::from_array(truth.velocity_mps).norm();
        self.max_speed_mps = self.max_speed_mps.max(speed);
        if truth.airborne != 0 {
            if let Some((before, from)) = self.last {
                let (length_m, duration_s) = (from.distance(position), now.seconds_since(before));
                self.path_length_m += length_m;
                self.deviation_m2 += length_m * at.off_m;
                self.airborne_s += duration_s;
                self.way.add(length_m, duration_s, at);
            }
            // Beyond what the simulator measures there is nothing to report.
            if truth.obstacle_clearance_m < 5.0 {
                self.min_clearance_m = self.min_clearance_m.min(truth.obstacle_clearance_m);
            }
        }
        self.last = Some((now, position));
        self.window.push_back((now, self.path_length_m));
        while self.window.front().is_some_and(|(at, _)| now.seconds_since(*at) > CRUISE_WINDOW_S) {
            self.window.pop_front();
        }
        if let Some((at, length)) = self.window.front() {
            let span_s = now.seconds_since(*at);
            if span_s > 0.9 * CRUISE_WINDOW_S {
                self.cruise_speed_mps = self.cruise_speed_mps.max((self.path_length_m - length) / span_s);
            }
        }
    }

    /// Median and 99th percentile of exposure → command so far, ms.
    pub fn exposure_to_command(&self) -> LatencySummary {
        LatencySummary::of_us(&self.exposure_to_command)
    }

    /// Time from input to output of a stage so far; nothing for what is none.
    pub fn stage(&self, name: &str) -> LatencySummary {
        self.stages.get(name).map(LatencySummary::of_us).unwrap_or_default()
    }

    /// Steps on the degradation ladder so far.
    pub fn degradation(&self) -> &[RungSummary] {
        &self.degradation
    }

    /// Least clearance so far, m.
    pub fn min_clearance_m(&self) -> Option<f64> {
        self.min_clearance_m.is_finite().then_some(self.min_clearance_m)
    }

    pub(crate) fn summary(
        &self,
        config: &MissionConfig,
        outcome: Outcome,
        now: FlightTime,
        truth: Option<&WorldTruth>,
        plan: Option<&Trajectory>,
    ) -> Summary {
        let position = self.last.map_or(config.start(), |(_, position)| position);
        Summary {
            outcome,
            flight_time_s: self.last.map_or(now, |(at, _)| at).as_secs_f64(),
            path_length_m: self.path_length_m,
            mean_deviation_m: if self.path_length_m > 0.0 { self.deviation_m2 / self.path_length_m } else { 0.0 },
            straight_line_m: config.straight_line_m(),
            distance_to_goal_m: config.to_goal_m(position),
            min_clearance_m: self.min_clearance_m(),
            max_speed_mps: self.max_speed_mps,
            mean_speed_mps: if self.airborne_s > 0.0 { self.path_length_m / self.airborne_s } else { 0.0 },
            way_speed_mps: self.way.speed_mps(),
            cruise_speed_mps: self.cruise_speed_mps,
            replans: plan.map_or(0, |plan| plan.replans),
            shadow_setpoints: self.shadow_setpoints,
            frames: self.frames,
            frames_without_map: self.frames.saturating_sub(self.maps),
            stages: self
                .stages
                .iter()
                .map(|(stage, histogram)| ((*stage).to_owned(), LatencySummary::of_us(histogram)))
                .collect(),
            exposure_to_command: LatencySummary::of_us(&self.exposure_to_command),
            clock_ratio: truth.map_or(0.0, |truth| truth.clock_ratio),
            processes: Vec::new(),
            losses: self.losses(),
            restarts: 0,
            takeovers: 0,
            degradation: self.degradation.clone(),
            deaths: Vec::new(),
            faults: Vec::new(),
            log_hash: None,
        }
    }
}

fn histogram() -> Histogram<u64> {
    // The bounds are constants that the constructor accepts.
    Histogram::new_with_bounds(1, LONGEST_US, 3).unwrap_or_else(|_| unreachable!("valid bounds"))
}

fn record(histogram: &mut Histogram<u64>, nanos: i64) {
    histogram.saturating_record((nanos.max(0) as u64 / 1000).min(LONGEST_US));
}
