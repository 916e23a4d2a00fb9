//! What every candidate costs, on one thread or several, and the cheapest of them made cheaper.
//!
//! Nothing is asked of the map. The same comes out whatever the number of threads.

use crate::Config;
use crate::field::Field;
use crate::gaze::{Gaze, is_seen};
use crate::guide::Guide;
use crate::library::{Aim, Index, Library};
use crate::rollout::{Rollout, STEP_S, Sample, Target, Turn};
use crate::situation::Situation;
use crate::stuck::{LOOK_SHARE, Stuck};
use ipc_types::frames::wrap_angle_rad;
use ipc_types::{FlightTime, Point, Vector, World};
use rayon::ThreadPool;
use rayon::prelude::*;
use runtime::thread_pool;
use std::sync::Arc;

/// Slower than this the vehicle looks before it sets out to where it does not look, m/s.
const LOOK_FIRST_MPS: f64 = 0.9;
/// What no way by the grid costs beyond the path, m.
const NO_WAY_M: f64 = 20.0;
/// Shortest move worth making, m: less is standing still.
const WORTHWHILE_M: f64 = 0.3;
/// A candidate sets out to where it leads after so long, s.
const SETS_OUT_S: f64 = 1.0;
/// Place of the manoeuvre being flown behind the library; refined ones follow it.
const FLYING: usize = 0;
/// What has no place yet.
const NEW: Index = usize::MAX;
/// So many of the cheapest manoeuvres are refined ...
const REFINED: usize = 3;
/// ... in so many rounds ...
const ROUNDS: usize = 8;
/// ... by so many parameters.
const PARAMETERS: usize = 5;
/// Largest changes of a manoeuvre's parameters at a time.
const LARGEST_TURN_RAD: f64 = 0.2;
const LARGEST_SCALE: f64 = 0.25;
const LARGEST_SWITCH_S: f64 = 0.3;
/// Weight of what remains to the goal by then, relative to what remains at a candidate's end: it will be chosen anew long
/// before that, and what puts off its speed would put it off for ever.
const SOON: f64 = 0.5;
/// More than sums of prices are rounded by, m.
const ROUNDING_M: f64 = 1e-6;

/// What is flown, named so that it stays the same in the world while the vehicle moves along it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Flown {
    /// A candidate that aims at the goal or follows a way.
    Aimed(Index),
    /// A manoeuvre, begun at this time.
    Turn(Turn, FlightTime),
}

/// A candidate and what it costs, m.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Priced {
    /// In the library; beyond it what is being flown, then what was refined.
    pub(crate) index: Index,
    pub(crate) price_m: f64,
    pub(crate) heading_rad: f64,
    /// Whether the camera does not look there, and the vehicle is slow enough to turn it first.
    pub(crate) turns: bool,
}

/// What candidates are priced in, made once.
#[derive(Clone, Debug)]
pub(crate) struct Pricing {
    /// In the order of their prices.
    pub(crate) priced: Vec<Priced>,
    /// Manoeuvres that the library does not hold.
    pub(crate) refined: Vec<Turn>,
    workers: Vec<Worker>,
    /// Absent when one thread does all.
    threads: Option<Arc<ThreadPool>>,
}

/// One thread's.
#[derive(Clone, Debug)]
struct Worker {
    rollout: Rollout,
    priced: Vec<Priced>,
    /// What to refine, and what it costs; what came of it.
    from: Option<(Turn, f64)>,
    found: Option<(Turn, Priced)>,
}

impl Pricing {
    /// For a library of `size`.
    pub(crate) fn new(size: usize, threads: usize) -> Self {
        let most = size + 1 + REFINED;
        let worker = |_| Worker { rollout: Rollout::new(), priced: Vec::with_capacity(most), from: None, found: None };
        Self {
            priced: Vec::with_capacity(most),
            refined: Vec::with_capacity(REFINED),
            workers: (0..threads.max(1)).map(worker).collect(),
            threads: thread_pool(threads).map(Arc::new),
        }
    }

