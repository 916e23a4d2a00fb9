//! The plan in the making: the roll-out chosen, and the points that are published of it, with their headings.

use crate::Config;
use crate::rollout::{Rollout, STEP_S, Sample, Target};
use crate::stuck::LOOK_SHARE;
use ipc_types::frames::wrap_angle_rad;
use ipc_types::messages::TrajectoryPoint;
use ipc_types::{Point, Vector, World};

/// Least points of a turn: the stop it goes with may be shorter.
const TURN_POINTS: usize = 12;

/// Slower than this the vehicle holds its place, m/s.
const HOVERING_MPS: f64 = 0.3;
/// Carried farther away than this it holds the new place, m: the way back asks no map, so it stays short.
const CARRIED_M: f64 = 0.3;
/// Speed of returning to the place held, m/s: still slow enough to hold it.
const RETURN_MPS: f64 = 0.2;
/// For so long it returns before the plan ends, s.
const RETURN_S: f64 = 1.0;

/// A roll-out and its points.
#[derive(Clone, Debug)]
pub(crate) struct Draft {
    /// The place held since the vehicle came to rest. Without it, every plan would stop where wind or a velocity bias
    /// has carried the vehicle since the one before.
    held: Option<Point<World>>,
    pub(crate) rollout: Rollout,
    pub(crate) points: Vec<TrajectoryPoint>,
}

impl Draft {
    pub(crate) fn new() -> Self {
        Self { held: None, rollout: Rollout::new(), points: Vec::with_capacity(256) }
    }

    /// A straight stop along the velocity; once at rest, holding the place.
    pub(crate) fn stop(&mut self, from: Sample, yaw_rad: f64, config: &Config) {
        let hovers = from.velocity.norm() < HOVERING_MPS;
        let near = |held: &Point<World>| held.distance(from.position) < CARRIED_M;
        let held = hovers.then(|| self.held.filter(near).unwrap_or(from.position));
        match held {
            Some(place) => self.rollout.fill(from, Target::Place(place, RETURN_MPS), RETURN_S, config),
            None => self.rollout.stop(from, config.hard_braking_mps2),
        }
        self.write(yaw_rad, config, |_| yaw_rad);
        self.held = held;
    }

    /// A stop that turns towards a heading.
    pub(crate) fn turn(&mut self, from: Sample, yaw_rad: f64, target_rad: f64, config: &Config) {
        let step = (LOOK_SHARE * config.yaw_rate_degps).to_radians() * STEP_S;
        self.stop(from, yaw_rad, config);
        while self.points.len() < TURN_POINTS {
            let Some(&last) = self.points.last() else { break };
            self.points.push(TrajectoryPoint { t_s: last.t_s + STEP_S, ..last });
        }
        let left_rad = wrap_angle_rad(target_rad - yaw_rad);
        for (index, point) in self.points.iter_mut().enumerate() {
            // Ahead of the heading, so that the tracker keeps turning at the rate.
            let most = step * (index + 6) as f64;
            point.yaw_rad = wrap_angle_rad(yaw_rad + left_rad.clamp(-most, most));
        }
    }

    /// Turns the roll-out into points; the heading turns towards `heading` of the velocity at the turn rate.
    pub(crate) fn write(&mut self, yaw_rad: f64, config: &Config, heading: impl Fn(Vector<World>) -> f64) {
        let most = config.yaw_rate_degps.to_radians() * STEP_S;
        let mut yaw_rad = yaw_rad;
        self.held = None;
        self.points.clear();
        for (index, sample) in self.rollout.samples.iter().enumerate() {
            // Look where the vehicle will be: half a second on.
            let ahead = self.rollout.samples.get(index + 5).map_or(sample.velocity, |ahead| ahead.velocity);
            yaw_rad = wrap_angle_rad(yaw_rad + wrap_angle_rad(heading(ahead) - yaw_rad).clamp(-most, most));
            self.points.push(TrajectoryPoint {
                t_s: index as f64 * STEP_S,
                position_m: sample.position.to_array(),
                velocity_mps: sample.velocity.to_array(),
                yaw_rad,
            });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::config;

    #[test]
    fn at_rest_a_place_is_held_and_not_given_up_bit_by_bit() {
        let (config, mut draft) = (config(), Draft::new());
        let mut stop = |x_m: f64, speed_mps: f64| {
            let velocity = Vector::new(speed_mps, 0.0, 0.0);
            draft.stop(Sample { position: Point::new(x_m, 0.0, 2.0), velocity }, 0.0, &config);
            let fastest = draft.points.iter().map(|point| Vector::<World>::from_array(point.velocity_mps).norm());
            (draft.points.last().expect("points").position_m[0], fastest.fold(0.0, f64::max))
        };
        assert!(stop(-1.0, 3.0).0 > -0.5, "braking comes first");
        assert!(stop(0.0, 0.0).0.abs() < 0.01);
        for step in 1..6 {
            // Carried off, bit by bit.
            let x_m = 0.05 * f64::from(step);
            let (end_m, fastest_mps) = stop(x_m, 0.0);
            assert!(end_m < x_m - 0.04, "back towards where it was: {end_m} from {x_m}");
            assert!(fastest_mps < HOVERING_MPS, "and still holding it: {fastest_mps}");
        }
        assert!(stop(0.6, 0.0).0 > 0.5, "too far to go back unseen");
    }
}
