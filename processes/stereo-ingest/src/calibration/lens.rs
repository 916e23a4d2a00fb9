//! One raw camera: pinhole with radial-tangential or equidistant distortion.

use ipc_types::StereoRig;
use ipc_types::bounds::Bounds;
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

/// Intrinsic parameters of a camera. Pixel coordinates are 0 at the centre of the first pixel.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Lens {
    /// Image width, px.
    pub width_px: u32,
    /// Image height, px.
    pub height_px: u32,
    /// Focal lengths along columns and rows, px.
    pub focal_px: [f64; 2],
    /// Principal point: column, row, px.
    pub centre_px: [f64; 2],
    /// How the lens departs from a pinhole.
    pub distortion: Distortion,
}

/// A distortion model.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Distortion {
    /// A pinhole.
    None,
    /// k1, k2, p1, p2, k3, k4, k5, k6 as in OpenCV: radial r²ᵏ, the last three in the denominator; p tangential.
    RadialTangential([f64; 8]),
    /// k1 to k4 of Kannala and Brandt 2006, OpenCV's fisheye: θ(1 + k1 θ² + k2 θ⁴ + k3 θ⁶ + k4 θ⁸).
    Equidistant([f64; 4]),
}

/// Rays farther from the axis than this are never used, rad: a rectified image cannot show them.
const WIDEST_RAD: f64 = 1.31;

impl Lens {
    /// Reports what cannot be a camera.
    pub fn check(&self, bounds: &mut Bounds, name: &str) {
        let side = 32..=StereoRig::MAX_SIDE_PX;
        bounds.range(&format!("{name}.width_px"), self.width_px, side.clone());
        bounds.range(&format!("{name}.height_px"), self.height_px, side);
        let sides = [f64::from(self.width_px), f64::from(self.height_px)];
        for (axis, (side, (focal, centre))) in
            sides.into_iter().zip(self.focal_px.into_iter().zip(self.centre_px)).enumerate()
        {
            bounds.range(&format!("{name}.focal_px.{axis}"), focal, 10.0..=1e5);
            bounds.range(&format!("{name}.centre_px.{axis}"), centre, 0.0..=side);
        }
        let coefficients: &[f64] = match &self.distortion {
            Distortion::None => &[],
            Distortion::RadialTangential(all) => all,
            Distortion::Equidistant(all) => all,
        };
        for (index, coefficient) in coefficients.iter().enumerate() {
            bounds.range(&format!("{name}.distortion.{index}"), *coefficient, -100.0..=100.0);
        }
    }

    /// Where a point in front of the camera (x right, y down, z forward) appears, px; `None` where the model does not
    /// reach: behind, too far aside, or where the distortion turns back.
    pub fn project(&self, point: Vector3<f64>) -> Option<[f64; 2]> {
        let radius = point.x.hypot(point.y);
        if point.z <= 0.0 || radius.atan2(point.z) > WIDEST_RAD {
            return None;
        }
        let (x, y) = (point.x / point.z, point.y / point.z);
        let [x, y] = self.distort(x, y)?;
        Some([self.focal_px[0] * x + self.centre_px[0], self.focal_px[1] * y + self.centre_px[1]])
    }

