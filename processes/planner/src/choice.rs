//! Which candidate to fly: all are priced, and the map is asked about them in the order of their prices.
//!
//! What a candidate costs is known before the map is asked. Most are never asked about, and the answer is the same as if all
//! had been.

use crate::Config;
use crate::admission::{Admission, Tally};
use crate::field::Field;
use crate::gaze::{Gaze, LOOKS, StepBack, is_seen};
use crate::guide::Guide;
use crate::library::{Aim, Index, Library};
use crate::rollout::{Rollout, STEP_S, Sample, Target, Turn};
use crate::situation::Situation;
use crate::stuck::{LOOK_SHARE, Stuck};
use ipc_types::frames::wrap_angle_rad;
use ipc_types::{FlightTime, Point, Vector, World};
use std::f64::consts::PI;

/// Slower than this the vehicle looks before it sets out to where it does not look, m/s.
const LOOK_FIRST_MPS: f64 = 0.9;
/// What no way at this height costs beyond the path, m.
const NO_WAY_M: f64 = 20.0;
/// Shortest move worth making, m: less is standing still.
const WORTHWHILE_M: f64 = 0.3;
/// A candidate sets out to where it leads after so long, s.
const SETS_OUT_S: f64 = 1.0;
/// How far to step back to look, as a share of what the camera cannot see a body within.
const STEP_SHARE: f64 = 0.7;
/// Speed of stepping back, m/s.
pub(crate) const STEP_MPS: f64 = 0.8;
/// Directions of stepping back, from straight back, rad.
const ASIDE_RAD: [f64; 5] = [0.0, 0.5, -0.5, 1.0, -1.0];
/// Place of the manoeuvre being flown behind the library; refined ones follow it.
const FLYING: usize = 0;
/// So many of the cheapest manoeuvres are refined ...
pub(crate) const REFINED: usize = 3;
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
/// What is to be known, or promised, of where the camera does not look, s.
const FORESEEN_S: f64 = 1.5;

/// What is flown, named so that it stays the same in the world while the vehicle moves along it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Flown {
    /// A candidate that aims at the goal or follows a way.
    Aimed(Index),
    /// A manoeuvre, begun at this time.
    Turn(Turn, FlightTime),
}

/// What the cheapest candidate asks for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Course {
    /// There is none.
    None,
    /// Fly it.
    Go(Flown),
    /// Look along its heading, rad, before it may be flown.
    Look(f64),
    /// Look along its heading from farther away.
    StepBack(StepBack),
}

