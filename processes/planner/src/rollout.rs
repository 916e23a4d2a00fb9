//! Dynamically feasible trajectories: a point mass whose velocity follows a target no faster than it can.

use crate::Config;
use crate::route::Timed;
use ipc_types::{Point, Vector, World};

/// Time step of a roll-out, s.
pub(crate) const STEP_S: f64 = 0.1;
/// Most samples of a trajectory; longer ones are cut, which only a configuration beyond its bounds can ask for.
pub(crate) const MOST_SAMPLES: usize = 200;

/// A place is closed in on by its distance in so long, s.
const SETTLE_S: f64 = 0.5;
/// A path is got back onto in so long, s.
const ONTO_PATH_S: f64 = 0.4;
/// A path's velocity is followed so many steps ahead: corners are begun before they are reached.
const AHEAD_STEPS: usize = 2;

/// A sample of a trajectory.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Sample {
    pub(crate) position: Point<World>,
    pub(crate) velocity: Vector<World>,
}

/// Two velocities, one after the other.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Turn {
    /// At first.
    pub(crate) first: Vector<World>,
    /// From `switch_s` on.
    pub(crate) then: Vector<World>,
    /// Since the start, s.
    pub(crate) switch_s: f64,
}

/// What the velocity follows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Target<'a> {
    /// One velocity, and after a while another.
    Turn(Turn),
    /// A place to come to rest at, approached no faster than this.
    Place(Point<World>, f64),
    /// A timed path, no faster than this.
    Along(&'a [Timed], f64),
}

/// A rolled-out trajectory: `samples[..braking]` goes, the rest brakes to rest.
#[derive(Clone, Debug, Default)]
pub(crate) struct Rollout {
    pub(crate) samples: Vec<Sample>,
    pub(crate) braking: usize,
}

impl Rollout {
    pub(crate) fn new() -> Self {
        Self { samples: Vec::with_capacity(MOST_SAMPLES + 1), braking: 0 }
    }

    /// Goes for `duration_s` after `target`, then brakes to rest. Reuses the samples' memory.
    pub(crate) fn fill(&mut self, start: Sample, target: Target<'_>, duration_s: f64, config: &Config) {
        self.samples.clear();
        self.samples.push(start);
        let mut sample = start;
        let steps = (duration_s / STEP_S).round() as usize;
        let mut passed = 0;
        self.samples.extend((0..steps.min(MOST_SAMPLES)).map(|step| {
            let wanted = match target {
                Target::Turn(turn) if (step as f64) * STEP_S < turn.switch_s => turn.first,
                Target::Turn(turn) => turn.then,
                Target::Place(place, speed) => approach(place - sample.position, speed, config),
                Target::Along(path, speed) => follow(path, &mut passed, sample.position, speed),
            };
            sample = advance(sample, limited(wanted - sample.velocity, sample.velocity, config));
            sample
        }));
        self.braking = self.samples.len();
        self.samples.extend(brake(sample, config.braking_mps2));
    }

    /// Brakes to rest at once, straight along the velocity. Reuses the samples' memory.
    pub(crate) fn stop(&mut self, start: Sample, braking_mps2: f64) {
        self.samples.clear();
        self.samples.push(start);
        self.braking = 1;
        self.samples.extend(brake(start, braking_mps2));
    }

    /// Where the going ends.
    pub(crate) fn end_of_going(&self) -> Sample {
        self.samples[self.braking - 1]
    }
}

/// What of a change of velocity is possible within a step: along the velocity and across it.
fn limited(change: Vector<World>, velocity: Vector<World>, config: &Config) -> Vector<World> {
    let speed_squared = velocity.dot(velocity);
    if speed_squared <= (config.lateral_mps2 * STEP_S).powi(2) {
        return change.clamp_norm(config.acceleration_mps2 * STEP_S);
    }
    // In squares, which need few roots: ten thousand steps and more are made for every plan.
    let ahead = change.dot(velocity);
    let along_squared = ahead * ahead / speed_squared;
    let across_squared = (change.dot(change) - along_squared).max(0.0);
    let limit = if ahead < 0.0 { config.braking_mps2 } else { config.acceleration_mps2 };
    // An ellipse: hard turns leave less for the rest.
    let asked_squared = along_squared / (limit * limit) + across_squared / config.lateral_mps2.powi(2);
    if asked_squared <= STEP_S * STEP_S { change } else { change * (STEP_S / asked_squared.sqrt()) }
}

/// The samples after `from` of a straight stop along its velocity; the last is at rest.
pub(crate) fn brake(from: Sample, braking_mps2: f64) -> impl Iterator<Item = Sample> {
    let (speed, slower) = (from.velocity.norm(), braking_mps2 * STEP_S);
    let change = if speed == 0.0 { Vector::ZERO } else { from.velocity * (-slower / speed) };
    // What is left by rounding is no step of its own; what is no number makes one that is refused.
    let steps = if speed == 0.0 { 0 } else { ((speed - 1e-6) / slower).ceil().max(1.0) as usize };
    let mut sample = from;
    (1..steps.min(MOST_SAMPLES) + 1).map(move |step| {
        sample = advance(sample, if step == steps { -sample.velocity } else { change });
        sample
    })
}

