//! From a disparity pixel to the layers, by table: one entry per 16-bit value.
//!
//! A *value* is what the windowed maximum competes on: the near end d + λσ of a surface's interval in fixed point, even for
//! a measured surface ("hard"), odd for the limit that the far-background rule grants ("soft"), 0 for nothing.
//! All rounding is towards the camera for fronts and away from it for backs.

use ipc_types::StereoRig;
use ipc_types::disparity::{MINIMUM, SCALE, is_valid};
use ipc_types::messages::{NEVER_OCCUPIED, UNKNOWN_FRONT};
use ipc_types::noise::NoiseModel;

/// Nearest range that a layer can express.
pub(crate) const NEAREST: u16 = UNKNOWN_FRONT - 1;
/// Number of 16-bit values.
const VALUES: usize = 1 << 16;

/// Radius over depth of values, which an inflation needs.
pub(crate) trait Radii: Sync {
    /// Of every value of a line.
    fn over_depths(&self, values: &[u16], out: &mut [f32]);
}

#[derive(Debug)]
pub(crate) struct Tables {
    rig: StereoRig,
    noise: NoiseModel,
    radius_m: f64,
    /// Hard value of a disparity pixel; 0 for codes.
    hard: Vec<u16>,
    /// Front and back of a value.
    faces: Vec<[u16; 2]>,
    /// Radius over depth: what it rises with a value, and where it begins.
    slope: f32,
    offset: f32,
}

impl Tables {
    pub(crate) fn new(rig: StereoRig, noise: NoiseModel, radius_m: f64) -> Self {
        let mut tables = Self {
            hard: Vec::new(),
            faces: Vec::new(),
            slope: (radius_m / rig.focal_baseline_px_m() / f64::from(SCALE)) as f32,
            offset: (radius_m / rig.focal_baseline_px_m() * rig.doffs_px) as f32,
            rig,
            noise,
            radius_m,
        };
        let value = |pixel: usize| {
            let end = (tables.interval_px(pixel as f32 / SCALE).0 * SCALE).min(f32::from(NEAREST)).ceil() as u16;
            if is_valid(pixel as u16) { (end + (end & 1)).min(NEAREST) } else { 0 }
        };
        tables.hard = (0..VALUES).map(value).collect();
        let front = |value: usize| tables.front_of(near_px(value as u16));
        // Several disparities may share a value after rounding: going down from the nearest, the farthest writes last.
        // Values that no disparity has are never looked up, and soft ones have no back.
        let mut backs = vec![NEVER_OCCUPIED; VALUES];
        for pixel in (usize::from(MINIMUM)..VALUES).rev() {
            backs[usize::from(tables.hard[pixel])] = tables.back_of(pixel as u16);
        }
        tables.faces = backs.into_iter().enumerate().map(|(value, back)| [front(value), back]).collect();
        tables
    }

    #[inline(always)]
    pub(crate) fn hard(&self, pixel: u16) -> u16 {
        self.hard[usize::from(pixel)]
    }

    /// Soft value of the range up to which free space is granted.
    pub(crate) fn soft(&self, range_m: f64) -> u16 {
        let end = (self.rig.disparity_px(range_m) * f64::from(SCALE)).ceil();
        let end = end.clamp(f64::from(MINIMUM), f64::from(NEAREST - 2)) as u16;
        (end + (end & 1)) | 1
    }

    /// Front and back.
    #[inline(always)]
    pub(crate) fn faces(&self, value: u16) -> [u16; 2] {
        self.faces[usize::from(value)]
    }

    pub(crate) fn rig(&self) -> &StereoRig {
        &self.rig
    }

    pub(crate) fn radius_m(&self) -> f64 {
        self.radius_m
    }

    /// Both ends of the interval of a measured disparity, px.
    pub(crate) fn interval_px(&self, disparity_px: f32) -> (f32, f32) {
        let doffs_px = self.rig.doffs_px as f32;
        let (near_px, far_px) = self.noise.ends_px(disparity_px + doffs_px, self.rig.focal_baseline_px_m() as f32);
        (near_px - doffs_px, far_px - doffs_px)
    }

    /// Eq. 3.6, front: disparity at depth z − r, saturated at the nearest range where z ≤ r.
    pub(crate) fn front_of(&self, near_px: f64) -> u16 {
        let depth_m = self.rig.depth_m(near_px) - self.radius_m;
        if depth_m <= 0.0 {
            return NEAREST;
        }
        (self.rig.disparity_px(depth_m) * f64::from(SCALE)).ceil().clamp(0.0, f64::from(NEAREST)) as u16
    }

    /// Eq. 3.6, back: disparity at depth z(d − λσ) + r of a disparity pixel.
    pub(crate) fn back_of(&self, pixel: u16) -> u16 {
        let far_px = self.interval_px(f32::from(pixel) / SCALE).1;
        let depth_m = self.rig.depth_m(f64::from(far_px)) + self.radius_m;
        (self.rig.disparity_px(depth_m) * f64::from(SCALE)).floor().clamp(0.0, f64::from(NEAREST)) as u16
    }
}

/// The near end that a value stands for, px.
pub(crate) fn near_px(value: u16) -> f64 {
    f64::from(f32::from(value & !1) / SCALE)
}

impl Radii for Tables {
    #[inline(always)]
    fn over_depths(&self, values: &[u16], out: &mut [f32]) {
        for (q, &value) in out.iter_mut().zip(values) {
            *q = (f32::from(value & !1) * self.slope + self.offset).max(0.0);
        }
    }
}
