//! What a flight may be troubled with: wind, lost frames, blindness, a state estimate that jumps or lags.

use crate::camera::generator;
use ipc_types::bounds::Bounds;
use ipc_types::{FlightTime, Vector, World};
use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64Mcg;
use serde::{Deserialize, Serialize};

/// Troubles of a flight; all zero is none.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Trouble {
    /// Mean wind, towards this direction of the world (x, y), m/s.
    pub wind_mps: [f64; 2],
    /// Standard deviation of the gusts about it along each axis, m/s; they last about a second.
    pub gust_mps: f64,
    /// Share of the camera's frames that are lost.
    pub lost_frames: f64,
    /// Blindness: begins at this flight time and lasts so long, s.
    pub blind_s: [f64; 2],
    /// The position estimate jumps: at this flight time, s, by so much to the left of the world's x axis, m.
    pub jump: [f64; 2],
    /// The state estimate is later by this than the estimator's delay, ms.
    pub lag_ms: f64,
}

impl Trouble {
    /// Reports values out of range.
    pub fn check(&self, bounds: &mut Bounds) {
        self.wind_mps.iter().for_each(|&wind| bounds.range("wind_mps", wind, -30.0..=30.0));
        bounds.range("gust_mps", self.gust_mps, 0.0..=15.0);
        bounds.range("lost_frames", self.lost_frames, 0.0..=1.0);
        self.blind_s.iter().for_each(|&time| bounds.range("blind_s", time, 0.0..=36_000.0));
        bounds.range("jump", self.jump[0], 0.0..=36_000.0);
        bounds.range("jump", self.jump[1], -100.0..=100.0);
        bounds.range("lag_ms", self.lag_ms, 0.0..=2000.0);
    }

    /// How far off the position estimate is at an instant.
    pub(crate) fn jump(&self, now: FlightTime) -> Vector<World> {
        let [at_s, by_m] = self.jump;
        Vector::new(0.0, if now.as_secs_f64() >= at_s { by_m } else { 0.0 }, 0.0)
    }
}

/// Correlation time of gusts, s.
const GUST_S: f64 = 1.0;

/// Troubles as they come.
#[derive(Debug)]
pub(crate) struct Troubles {
    config: Trouble,
    gust: [f64; 3],
    winds: Pcg64Mcg,
    frames: Pcg64Mcg,
}

impl Troubles {
    /// Drawn from a seed.
    pub(crate) fn new(config: Trouble, seed: u64) -> Self {
        Self { config, gust: [0.0; 3], winds: generator(seed, 11), frames: generator(seed, 12) }
    }

    /// The wind after another `step_s`: a mean and gusts (Ornstein and Uhlenbeck).
    pub(crate) fn wind(&mut self, step_s: f64) -> Vector<World> {
        let keep = (-step_s / GUST_S).exp();
        let renew = (1.0 - keep * keep).sqrt() * self.config.gust_mps;
        for gust in &mut self.gust {
            let fresh: f64 = StandardNormal.sample(&mut self.winds);
            *gust = *gust * keep + fresh * renew;
        }
        let [x, y] = self.config.wind_mps;
        Vector::from_array(self.gust) + Vector::new(x, y, 0.0)
    }

    /// Whether a frame exposed at an instant is lost.
    pub(crate) fn loses(&mut self, exposure: FlightTime) -> bool {
        let [from_s, for_s] = self.config.blind_s;
        let is_blind = for_s > 0.0 && (from_s..from_s + for_s).contains(&exposure.as_secs_f64());
        // Drawn for every frame, so that blindness changes nothing about the others.
        let is_lost = self.frames.random::<f64>() < self.config.lost_frames;
        is_blind || is_lost
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gusts_have_their_size_and_frames_are_lost_as_often_as_said() {
        let config = Trouble {
            wind_mps: [6.0, 0.0],
            gust_mps: 2.0,
            lost_frames: 0.3,
            blind_s: [5.0, 2.0],
            ..Trouble::default()
        };
        let mut troubles = Troubles::new(config, 4);
        let winds: Vec<_> = (0..400_000).map(|_| troubles.wind(0.005)).collect();
        let count = winds.len() as f64;
        let mean = winds.iter().map(|wind| wind.x).sum::<f64>() / count;
        let deviation = (winds.iter().map(|wind| (wind.x - mean).powi(2)).sum::<f64>() / count).sqrt();
        assert!((mean - 6.0).abs() < 0.3 && (deviation - 2.0).abs() < 0.3, "{mean} {deviation}");
        let lost = |from_s: f64, troubles: &mut Troubles| {
            (0..1000).filter(|&n| troubles.loses(FlightTime::from_secs_f64(from_s + f64::from(n) * 0.001))).count()
        };
        assert!((250..350).contains(&lost(1.0, &mut troubles)));
        assert_eq!(lost(5.5, &mut troubles), 1000);
        let mut none = Troubles::new(Trouble::default(), 4);
        assert_eq!((none.wind(0.005), lost(0.0, &mut none)), (Vector::ZERO, 0));
        assert_eq!(Trouble { jump: [3.0, 1.0], ..Trouble::default() }.jump(FlightTime::from_secs_f64(3.5)).y, 1.0);
    }
}
