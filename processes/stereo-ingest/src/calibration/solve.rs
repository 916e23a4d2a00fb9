//! Intrinsics and extrinsics of a stereo pair from views of a chessboard.
//!
//! Zhang 2000 for a start (focal length from the homographies, the principal point in the middle, no distortion), then
//! Levenberg and Marquardt's method on everything at once: both lenses, the pose of one camera to the other, and the
//! pose of every board. What is minimised is the reprojection error of all corners in both images.

use super::board::Pixel;
use super::lens::{Distortion, Lens};
use super::stereo::StereoCalibration;
use nalgebra::{DMatrix, DVector, Isometry3, Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};

/// Corners of one board as both cameras see it, in the board's order.
#[derive(Clone, Debug)]
pub struct BoardView {
    /// In the left image.
    pub left: Vec<Pixel>,
    /// In the right image.
    pub right: Vec<Pixel>,
}

/// A board: inner corners and side of a square.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Board {
    /// Corners of a row.
    pub columns: usize,
    /// Rows.
    pub rows: usize,
    /// Side of a square, m.
    pub square_m: f64,
}

/// What was solved for, and how well it fits.
#[derive(Clone, Debug)]
pub struct Solution {
    /// The cameras.
    pub calibration: StereoCalibration,
    /// Left camera from board, for every view.
    pub(crate) boards: Vec<Isometry3<f64>>,
    /// Root mean square of the distances between seen and predicted corners, px.
    pub rms_px: f64,
}

impl Solution {
    /// Depths of a view's corners in the left camera, m.
    pub fn distances(&self, board: &Board, view: usize) -> impl Iterator<Item = f64> {
        let pose = self.boards[view];
        board.corners().into_iter().map(move |corner| (pose.rotation * corner + pose.translation.vector).z)
    }

    /// Boards that it was solved from.
    pub fn views(&self) -> usize {
        self.boards.len()
    }
}

/// Parameters of a lens: focal lengths, principal point, k1, k2, p1, p2, k3.
const LENS: usize = 9;
/// Both lenses and the pose of the right camera.
const CAMERAS: usize = 2 * LENS + 6;
const ITERATIONS: usize = 60;

impl Board {
    /// Corner `index` on the board, m.
    pub fn corner(&self, index: usize) -> Vector3<f64> {
        Vector3::new((index % self.columns) as f64, (index / self.columns) as f64, 0.0) * self.square_m
    }

    fn corners(&self) -> Vec<Vector3<f64>> {
        (0..self.columns * self.rows).map(|index| self.corner(index)).collect()
    }
}

/// Solves for both cameras.
///
/// # Errors
/// Fewer than three views, or views that leave the focal length open (all boards parallel to the image).
pub fn calibrate(board: &Board, views: &[BoardView], size: (u32, u32)) -> Result<Solution, String> {
    if views.len() < 3 {
        return Err(format!("{} boards seen whole by both cameras; expected at least 3, better 10", views.len()));
    }
    let corners = board.corners();
    let centre = [(f64::from(size.0) - 1.0) / 2.0, (f64::from(size.1) - 1.0) / 2.0];
    let start = |side: fn(&BoardView) -> &[Pixel]| -> Result<(f64, Vec<Isometry3<f64>>), String> {
        let homographies: Option<Vec<_>> = views.iter().map(|view| homography(&corners, side(view), centre)).collect();
        let homographies = homographies.ok_or("the corners of a board lie on a line")?;
        let focal = focal_length(&homographies).ok_or("the views leave the focal length open: tilt the board")?;
        Ok((focal, homographies.iter().map(|homography| pose(homography, focal)).collect()))
    };
    let (left_focal, boards) = start(|view| &view.left)?;
    let (right_focal, right_boards) = start(|view| &view.right)?;
    let relative = boards.iter().zip(&right_boards).map(|(left, right)| right * left.inverse()).collect();
    let mut parameters = Vec::new();
    for focal in [left_focal, right_focal] {
        parameters.extend([focal, focal, centre[0], centre[1], 0.0, 0.0, 0.0, 0.0, 0.0]);
    }
    parameters.extend(to_six(&median_pose(relative)));
    boards.iter().for_each(|pose| parameters.extend(to_six(pose)));
    let problem = Problem { corners, views, size, given: None };
    let (parameters, rms_px) = problem.solve(DVector::from_vec(parameters), 0);
    Ok(problem.solution(&parameters, rms_px))
}

