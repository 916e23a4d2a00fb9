//! The stereo noise model: Gaussian matching error and the λ schedule (DROAN, sections 3.1.2–3.1.5).

use crate::bounds::Bounds;
use serde::{Deserialize, Serialize};

/// Matching error and how many of its standard deviations an obstacle is padded by.
///
/// Disparities here are f·b/z: where the principal points differ, the difference (doffs) is added to what is measured.
/// λ is `lambda_near` at and above `near_px` of disparity, `lambda_far` at and below `far_px`, linear between.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NoiseModel {
    /// Standard deviation of the matching error σ, px.
    pub sigma_px: f32,
    /// Multiplier near the vehicle.
    pub lambda_near: f32,
    /// Multiplier at long range.
    pub lambda_far: f32,
    /// Disparity at and above which λ is `lambda_near`, px.
    pub near_px: f32,
    /// Disparity at and below which λ is `lambda_far`, px.
    pub far_px: f32,
}

impl NoiseModel {
    /// Reports values out of range, and a ramp so short that d − λσ would not rise with d.
    pub fn check(&self, bounds: &mut Bounds) {
        bounds.range("sigma_px", self.sigma_px, 0.01..=5.0);
        bounds.range("lambda_near", self.lambda_near, 0.0..=6.0);
        bounds.range("lambda_far", self.lambda_far, 0.0..=6.0);
        bounds.range("far_px", self.far_px, 0.0..=500.0);
        bounds.range("near_px", self.near_px, 0.0..=1000.0);
        let ramp_px = self.near_px - self.far_px;
        let least_px = (self.lambda_near - self.lambda_far).abs() * self.sigma_px;
        bounds.require(
            ramp_px > least_px,
            "near_px",
            format_args!(
                "- far_px is {ramp_px} px, must exceed |lambda_near - lambda_far|·sigma = {least_px} px so that d - lambda·sigma rises with d"
            ),
        );
    }

    /// λ at a disparity.
    #[inline]
    pub fn lambda(&self, disparity_px: f32) -> f32 {
        let share = ((disparity_px - self.far_px) / (self.near_px - self.far_px)).clamp(0.0, 1.0);
        self.lambda_far + (self.lambda_near - self.lambda_far) * share
    }

    /// λσ at a disparity, px: the half-width of the interval in which the surface may lie.
    #[inline]
    pub fn margin_px(&self, disparity_px: f32) -> f32 {
        self.lambda(disparity_px) * self.sigma_px
    }

    /// Vote of a disparity, C/(1−C) with C = (d−σ)/d (eq. 3.9): (d−σ)/σ, clamped at 0 where the formula changes sign.
    #[inline]
    pub fn vote(&self, disparity_px: f32) -> f32 {
        ((disparity_px - self.sigma_px) / self.sigma_px).max(0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const NOISE: NoiseModel =
        NoiseModel { sigma_px: 0.5, lambda_near: 3.0, lambda_far: 1.0, near_px: 8.0, far_px: 3.0 };

    #[test]
    fn the_near_end_of_the_interval_rises_with_disparity() {
        let ends: Vec<f32> = (0..2000).map(|i| i as f32 * 0.01).map(|d| d - NOISE.margin_px(d)).collect();
        assert!(ends.windows(2).all(|pair| pair[1] > pair[0]));
    }

    #[test]
    fn a_ramp_that_is_too_steep_is_refused() {
        let mut bounds = Bounds::default();
        NoiseModel { near_px: 3.5, ..NOISE }.check(&mut bounds);
        assert_eq!(bounds.into_violations().len(), 1);
    }

    #[test]
    fn votes_never_change_sign() {
        assert_eq!(NOISE.vote(0.1), 0.0);
        assert!((NOISE.vote(3.6) - 6.2).abs() < 1e-5);
    }
}
