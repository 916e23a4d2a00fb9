//! A flight as its log tells it: what the report's plots are drawn from.

use encoding::View;
use ground::ObstacleCells;
use ipc_types::messages::{
    Degradation, Goal, Health, HealthLevel, KeyframeSet, Rung, Setpoint, Trajectory, VehicleState, WorldTruth,
};
use ipc_types::pose_history::{PoseAt, PoseHistory};
use ipc_types::rig::CameraMount;
use ipc_types::wire::Header;
use ipc_types::{FlightTime, ProcessId, Vector, World};
use recorder::{Damage, Log, LogError, Record};
use std::collections::BTreeMap;

/// Where the vehicle was.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Moment {
    pub(crate) at_s: f64,
    pub(crate) position_m: [f64; 3],
    pub(crate) speed_mps: f64,
}

/// How near it came to something.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Near {
    pub(crate) at_s: f64,
    pub(crate) distance_m: f64,
    pub(crate) speed_mps: f64,
}

impl Near {
    /// If it were to fly towards it, s (as in Figures 5.13 to 5.17 of DROAN).
    pub(crate) fn time_to_collision_s(&self) -> f64 {
        self.distance_m / self.speed_mps.max(1e-3)
    }
}

/// How a process was doing from some time on.
#[derive(Clone, Debug)]
pub(crate) struct Doing {
    pub(crate) from_s: f64,
    /// Until it was last heard.
    pub(crate) until_s: f64,
    pub(crate) level: HealthLevel,
    pub(crate) incarnation: u32,
    pub(crate) note: String,
}

/// The rung that was flown on from some time on.
#[derive(Clone, Debug)]
pub(crate) struct OnRung {
    pub(crate) from_s: f64,
    pub(crate) rung: Rung,
    pub(crate) speed_share: f64,
    pub(crate) reason: String,
}

/// A place to fly to, from some time on.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Aimed {
    pub(crate) from_s: f64,
    pub(crate) position_m: [f64; 3],
    pub(crate) speed_mps: f64,
}

/// What a log tells.
#[derive(Debug, Default)]
pub(crate) struct FlownFlight {
    /// As the vehicle believed.
    pub(crate) track: Vec<Moment>,
    /// As it was, in a simulator.
    pub(crate) truth: Vec<Moment>,
    /// To what was nearest, in a simulator.
    pub(crate) clearance: Vec<Near>,
    /// To what was seen nearest in the current view.
    pub(crate) seen: Vec<Near>,
    pub(crate) collided_s: Option<f64>,
    pub(crate) goals: Vec<Aimed>,
    pub(crate) rungs: Vec<OnRung>,
    pub(crate) health: BTreeMap<ProcessId, Vec<Doing>>,
    /// From exposure, ms, by what came of it.
    pub(crate) latencies_ms: BTreeMap<&'static str, Vec<f64>>,
    pub(crate) obstacles: ObstacleCells,
    pub(crate) replans: u64,
    pub(crate) messages: u64,
    /// What are no messages.
    pub(crate) no_messages: u64,
    /// Of each file.
    pub(crate) damage: Vec<Damage>,
    /// Exposure of the newest image that a command came of, ns.
    commanded_ns: i64,
}

impl FlownFlight {
    /// Takes everything from log files, in their order.
    pub(crate) fn read(logs: &[Log], mount: &CameraMount) -> Result<Self, LogError> {
        let (mut flight, mut states) = (Self::default(), Vec::new());
        for log in logs {
            let read = log.each(|record| {
                states.extend(record.header::<VehicleState>().filter(is_sane));
                flight.take(&record);
            })?;
            flight.no_messages += read.no_messages;
            flight.damage.push(read.damage);
        }
        // Clouds and the states that they were seen from come in no order: all states first.
        let mut poses = PoseHistory::new(states.len());
        for state in &states {
            if let Some(pose) = state.world_from_body() {
                poses.push(FlightTime::from_nanos(state.stamp.valid_ns), pose);
            }
        }
        for log in logs {
            log.views(View::Obstacles, |cloud| flight.take_cloud(cloud, &poses, mount))?;
        }
        flight.seen.sort_by(|a, b| a.at_s.total_cmp(&b.at_s));
        Ok(flight)
    }