/// How well given cameras explain the views: only the boards' poses are solved for.
///
/// # Errors
/// A board is seen where the left lens does not reach, or its corners lie on a line.
pub fn check(board: &Board, views: &[BoardView], calibration: &StereoCalibration) -> Result<Solution, String> {
    let corners = board.corners();
    // The lenses' parameters stand still; what holds their place is not looked at.
    let mut parameters = vec![0.0; 2 * LENS];
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix(&calibration.rotation()));
    parameters.extend(to_six(&Isometry3::from_parts(Translation3::from(calibration.translation_m), rotation)));
    let lens = &calibration.left;
    let focal = (lens.focal_px[0] + lens.focal_px[1]) / 2.0;
    for view in views {
        // Where a pinhole would see the corners: a fisheye's image of a board is far from a homography's.
        let straight = |seen: &Pixel| Some(lens.unproject(*seen)?.map(|ray| ray * focal));
        let seen: Option<Vec<Pixel>> = view.left.iter().map(straight).collect();
        let seen = seen.ok_or("the calibration's left lens does not reach to where a board is seen")?;
        let homography = homography(&corners, &seen, [0.0; 2]).ok_or("the corners of a board lie on a line")?;
        parameters.extend(to_six(&pose(&homography, focal)));
    }
    let size = (lens.width_px, lens.height_px);
    let problem = Problem { corners, views, size, given: Some(calibration) };
    let (parameters, rms_px) = problem.solve(DVector::from_vec(parameters), CAMERAS);
    Ok(problem.solution(&parameters, rms_px))
}

struct Problem<'a> {
    corners: Vec<Vector3<f64>>,
    views: &'a [BoardView],
    size: (u32, u32),
    /// Cameras that are not solved for.
    given: Option<&'a StereoCalibration>,
}

