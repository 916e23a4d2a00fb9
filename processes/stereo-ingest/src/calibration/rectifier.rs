//! Raw images to rectified ones, by maps computed once.

use super::lens::Lens;
use super::stereo::{Rectification, StereoCalibration};
use ipc_types::StereoRig;
use multiversion::multiversion;
use nalgebra::{Matrix3, Vector3};

/// Maps of both cameras. A pixel is the bilinear mixture of four raw ones, in 1/128 px.
#[derive(Debug)]
pub struct Rectifier {
    width: usize,
    pixels: usize,
    maps: [Map; 2],
}

/// Where each rectified pixel comes from.
#[derive(Debug)]
struct Map {
    /// Index of the upper left one of the four raw pixels.
    from: Vec<u32>,
    /// Weights of the right and the lower ones, in 1/128.
    weights: Vec<[u8; 2]>,
    /// Rectified pixels that the camera does not see.
    outside: Vec<u32>,
}

const UNIT: u16 = 128;

impl Rectifier {
    /// Computes the maps.
    pub fn new(calibration: &StereoCalibration, rectification: &Rectification) -> Self {
        let rig = &rectification.rig;
        let lenses = [&calibration.left, &calibration.right];
        Self {
            width: rig.width_px as usize,
            pixels: rig.pixels(),
            maps: [0, 1].map(|side| Map::new(lenses[side], rig, &rectification.rotations[side])),
        }
    }

    /// Rectifies one image: 0 is the left camera, 1 the right one. What the camera does not see is black.
    ///
    /// # Panics
    /// An image is not of the rig's size.
    pub fn remap(&self, camera: usize, raw: &[u8], rectified: &mut [u8]) {
        assert!(raw.len() == self.pixels && rectified.len() == self.pixels, "images of the rig's size");
        let map = &self.maps[camera];
        remap(&map.from, &map.weights, raw, self.width, rectified);
        map.outside.iter().for_each(|&pixel| rectified[pixel as usize] = 0);
    }

    /// Pixels of the rectified left image that the left camera does not see.
    pub fn outside(&self) -> &[u32] {
        &self.maps[0].outside
    }
}

impl Map {
    fn new(lens: &Lens, rig: &StereoRig, rectified_from_camera: &Matrix3<f64>) -> Self {
        let camera_from_rectified = rectified_from_camera.transpose();
        let (last_column, last_row) = (f64::from(lens.width_px - 1), f64::from(lens.height_px - 1));
        let mut map = Self { from: Vec::new(), weights: Vec::new(), outside: Vec::new() };
        for row in 0..rig.height_px {
            for column in 0..rig.width_px {
                let x = (f64::from(column) - rig.cx_px) / rig.focal_px;
                let y = (f64::from(row) - rig.cy_px) / rig.focal_px;
                let seen = lens.project(camera_from_rectified * Vector3::new(x, y, 1.0));
                // At the very border rounding may lead out by a little.
                let seen = seen
                    .filter(|[u, v]| (-0.01..=last_column + 0.01).contains(u) && (-0.01..=last_row + 0.01).contains(v));
                let [u, v] = seen.unwrap_or_else(|| {
                    map.outside.push(map.from.len() as u32);
                    [0.0, 0.0]
                });
                // The last column and row are reached as the full right and lower neighbour.
                let split = |at: f64, last: f64| {
                    let at = at.clamp(0.0, last);
                    let whole = at.floor().min(last - 1.0);
                    (whole as u32, ((at - whole) * f64::from(UNIT)).round() as u8)
                };
                let ((u, right), (v, lower)) = (split(u, last_column), split(v, last_row));
                map.from.push(v * lens.width_px + u);
                map.weights.push([right, lower]);
            }
        }
        map
    }
}

/// Gathers four neighbours for a block of pixels, then mixes the block in vectors.
#[multiversion(targets("x86_64+avx512f+avx512bw", "x86_64+avx2", "aarch64+neon"))]
fn remap(from: &[u32], weights: &[[u8; 2]], raw: &[u8], width: usize, out: &mut [u8]) {
    const BLOCK: usize = 32;
    let mut corners = [[0_u16; BLOCK]; 4];
    let (mut right, mut lower) = ([0_u16; BLOCK], [0_u16; BLOCK]);
    for ((from, weights), out) in from.chunks(BLOCK).zip(weights.chunks(BLOCK)).zip(out.chunks_mut(BLOCK)) {
        for (i, (&from, &[wx, wy])) in from.iter().zip(weights).enumerate() {
            let upper = &raw[from as usize..from as usize + width + 2];
            corners[0][i] = upper[0].into();
            corners[1][i] = upper[1].into();
            corners[2][i] = upper[width].into();
            corners[3][i] = upper[width + 1].into();
            (right[i], lower[i]) = (wx.into(), wy.into());
        }
        let mut mixed = [0_u8; BLOCK];
        for i in 0..BLOCK {
            let above = corners[0][i] * (UNIT - right[i]) + corners[1][i] * right[i];
            let below = corners[2][i] * (UNIT - right[i]) + corners[3][i] * right[i];
            let both = u32::from(above) * u32::from(UNIT - lower[i]) + u32::from(below) * u32::from(lower[i]);
            mixed[i] = ((both + (1 << 13)) >> 14) as u8;
        }
        let length = out.len();
        out.copy_from_slice(&mixed[..length]);
    }
}