    /// The same without distortion's limits checked twice: normalised coordinates to distorted ones.
    fn distort(&self, x: f64, y: f64) -> Option<[f64; 2]> {
        let r2 = x * x + y * y;
        match self.distortion {
            Distortion::None => Some([x, y]),
            Distortion::RadialTangential([k1, k2, p1, p2, k3, k4, k5, k6]) => {
                let radial =
                    |r2: f64| (1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1.0 + r2 * (k4 + r2 * (k5 + r2 * k6)));
                // Past the radius where r·radial(r²) falls again, the polynomial shows what is not there.
                let r = r2.sqrt();
                let ahead = r + 1e-3;
                if ahead * radial(ahead * ahead) <= r * radial(r2) {
                    return None;
                }
                let factor = radial(r2);
                Some([
                    x * factor + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
                    y * factor + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
                ])
            }
            Distortion::Equidistant([k1, k2, k3, k4]) => {
                let r = r2.sqrt();
                let bent = |theta: f64| {
                    let t2 = theta * theta;
                    theta * (1.0 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4))))
                };
                let theta = r.atan();
                if bent(theta + 1e-3) <= bent(theta) {
                    return None;
                }
                let factor = if r > 1e-9 { bent(theta) / r } else { 1.0 };
                Some([x * factor, y * factor])
            }
        }
    }

    /// Normalised coordinates (x/z, y/z) of the ray through a pixel; `None` where no ray leads there.
    ///
    /// Newton's method with a numerical derivative: distortions are smooth.
    pub fn unproject(&self, pixel: [f64; 2]) -> Option<[f64; 2]> {
        const STEP: f64 = 1e-6;
        let wanted = [0, 1].map(|i| (pixel[i] - self.centre_px[i]) / self.focal_px[i]);
        let mut guess = wanted;
        if let Distortion::Equidistant(_) = self.distortion {
            let theta = wanted[0].hypot(wanted[1]).min(WIDEST_RAD);
            let scale = if theta > 1e-9 { theta.tan() / theta } else { 1.0 };
            guess = wanted.map(|value| value * scale);
        }
        for _ in 0..50 {
            let here = self.distort(guess[0], guess[1])?;
            let error = [wanted[0] - here[0], wanted[1] - here[1]];
            if error[0].hypot(error[1]) < 1e-10 {
                return (guess[0].hypot(guess[1]).atan() <= WIDEST_RAD).then_some(guess);
            }
            let along_x = self.distort(guess[0] + STEP, guess[1])?;
            let along_y = self.distort(guess[0], guess[1] + STEP)?;
            let [a, c] = [0, 1].map(|i| (along_x[i] - here[i]) / STEP);
            let [b, d] = [0, 1].map(|i| (along_y[i] - here[i]) / STEP);
            let determinant = a * d - b * c;
            if determinant.abs() < 1e-12 {
                return None;
            }
            guess[0] += (d * error[0] - b * error[1]) / determinant;
            guess[1] += (a * error[1] - c * error[0]) / determinant;
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lens(distortion: Distortion) -> Lens {
        Lens { width_px: 752, height_px: 480, focal_px: [458.7, 457.3], centre_px: [367.2, 248.4], distortion }
    }

    #[test]
    fn unprojection_inverts_projection() {
        let euroc =
            Distortion::RadialTangential([-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05, 0.0, 0.0, 0.0, 0.0]);
        let fisheye = Distortion::Equidistant([-0.01, 0.02, -0.01, 0.001]);
        for lens in [Distortion::None, euroc, fisheye].map(lens) {
            for column in (0..752).step_by(47) {
                for row in (0..480).step_by(40) {
                    let pixel = [f64::from(column), f64::from(row)];
                    let [x, y] = lens.unproject(pixel).expect("inside the image");
                    let back = lens.project(Vector3::new(2.0 * x, 2.0 * y, 2.0)).expect("in front");
                    assert!((back[0] - pixel[0]).hypot(back[1] - pixel[1]) < 1e-6, "{pixel:?} {back:?}");
                }
            }
        }
    }

    #[test]
    fn nothing_is_seen_where_the_model_does_not_reach() {
        let barrel = lens(Distortion::RadialTangential([-0.4, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]));
        assert!(barrel.project(Vector3::new(0.2, 0.0, 1.0)).is_some());
        assert!(barrel.project(Vector3::new(1.2, 0.0, 1.0)).is_none(), "the polynomial turns back at r = 0.91");
        assert!(barrel.project(Vector3::new(0.0, 0.0, -1.0)).is_none());
        assert!(lens(Distortion::None).project(Vector3::new(5.0, 0.0, 1.0)).is_none());
    }

    #[test]
    fn impossible_lenses_are_named() {
        let mut bounds = Bounds::default();
        let broken = Lens { focal_px: [f64::NAN, 400.0], centre_px: [-5.0, 200.0], ..lens(Distortion::None) };
        broken.check(&mut bounds, "left");
        assert_eq!(bounds.into_violations().len(), 2);
    }
}