impl Problem<'_> {
    /// Differences between predicted and seen corners, both coordinates, both cameras.
    fn residuals(&self, parameters: &DVector<f64>) -> DVector<f64> {
        let lenses = self.lenses(parameters.as_slice());
        let right_from_left = from_six(&parameters.as_slice()[2 * LENS..CAMERAS]);
        let mut residuals = Vec::with_capacity(self.views.len() * self.corners.len() * 4);
        for (view, pose) in self.views.iter().zip(parameters.as_slice()[CAMERAS..].chunks_exact(6)) {
            let left_from_board = from_six(pose);
            let cameras = [(left_from_board, &view.left), (right_from_left * left_from_board, &view.right)];
            for (lens, (from_board, seen)) in lenses.iter().zip(cameras) {
                for (corner, seen) in self.corners.iter().zip(seen) {
                    let point = from_board.rotation * corner + from_board.translation.vector;
                    // A step that throws a corner out of view is so bad that it is taken back.
                    let predicted = lens.project(point).unwrap_or([1e4; 2]);
                    residuals.extend([predicted[0] - seen[0], predicted[1] - seen[1]]);
                }
            }
        }
        DVector::from_vec(residuals)
    }

    /// Both cameras of a set of parameters.
    fn lenses(&self, parameters: &[f64]) -> [Lens; 2] {
        match self.given {
            Some(given) => [given.left, given.right],
            None => [0, 1].map(|side| self.lens(&parameters[side * LENS..(side + 1) * LENS])),
        }
    }

    fn lens(&self, parameters: &[f64]) -> Lens {
        let mut k = [0.0; 8];
        k[..5].copy_from_slice(&parameters[4..LENS]);
        Lens {
            width_px: self.size.0,
            height_px: self.size.1,
            focal_px: [parameters[0], parameters[1]],
            centre_px: [parameters[2], parameters[3]],
            distortion: Distortion::RadialTangential(k),
        }
    }

    /// Improves the parameters from `first` on; also the root mean square distance, px.
    fn solve(&self, mut parameters: DVector<f64>, first: usize) -> (DVector<f64>, f64) {
        let mut residuals = self.residuals(&parameters);
        let mut damping = 1e-3;
        for _ in 0..ITERATIONS {
            let jacobian = self.jacobian(&parameters, &residuals, first);
            let gradient = jacobian.tr_mul(&residuals);
            let normal = jacobian.tr_mul(&jacobian);
            let before = residuals.norm_squared();
            let mut gained = 0.0;
            while damping < 1e9 {
                let mut damped = normal.clone();
                for index in 0..damped.nrows() {
                    damped[(index, index)] += damping * normal[(index, index)].max(1e-12);
                }
                let Some(step) = damped.cholesky().map(|factors| factors.solve(&gradient)) else {
                    damping *= 10.0;
                    continue;
                };
                let mut candidate = parameters.clone();
                let mut moved = candidate.rows_mut(first, step.len());
                moved -= &step;
                let there = self.residuals(&candidate);
                if there.norm_squared() < before {
                    gained = before - there.norm_squared();
                    (parameters, residuals) = (candidate, there);
                    damping = (damping * 0.1).max(1e-9);
                    break;
                }
                damping *= 10.0;
            }
            if gained < 1e-10 * before {
                break;
            }
        }
        let rms_px = (2.0 * residuals.norm_squared() / residuals.len() as f64).sqrt();
        (parameters, rms_px)
    }

    /// By differences: a few dozen parameters, a few thousand residuals.
    fn jacobian(&self, parameters: &DVector<f64>, residuals: &DVector<f64>, first: usize) -> DMatrix<f64> {
        let mut jacobian = DMatrix::zeros(residuals.len(), parameters.len() - first);
        for index in first..parameters.len() {
            let step = 1e-6 * parameters[index].abs().max(1.0);
            let mut ahead = parameters.clone();
            ahead[index] += step;
            jacobian.set_column(index - first, &((self.residuals(&ahead) - residuals) / step));
        }
        jacobian
    }

    fn solution(&self, parameters: &DVector<f64>, rms_px: f64) -> Solution {
        let all = parameters.as_slice();
        let pose = from_six(&all[2 * LENS..CAMERAS]);
        let rotation = pose.rotation.to_rotation_matrix();
        let [left, right] = self.lenses(all);
        let calibration = StereoCalibration {
            left,
            right,
            rotation: [0, 1, 2].map(|row| [0, 1, 2].map(|column| rotation[(row, column)])),
            translation_m: pose.translation.vector.into(),
        };
        Solution { calibration, boards: all[CAMERAS..].chunks_exact(6).map(from_six).collect(), rms_px }
    }
}

fn to_six(pose: &Isometry3<f64>) -> [f64; 6] {
    let (turn, shift) = (pose.rotation.scaled_axis(), pose.translation.vector);
    [turn.x, turn.y, turn.z, shift.x, shift.y, shift.z]
}

fn from_six(six: &[f64]) -> Isometry3<f64> {
    Isometry3::new(Vector3::new(six[3], six[4], six[5]), Vector3::new(six[0], six[1], six[2]))
}

/// The pose whose translation is the median of all: a few wrong starts do not matter.
fn median_pose(mut poses: Vec<Isometry3<f64>>) -> Isometry3<f64> {
    poses.sort_by(|a, b| a.translation.vector.x.total_cmp(&b.translation.vector.x));
    poses[poses.len() / 2]
}

