//! From a disparity pixel to the planes, by table: one entry per fixed-point value.
//!
//! A *key* is what the windowed maximum competes on: the near end d + λσ of a surface's interval in fixed point,
//! even for a measured surface ("hard"), odd for the limit that the far-background rule grants ("soft").
//! All rounding is towards the camera for fronts and away from it for backs.

use crate::Config;
use ipc_types::StereoRig;
use ipc_types::disparity::{MINIMUM, SCALE, is_valid};
use ipc_types::messages::{NEVER_OCCUPIED, UNKNOWN_FRONT};
use ipc_types::noise::NoiseModel;

/// Nearest range that a plane can express.
const NEAREST: u16 = UNKNOWN_FRONT - 1;

#[derive(Debug)]
pub(crate) struct Tables {
    /// Hard key of a disparity pixel; 0 for codes.
    near: Vec<u16>,
    /// Front plane of a key.
    front: Vec<u16>,
    /// Back plane of a key.
    back: Vec<u16>,
    /// Radius / depth of a key.
    radius_over_depth: Vec<f32>,
}

impl Tables {
    pub(crate) fn new(rig: &StereoRig, noise: &NoiseModel, config: &Config) -> Self {
        let values = usize::from(u16::MAX) + 1;
        let radius_m = f64::from(config.radius_m);
        let px = |value: usize| value as f32 / SCALE;
        let focal_baseline = rig.focal_baseline_px_m() as f32;
        let near: Vec<u16> = (0..values)
            .map(|value| {
                let (near_px, _) = noise.ends_px(px(value) + rig.doffs_px as f32, focal_baseline);
                let end = f32::from(u16::MAX - 1).min((near_px - rig.doffs_px as f32) * SCALE).ceil() as u16;
                if is_valid(value as u16) { (end + (end & 1)).min(u16::MAX - 1) } else { 0 }
            })
            .collect();
        let front = (0..values).map(|key| front_of(rig, radius_m, f64::from(px(key)))).collect();
        let radius_over_depth = (0..values).map(|key| (radius_m / rig.depth_m(f64::from(px(key)))) as f32).collect();
        Self { back: backs(rig, noise, radius_m, &near), near, front, radius_over_depth }
    }

    #[inline(always)]
    pub(crate) fn hard_key(&self, pixel: u16) -> u16 {
        self.near[usize::from(pixel)]
    }

    #[inline(always)]
    pub(crate) fn front(&self, key: u16) -> u16 {
        self.front[usize::from(key)]
    }

    #[inline(always)]
    pub(crate) fn back(&self, key: u16) -> u16 {
        self.back[usize::from(key)]
    }

    #[inline(always)]
    pub(crate) fn radius_over_depth(&self, key: u16) -> f32 {
        self.radius_over_depth[usize::from(key)]
    }
}

/// Soft key of the range up to which free space is granted.
pub(crate) fn soft_key(rig: &StereoRig, range_m: f64) -> u16 {
    let value = (rig.disparity_px(range_m) * f64::from(SCALE)).ceil().clamp(f64::from(MINIMUM), f64::from(NEAREST - 1));
    value as u16 | 1
}

/// Eq. 3.6, front: disparity at depth z − r, saturated at the nearest range where z ≤ r.
fn front_of(rig: &StereoRig, radius_m: f64, near_px: f64) -> u16 {
    let depth_m = rig.depth_m(near_px) - radius_m;
    if depth_m <= 0.0 {
        return NEAREST;
    }
    (rig.disparity_px(depth_m) * f64::from(SCALE)).ceil().clamp(0.0, f64::from(NEAREST)) as u16
}

/// Eq. 3.6, back: disparity at depth z(d − λσ) + r, for every key; soft keys have no back.
fn backs(rig: &StereoRig, noise: &NoiseModel, radius_m: f64, near: &[u16]) -> Vec<u16> {
    let mut backs = vec![NEVER_OCCUPIED; near.len()];
    // Several disparities may share a key after rounding: going down from the nearest, the farthest writes last.
    // Keys that no disparity has are never looked up.
    for value in (usize::from(MINIMUM)..near.len()).rev() {
        let d_px = value as f32 / SCALE;
        let (_, far_px) = noise.ends_px(d_px + rig.doffs_px as f32, rig.focal_baseline_px_m() as f32);
        let depth_m = rig.depth_m(f64::from(far_px - rig.doffs_px as f32)) + radius_m;
        let back = (rig.disparity_px(depth_m) * f64::from(SCALE)).floor().clamp(0.0, f64::from(NEAREST));
        backs[usize::from(near[value])] = back as u16;
    }
    backs
}
