//! The candidates: a library of manoeuvres made once from the vehicle's dynamics, and what aims at the goal or follows a way.
//!
//! A manoeuvre turns to one velocity and after [`SWITCH_S`] to another, so that it may go around something. Which ones a
//! library holds is chosen for dispersion (Green and Kelly 2007): of many more, drawn evenly, greedily the one that leads
//! farthest from all that were chosen before. What a manoeuvre does depends on the speed it begins at, so there is a
//! library for each of [`SPEEDS`].

use crate::Config;
use crate::rollout::{Rollout, STEP_S, Sample, Target, Turn};
use crate::route::Timed;
use ipc_types::{Point, Vector, World};
use serde::{Deserialize, Serialize};
use std::f64::consts::FRAC_PI_2;
use std::sync::OnceLock;

/// How long a manoeuvre holds its first velocity, s.
pub(crate) const SWITCH_S: f64 = 0.8;
/// Start speeds that have a library of their own, as shares of the cruise speed.
const SPEEDS: [f64; 4] = [0.0, 0.33, 0.67, 1.0];
/// So many manoeuvres are drawn for each that is chosen.
const DRAWN: usize = 4;
/// When two manoeuvres are compared, as shares of the horizon.
const COMPARED: [f64; 3] = [0.3, 0.6, 1.0];
/// Every so-many-th manoeuvre drawn climbs or descends.
const CLIMBING: usize = 4;
/// Largest second turn, rad.
const SECOND_TURN_RAD: f64 = FRAC_PI_2;
/// Speeds of what aims at the goal or follows a way, as shares of the cruise speed.
const AIMED_SHARES: [f64; 5] = [1.0, 0.8, 0.6, 0.4, 0.25];
/// What is aimed at: the goal, the guide's path, the field's way.
const AIMS: usize = 3;
/// A height is corrected in so long, s ...
const HEIGHT_S: f64 = 0.8;
/// ... no steeper than this share of the speed.
const STEEPEST: f64 = 0.3;

/// Which manoeuvres there are.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LibraryConfig {
    /// How many.
    pub size: u32,
    /// Largest first turn, to either side, degrees.
    pub turn_deg: f64,
    /// Steepest climb and descent, degrees; 0: a level library.
    pub climb_deg: f64,
    /// Slowest speed, as a share of the cruise speed.
    pub slowest_share: f64,
}

/// How a candidate is named: its place in the library.
pub(crate) type Index = usize;

/// What candidates are relative to.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Aim<'a> {
    pub(crate) from: Sample,
    pub(crate) goal: Point<World>,
    /// Highest speed, m/s.
    pub(crate) speed_mps: f64,
    /// Height to keep, m.
    pub(crate) height_m: f64,
    /// Heading that turns are relative to, rad.
    pub(crate) heading_rad: f64,
    /// Timed ways to the goal: the guide's path and the field's.
    pub(crate) ways: [&'a [Timed]; 2],
}

/// Two velocities, one after the other.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Manoeuvre {
    /// From the heading; from the first velocity.
    turns_rad: [f64; 2],
    /// Of the cruise speed.
    shares: [f64; 2],
    /// None: keeps its height, or gets back to it.
    climb_rad: Option<f64>,
}

/// The library. Each start speed's part is made when it is first asked for, so that a successor of a planner in flight
/// makes one of four before it plans, or ahead of that by [`Library::prepare`].
#[derive(Clone, Debug)]
pub(crate) struct Library {
    config: Config,
    cruise_mps: f64,
    sets: [OnceLock<Vec<Manoeuvre>>; SPEEDS.len()],
    aimed_shares: Vec<f64>,
}

impl Library {
    /// For a cruise speed; flown at another it is less well dispersed.
    pub(crate) fn new(config: &Config, cruise_mps: f64) -> Self {
        let aimed_shares = AIMED_SHARES.into_iter().filter(|&share| share >= config.library.slowest_share);
        Self { config: config.clone(), cruise_mps, sets: Default::default(), aimed_shares: aimed_shares.collect() }
    }

    /// Makes one part that has not been asked for yet, the fastest first; whether there was one.
    pub(crate) fn prepare(&self) -> bool {
        let missing = (0..SPEEDS.len()).rev().find(|&set| self.sets[set].get().is_none());
        missing.map(|set| self.set(set)).is_some()
    }