/// From the board's plane to the image, px from the principal point, by the direct linear transformation.
fn homography(corners: &[Vector3<f64>], seen: &[Pixel], centre: [f64; 2]) -> Option<Matrix3<f64>> {
    // Scaled so that the equations' coefficients are of one order.
    let board_scale = corners.iter().map(|corner| corner.norm()).fold(1e-12, f64::max);
    let image_scale = 500.0;
    let mut equations = DMatrix::zeros(2 * corners.len(), 9);
    for (index, (corner, seen)) in corners.iter().zip(seen).enumerate() {
        let (x, y) = (corner.x / board_scale, corner.y / board_scale);
        let (u, v) = ((seen[0] - centre[0]) / image_scale, (seen[1] - centre[1]) / image_scale);
        let rows = [[x, y, 1.0, 0.0, 0.0, 0.0, -u * x, -u * y, -u], [0.0, 0.0, 0.0, x, y, 1.0, -v * x, -v * y, -v]];
        for (row, values) in rows.iter().enumerate() {
            for (column, value) in values.iter().enumerate() {
                equations[(2 * index + row, column)] = *value;
            }
        }
    }
    let eigen = equations.tr_mul(&equations).symmetric_eigen();
    let least = eigen.eigenvalues.imin();
    let solution = eigen.eigenvectors.column(least);
    let scaled = Matrix3::from_row_slice(solution.as_slice());
    let homography = Matrix3::from_diagonal(&Vector3::new(image_scale, image_scale, 1.0))
        * scaled
        * Matrix3::from_diagonal(&Vector3::new(1.0 / board_scale, 1.0 / board_scale, 1.0));
    (homography.determinant().abs() > 1e-12).then_some(homography)
}

/// Zhang's constraints for square pixels and a known principal point: two equations in 1/f² a view, by least squares.
fn focal_length(homographies: &[Matrix3<f64>]) -> Option<f64> {
    let (mut numerator, mut denominator) = (0.0, 0.0);
    for homography in homographies {
        // Homographies have no scale of their own.
        let h = homography / homography.column(2).norm();
        let (a, b) = (h.column(0), h.column(1));
        let weight = 1.0 / (a.norm() * b.norm()).max(1e-12);
        for (slope, constant) in [
            (a[0] * b[0] + a[1] * b[1], a[2] * b[2]),
            (a[0] * a[0] + a[1] * a[1] - b[0] * b[0] - b[1] * b[1], a[2] * a[2] - b[2] * b[2]),
        ] {
            let (slope, constant) = (slope * weight, constant * weight);
            numerator -= slope * constant;
            denominator += slope * slope;
        }
    }
    let inverse_square = numerator / denominator;
    (inverse_square > 0.0 && inverse_square.is_finite()).then(|| 1.0 / inverse_square.sqrt())
}

