//! What the vehicle believes of its own state: late, with attitude and velocity noise and slow drift of position.

use crate::camera::generator;
use ipc_types::bounds::Bounds;
use ipc_types::{Body, FlightTime, Pose, Rotation, Vector, World};
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64Mcg;
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// The state estimate's errors. All zero makes it the truth.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EstimatorConfig {
    /// From validity to publication, ms.
    pub delay_ms: f64,
    /// Standard deviation of roll, pitch and yaw errors, degrees.
    pub attitude_deg: f64,
    /// Standard deviation of velocity errors, m/s.
    pub velocity_mps: f64,
    /// Random walk of position, m per root second.
    pub drift_m_per_sqrt_s: f64,
    /// Correlation time of attitude and velocity errors, s.
    pub correlation_s: f64,
}

impl EstimatorConfig {
    /// Reports values out of range.
    pub fn check(&self, bounds: &mut Bounds) {
        bounds.range("delay_ms", self.delay_ms, 0.0..=200.0);
        bounds.range("attitude_deg", self.attitude_deg, 0.0..=10.0);
        bounds.range("velocity_mps", self.velocity_mps, 0.0..=2.0);
        bounds.range("drift_m_per_sqrt_s", self.drift_m_per_sqrt_s, 0.0..=1.0);
        bounds.range("correlation_s", self.correlation_s, 0.01..=100.0);
    }
}

/// A state estimate.
#[derive(Clone, Copy, Debug)]
pub struct Estimate {
    /// Instant for which it holds.
    pub valid: FlightTime,
    /// Pose.
    pub world_from_body: Pose<World, Body>,
    /// Velocity.
    pub velocity: Vector<World>,
}

/// Spoils the truth.
#[derive(Debug)]
pub struct Estimator {
    config: EstimatorConfig,
    random: Pcg64Mcg,
    attitude_rad: [f64; 3],
    velocity: [f64; 3],
    drift: [f64; 3],
    last: Option<FlightTime>,
    waiting: VecDeque<Estimate>,
}

impl Estimator {
    /// With errors drawn from a seed.
    pub fn new(config: EstimatorConfig, seed: u64) -> Self {
        Self {
            config,
            random: generator(seed, 2),
            attitude_rad: [0.0; 3],
            velocity: [0.0; 3],
            drift: [0.0; 3],
            last: None,
            waiting: VecDeque::new(),
        }
    }

    /// Measures the truth at `now`.
    pub fn measure(&mut self, now: FlightTime, world_from_body: Pose<World, Body>, velocity: Vector<World>) {
        let elapsed_s = self.last.map_or(0.0, |last| now.seconds_since(last));
        self.last = Some(now);
        let keep = (-elapsed_s / self.config.correlation_s).exp();
        let renew = (1.0 - keep * keep).sqrt();
        let random = &mut self.random;
        let mut wander = |errors: &mut [f64; 3], keep: f64, scale: f64| {
            for error in errors {
                let fresh: f64 = StandardNormal.sample(random);
                *error = *error * keep + fresh * scale;
            }
        };
        wander(&mut self.attitude_rad, keep, renew * self.config.attitude_deg.to_radians());
        wander(&mut self.velocity, keep, renew * self.config.velocity_mps);
        wander(&mut self.drift, 1.0, self.config.drift_m_per_sqrt_s * elapsed_s.max(0.0).sqrt());
        let [roll, pitch, yaw] = self.attitude_rad;
        let error = Rotation::<Body, Body>::from_roll_pitch_yaw(roll, pitch, yaw);
        self.waiting.push_back(Estimate {
            valid: now,
            world_from_body: Pose {
                rotation: world_from_body.rotation * error,
                translation: world_from_body.translation + Vector::from_array(self.drift),
            },
            velocity: velocity + Vector::from_array(self.velocity),
        });
    }

    /// The next estimate whose delay has passed.
    pub fn deliver(&mut self, now: FlightTime) -> Option<Estimate> {
        let due = self.waiting.front()?.valid + std::time::Duration::from_secs_f64(self.config.delay_ms * 1e-3);
        if due <= now { self.waiting.pop_front() } else { None }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_have_the_stated_size_and_delay() {
        let config = EstimatorConfig {
            delay_ms: 20.0,
            attitude_deg: 0.5,
            velocity_mps: 0.1,
            drift_m_per_sqrt_s: 0.02,
            correlation_s: 0.2,
        };
        let mut estimator = Estimator::new(config, 9);
        let (mut squares, mut count) = (0.0, 0);
        for tick in 0..20_000 {
            let now = FlightTime::from_secs_f64(f64::from(tick) * 0.01);
            estimator.measure(now, Pose::IDENTITY, Vector::ZERO);
            while let Some(estimate) = estimator.deliver(now) {
                assert!(now.seconds_since(estimate.valid) >= 0.02 - 1e-9);
                squares += estimate.velocity.x.powi(2);
                count += 1;
            }
        }
        let deviation = (squares / f64::from(count)).sqrt();
        assert!((deviation - 0.1).abs() < 0.02, "{deviation}");
    }

    #[test]
    fn without_errors_it_is_the_truth() {
        let config = EstimatorConfig {
            delay_ms: 0.0,
            attitude_deg: 0.0,
            velocity_mps: 0.0,
            drift_m_per_sqrt_s: 0.0,
            correlation_s: 1.0,
        };
        let mut estimator = Estimator::new(config, 1);
        let pose = Pose { translation: Vector::new(1.0, 2.0, 3.0), ..Pose::IDENTITY };
        estimator.measure(FlightTime::from_secs_f64(1.0), pose, Vector::new(1.0, 0.0, 0.0));
        let estimate = estimator.deliver(FlightTime::from_secs_f64(1.0)).expect("due at once");
        assert_eq!(estimate.world_from_body.origin(), pose.origin());
    }
}