    /// Lets every worker do its part, by number.
    fn each(&mut self, act: impl Fn(usize, &mut Worker) + Sync) {
        let Self { workers, threads, .. } = self;
        match threads {
            None => workers.iter_mut().enumerate().for_each(|(number, worker)| act(number, worker)),
            Some(pool) => pool.install(|| {
                workers.par_iter_mut().enumerate().for_each(|(number, worker)| act(number, worker));
            }),
        }
    }
}

/// What candidates are priced by.
pub(crate) struct Prices<'a> {
    pub(crate) config: &'a Config,
    pub(crate) library: &'a Library,
    pub(crate) aim: Aim<'a>,
    pub(crate) situation: &'a Situation,
    /// When the candidates begin.
    pub(crate) start: FlightTime,
    pub(crate) field: &'a Field,
    pub(crate) guide: &'a Guide,
    pub(crate) stuck: &'a Stuck,
    pub(crate) gaze: &'a Gaze,
    pub(crate) flying: Option<Flown>,
    pub(crate) near_goal: bool,
    /// Least distance to commit to, m.
    pub(crate) least_m: f64,
    pub(crate) half_view_rad: f64,
}

impl Prices<'_> {
    pub(crate) fn target(&self, index: Index, refined: &[Turn]) -> Target<'_> {
        let size = self.library.size();
        match (index.checked_sub(size), self.flying) {
            (None, _) => self.library.target(index, &self.aim),
            (Some(FLYING), Some(Flown::Turn(turn, begun))) => {
                Target::Turn(Turn { switch_s: turn.switch_s - self.start.seconds_since(begun), ..turn })
            }
            (Some(other), _) => Target::Turn(refined[other - FLYING - 1]),
        }
    }

    /// What a candidate is called once it is flown.
    pub(crate) fn flown(&self, index: Index, refined: &[Turn]) -> Flown {
        match (self.target(index, refined), self.flying) {
            (_, Some(flying)) if self.is_flying(index) => flying,
            (Target::Turn(turn), _) => Flown::Turn(turn, self.start),
            _ => Flown::Aimed(index),
        }
    }

    pub(crate) fn is_flying(&self, index: Index) -> bool {
        match self.flying {
            Some(Flown::Turn(..)) => index == self.library.size() + FLYING,
            Some(Flown::Aimed(flying)) => index == flying,
            None => false,
        }
    }

    pub(crate) fn roll_out(&self, target: Target<'_>, rollout: &mut Rollout) {
        rollout.fill(self.aim.from, target, self.config.horizon_s, self.config);
    }

    /// Prices a candidate, rolled out; `None` where it hardly moves, or creeps, or is no cheaper than `most_m`.
    fn price(&self, index: Index, rollout: &Rollout, most_m: f64) -> Option<Priced> {
        let (going, end) = (&rollout.samples[..rollout.braking], rollout.end_of_going());
        let from = self.aim.from.position;
        if !self.near_goal && (end.position.distance(from) < WORTHWHILE_M || self.committed_m(going) < self.least_m) {
            return None;
        }
        let hysteresis_m = if self.is_flying(index) { self.config.hysteresis_m } else { 0.0 };
        let sets_out_at = going[going.len().min((SETS_OUT_S / STEP_S) as usize + 1) - 1].position;
        let sets_out = sets_out_at - from;
        let heading_rad = sets_out.y.atan2(sets_out.x);
        let slow = self.is_slow();
        let turns = slow && !is_seen(heading_rad, self.situation.yaw_rad, self.half_view_rad);
        // Every look from here makes turning away dearer, by the square of their number: it must be done with looking.
        let looks = if turns { 1 + self.gaze.looks(self.situation) } else { 0 };
        let look_m =
            self.config.look_price_m * (looks * looks) as f64 + if turns { self.waiting_m(heading_rad) } else { 0.0 };
        // Also where it comes to rest: what shoots past the goal is no nearer to it.
        let rest = rollout.samples.last().map_or(end.position, |rest| rest.position);
        let to_goal_m = self.to_goal_m(end.position).max(self.to_goal_m(rest));
        let (soon_m, turning_m) = (SOON * self.to_goal_m(sets_out_at), self.turning_m(end));
        let stuck_m = self.stuck.price(end.position);
        // What is too dear already is not followed through the grid.
        if to_goal_m + soon_m + turning_m + stuck_m + look_m - hysteresis_m > most_m + ROUNDING_M {
            return None;
        }
        let beyond_m = self.field.beyond_length_m(going);
        let price_m = to_goal_m + soon_m + beyond_m + turning_m + stuck_m + look_m - hysteresis_m;
        (price_m < most_m).then_some(Priced { index, price_m, heading_rad, turns })
    }

    /// Whether the vehicle is slow enough to look before it sets out.
    pub(crate) fn is_slow(&self) -> bool {
        self.config.gaze_follows_flight && self.situation.velocity.norm() < LOOK_FIRST_MPS && !self.near_goal
    }

    /// How far from its start a candidate gets by what it commits to, the stop included, m: less than the slowest manoeuvre
    /// does is creeping, which the swept volume alone would admit again and again.
    fn committed_m(&self, going: &[Sample]) -> f64 {
        let last = going[going.len().min((self.config.commit_s / STEP_S).round() as usize + 1) - 1];
        let stop = last.velocity * (last.velocity.norm() / (2.0 * self.config.braking_mps2));
        (last.position + stop).distance(going[0].position)
    }

    /// Distance that would be flown, at half of the cruise speed, while the camera turns to a heading, m.
    fn waiting_m(&self, heading_rad: f64) -> f64 {
        let turn_rad = wrap_angle_rad(heading_rad - self.situation.yaw_rad).abs();
        0.5 * self.situation.cruise_mps * turn_rad / (LOOK_SHARE * self.config.yaw_rate_degps.to_radians())
    }

    /// What it costs to get from the velocity at a candidate's end to the one that the rest of the way asks for, m: the
    /// distance |Δv|²/2a that is lost meanwhile, by acceleration a.
    fn turning_m(&self, end: Sample) -> f64 {
        let Some(downhill) = self.field.downhill(end.position).filter(|_| !self.near_goal) else { return 0.0 };
        let left_m = end.position.distance(self.situation.goal);
        let able_mps = (2.0 * self.config.braking_mps2 * left_m).sqrt();
        let wanted = downhill * self.situation.cruise_mps.min(able_mps);
        let change = (wanted - end.velocity).horizontal_norm();
        self.config.turning_price * change * change / (2.0 * self.config.acceleration_mps2)
    }

    /// What remains to the goal, m: around and over what is known and remembered. A way that is much longer is as good as
    /// none, and then the path tells, which is bound to no level.
    fn to_goal_m(&self, end: Point<World>) -> f64 {
        let straight_m = end.distance(self.situation.goal);
        // Close to the goal the grid tells nothing of the height, which is all that may be left.
        let level_m = self.field.to_goal_m(end).max(if self.near_goal { straight_m } else { 0.0 });
        let path_m = self.guide.to_goal_m(end);
        // Where there is no path either, far is better than nothing.
        level_m.min(NO_WAY_M + if path_m.is_finite() { path_m } else { straight_m })
    }

    /// Prices all candidates, and refines the cheapest manoeuvres.
    pub(crate) fn price_all(&self, pricing: &mut Pricing) {
        let count = self.library.size() + usize::from(matches!(self.flying, Some(Flown::Turn(..))));
        let share = count.div_ceil(pricing.workers.len());
        pricing.refined.clear();
        pricing.each(|number, worker| {
            worker.priced.clear();
            for index in number * share..((number + 1) * share).min(count) {
                self.roll_out(self.target(index, &[]), &mut worker.rollout);
                worker.priced.extend(self.price(index, &worker.rollout, f64::INFINITY));
            }
        });
        let Pricing { priced, workers, .. } = pricing;
        priced.clear();
        workers.iter().for_each(|worker| priced.extend_from_slice(&worker.priced));
        sort(priced);
        self.refine_cheapest(pricing);
        sort(&mut pricing.priced);
    }

    /// Adds cheaper manoeuvres than the cheapest, to each of which there is one nearby.
    fn refine_cheapest(&self, pricing: &mut Pricing) {
        let (count, mut next) = (pricing.priced.len(), 0);
        while pricing.refined.len() < REFINED && next < count {
            let Pricing { priced, refined, workers, .. } = pricing;
            let wanted = (REFINED - refined.len()).min(workers.len());
            workers.iter_mut().for_each(|worker| worker.from = None);
            for worker in &mut workers[..wanted] {
                while worker.from.is_none() && next < count {
                    let Priced { index, price_m, .. } = priced[next];
                    if let Target::Turn(turn) = self.target(index, refined) {
                        worker.from = Some((turn, price_m));
                    }
                    next += 1;
                }
            }
            pricing.each(|_, worker| {
                let Worker { from, found, rollout, .. } = worker;
                *found = from.and_then(|(turn, price_m)| self.refine(turn, price_m, rollout));
            });
            let Pricing { priced, refined, workers, .. } = pricing;
            for (turn, cheaper) in workers.iter().filter_map(|worker| worker.found) {
                priced.push(Priced { index: self.library.size() + FLYING + 1 + refined.len(), ..cheaper });
                refined.push(turn);
            }
        }
    }

    /// Pattern search (Hooke and Jeeves 1961) from a manoeuvre to a cheaper one; `None` if there is none nearby.
    fn refine(&self, from: Turn, price_m: f64, rollout: &mut Rollout) -> Option<(Turn, Priced)> {
        let (mut turn, mut best, mut step) = (from, None, 1.0);
        let mut cheapest_m = price_m;
        for _ in 0..ROUNDS {
            let mut found = None;
            for change in 0..2 * PARAMETERS {
                let tried = varied(turn, change, step, self.aim.speed_mps);
                self.roll_out(Target::Turn(tried), rollout);
                if let Some(priced) = self.price(NEW, rollout, cheapest_m) {
                    cheapest_m = priced.price_m;
                    found = Some((tried, priced));
                }
            }
            match found {
                Some((tried, _)) => (turn, best) = (tried, found),
                None => step *= 0.5,
            }
        }
        best
    }
}

fn sort(priced: &mut [Priced]) {
    priced.sort_unstable_by(|a, b| a.price_m.total_cmp(&b.price_m).then(a.index.cmp(&b.index)));
}

/// A manoeuvre with one of its parameters changed, up or down, by a share of the largest change.
fn varied(turn: Turn, change: usize, step: f64, most_mps: f64) -> Turn {
    let by = if change.is_multiple_of(2) { step } else { -step };
    let turned = |velocity: Vector<World>| {
        let (sin, cos) = (LARGEST_TURN_RAD * by).sin_cos();
        Vector::new(cos * velocity.x - sin * velocity.y, sin * velocity.x + cos * velocity.y, velocity.z)
    };
    let scaled = |velocity: Vector<World>| (velocity * (1.0 + LARGEST_SCALE * by)).clamp_norm(most_mps);
    match change / 2 {
        0 => Turn { first: turned(turn.first), ..turn },
        1 => Turn { then: turned(turn.then), ..turn },
        2 => Turn { first: scaled(turn.first), ..turn },
        3 => Turn { then: scaled(turn.then), ..turn },
        _ => Turn { switch_s: (turn.switch_s + LARGEST_SWITCH_S * by).max(0.0), ..turn },
    }
}
