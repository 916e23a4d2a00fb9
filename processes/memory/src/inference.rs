//! What a view's vote weighs: the confidence of eq. 3.9, or the probability mass of section 3.1.8.
//!
//! * **Confidence**: C/(1−C) = (d−σ)/σ, clamped at 0 (Table 3.1). It rises linearly with disparity.
//! * **Log-odds** (eqs 3.7, 3.8): the mass p(d) that a Gaussian about d has within the disparities that the vehicle's radius
//!   spans there (Fig. 3.13), as the ratio to the prior, ln(p/p₀). Read literally, as log-odds, a hit beyond some 8 to 28 m
//!   would vote free, since less than half of the mass is within the vehicle there; so a vote is never below 0. The mass
//!   is interpolated linearly between knots (section 6.2).
//!
//! A vote is a whole number of [`VOTE`]ths, so that sums do not depend on the order of the views.

use ipc_types::StereoRig;
use ipc_types::bounds::Bounds;
use ipc_types::noise::NoiseModel;
use ipc_types::rounding::to_nearest;
use serde::{Deserialize, Serialize};

/// A vote of 1.
pub(crate) const VOTE: f32 = 256.0;
/// No vote weighs more than this: sums of 64 of them are still whole numbers that fit, and floats that are exact.
const MOST: f32 = 16_000.0;
/// Knots of the interpolated mass, and how many of them lie below the disparity where its half-width is one σ.
const KNOTS: usize = 512;
const KNOTS_TO_SIGMA: f32 = 64.0;

/// How votes are weighed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Inference {
    /// By the confidence of eq. 3.9.
    Confidence,
    /// By the log of the probability mass over the prior.
    LogOdds {
        /// Probability that a place is occupied before anything is seen, 0..1.
        prior: f32,
    },
}

impl Inference {
    pub(crate) fn check(&self, bounds: &mut Bounds) {
        if let Self::LogOdds { prior } = self {
            bounds.range("prior", *prior, 0.001..=0.5);
        }
    }
}

/// Probability mass of a vehicle of `radius_m` at a disparity (f·b/z, px): Fig. 3.13.
pub fn probability_mass(rig: &StereoRig, noise: &NoiseModel, radius_m: f32, disparity_px: f64) -> f64 {
    let focal_baseline = rig.focal_baseline_px_m();
    if disparity_px <= 0.0 {
        return 0.0;
    }
    let (depth_m, radius_m) = (focal_baseline / disparity_px, f64::from(radius_m));
    let sigma_px = f64::from(noise.at(disparity_px as f32, focal_baseline as f32));
    let below = |d: f64| 0.5 * libm::erfc((disparity_px - d) / sigma_px / std::f64::consts::SQRT_2);
    let near_px = if depth_m > radius_m { focal_baseline / (depth_m - radius_m) } else { f64::INFINITY };
    below(near_px) - below(focal_baseline / (depth_m + radius_m))
}

/// Weighs votes by disparity (f·b/z, px).
#[derive(Clone, Debug)]
pub(crate) enum Weights {
    Confidence { noise: NoiseModel, focal_baseline: f32 },
    LogOdds { per_px: f32, knots: Vec<f32> },
}

impl Weights {
    pub(crate) fn new(rig: &StereoRig, noise: &NoiseModel, radius_m: f32, inference: Inference) -> Self {
        let focal_baseline = rig.focal_baseline_px_m() as f32;
        match inference {
            Inference::Confidence => Self::Confidence { noise: *noise, focal_baseline },
            Inference::LogOdds { prior } => {
                let sigma_at_px = (noise.sigma_px * focal_baseline / radius_m).sqrt();
                let per_px = KNOTS_TO_SIGMA / sigma_at_px;
                let mass = |knot: usize| probability_mass(rig, noise, radius_m, f64::from(knot as f32 / per_px));
                Self::LogOdds {
                    per_px,
                    knots: (0..=KNOTS).map(|knot| (mass(knot) as f32 / prior).ln().max(0.0)).collect(),
                }
            }
        }
    }

    /// Weight at a disparity, in votes.
    #[inline(always)]
    pub(crate) fn at(&self, disparity_px: f32) -> f32 {
        match self {
            Self::Confidence { noise, focal_baseline } => noise.vote(disparity_px, *focal_baseline),
            Self::LogOdds { per_px, knots } => {
                let place = (disparity_px * per_px).clamp(0.0, KNOTS as f32 - 0.001);
                let knot = place as usize;
                knots[knot] + (knots[knot + 1] - knots[knot]) * (place - knot as f32)
            }
        }
    }

    /// Weights of several disparities, as whole numbers.
    #[inline(always)]
    pub(crate) fn fill<const N: usize>(&self, disparities_px: &[f32; N], weights: &mut [i32; N]) {
        match self {
            // Of its own, so that the loop vectorises.
            Self::Confidence { noise, focal_baseline } => {
                for (weight, &d) in weights.iter_mut().zip(disparities_px) {
                    *weight = whole(noise.vote(d, *focal_baseline));
                }
            }
            Self::LogOdds { .. } => {
                for (weight, &d) in weights.iter_mut().zip(disparities_px) {
                    *weight = whole(self.at(d));
                }
            }
        }
    }