/// Velocity towards a place from which the vehicle can still come to rest there.
fn approach(offset: Vector<World>, speed: f64, config: &Config) -> Vector<World> {
    // Half of the braking that is available: the rest is for what the vehicle does not follow exactly.
    let able = (config.braking_mps2 * offset.norm()).sqrt();
    // Linear at the end, so that the discrete steps settle instead of overshooting.
    let settle = offset.norm() / SETTLE_S;
    offset.direction().map_or(Vector::ZERO, |direction| direction * speed.min(able).min(settle))
}

/// Velocity that follows a timed path, of which `passed` places lie behind: what is timed next, and back onto the path.
fn follow(path: &[Timed], passed: &mut usize, at: Point<World>, speed: f64) -> Vector<World> {
    let gap = |index: usize| path.get(index).map_or(f64::INFINITY, |timed| timed.at.distance(at));
    while gap(*passed + 1) < gap(*passed) {
        *passed += 1;
    }
    let Some(last) = path.len().checked_sub(1) else { return Vector::ZERO };
    let next = &path[(*passed + AHEAD_STEPS).min(last)];
    let off = path[*passed].at - at;
    match next.velocity.direction().filter(|_| *passed < last) {
        Some(tangent) => {
            let across = off - tangent * off.dot(tangent);
            tangent * next.velocity.norm().min(speed) + across * (1.0 / ONTO_PATH_S)
        }
        // At the end the place counts, not the speed there, which is none.
        None => (next.at - at) * (1.0 / SETTLE_S),
    }
    .clamp_norm(speed)
}

pub(crate) fn advance(sample: Sample, change: Vector<World>) -> Sample {
    let velocity = sample.velocity + change;
    // The mean velocity of the step: exact for constant acceleration.
    Sample { position: sample.position + (sample.velocity + velocity) * (STEP_S / 2.0), velocity }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::config;
    use crate::route::Timing;

    fn start(speed: f64) -> Sample {
        Sample { position: Point::new(0.0, 0.0, 2.0), velocity: Vector::new(speed, 0.0, 0.0) }
    }

    #[test]
    fn every_rollout_is_feasible_and_ends_at_rest() {
        let config = config();
        let mut rollout = Rollout::new();
        let turn = |first, then| Target::Turn(Turn { first, then, switch_s: 0.8 });
        let targets = [
            turn(Vector::new(-2.0, 3.0, 1.0), Vector::new(3.0, 2.0, 0.0)),
            Target::Place(Point::new(1.0, 0.5, 2.0), 4.0),
            turn(Vector::ZERO, Vector::ZERO),
        ];
        for target in targets {
            rollout.fill(start(4.0), target, config.horizon_s, &config);
            assert_eq!(rollout.samples.last().expect("samples").velocity, Vector::ZERO);
            let most = config.acceleration_mps2.max(config.braking_mps2) * STEP_S;
            for pair in rollout.samples.windows(2) {
                assert!((pair[1].velocity - pair[0].velocity).norm() <= most + 1e-9);
                assert!(pair[0].position.distance(pair[1].position) <= 4.5 * STEP_S);
            }
        }
    }

    #[test]
    fn braking_covers_the_braking_distance() {
        let config = config();
        let end = brake(start(4.0), config.braking_mps2).last().expect("it has to brake");
        let expected = 16.0 / (2.0 * config.braking_mps2);
        assert!((end.position.x - expected).abs() < 0.1, "{end:?}, expected {expected}");
        assert_eq!(brake(start(0.0), config.braking_mps2).count(), 0);
        for hostile in [f64::NAN, f64::INFINITY] {
            let stop = brake(start(hostile), config.braking_mps2).take(MOST_SAMPLES + 1).last();
            assert!(stop.is_some_and(|stop| !stop.position.x.is_finite()), "{hostile} is no stop");
        }
        assert_eq!(brake(start(4.0), 0.0).count(), MOST_SAMPLES);
    }

    #[test]
    fn a_bent_path_is_followed_and_none_is_no_way() {
        let (config, mut rollout, mut timing) = (config(), Rollout::new(), Timing::default());
        let path = [Point::new(0.0, 0.0, 2.0), Point::new(6.0, 0.0, 2.0), Point::new(10.0, 4.0, 2.0)];
        let timed = timing.time(&path, 40.0, 2.0, &config.limits(3.0), STEP_S);
        rollout.fill(start(2.0), Target::Along(timed, 3.0), 8.0, &config);
        let off_m = |sample: &Sample| {
            timed.iter().map(|timed| timed.at.distance(sample.position)).fold(f64::INFINITY, f64::min)
        };
        assert!(rollout.samples.iter().all(|sample| off_m(sample) < 0.12 && sample.velocity.norm() < 3.01));
        assert!(rollout.end_of_going().position.distance(path[2]) < 0.2, "{:?}", rollout.end_of_going());
        rollout.fill(start(2.0), Target::Along(&[], 3.0), 8.0, &config);
        assert!(rollout.end_of_going().position.x < 1.0, "it stops");
    }

    #[test]
    fn a_place_is_reached_and_kept() {
        let config = config();
        let mut rollout = Rollout::new();
        rollout.fill(start(0.0), Target::Place(Point::new(6.0, 0.0, 2.0), 4.0), 8.0, &config);
        assert!(rollout.end_of_going().position.distance(Point::new(6.0, 0.0, 2.0)) < 0.1);
    }
}
