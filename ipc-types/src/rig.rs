//! Rectified stereo rig: the geometry between disparity, depth and points.

use crate::bounds::Bounds;
use crate::frames::{Body, Camera, Point, Pose, Rotation, Vector};
use serde::{Deserialize, Serialize};

/// A rectified pair: two identical pinhole cameras, the right one displaced by `baseline_m` along the camera's x axis.
///
/// Depth follows Z = f·b / (d + doffs), where `doffs` is the difference of the principal points' columns
/// (cx_right − cx_left, as Middlebury defines it; 0 for most rigs).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StereoRig {
    /// Image width, px.
    pub width_px: u32,
    /// Image height, px.
    pub height_px: u32,
    /// Focal length, px.
    pub focal_px: f64,
    /// Principal point column, px (0 is the centre of the first pixel).
    pub cx_px: f64,
    /// Principal point row, px.
    pub cy_px: f64,
    /// Distance between the cameras, m.
    pub baseline_m: f64,
    /// Difference of the principal points' columns, px.
    pub doffs_px: f64,
}

impl StereoRig {
    /// Largest side that every stage supports, px.
    pub const MAX_SIDE_PX: u32 = 4096;

    /// Reports what cannot be a rig.
    pub fn check(&self, bounds: &mut Bounds) {
        bounds.range("width_px", self.width_px, 32..=Self::MAX_SIDE_PX);
        bounds.range("height_px", self.height_px, 24..=Self::MAX_SIDE_PX);
        bounds.range("focal_px", self.focal_px, 10.0..=1e5);
        bounds.range("cx_px", self.cx_px, 0.0..=f64::from(self.width_px));
        bounds.range("cy_px", self.cy_px, 0.0..=f64::from(self.height_px));
        bounds.range("baseline_m", self.baseline_m, 0.005..=10.0);
        bounds.range("doffs_px", self.doffs_px, -1000.0..=1000.0);
    }

    /// Number of pixels of one image.
    pub const fn pixels(&self) -> usize {
        self.width_px as usize * self.height_px as usize
    }

    /// f·b, px·m: depth times (disparity + doffs).
    pub fn focal_baseline_px_m(&self) -> f64 {
        self.focal_px * self.baseline_m
    }

    /// Depth along the optical axis for a disparity, m; infinite when the disparity points beyond infinity.
    pub fn depth_m(&self, disparity_px: f64) -> f64 {
        let d = disparity_px + self.doffs_px;
        if d > 0.0 { self.focal_baseline_px_m() / d } else { f64::INFINITY }
    }

    /// Disparity at a depth along the optical axis, px.
    pub fn disparity_px(&self, depth_m: f64) -> f64 {
        self.focal_baseline_px_m() / depth_m - self.doffs_px
    }

    /// Column, row (px, unrounded) and disparity (px) of a point in front of the camera, else `None`.
    pub fn project(&self, point: Point<Camera>) -> Option<(f64, f64, f64)> {
        if point.z <= 1e-6 {
            return None;
        }
        let u = self.cx_px + self.focal_px * point.x / point.z;
        let v = self.cy_px + self.focal_px * point.y / point.z;
        Some((u, v, self.disparity_px(point.z)))
    }

    /// The point seen at column `u_px`, row `v_px` with a disparity.
    pub fn back_project(&self, u_px: f64, v_px: f64, disparity_px: f64) -> Point<Camera> {
        let z = self.depth_m(disparity_px);
        Point::new((u_px - self.cx_px) / self.focal_px * z, (v_px - self.cy_px) / self.focal_px * z, z)
    }

    /// Part of the vertical field of view above the optical axis, rad.
    pub fn half_view_up_rad(&self) -> f64 {
        (self.cy_px / self.focal_px).atan()
    }
}

/// Where the left camera sits on the vehicle.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CameraMount {
    /// Left camera's position in the body frame (forward, left, up), m.
    pub position_m: [f64; 3],
    /// Angle of the optical axis above the body's x axis, degrees.
    pub pitch_up_deg: f64,
}

impl CameraMount {
    /// Reports what cannot be a mount.
    pub fn check(&self, bounds: &mut Bounds) {
        for (axis, value) in ["position_m.x", "position_m.y", "position_m.z"].iter().zip(self.position_m) {
            bounds.range(axis, value, -2.0..=2.0);
        }
        bounds.range("pitch_up_deg", self.pitch_up_deg, -60.0..=60.0);
    }

    /// Pose of the camera on the body.
    pub fn body_from_camera(&self) -> Pose<Body, Camera> {
        Pose {
            rotation: Rotation::camera_mount(self.pitch_up_deg.to_radians()),
            translation: Vector::from_array(self.position_m),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const RIG: StereoRig = StereoRig {
        width_px: 320,
        height_px: 240,
        focal_px: 200.0,
        cx_px: 159.5,
        cy_px: 119.5,
        baseline_m: 0.3,
        doffs_px: 0.0,
    };

    #[test]
    fn thesis_table_5_1_disparities() {
        // Table 5.1: b = 0.35 m, f = 514.17 px: 50 m and 5 m are 3.60 px and 35.99 px.
        let rig = StereoRig { focal_px: 514.17, baseline_m: 0.35, ..RIG };
        assert!((rig.disparity_px(50.0) - 3.60).abs() < 0.005);
        assert!((rig.disparity_px(5.0) - 35.99).abs() < 0.005);
    }

    #[test]
    fn projection_inverts_back_projection() {
        let rig = StereoRig { doffs_px: 31.086, ..RIG };
        let (u, v, d) = rig.project(rig.back_project(12.0, 200.0, 7.25)).expect("in front");
        assert!((u - 12.0).abs() < 1e-9 && (v - 200.0).abs() < 1e-9 && (d - 7.25).abs() < 1e-9);
    }

    #[test]
    fn nothing_behind_the_camera_projects() {
        assert!(RIG.project(Point::new(0.0, 0.0, -1.0)).is_none());
        assert!(RIG.depth_m(0.0).is_infinite());
    }

    #[test]
    fn impossible_rigs_are_named() {
        let mut bounds = Bounds::default();
        StereoRig { focal_px: f64::NAN, baseline_m: -0.1, ..RIG }.check(&mut bounds);
        assert_eq!(bounds.into_violations().len(), 2);
    }
}
