//! The plan in the making: the roll-out chosen, and the points that are published of it, with their headings.

use crate::Config;
use crate::rollout::{Rollout, STEP_S, Sample};
use crate::stuck::LOOK_SHARE;
use ipc_types::frames::wrap_angle_rad;
use ipc_types::messages::TrajectoryPoint;
use ipc_types::{Vector, World};

/// Least points of a turn on the spot, which has a single sample when at rest.
const TURN_POINTS: usize = 12;

/// A roll-out and its points.
#[derive(Clone, Debug)]
pub(crate) struct Draft {
    pub(crate) rollout: Rollout,
    pub(crate) points: Vec<TrajectoryPoint>,
}

impl Draft {
    pub(crate) fn new() -> Self {
        Self { rollout: Rollout::new(), points: Vec::with_capacity(256) }
    }

    /// A straight stop along the velocity.
    pub(crate) fn stop(&mut self, from: Sample, yaw_rad: f64, config: &Config) {
        self.rollout.stop(from, config.hard_braking_mps2);
        self.write(yaw_rad, config, |_| yaw_rad);
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