    /// Least and largest weight between two disparities.
    pub(crate) fn range(&self, least_px: f32, most_px: f32) -> (i32, i32) {
        let ends = [whole(self.at(least_px)), whole(self.at(most_px))];
        let between = |d: f32| if d > least_px && d < most_px { whole(self.at(d)) } else { ends[0] };
        let within: (i32, i32) = match self {
            // Rises, then falls where an error of depth prevails.
            Self::Confidence { noise, focal_baseline } => {
                let peak = between((noise.sigma_px * focal_baseline / noise.sigma_m).sqrt());
                (peak, peak)
            }
            Self::LogOdds { per_px, .. } => (0..=KNOTS).fold((ends[0], ends[0]), |(least, most), knot| {
                let weight = between(knot as f32 / per_px);
                (least.min(weight), most.max(weight))
            }),
        };
        (within.0.min(ends[0]).min(ends[1]), within.1.max(ends[0]).max(ends[1]))
    }
}

/// A weight as a whole number.
#[inline(always)]
fn whole(weight: f32) -> i32 {
    to_nearest(weight.min(MOST) * VOTE) as i32
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The two platforms of Tables 5.1 and 5.2.
    const RIGS: [(f64, f32); 2] = [(0.35, 1.5), (0.17, 0.5)];

    fn rig(baseline_m: f64) -> StereoRig {
        StereoRig {
            width_px: 640,
            height_px: 480,
            focal_px: 514.17,
            cx_px: 320.0,
            cy_px: 240.0,
            baseline_m,
            doffs_px: 0.0,
        }
    }

    const NOISE: NoiseModel =
        NoiseModel { sigma_px: 0.5, sigma_m: 0.0, lambda_near: 3.0, lambda_far: 1.0, near_px: 10.0, far_px: 4.0 };

    #[test]
    fn the_mass_is_nearly_one_at_5_m_and_small_at_50_m() {
        let rig = rig(0.35);
        let at = |depth_m: f64| probability_mass(&rig, &NOISE, 0.5, rig.disparity_px(depth_m));
        // Fig. 3.12: 3.60 px at 50 m, 35.99 px at 5 m; half-widths of 0.036 px and of 3.3 and 4.0 px at σ = 0.5 px.
        assert!((at(50.0) - 0.0574).abs() < 0.0005, "{}", at(50.0));
        assert!(at(5.0) > 0.999_999, "{}", at(5.0));
    }

    #[test]
    fn the_interpolant_follows_the_mass() {
        for (baseline_m, radius_m) in RIGS {
            let rig = rig(baseline_m);
            let weights = Weights::new(&rig, &NOISE, radius_m, Inference::LogOdds { prior: 0.1 });
            for tenth in 1..3000 {
                let d = f64::from(tenth) * 0.1;
                let exact = (probability_mass(&rig, &NOISE, radius_m, d) / 0.1).ln().max(0.0);
                assert!((f64::from(weights.at(d as f32)) - exact).abs() < 0.03, "{d} px: {exact}");
            }
        }
    }

    /// Fig. 3.15: the confidence rule needs no more observations than log-odds do.
    #[test]
    fn what_log_odds_call_occupied_confidence_does_too() {
        for (baseline_m, radius_m) in RIGS {
            let rig = rig(baseline_m);
            let confidence = Weights::new(&rig, &NOISE, radius_m, Inference::Confidence);
            for prior in [0.05, 0.1, 0.2, 0.5] {
                let log_odds = Weights::new(&rig, &NOISE, radius_m, Inference::LogOdds { prior });
                for hundredth in 10..20_000 {
                    let d = hundredth as f32 * 0.01;
                    let (found, expected) = (confidence.at(d), log_odds.at(d));
                    assert!(found >= expected, "{d} px, prior {prior}: {found} < {expected}");
                }
            }
        }
    }

    #[test]
    fn a_range_holds_every_weight_within() {
        let timed = NoiseModel { sigma_px: 0.1, sigma_m: 0.02, ..NOISE };
        for noise in [NOISE, timed] {
            for inference in [Inference::Confidence, Inference::LogOdds { prior: 0.1 }] {
                let weights = Weights::new(&rig(0.17), &noise, 0.5, inference);
                for (least, most) in [(0.5, 3.0), (2.0, 40.0), (15.0, 200.0), (7.0, 7.0)] {
                    let (low, high) = weights.range(least, most);
                    for step in 0..=100 {
                        let mut found = [0];
                        weights.fill(&[least + (most - least) * step as f32 * 0.01], &mut found);
                        assert!((low..=high).contains(&found[0]), "{inference:?} {least}..{most}");
                    }
                }
            }
        }
    }
}
