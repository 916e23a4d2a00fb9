//! The noise model: Gaussian error of disparity or depth, and the λ schedule (DROAN, sections 3.1.2–3.1.5).

use crate::bounds::Bounds;
use crate::rig::StereoRig;
use serde::{Deserialize, Serialize};

/// Error of the sensor, and how many standard deviations an obstacle is padded by.
///
/// Triangulation (a stereo pair, structured light) errs by as many pixels of disparity at every distance; time of flight
/// and steps of a millimetre by as much depth. Either may be zero, and both add up: σ(d) = `sigma_px` + `sigma_m`·d²/(f·b).
/// Disparities here are f·b/z: where the principal points differ, the difference (doffs) is added to what is measured.
/// λ is `lambda_near` at and above `near_px` of disparity, `lambda_far` at and below `far_px`, linear between.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NoiseModel {
    /// Standard deviation of disparity, px.
    pub sigma_px: f32,
    /// Standard deviation of depth, m, besides the one that `sigma_px` gives it.
    pub sigma_m: f32,
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
    pub fn check(&self, bounds: &mut Bounds, rig: &StereoRig) {
        bounds.range("sigma_px", self.sigma_px, 0.01..=5.0);
        bounds.range("sigma_m", self.sigma_m, 0.0..=0.1);
        bounds.range("lambda_near", self.lambda_near, 0.0..=6.0);
        bounds.range("lambda_far", self.lambda_far, 0.0..=6.0);
        bounds.range("far_px", self.far_px, 0.0..=500.0);
        bounds.range("near_px", self.near_px, 0.0..=1000.0);
        let ramp_px = self.near_px - self.far_px;
        let sigma_px = self.at(self.near_px, rig.focal_baseline_px_m() as f32);
        let least_px = (self.lambda_near - self.lambda_far).abs() * sigma_px;
        bounds.require(
            ramp_px > least_px,
            "near_px",
            format_args!("- far_px is {ramp_px} px, must exceed {least_px} px so that d - lambda·sigma rises with d"),
        );
    }

    /// λ at a disparity.
    #[inline]
    pub fn lambda(&self, disparity_px: f32) -> f32 {
        let share = ((disparity_px - self.far_px) / (self.near_px - self.far_px)).clamp(0.0, 1.0);
        self.lambda_far + (self.lambda_near - self.lambda_far) * share
    }

    /// σ at a disparity, px, for a camera's f·b (px·m).
    #[inline]
    pub fn at(&self, disparity_px: f32, focal_baseline: f32) -> f32 {
        self.sigma_px + self.sigma_m * disparity_px * disparity_px / focal_baseline
    }

    /// Ends of the interval in which the surface may lie, px: near, far. `sigma_px` widens it in disparity, then
    /// `sigma_m` in depth. The near end is infinite where the interval reaches the camera.
    #[inline]
    pub fn ends_px(&self, disparity_px: f32, focal_baseline: f32) -> (f32, f32) {
        let lambda = self.lambda(disparity_px);
        let (near_px, far_px) = (disparity_px + lambda * self.sigma_px, disparity_px - lambda * self.sigma_px);
        let shift_m = lambda * self.sigma_m;
        if shift_m == 0.0 {
            return (near_px, far_px);
        }
        let near_m = focal_baseline / near_px - shift_m;
        let near_px = if near_m > 0.0 { focal_baseline / near_m } else { f32::INFINITY };
        let far_px = if far_px > 0.0 { focal_baseline / (focal_baseline / far_px + shift_m) } else { far_px };
        (near_px, far_px)
    }

    /// Vote of a disparity, C/(1−C) with C = (d−σ)/d (eq. 3.9): (d−σ)/σ, clamped at 0 where the formula changes sign.
    #[inline]
    pub fn vote(&self, disparity_px: f32, focal_baseline: f32) -> f32 {
        let sigma_px = self.at(disparity_px, focal_baseline);
        ((disparity_px - sigma_px) / sigma_px).max(0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const NOISE: NoiseModel =
        NoiseModel { sigma_px: 0.5, sigma_m: 0.0, lambda_near: 3.0, lambda_far: 1.0, near_px: 8.0, far_px: 3.0 };
    const RIG: StereoRig = StereoRig {
        width_px: 640,
        height_px: 480,
        focal_px: 440.0,
        cx_px: 320.0,
        cy_px: 240.0,
        baseline_m: 0.1,
        doffs_px: 0.0,
    };
    const FOCAL_BASELINE: f32 = 44.0;

    #[test]
    fn both_ends_of_the_interval_rise_with_disparity() {
        for sigma_m in [0.0, 0.01, 0.1] {
            let noise = NoiseModel { sigma_m, ..NOISE };
            let ends: Vec<(f32, f32)> = (1..100_000).map(|i| noise.ends_px(i as f32 * 0.01, FOCAL_BASELINE)).collect();
            for pair in ends.windows(2) {
                assert!(pair[1].0 > pair[0].0 || pair[0].0 == f32::INFINITY, "{sigma_m}: {pair:?}");
                // Near the camera a step of a hundredth of a pixel is less than a float tells apart.
                assert!(pair[1].1 >= pair[0].1, "{sigma_m}: {pair:?}");
            }
        }
    }

    #[test]
    fn an_error_of_depth_moves_the_ends_in_depth() {
        let noise = NoiseModel { sigma_px: 0.01, sigma_m: 0.1, lambda_near: 3.0, lambda_far: 3.0, ..NOISE };
        for depth_m in [0.2_f32, 0.5, 1.0, 4.0] {
            let d = FOCAL_BASELINE / depth_m;
            let (near_px, far_px) = noise.ends_px(d, FOCAL_BASELINE);
            let near_m = FOCAL_BASELINE / (d + 0.03) - 0.3;
            let far_m = FOCAL_BASELINE / (d - 0.03) + 0.3;
            let is_near =
                if near_m > 0.0 { (FOCAL_BASELINE / near_px - near_m).abs() < 1e-4 } else { near_px.is_infinite() };
            assert!(is_near && (FOCAL_BASELINE / far_px - far_m).abs() < 1e-3, "{depth_m}: {near_px} {far_px}");
        }
    }

    #[test]
    fn a_ramp_that_is_too_steep_is_refused() {
        let mut bounds = Bounds::default();
        NoiseModel { near_px: 3.5, ..NOISE }.check(&mut bounds, &RIG);
        assert_eq!(bounds.into_violations().len(), 1);
    }

    #[test]
    fn votes_never_change_sign() {
        assert_eq!(NOISE.vote(0.1, FOCAL_BASELINE), 0.0);
        assert!((NOISE.vote(3.6, FOCAL_BASELINE) - 6.2).abs() < 1e-5);
    }

    #[test]
    fn an_error_of_depth_counts_most_near_the_camera() {
        let noise = NoiseModel { sigma_px: 0.04, sigma_m: 0.01, ..NOISE };
        // σ_z = sigma_px·z²/(f·b) + sigma_m.
        for (depth_m, expected_m) in [(0.5, 0.010_227), (1.0, 0.010_909), (4.0, 0.024_545)] {
            let disparity_px = FOCAL_BASELINE / depth_m;
            let sigma_m = noise.at(disparity_px, FOCAL_BASELINE) * depth_m * depth_m / FOCAL_BASELINE;
            assert!((sigma_m - expected_m).abs() < 1e-5, "{depth_m}: {sigma_m}");
        }
    }
}