#[cfg(test)]
mod tests {
    use super::super::lens::Distortion;
    use super::*;

    /// Two cameras that are turned by 3 degrees against each other, behind distorting lenses.
    fn crooked() -> StereoCalibration {
        let distortion = Distortion::RadialTangential([-0.28, 0.07, 0.0002, 0.00002, 0.0, 0.0, 0.0, 0.0]);
        let left =
            Lens { width_px: 320, height_px: 240, focal_px: [200.0, 199.0], centre_px: [161.0, 118.0], distortion };
        let right = Lens { centre_px: [158.0, 121.0], ..left };
        let (sin, cos) = 0.05_f64.sin_cos();
        let rotation = [[cos, 0.0, -sin], [0.0, 1.0, 0.0], [sin, 0.0, cos]];
        StereoCalibration { left, right, rotation, translation_m: [-0.11, 0.002, 0.004] }
    }

    #[test]
    fn points_come_to_lie_in_the_same_row_at_their_disparity() {
        let calibration = crooked();
        let Rectification { rig, rotations } = calibration.rectify().expect("overlap");
        assert!((rig.baseline_m - Vector3::from(calibration.translation_m).norm()).abs() < 1e-12);
        for (x, y, z) in [(0.1, 0.0, 1.0), (-0.5, 0.4, 2.0), (1.0, -0.6, 5.0), (0.0, 0.0, 50.0)] {
            let in_left = Vector3::new(x, y, z);
            let in_right = calibration.rotation() * in_left + Vector3::from(calibration.translation_m);
            let project = |point: Vector3<f64>| {
                [rig.cx_px + rig.focal_px * point.x / point.z, rig.cy_px + rig.focal_px * point.y / point.z]
            };
            let ([u, v], [u_right, v_right]) = (project(rotations[0] * in_left), project(rotations[1] * in_right));
            assert!((v - v_right).abs() < 1e-9);
            let depth = (rotations[0] * in_left).z;
            assert!((u - u_right - rig.disparity_px(depth)).abs() < 1e-9);
        }
    }

    #[test]
    fn every_rectified_pixel_is_seen_by_both_cameras() {
        let calibration = crooked();
        let rectification = calibration.rectify().expect("overlap");
        let rectifier = Rectifier::new(&calibration, &rectification);
        assert!(rectifier.maps.iter().all(|map| map.outside.is_empty()));
    }

    #[test]
    fn a_ramp_stays_a_ramp() {
        let calibration = crooked();
        let rectification = calibration.rectify().expect("overlap");
        let rectifier = Rectifier::new(&calibration, &rectification);
        // Grey levels rise linearly with the raw column, so a rectified one tells which column it came from.
        let raw: Vec<u8> = (0..320 * 240).map(|i| (i % 320 / 2) as u8).collect();
        let mut out = vec![0; raw.len()];
        rectifier.remap(0, &raw, &mut out);
        let turn = rectification.rotations[0].transpose();
        let rig = rectification.rig;
        for (i, &value) in out.iter().enumerate().step_by(97) {
            let ray = Vector3::new(
                ((i % 320) as f64 - rig.cx_px) / rig.focal_px,
                ((i / 320) as f64 - rig.cy_px) / rig.focal_px,
                1.0,
            );
            let [column, _] = calibration.left.project(turn * ray).expect("seen");
            assert!((f64::from(value) - column / 2.0).abs() < 1.01, "pixel {i}: {value} for column {column}");
        }
    }

    #[test]
    fn swapped_cameras_are_refused() {
        let calibration = StereoCalibration { translation_m: [0.11, 0.0, 0.0], ..crooked() };
        let mut bounds = ipc_types::bounds::Bounds::default();
        calibration.check(&mut bounds);
        let violations = bounds.into_violations();
        assert!(violations.iter().any(|violation| violation.contains("swapped")), "{violations:?}");
    }
}
