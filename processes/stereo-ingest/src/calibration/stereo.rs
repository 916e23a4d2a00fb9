//! Two raw cameras, and how they are turned into a rectified rig.

use super::lens::Lens;
use ipc_types::StereoRig;
use ipc_types::bounds::Bounds;
use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};

/// A raw stereo pair: what has to be known to rectify it.
///
/// A point in the right camera's frame (x right, y down, z forward) is `rotation` · (the point in the left one's) +
/// `translation_m`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StereoCalibration {
    /// The left camera.
    pub left: Lens,
    /// The right camera.
    pub right: Lens,
    /// Rotation matrix, by rows.
    pub rotation: [[f64; 3]; 3],
    /// Translation, m.
    pub translation_m: [f64; 3],
}

/// A rectification: what the two images become, and how the cameras turn for it.
#[derive(Clone, Copy, Debug)]
pub struct Rectification {
    /// The rectified rig, of the raw images' size.
    pub rig: StereoRig,
    /// Rectified frame from the left and the right camera's.
    pub(crate) rotations: [Matrix3<f64>; 2],
}

impl StereoCalibration {
    /// Reports what cannot be a pair of cameras.
    pub fn check(&self, bounds: &mut Bounds) {
        self.left.check(bounds, "left");
        self.right.check(bounds, "right");
        let sizes = [self.left, self.right].map(|lens| (lens.width_px, lens.height_px));
        bounds.require(
            sizes[0] == sizes[1],
            "right",
            format_args!("is {:?} px, the left image is {:?}", sizes[1], sizes[0]),
        );
        let rotation = self.rotation();
        let skew = (rotation * rotation.transpose() - Matrix3::identity()).abs().max();
        let proper = skew < 1e-3 && rotation.determinant() > 0.0;
        bounds.require(proper, "rotation", format_args!("is no rotation matrix (off by {skew:.4})"));
        let baseline = Vector3::from(self.translation_m).norm();
        bounds.range("baseline_m", baseline, 0.005..=10.0);
        let right_of = -(rotation.transpose() * Vector3::from(self.translation_m));
        bounds.require(
            right_of.x > 0.7 * baseline,
            "translation_m",
            format_args!(
                "puts the right camera at {:.3?} m from the left one; expected it on its right: swapped?",
                right_of.as_slice()
            ),
        );
        let turned = rotation.trace().clamp(-1.0, 3.0);
        let angle_deg = ((turned - 1.0) / 2.0).acos().to_degrees();
        bounds.range("angle between the cameras, degrees", angle_deg, 0.0..=20.0);
    }

    pub(crate) fn rotation(&self) -> Matrix3<f64> {
        Matrix3::from_fn(|row, column| self.rotation[row][column])
    }

    /// Turns both cameras so that their rows lie along the baseline and both look the same way: half of the way each
    /// (Bouguet). The focal length is the smallest for which no rectified pixel lies outside of either raw image.
    ///
    /// # Errors
    /// The views overlap in nothing.
    pub fn rectify(&self) -> Result<Rectification, String> {
        let right_from_left = self.rotation();
        let baseline = -(right_from_left.transpose() * Vector3::from(self.translation_m));
        let along = baseline.normalize();
        let ahead = Vector3::z() + right_from_left.transpose() * Vector3::z();
        let down = ahead.cross(&along).normalize();
        let rectified_from_left =
            Matrix3::from_rows(&[along.transpose(), down.transpose(), along.cross(&down).transpose()]);
        let rotations = [rectified_from_left, rectified_from_left * right_from_left.transpose()];
        let [left, right] =
            [(self.left, rotations[0]), (self.right, rotations[1])].map(|(lens, rotation)| visible(&lens, &rotation));
        let [from, to] = [0, 1].map(|axis| (left.0[axis].max(right.0[axis]), left.1[axis].min(right.1[axis])));
        let (width, height) = (f64::from(self.left.width_px), f64::from(self.left.height_px));
        let focal_px = ((width - 1.0) / (from.1 - from.0)).max((height - 1.0) / (to.1 - to.0));
        if !(from.1 > from.0 && to.1 > to.0 && focal_px.is_finite()) {
            return Err(format!(
                "no common view remains: columns {:.2}..{:.2}, rows {:.2}..{:.2}",
                from.0, from.1, to.0, to.1
            ));
        }
        let rig = StereoRig {
            width_px: self.left.width_px,
            height_px: self.left.height_px,
            focal_px,
            cx_px: (width - 1.0) / 2.0 - focal_px * (from.0 + from.1) / 2.0,
            cy_px: (height - 1.0) / 2.0 - focal_px * (to.0 + to.1) / 2.0,
            baseline_m: baseline.norm(),
            doffs_px: 0.0,
        };
        Ok(Rectification { rig, rotations })
    }
}

impl Rectification {
    /// Rectified frame from the left camera's.
    pub fn left_turn(&self) -> Matrix3<f64> {
        self.rotations[0]
    }

    /// Where a raw pixel of a camera (0 left, 1 right) comes to lie, px; `None` where no ray leads there.
    pub fn rectified(&self, calibration: &StereoCalibration, camera: usize, pixel: [f64; 2]) -> Option<[f64; 2]> {
        let lens = if camera == 0 { &calibration.left } else { &calibration.right };
        let [x, y] = lens.unproject(pixel)?;
        let ray = self.rotations[camera] * Vector3::new(x, y, 1.0);
        let at = |centre: f64, part: f64| centre + self.rig.focal_px * part / ray.z;
        (ray.z > 0.0).then(|| [at(self.rig.cx_px, ray.x), at(self.rig.cy_px, ray.y)])
    }
}

/// Least and largest normalised coordinates (columns, rows) of the upright rectangle that a turned camera sees all of.
fn visible(lens: &Lens, rotation: &Matrix3<f64>) -> ([f64; 2], [f64; 2]) {
    const SAMPLES: u32 = 64;
    let (right, bottom) = (f64::from(lens.width_px - 1), f64::from(lens.height_px - 1));
    let (mut least, mut most) = ([f64::NEG_INFINITY; 2], [f64::INFINITY; 2]);
    // Wider than this no lens is used.
    let widest = 2.0;
    let seen = |pixel: [f64; 2]| -> Option<[f64; 2]> {
        let [x, y] = lens.unproject(pixel)?;
        let ray = rotation * Vector3::new(x, y, 1.0);
        (ray.z > 0.0).then(|| [ray.x / ray.z, ray.y / ray.z])
    };
    for sample in 0..=SAMPLES {
        let share = f64::from(sample) / f64::from(SAMPLES);
        let sides = [[0.0, bottom * share], [right, bottom * share], [right * share, 0.0], [right * share, bottom]];
        let [left_side, right_side, top_side, bottom_side] = sides.map(seen);
        least[0] = least[0].max(left_side.map_or(-widest, |at| at[0].max(-widest)));
        most[0] = most[0].min(right_side.map_or(widest, |at| at[0].min(widest)));
        least[1] = least[1].max(top_side.map_or(-widest, |at| at[1].max(-widest)));
        most[1] = most[1].min(bottom_side.map_or(widest, |at| at[1].min(widest)));
    }
    (least, most)
}