    fn take(&mut self, record: &Record) {
        self.messages += 1;
        if let Some(state) = record.header::<VehicleState>().filter(is_sane) {
            self.track.push(moment(state.stamp.valid_ns, state.position_m, state.velocity_mps));
        } else if let Some(truth) = record.header::<WorldTruth>().filter(|truth| is_near(truth.position_m)) {
            let moment = moment(truth.stamp.valid_ns, truth.position_m, truth.velocity_mps);
            if truth.airborne != 0 && truth.obstacle_clearance_m.is_finite() {
                let Moment { at_s, speed_mps, .. } = moment;
                self.clearance.push(Near { at_s, distance_m: truth.obstacle_clearance_m, speed_mps });
            }
            if truth.collided != 0 {
                self.collided_s.get_or_insert(moment.at_s);
            }
            self.truth.push(moment);
        } else if let Some(goal) = record.header::<Goal>().filter(|goal| is_near(goal.position_m)) {
            let aimed = Aimed {
                from_s: seconds(goal.stamp.published_ns),
                position_m: goal.position_m,
                speed_mps: goal.cruise_speed_mps,
            };
            let is_news = |last: &Aimed| (last.position_m, last.speed_mps) != (aimed.position_m, aimed.speed_mps);
            if self.goals.last().is_none_or(is_news) {
                self.goals.push(aimed);
            }
        } else if let Some(health) = record.header::<Health>() {
            self.take_health(&health);
        } else if let Some(rung) = record.header::<Degradation>() {
            let on = OnRung {
                from_s: seconds(rung.stamp.published_ns),
                rung: Rung::from_wire(rung.rung),
                speed_share: rung.speed_share,
                reason: rung.reason.to_string_lossy(),
            };
            let is_news =
                |last: &OnRung| last.rung != on.rung || last.speed_share.to_bits() != on.speed_share.to_bits();
            if self.rungs.last().is_none_or(is_news) {
                self.rungs.push(on);
            }
        } else {
            self.take_latency(record);
        }
    }

    fn take_health(&mut self, health: &Health) {
        let Some(process) = ProcessId::from_wire(health.stamp.producer) else { return };
        let at_s = seconds(health.stamp.published_ns);
        let doing = Doing {
            from_s: at_s,
            until_s: at_s,
            level: HealthLevel::from_wire(health.level),
            incarnation: health.stamp.incarnation,
            note: health.note.to_string_lossy(),
        };
        let history = self.health.entry(process).or_default();
        match history.last_mut() {
            Some(last) if (last.level, last.incarnation) == (doing.level, doing.incarnation) => last.until_s = at_s,
            _ => history.push(doing),
        }
    }

    fn take_latency(&mut self, record: &Record) {
        let of_image =
            |published_ns: i64, image_ns: i64| (image_ns > 0).then(|| (published_ns - image_ns) as f64 * 1e-6);
        let latency = if let Some(set) = record.header::<KeyframeSet>() {
            of_image(set.stamp().published_ns, set.stamp().valid_ns).map(|ms| ("map", ms))
        } else if let Some(plan) = record.header::<Trajectory>() {
            self.replans = self.replans.max(plan.replans);
            of_image(plan.stamp.published_ns, plan.image_valid_ns).map(|ms| ("plan", ms))
        } else {
            // The first of each image: the others are as old as they are often.
            let setpoint = record.header::<Setpoint>().filter(|s| s.image_valid_ns > self.commanded_ns);
            self.commanded_ns = setpoint.map_or(self.commanded_ns, |s| s.image_valid_ns);
            setpoint.and_then(|s| of_image(s.stamp.published_ns, s.image_valid_ns).map(|ms| ("command", ms)))
        };
        if let Some((name, ms)) = latency {
            self.latencies_ms.entry(name).or_default().push(ms);
        }
    }

    fn take_cloud(&mut self, message: &[u8], poses: &PoseHistory, mount: &CameraMount) {
        let Some((at, points)) = encoding::points(message) else { return };
        let PoseAt::Known(body) = poses.at(at) else { return };
        let nearest_m = self.obstacles.see(body, mount, &points);
        let at_s = at.as_secs_f64();
        let index = self.track.partition_point(|moment| moment.at_s < at_s);
        let speed = self.track.get(index).map(|moment| moment.speed_mps);
        if let Some((distance_m, speed_mps)) = nearest_m.zip(speed) {
            self.seen.push(Near { at_s, distance_m, speed_mps });
        }
    }

    /// The last instant that is told of, s.
    pub(crate) fn end_s(&self) -> f64 {
        let last = |moments: &[Moment]| moments.iter().map(|moment| moment.at_s).fold(0.0, f64::max);
        last(&self.track).max(last(&self.truth)).max(1e-3)
    }

    /// Highest speed that was allowed at a time, m/s: what was asked for, scaled down by the ladder.
    pub(crate) fn allowed_mps(&self, at_s: f64) -> f64 {
        let goal = self.goals.iter().take_while(|goal| goal.from_s <= at_s).last().or(self.goals.first());
        goal.map_or(0.0, |goal| goal.speed_mps)
    }
}

/// Within what flights are flown: a damaged message may say anything.
fn is_near(place_m: [f64; 3]) -> bool {
    place_m.iter().all(|x| x.abs() < 1e5)
}

fn is_sane(state: &VehicleState) -> bool {
    let is_dated = (0..=state.stamp.published_ns + 1_000_000_000).contains(&state.stamp.valid_ns);
    is_dated && is_near(state.position_m) && state.velocity_mps.iter().all(|v| v.abs() < 100.0)
}

fn seconds(nanoseconds: i64) -> f64 {
    nanoseconds as f64 * 1e-9
}

fn moment(at_ns: i64, position_m: [f64; 3], velocity_mps: [f64; 3]) -> Moment {
    let speed_mps = Vector::<World>::from_array(velocity_mps).norm();
    Moment { at_s: seconds(at_ns), position_m, speed_mps }
}