/// Camera from board.
fn pose(homography: &Matrix3<f64>, focal: f64) -> Isometry3<f64> {
    let rays = Matrix3::from_diagonal(&Vector3::new(1.0 / focal, 1.0 / focal, 1.0)) * homography;
    let mut scale = 2.0 / (rays.column(0).norm() + rays.column(1).norm());
    if rays[(2, 2)] < 0.0 {
        scale = -scale;
    }
    let (x, y) = (rays.column(0) * scale, rays.column(1) * scale);
    let rotation = Rotation3::from_matrix(&Matrix3::from_columns(&[x, y, x.cross(&y)]));
    Isometry3::from_parts(Translation3::from(rays.column(2) * scale), UnitQuaternion::from_rotation_matrix(&rotation))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Ten boards, seen from both cameras.
    fn views(board: &Board, [left, right]: [Lens; 2], right_from_left: Isometry3<f64>) -> Vec<BoardView> {
        let see = |lens: &Lens, from_board: Isometry3<f64>| {
            let place = |corner: &Vector3<f64>| from_board.rotation * corner + from_board.translation.vector;
            board.corners().iter().map(|corner| lens.project(place(corner)).expect("in view")).collect()
        };
        let view = |index: u32| {
            let turn = f64::from(index);
            let pose = Isometry3::new(
                Vector3::new(-0.12 + 0.02 * (turn * 1.3).sin(), -0.07 + 0.03 * turn.cos(), 0.45 + 0.05 * turn),
                Vector3::new(0.5 * (turn * 0.9).sin(), 0.5 * (turn * 1.7).cos(), 0.2 * turn.sin()),
            );
            BoardView { left: see(&left, pose), right: see(&right, right_from_left * pose) }
        };
        (0..10).map(view).collect()
    }

    #[test]
    fn known_cameras_are_found_again() {
        let board = Board { columns: 9, rows: 6, square_m: 0.03 };
        let k = [-0.28, 0.08, 0.0005, -0.0003, 0.0, 0.0, 0.0, 0.0];
        let left = Lens {
            width_px: 640,
            height_px: 480,
            focal_px: [530.0, 533.0],
            centre_px: [325.0, 236.0],
            distortion: Distortion::RadialTangential(k),
        };
        let right = Lens { focal_px: [536.0, 535.0], centre_px: [314.0, 244.0], ..left };
        let right_from_left = Isometry3::new(Vector3::new(-0.1, 0.001, 0.002), Vector3::new(0.004, -0.02, 0.006));
        let views = views(&board, [left, right], right_from_left);
        let solution = calibrate(&board, &views, (640, 480)).expect("solved");
        assert!(solution.rms_px < 1e-4, "{}", solution.rms_px);
        let found = solution.calibration;
        for (found, truth) in [(found.left, left), (found.right, right)] {
            let off = (0..2).map(|i| {
                (found.focal_px[i] - truth.focal_px[i]).abs() + (found.centre_px[i] - truth.centre_px[i]).abs()
            });
            assert!(off.sum::<f64>() < 0.05, "{found:?}");
        }
        assert!((found.translation_m[0] + 0.1).abs() < 1e-5, "{:?}", found.translation_m);
        let checked = check(&board, &views, &found).expect("checked");
        assert!(checked.rms_px < 1e-4, "{}", checked.rms_px);
        // A wrong focal length is noticed.
        let wrong = StereoCalibration { left: Lens { focal_px: [560.0, 560.0], ..found.left }, ..found };
        assert!(check(&board, &views, &wrong).expect("checked").rms_px > 0.5);
        assert!(calibrate(&board, &views[..2], (640, 480)).is_err());
    }

    #[test]
    fn lenses_of_every_kind_can_be_checked() {
        let board = Board { columns: 9, rows: 6, square_m: 0.03 };
        let rational = Distortion::RadialTangential([0.3, -0.1, 0.0005, -0.0003, 0.01, 0.55, -0.02, 0.01]);
        for distortion in [Distortion::None, Distortion::Equidistant([0.01, -0.004, 0.002, -0.0005]), rational] {
            let left =
                Lens { width_px: 640, height_px: 480, focal_px: [290.0, 291.0], centre_px: [321.0, 238.0], distortion };
            let right = Lens { centre_px: [317.0, 243.0], ..left };
            let right_from_left = Isometry3::new(Vector3::new(-0.1, 0.001, 0.002), Vector3::new(0.004, -0.02, 0.006));
            let rotation = right_from_left.rotation.to_rotation_matrix();
            let given = StereoCalibration {
                left,
                right,
                rotation: [0, 1, 2].map(|row| [0, 1, 2].map(|column| rotation[(row, column)])),
                translation_m: right_from_left.translation.vector.into(),
            };
            let views = views(&board, [left, right], right_from_left);
            let checked = check(&board, &views, &given).expect("checked");
            assert!(checked.rms_px < 1e-4, "{distortion:?}: {}", checked.rms_px);
            let wrong = StereoCalibration { translation_m: [-0.105, 0.001, 0.002], ..given };
            assert!(check(&board, &views, &wrong).expect("checked").rms_px > 0.3, "{distortion:?}");
        }
    }
}