    fn set(&self, set: usize) -> &[Manoeuvre] {
        self.sets[set].get_or_init(|| choose(&self.config, self.cruise_mps, SPEEDS[set] * self.cruise_mps))
    }

    /// Number of candidates.
    pub(crate) fn size(&self) -> usize {
        AIMS * self.aimed_shares.len() + self.config.library.size as usize
    }

    /// A candidate.
    pub(crate) fn target<'a>(&self, index: Index, aim: &Aim<'a>) -> Target<'a> {
        let aimed = AIMS * self.aimed_shares.len();
        if let Some(manoeuvre) = index.checked_sub(aimed) {
            let share = aim.from.velocity.norm() / aim.speed_mps;
            let gap = |set: &usize| (SPEEDS[*set] - share).abs();
            let set = (0..SPEEDS.len()).min_by(|a, b| gap(a).total_cmp(&gap(b))).unwrap_or(0);
            return self.set(set)[manoeuvre].target(aim);
        }
        let speed = aim.speed_mps * self.aimed_shares[index / AIMS];
        match index % AIMS {
            0 => Target::Place(aim.goal, speed),
            way => Target::Along(aim.ways[way - 1], speed),
        }
    }
}

impl Manoeuvre {
    fn target<'a>(&self, aim: &Aim<'_>) -> Target<'a> {
        let mut heading_rad = aim.heading_rad;
        let off_m = aim.height_m - aim.from.position.z;
        let [first, then] = [0, 1].map(|part| {
            heading_rad += self.turns_rad[part];
            let speed = aim.speed_mps * self.shares[part];
            let up = match self.climb_rad {
                Some(climb_rad) => speed * climb_rad.sin(),
                None => (off_m / HEIGHT_S).clamp(-STEEPEST * speed, STEEPEST * speed),
            };
            let level = (speed * speed - up * up).max(0.0).sqrt();
            Vector::new(level * heading_rad.cos(), level * heading_rad.sin(), up)
        });
        Target::Turn(Turn { first, then, switch_s: SWITCH_S })
    }
}

/// The manoeuvres for a start speed.
fn choose(config: &Config, cruise_mps: f64, start_mps: f64) -> Vec<Manoeuvre> {
    let size = config.library.size as usize;
    let drawn: Vec<_> = (0..DRAWN * size).map(|index| draw(index, &config.library)).collect();
    let start = Sample { position: Point::ZERO, velocity: Vector::new(start_mps, 0.0, 0.0) };
    let aim = Aim {
        from: start,
        goal: Point::ZERO,
        speed_mps: cruise_mps,
        height_m: 0.0,
        heading_rad: 0.0,
        ways: [&[], &[]],
    };
    let mut rollout = Rollout::new();
    let traces: Vec<_> = drawn
        .iter()
        .map(|manoeuvre| {
            rollout.fill(start, manoeuvre.target(&aim), config.horizon_s, config);
            COMPARED.map(|share| {
                let step = (share * config.horizon_s / STEP_S).round() as usize;
                rollout.samples[step.min(rollout.braking - 1)].position
            })
        })
        .collect();
    disperse(&traces, size).into_iter().map(|index| drawn[index]).collect()
}

/// Greedily the `size` traces that are farthest from one another; the first is the first.
fn disperse(traces: &[[Point<World>; 3]], size: usize) -> Vec<usize> {
    let apart = |a: &[Point<World>; 3], b: &[Point<World>; 3]| -> f64 {
        // Early differences decide what is passed on which side: they are small and count as much.
        a.iter().zip(b).zip(COMPARED).map(|((a, b), share)| a.distance(*b) / share).sum()
    };
    let mut nearest = vec![f64::INFINITY; traces.len()];
    let (mut chosen, mut next) = (Vec::with_capacity(size), 0);
    while chosen.len() < size.min(traces.len()) {
        chosen.push(next);
        let mut farthest = (f64::NEG_INFINITY, next);
        for (index, trace) in traces.iter().enumerate() {
            nearest[index] = nearest[index].min(apart(trace, &traces[next]));
            if nearest[index] > farthest.0 {
                farthest = (nearest[index], index);
            }
        }
        nearest[farthest.1] = f64::NEG_INFINITY;
        next = farthest.1;
    }
    chosen
}

