//! Three-valued occupancy: what the keyframes and the free-space evidence say about a point.

use crate::evidence::FreeSpace;
use ipc_types::disparity::SCALE;
use ipc_types::messages::{NEVER_OCCUPIED, UNKNOWN_FRONT};
use ipc_types::noise::NoiseModel;
use ipc_types::{Camera, Point, Pose, StereoRig, World};
use runtime::images::StoredImage;

/// Weight of a vote for free or occluded against one for occupied (Table 3.1).
const SAFE_DISCOUNT: f32 = 0.5;

/// Views whose votes for occupied count in full.
const WITNESSES: f32 = 2.0;

/// Votes of one kind on a point. Views err together, so their sum is capped by the strongest among them.
///
/// Eq. 3.11 takes half of the safe votes' sum. What one view is too far away to resolve, such as a thin branch, its
/// neighbours miss as well, and ten of them would outvote the one view that was near enough. So the safe sum counts for
/// no more than the strongest free vote, and views from which the point is hidden clear nothing alone.
///
/// Far views pad an obstacle by what they cannot resolve. So the occupied sum counts for no more than twice its
/// strongest vote, or no number of views from half of the distance could clear what a row of them padded.
#[derive(Clone, Copy, Default)]
struct Votes {
    sum: f32,
    strongest: f32,
}

impl Votes {
    fn cast(&mut self, weight: f32) {
        self.sum += weight;
        self.strongest = self.strongest.max(weight);
    }

    /// A vote that supports others and counts for nothing alone.
    fn support(&mut self, weight: f32) {
        self.sum += weight;
    }

    fn as_occupied(self) -> f32 {
        self.sum.min(WITNESSES * self.strongest)
    }

    fn as_safe(self) -> f32 {
        (SAFE_DISCOUNT * self.sum).min(self.strongest)
    }
}

/// Why a point is unknown.
#[derive(Clone, Copy, PartialEq, Eq, Debug, PartialOrd, Ord)]
pub enum Unknown {
    /// No keyframe's camera looked there.
    OutOfView,
    /// Looked at, but nothing was measured there, or the vehicle's body would reach what was not measured.
    NoReturn,
    /// Hidden behind something.
    Occluded,
}

/// What is known about a point.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Occupancy {
    /// The vehicle's centre may be there.
    Free,
    /// It may not.
    Occupied,
    /// Nobody vouches for it.
    Unknown(Unknown),
}

/// The sum of the votes on a point, before a threshold makes an answer of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Score {
    /// Eq. 3.11: occupied votes, at most twice the strongest of them, minus half of the others, at most the strongest
    /// free one.
    pub sum: f32,
    /// Whether any view vouches for free space.
    pub vouched: bool,
    /// The most telling reason for which a view does not vouch.
    pub unknown: Unknown,
}

/// One keyframe, ready to be asked.
#[derive(Clone, Debug)]
struct KeyView {
    /// Camera from world, row-major.
    rotation: [[f32; 3]; 3],
    origin: Point<World>,
    image: StoredImage,
}

enum Vote {
    OutOfView,
    NoReturn,
    Occluded(f32),
    Occupied(f32),
    Free(f32),
    FarBackground(f32),
}

/// Keyframes and evidence, to be asked about points.
#[derive(Clone, Debug)]
pub struct View {
    rig: StereoRig,
    noise: NoiseModel,
    focal_px: f32,
    centre_px: (f32, f32),
    focal_baseline: f32,
    keys: Vec<KeyView>,
    free_space: FreeSpace,
}

impl View {
    /// A view that knows nothing but `free_space`.
    pub fn new(rig: StereoRig, noise: NoiseModel, free_space: FreeSpace) -> Self {
        Self {
            focal_px: rig.focal_px as f32,
            centre_px: (rig.cx_px as f32, rig.cy_px as f32),
            focal_baseline: rig.focal_baseline_px_m() as f32,
            rig,
            noise,
            keys: Vec::new(),
            free_space,
        }
    }

    /// Forgets all keyframes.
    pub fn clear(&mut self) {
        self.keys.clear();
    }

