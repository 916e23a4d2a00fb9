//! Which candidate to fly: all are priced, and the map is asked about them in the order of their prices.
//!
//! What a candidate costs is known from below before the map is asked: what remains to the goal from its end. Most are
//! never asked about, and the answer is the same as if all had been.

use crate::Config;
use crate::admission::{Admission, Tally};
use crate::field::Field;
use crate::gaze::{Gaze, LOOKS, is_seen};
use crate::guide::Guide;
use crate::library::{Aim, Index, Library};
use crate::rollout::{Rollout, Sample};
use crate::situation::Situation;
use crate::stuck::Stuck;
use ipc_types::{Point, World};

/// Slower than this the vehicle looks before it sets out to where it does not look, m/s.
const LOOK_FIRST_MPS: f64 = 0.9;
/// What no way at this height costs beyond the path, m.
const NO_WAY_M: f64 = 20.0;
/// Shortest move worth making, m: less is standing still.
const WORTHWHILE_M: f64 = 0.3;

/// What the cheapest candidate asks for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Course {
    /// There is none.
    None,
    /// Fly it.
    Go(Index),
    /// Look along its heading, rad, before it may be flown.
    Look(f64),
}

/// A candidate and what it costs at least, m: what is unknown of it comes on top.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Priced {
    index: Index,
    price_m: f64,
    heading_rad: f64,
    /// Whether the camera does not look there, and the vehicle is slow enough to turn it first.
    turns: bool,
}

/// What candidates are priced by.
pub(crate) struct Prices<'a> {
    pub(crate) config: &'a Config,
    pub(crate) library: &'a Library,
    pub(crate) aim: Aim<'a>,
    pub(crate) situation: &'a Situation,
    pub(crate) from: Sample,
    pub(crate) field: &'a Field,
    pub(crate) guide: &'a Guide,
    pub(crate) stuck: &'a Stuck,
    pub(crate) gaze: &'a Gaze,
    pub(crate) flying: Option<Index>,
    /// Height to keep, m.
    pub(crate) height_m: f64,
    pub(crate) near_goal: bool,
    pub(crate) half_view_rad: f64,
}

impl Prices<'_> {
    fn roll_out(&self, index: Index, rollout: &mut Rollout) {
        rollout.fill(self.from, self.library.target(index, &self.aim), self.config.horizon_s, self.config);
    }

    /// Prices a candidate, rolled out; `None` where it hardly moves.
    fn price(&self, index: Index, rollout: &Rollout) -> Option<Priced> {
        let end = rollout.end_of_going().position;
        let way = end - self.from.position;
        if way.norm() < WORTHWHILE_M && !self.near_goal {
            return None;
        }
        let hysteresis_m = if self.flying == Some(index) { self.config.hysteresis_m } else { 0.0 };
        let heading_rad = way.y.atan2(way.x);
        let slow = self.situation.velocity.norm() < LOOK_FIRST_MPS && !self.near_goal;
        let turns = slow && !is_seen(heading_rad, self.situation.yaw_rad, self.half_view_rad);
        // Every look from here makes turning away dearer, by the square of their number: it must be done with looking.
        let looks = if turns { 1 + self.gaze.looks(self.situation) } else { 0 };
        let turning_m = self.config.look_price_m * (looks * looks) as f64;
        // Also where it comes to rest: what shoots past the goal is no nearer to it.
        let rest = rollout.samples.last().map_or(end, |rest| rest.position);
        let price_m = self.to_goal_m(end).max(self.to_goal_m(rest))
            + self.turning_m(rollout.end_of_going())
            + self.stuck.price(end)
            + turning_m
            - hysteresis_m;
        Some(Priced { index, price_m, heading_rad, turns })
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

    /// What remains to the goal, m: around what is known at this height and remembered there. A way that is much longer
    /// is as good as none, and then the path tells, which may lead over things.
    fn to_goal_m(&self, end: Point<World>) -> f64 {
        let off_m = if self.near_goal { 0.0 } else { (end.z - self.height_m).abs() };
        let level_m = self.field.to_goal_m(end) + self.config.height_price * off_m;
        let path_m = self.guide.to_goal_m(end);
        // Where there is no path either, far is better than nothing.
        level_m.min(NO_WAY_M + if path_m.is_finite() { path_m } else { end.distance(self.situation.goal) })
    }

    /// Asks about candidates, cheapest first, and leaves the cheapest admissible one in `best`.
    pub(crate) fn choose(
        &self,
        admission: &Admission<'_>,
        priced: &mut Vec<Priced>,
        [scratch, best]: [&mut Rollout; 2],
        tally: &mut Tally,
    ) -> Course {
        priced.clear();
        for index in 0..self.library.size() {
            self.roll_out(index, scratch);
            priced.extend(self.price(index, scratch));
        }
        tally.candidates = self.library.size() as u32;
        priced.sort_unstable_by(|a, b| a.price_m.total_cmp(&b.price_m).then(a.index.cmp(&b.index)));
        let looked = self.gaze.looks(self.situation);
        let (mut cheapest_m, mut course) = (f64::INFINITY, Course::None);
        for candidate in priced.iter() {
            if candidate.price_m >= cheapest_m {
                break;
            }
            let is_flying = self.flying == Some(candidate.index);
            let threshold = if is_flying { self.config.gamma_high } else { self.config.gamma_low };
            let heading_rad = candidate.heading_rad;
            self.roll_out(candidate.index, scratch);
            let admitted = tally.count(admission.admit(scratch, threshold));
            // What is known all along, though not from here, needs no look.
            let is_known = admitted.is_some_and(|found| found.unknown_m == 0.0);
            let looks = candidate.turns && looked < LOOKS && !is_known;
            let found = if looks && !self.gaze.has_looked(heading_rad, self.situation, self.half_view_rad) {
                admission.promises(scratch, threshold)
            } else {
                admitted
            };
            let Some(found) = found else { continue };
            let price_m = candidate.price_m + self.config.unknown_price * found.unknown_m;
            if price_m < cheapest_m {
                cheapest_m = price_m;
                course = if looks { Course::Look(heading_rad) } else { Course::Go(candidate.index) };
                std::mem::swap(scratch, best);
            }
        }
        course
    }
}