/// The index-th manoeuvre of a Halton sequence; the first goes straight at full speed.
fn draw(index: usize, config: &LibraryConfig) -> Manoeuvre {
    if index == 0 {
        return Manoeuvre { turns_rad: [0.0; 2], shares: [1.0; 2], climb_rad: None };
    }
    let even = |base| radical_inverse(index, base);
    // Small turns more often than large ones.
    let turn = |value: f64, most_rad: f64| (2.0 * value - 1.0) * (2.0 * value - 1.0).abs() * most_rad;
    let share = |value: f64| config.slowest_share + (1.0 - config.slowest_share) * value;
    let climbs = config.climb_deg > 0.0 && index.is_multiple_of(CLIMBING);
    Manoeuvre {
        turns_rad: [turn(even(2), config.turn_deg.to_radians()), turn(even(3), SECOND_TURN_RAD)],
        shares: [share(even(5)), share(even(7))],
        climb_rad: climbs.then(|| (2.0 * even(11) - 1.0) * config.climb_deg.to_radians()),
    }
}

/// Van der Corput's sequence: the digits of `index` in a base, mirrored at the point.
fn radical_inverse(mut index: usize, base: usize) -> f64 {
    let (mut value, mut digit) = (0.0, 1.0 / base as f64);
    while index > 0 {
        value += (index % base) as f64 * digit;
        index /= base;
        digit /= base as f64;
    }
    value
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::config;

    #[test]
    fn the_library_has_no_duplicates_and_begins_with_what_is_aimed() {
        let library = Library::new(&config(), 4.0);
        let from = Sample { position: Point::ZERO, velocity: Vector::new(2.0, 1.0, 0.0) };
        let goal = Point::new(50.0, 10.0, 0.0);
        let way = [Timed { t_s: 0.0, at: goal, velocity: Vector::ZERO }];
        let aim = Aim { from, goal, speed_mps: 4.0, height_m: 0.0, heading_rad: 0.5, ways: [&way, &[]] };
        let mut targets = Vec::new();
        for index in 0..library.size() {
            let target = library.target(index, &aim);
            assert!(!targets.contains(&target), "{target:?} twice");
            targets.push(target);
        }
        assert_eq!(targets.len(), 12 + config().library.size as usize);
        assert!(matches!(targets[..3], [Target::Place(..), Target::Along(..), Target::Along(..)]));
    }

    #[test]
    fn what_is_chosen_is_better_dispersed_than_what_is_drawn() {
        let traces: Vec<_> = (0..400)
            .map(|index| {
                let at = Point::new(10.0 * radical_inverse(index, 2).powi(3), 10.0 * radical_inverse(index, 3), 0.0);
                [at; 3]
            })
            .collect();
        // The farthest that any trace is from the chosen ones.
        let dispersion = |chosen: &[usize]| {
            let gap = |trace: &[Point<World>; 3]| {
                chosen.iter().map(|&index| traces[index][0].distance(trace[0])).fold(f64::INFINITY, f64::min)
            };
            traces.iter().map(gap).fold(0.0, f64::max)
        };
        let chosen = disperse(&traces, 40);
        let first: Vec<_> = (0..40).collect();
        assert!(dispersion(&chosen) < 0.75 * dispersion(&first), "{} {}", dispersion(&chosen), dispersion(&first));
        let mut unique = chosen.clone();
        unique.sort_unstable();
        unique.dedup();
        assert_eq!((unique.len(), chosen[0]), (40, 0));
    }

    #[test]
    fn a_level_library_keeps_its_height_and_gets_back_to_it() {
        let mut config = config();
        config.library.climb_deg = 0.0;
        let library = Library::new(&config, 4.0);
        let from = Sample { position: Point::new(0.0, 0.0, 1.0), velocity: Vector::ZERO };
        let aim = Aim { from, goal: Point::ZERO, speed_mps: 4.0, height_m: 2.0, heading_rad: 0.0, ways: [&[], &[]] };
        for index in 12..library.size() {
            let Target::Turn(Turn { first, then, .. }) = library.target(index, &aim) else { panic!("no manoeuvre") };
            assert!(first.z > 0.0 && then.z > 0.0 && first.norm() < 4.001, "{first:?} {then:?}");
        }
    }
}