    /// Adds a keyframe: its camera and its three planes. Returns false, and adds nothing, when the image is not
    /// of the rig's size.
    pub fn push(&mut self, world_from_camera: Pose<World, Camera>, image: StoredImage) -> bool {
        let fits = image.len() == 3 * self.rig.pixels();
        if fits {
            let rotation = world_from_camera.inverse().rotation.to_matrix().map(|row| row.map(|cell| cell as f32));
            self.keys.push(KeyView { rotation, origin: world_from_camera.origin(), image });
        }
        fits
    }

    /// Half of the camera's horizontal field of view, rad.
    pub fn half_view_rad(&self) -> f64 {
        let half_px = self.rig.cx_px.min(f64::from(self.rig.width_px) - 1.0 - self.rig.cx_px);
        (half_px / self.rig.focal_px).atan()
    }

    /// Number of keyframes.
    pub fn keyframes(&self) -> usize {
        self.keys.len()
    }

    /// The free-space evidence.
    pub fn free_space(&self) -> &FreeSpace {
        &self.free_space
    }

    /// The free-space evidence, to be brought up to date.
    pub fn free_space_mut(&mut self) -> &mut FreeSpace {
        &mut self.free_space
    }

    /// What is known about a point: occupied from a score of `threshold` (γ) on.
    pub fn occupancy(&self, point: Point<World>, threshold: f32) -> Occupancy {
        let score = self.score(point);
        if score.sum >= threshold {
            Occupancy::Occupied
        } else if score.vouched || self.free_space.is_swept(point) || self.free_space.is_home(point) {
            Occupancy::Free
        } else {
            Occupancy::Unknown(score.unknown)
        }
    }

    /// The sum of the keyframes' votes on a point (Table 3.1).
    pub fn score(&self, point: Point<World>) -> Score {
        let mut score = Score { sum: 0.0, vouched: false, unknown: Unknown::OutOfView };
        let (mut occupied, mut safe, mut background) = (Votes::default(), Votes::default(), Votes::default());
        for key in &self.keys {
            match self.vote(key, point) {
                Vote::OutOfView => {}
                Vote::NoReturn => score.unknown = score.unknown.max(Unknown::NoReturn),
                Vote::Occluded(weight) => {
                    safe.support(weight);
                    score.unknown = Unknown::Occluded;
                }
                Vote::Occupied(weight) => occupied.cast(weight),
                Vote::Free(weight) => {
                    safe.cast(weight);
                    score.vouched = true;
                }
                Vote::FarBackground(weight) => {
                    score.unknown = score.unknown.max(Unknown::NoReturn);
                    background.cast(weight);
                }
            }
        }
        if background.sum > 0.0 && self.background_has_parallax(point) {
            score.vouched = true;
            safe.sum += background.sum;
            safe.strongest = safe.strongest.max(background.strongest);
        }
        score.sum = occupied.as_occupied() - safe.as_safe();
        score
    }

    /// Whether any two views of far background at a point lie a parallax apart.
    fn background_has_parallax(&self, point: Point<World>) -> bool {
        let sees = |key: &&KeyView| matches!(self.vote(key, point), Vote::FarBackground(_));
        let least_m = self.free_space.rule().background_parallax_m;
        let mut views = self.keys.iter().filter(sees);
        while let Some(view) = views.next() {
            if views.clone().any(|other| other.origin.distance(view.origin) >= least_m) {
                return true;
            }
        }
        false
    }