/// A candidate and what it costs, m.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Priced {
    /// In the library; beyond it what is being flown, then what was refined.
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
    fn target(&self, index: Index, refined: &[Turn]) -> Target<'_> {
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
    fn flown(&self, index: Index, refined: &[Turn]) -> Flown {
        match (self.target(index, refined), self.flying) {
            (_, Some(flying)) if self.is_flying(index) => flying,
            (Target::Turn(turn), _) => Flown::Turn(turn, self.start),
            _ => Flown::Aimed(index),
        }
    }

    fn is_flying(&self, index: Index) -> bool {
        match self.flying {
            Some(Flown::Turn(..)) => index == self.library.size() + FLYING,
            Some(Flown::Aimed(flying)) => index == flying,
            None => false,
        }
    }

    fn roll_out(&self, target: Target<'_>, rollout: &mut Rollout) {
        rollout.fill(self.aim.from, target, self.config.horizon_s, self.config);
    }

    /// Prices a candidate, rolled out; `None` where it hardly moves, or creeps.
    fn price(&self, index: Index, rollout: &Rollout) -> Option<Priced> {
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
        let price_m = self.to_goal_m(end.position).max(self.to_goal_m(rest))
            + SOON * self.to_goal_m(sets_out_at)
            + self.field.beyond_length_m(going)
            + self.turning_m(end)
            + self.stuck.price(end.position)
            + look_m
            - hysteresis_m;
        Some(Priced { index, price_m, heading_rad, turns })
    }

    /// Whether the vehicle is slow enough to look before it sets out.
    fn is_slow(&self) -> bool {
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

    /// What remains to the goal, m: around what is known at this height and remembered there. A way that is much longer
    /// is as good as none, and then the path tells, which may lead over things.
    fn to_goal_m(&self, end: Point<World>) -> f64 {
        let off_m = if self.near_goal { 0.0 } else { (end.z - self.aim.height_m).abs() };
        let level_m = self.field.to_goal_m(end) + self.config.height_price * off_m;
        let path_m = self.guide.to_goal_m(end);
        // Where there is no path either, far is better than nothing.
        level_m.min(NO_WAY_M + if path_m.is_finite() { path_m } else { end.distance(self.situation.goal) })
    }

    /// Prices all candidates, and refines the cheapest manoeuvres. Leaves them in the order of their prices.
    pub(crate) fn price_all(&self, priced: &mut Vec<Priced>, refined: &mut Vec<Turn>, scratch: &mut Rollout) {
        priced.clear();
        refined.clear();
        let size = self.library.size();
        for index in (0..size).chain(matches!(self.flying, Some(Flown::Turn(..))).then_some(size + FLYING)) {
            self.roll_out(self.target(index, refined), scratch);
            priced.extend(self.price(index, scratch));
        }
        sort(priced);
        let mut begun = 0;
        for from in 0..priced.len() {
            let Target::Turn(turn) = self.target(priced[from].index, refined) else { continue };
            let index = size + FLYING + 1 + refined.len();
            let Some((turn, cheapest)) = self.refine(turn, index, priced[from].price_m, scratch) else { continue };
            refined.push(turn);
            priced.push(cheapest);
            begun += 1;
            if begun == REFINED {
                break;
            }
        }
        sort(priced);
    }

    /// Pattern search (Hooke and Jeeves 1961) from a manoeuvre to a cheaper one; `None` if there is none nearby.
    fn refine(&self, from: Turn, index: Index, price_m: f64, scratch: &mut Rollout) -> Option<(Turn, Priced)> {
        let (mut turn, mut best, mut step) = (from, None, 1.0);
        let mut cheapest_m = price_m;
        for _ in 0..ROUNDS {
            let mut found = None;
            for change in 0..2 * PARAMETERS {
                let tried = varied(turn, change, step, self.aim.speed_mps);
                self.roll_out(Target::Turn(tried), scratch);
                if let Some(priced) = self.price(index, scratch).filter(|priced| priced.price_m < cheapest_m) {
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

    /// Asks about candidates, cheapest first, and leaves the first admissible one in `best`.
    pub(crate) fn choose(
        &self,
        admission: &Admission<'_>,
        Candidates { priced, refined, scratch, best }: Candidates<'_>,
        tally: &mut Tally,
    ) -> Course {
        self.price_all(priced, refined, scratch);
        tally.candidates = priced.len() as u32;
        let looked = self.gaze.looks(self.situation);
        let slow = self.is_slow();
        let mut hidden: Option<(f64, StepBack)> = None;
        for candidate in priced.iter() {
            if let Some((_, step)) = hidden.filter(|(price_m, _)| *price_m < candidate.price_m) {
                return Course::StepBack(step);
            }
            let threshold =
                if self.is_flying(candidate.index) { self.config.gamma_high } else { self.config.gamma_low };
            let heading_rad = candidate.heading_rad;
            self.roll_out(self.target(candidate.index, refined), best);
            let admitted = tally.count(admission.admit(best, threshold));
            // What is known, though not from here, needs no look.
            let looks =
                candidate.turns && looked < LOOKS && !(admitted && admission.knows(best, threshold, FORESEEN_S));
            if looks && !self.gaze.has_looked(heading_rad, self.situation, self.half_view_rad) {
                if admission.promises(best, threshold, FORESEEN_S, self.config.blind_m) {
                    return Course::Look(heading_rad);
                }
            } else if admitted {
                let go = || Course::Go(self.flown(candidate.index, refined));
                return if looks { Course::Look(heading_rad) } else { go() };
            }
            let hides = slow && hidden.is_none() && looked < LOOKS;
            if hides
                && admission.promises(best, threshold, FORESEEN_S, 0.0)
                && let Some(step) = self.step_back(heading_rad, admission, best)
            {
                hidden = Some((candidate.price_m + self.config.step_back_price_m * (looked + 1).pow(2) as f64, step));
            }
        }
        hidden.map_or(Course::None, |(_, step)| Course::StepBack(step))
    }

    /// A place from where what hides on a heading, too near for the camera, can be seen: straight back or aside of that, as
    /// far as all of the way is known free. Leaves the way in `best`.
    fn step_back(&self, heading_rad: f64, admission: &Admission<'_>, best: &mut Rollout) -> Option<StepBack> {
        let (from, threshold) = (self.aim.from, self.config.gamma_high);
        ASIDE_RAD.into_iter().find_map(|aside_rad| {
            let back_rad = heading_rad + PI + aside_rad;
            let to =
                from.position + Vector::new(back_rad.cos(), back_rad.sin(), 0.0) * (STEP_SHARE * self.config.blind_m);
            best.fill(from, Target::Place(to, STEP_MPS), FORESEEN_S, self.config);
            let is_free = admission.admit(best, threshold).is_ok() && admission.knows(best, threshold, f64::INFINITY);
            is_free.then_some(StepBack { to, heading_rad })
        })
    }
}

/// What candidates are worked out in, made once.
pub(crate) struct Candidates<'a> {
    pub(crate) priced: &'a mut Vec<Priced>,
    /// Manoeuvres that the library does not hold.
    pub(crate) refined: &'a mut Vec<Turn>,
    pub(crate) scratch: &'a mut Rollout,
    /// Where the one that is chosen is left.
    pub(crate) best: &'a mut Rollout,
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