    fn vote(&self, key: &KeyView, point: Point<World>) -> Vote {
        let offset = point - key.origin;
        let offset = [offset.x as f32, offset.y as f32, offset.z as f32];
        let [x, y, z] = key.rotation.map(|row| row[0] * offset[0] + row[1] * offset[1] + row[2] * offset[2]);
        if z < 0.05 {
            return Vote::OutOfView;
        }
        let column = self.centre_px.0 + self.focal_px * x / z + 0.5;
        let row = self.centre_px.1 + self.focal_px * y / z + 0.5;
        // Written so that NaN is out of view.
        let inside =
            column >= 0.0 && row >= 0.0 && column < self.rig.width_px as f32 && row < self.rig.height_px as f32;
        if !inside {
            return Vote::OutOfView;
        }
        let pixels = self.rig.pixels();
        let index = row as usize * self.rig.width_px as usize + column as usize;
        let (front, back, near) = (key.image[index], key.image[pixels + index], key.image[2 * pixels + index]);
        if front == UNKNOWN_FRONT {
            return Vote::NoReturn;
        }
        let inverse_depth_px = self.focal_baseline / z;
        let d = (inverse_depth_px - self.rig.doffs_px as f32) * SCALE;
        let weight = self.noise.vote(inverse_depth_px, self.focal_baseline);
        if d > f32::from(front) {
            match (d > f32::from(near), back == NEVER_OCCUPIED) {
                (true, _) => Vote::NoReturn,
                (false, true) => Vote::FarBackground(weight),
                (false, false) => Vote::Free(weight),
            }
        } else if back != NEVER_OCCUPIED && d > f32::from(back) {
            Vote::Occupied(weight)
        } else {
            Vote::Occluded(weight)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::FreeSpaceRule;
    use ipc_types::{Rotation, Vector};

    const RIG: StereoRig = StereoRig {
        width_px: 32,
        height_px: 24,
        focal_px: 20.0,
        cx_px: 15.5,
        cy_px: 11.5,
        baseline_m: 0.5,
        doffs_px: 0.0,
    };
    const NOISE: NoiseModel =
        NoiseModel { sigma_px: 0.1, sigma_m: 0.0, lambda_near: 3.0, lambda_far: 1.0, near_px: 8.0, far_px: 3.0 };
    const RULE: FreeSpaceRule =
        FreeSpaceRule { home_radius_m: 1.0, home_height_m: 2.0, swept_radius_m: 0.5, background_parallax_m: 0.5 };
    const GAMMA: f32 = 0.9;

    fn view() -> View {
        View::new(RIG, NOISE, FreeSpace::new(RULE, Point::new(-50.0, 0.0, 0.0)))
    }

    /// Looks along the world's x axis from `x_m`; the same front, back and near limit (m) at every pixel.
    fn wall(view: &mut View, x_m: f64, front_m: f64, back_m: f64) {
        let value = |depth_m: f64| (RIG.disparity_px(depth_m) * f64::from(SCALE)) as u16;
        let planes = [value(front_m), value(back_m), value(0.3)];
        image(view, x_m, planes);
    }

    fn image(view: &mut View, x_m: f64, planes: [u16; 3]) {
        let camera = Rotation::<World, ipc_types::Body>::IDENTITY * Rotation::camera_mount(0.0);
        let pose = Pose { rotation: camera, translation: Vector::new(x_m, 0.0, 0.0) };
        let pixels = planes.iter().flat_map(|&value| vec![value; RIG.pixels()]).collect::<Vec<_>>();
        assert!(view.push(pose, pixels.into()));
    }

    fn at(view: &View, x_m: f64) -> Occupancy {
        view.occupancy(Point::new(x_m, 0.0, 0.0), GAMMA)
    }

    #[test]
    fn free_before_occupied_inside_unknown_behind_and_beside() {
        let mut view = view();
        assert_eq!(at(&view, 3.0), Occupancy::Unknown(Unknown::OutOfView));
        wall(&mut view, 0.0, 4.0, 6.0);
        assert_eq!(at(&view, 3.0), Occupancy::Free);
        assert_eq!(at(&view, 5.0), Occupancy::Occupied);
        assert_eq!(at(&view, 7.0), Occupancy::Unknown(Unknown::Occluded));
        assert_eq!(at(&view, -3.0), Occupancy::Unknown(Unknown::OutOfView));
        assert_eq!(at(&view, 0.2), Occupancy::Unknown(Unknown::NoReturn), "nearer than the near limit");
    }

    #[test]
    fn unmatched_is_unknown() {
        let mut view = view();
        image(&mut view, 0.0, [UNKNOWN_FRONT, UNKNOWN_FRONT, 0]);
        assert_eq!(at(&view, 3.0), Occupancy::Unknown(Unknown::NoReturn));
    }

    #[test]
    fn far_background_needs_two_views_with_parallax() {
        let far = (RIG.disparity_px(10.0) * f64::from(SCALE)) as u16;
        let sky = [far, NEVER_OCCUPIED, u16::MAX];
        let mut view = view();
        image(&mut view, 0.0, sky);
        image(&mut view, 0.1, sky);
        assert_eq!(at(&view, 3.0), Occupancy::Unknown(Unknown::NoReturn));
        image(&mut view, -0.4, sky);
        assert_eq!(at(&view, 3.0), Occupancy::Free, "0.1 and -0.4, whatever the first is");
        assert_ne!(at(&view, 12.0), Occupancy::Free);
    }

    #[test]
    fn the_order_of_keyframes_does_not_matter() {
        let walls = [(0.0, 4.0, 6.0), (1.0, 9.0, 12.0), (-2.0, 5.5, 8.0), (0.5, 3.0, 20.0)];
        let answers = |order: [usize; 4]| {
            let mut view = view();
            order.iter().for_each(|&i| wall(&mut view, walls[i].0, walls[i].1, walls[i].2));
            (1..80).map(|i| at(&view, f64::from(i) * 0.2)).collect::<Vec<_>>()
        };
        let reference = answers([0, 1, 2, 3]);
        for order in [[3, 2, 1, 0], [1, 3, 0, 2], [2, 0, 3, 1]] {
            assert_eq!(answers(order), reference);
        }
    }

    #[test]
    fn near_free_views_outvote_a_far_phantom() {
        let mut view = view();
        wall(&mut view, -8.0, 9.0, 12.0);
        assert_eq!(at(&view, 2.0), Occupancy::Occupied);
        wall(&mut view, 0.0, 15.0, 20.0);
        assert_eq!(at(&view, 2.0), Occupancy::Free);
    }

    #[test]
    fn a_row_of_far_views_is_cleared_by_two_from_less_than_half_of_the_distance() {
        let mut view = view();
        (0..6).for_each(|i| wall(&mut view, -8.0 - 0.3 * f64::from(i), 9.0, 12.0));
        wall(&mut view, -2.5, 15.0, 20.0);
        wall(&mut view, -2.4, 15.0, 20.0);
        assert_eq!(at(&view, 2.0), Occupancy::Free);
    }

    #[test]
    fn a_row_of_views_is_not_cleared_by_one_from_a_third_or_two_from_more_than_half_of_the_distance() {
        let mut view = view();
        (0..6).for_each(|i| wall(&mut view, -8.0 - 0.3 * f64::from(i), 9.0, 12.0));
        wall(&mut view, -1.4, 15.0, 20.0);
        assert_eq!(at(&view, 2.0), Occupancy::Occupied);
        view.clear();
        (0..6).for_each(|i| wall(&mut view, -8.0 - 0.3 * f64::from(i), 9.0, 12.0));
        wall(&mut view, -4.0, 15.0, 20.0);
        wall(&mut view, -3.9, 15.0, 20.0);
        assert_eq!(at(&view, 2.0), Occupancy::Occupied);
    }

    #[test]
    fn ten_views_too_far_to_resolve_a_branch_do_not_outvote_one_that_is_near() {
        let mut view = view();
        // From 2 m away something is seen; from 4.5 m to 8 m away all looks free up to 20 m.
        wall(&mut view, 0.0, 1.8, 2.6);
        (0..10).for_each(|i| wall(&mut view, -2.5 - 0.35 * f64::from(i), 20.0, 25.0));
        assert_eq!(at(&view, 2.0), Occupancy::Occupied);
    }

    #[test]
    fn views_from_which_a_point_is_hidden_do_not_clear_it() {
        let mut view = view();
        wall(&mut view, -8.0, 9.0, 12.0);
        (0..8).for_each(|i| wall(&mut view, -1.0 - 0.1 * f64::from(i), 1.0, 1.5));
        assert_eq!(at(&view, 2.0), Occupancy::Occupied);
    }

    #[test]
    fn evidence_of_free_space() {
        let mut view = view();
        view.free_space_mut().set_path([Point::new(3.0, 0.0, 0.0)]);
        assert_eq!(at(&view, 3.4), Occupancy::Free);
        assert_ne!(at(&view, 3.6), Occupancy::Free);
        assert_eq!(at(&view, -50.5), Occupancy::Free, "home");
        wall(&mut view, 0.0, 2.0, 6.0);
        assert_eq!(at(&view, 3.4), Occupancy::Occupied, "an image says otherwise");
    }

    #[test]
    fn hostile_points_and_images_are_unknown() {
        let mut view = view();
        assert!(!view.push(Pose::IDENTITY, vec![0; 5].into()));
        wall(&mut view, 0.0, 4.0, 6.0);
        for value in [f64::NAN, f64::INFINITY, 1e300, -1e300] {
            assert!(matches!(at(&view, value), Occupancy::Unknown(_)), "{value}");
        }
    }
}
