//! What the map answers: free, occupied, or unknown and why, from views that agree, contradict each other, and age.

use ipc_types::disparity::SCALE;
use ipc_types::messages::{ExpandedLayout, Layers, NEVER_OCCUPIED, UNKNOWN_FRONT};
use ipc_types::noise::NoiseModel;
use ipc_types::{FlightTime, Point, Pose, Rotation, StereoRig, Vector, World};
use memory::{FreeSpace, FreeSpaceRule, Inference, MapModel, Occupancy, Unknown, View};

const RIG: StereoRig =
    StereoRig { width_px: 32, height_px: 24, focal_px: 20.0, cx_px: 15.5, cy_px: 11.5, baseline_m: 0.5, doffs_px: 0.0 };
const NOISE: NoiseModel =
    NoiseModel { sigma_px: 0.1, sigma_m: 0.0, lambda_near: 3.0, lambda_far: 1.0, near_px: 8.0, far_px: 3.0 };
const RULE: FreeSpaceRule =
    FreeSpaceRule { home_radius_m: 1.0, home_height_m: 2.0, swept_radius_m: 0.5, background_parallax_m: 0.5 };
const GAMMA: f32 = 0.9;

fn view() -> View {
    View::new(model(Layers::Two), FreeSpace::new(RULE, Point::new(-50.0, 0.0, 0.0)))
}

fn model(layers: Layers) -> MapModel {
    let layout = ExpandedLayout::new(&RIG, 0, layers);
    MapModel { rig: RIG, noise: NOISE, layout, radius_m: 0.5, inference: Inference::Confidence, forget_s: 1.0 }
}

fn value(depth_m: f64) -> u16 {
    (RIG.disparity_px(depth_m) * f64::from(SCALE)) as u16
}

/// Looks along the world's x axis from `x_m`, a hundredth of a second after the last; the same front, back and near limit
/// (m) at every pixel.
fn wall(view: &mut View, x_m: f64, front_m: f64, back_m: f64) {
    wall_at(view, view.keyframes() as f64 * 0.01, x_m, front_m, back_m);
}

fn wall_at(view: &mut View, exposure_s: f64, x_m: f64, front_m: f64, back_m: f64) {
    image(view, exposure_s, x_m, [value(0.3), value(front_m), value(back_m), 0]);
}

fn image(view: &mut View, exposure_s: f64, x_m: f64, cell: [u16; 4]) {
    let camera = Rotation::<World, ipc_types::Body>::IDENTITY * Rotation::camera_mount(0.0);
    let pose = Pose { rotation: camera, translation: Vector::new(x_m, 0.0, 0.0) };
    let cells = cell.repeat(RIG.pixels());
    assert!(view.push(pose, FlightTime::from_secs_f64(exposure_s), cells.into()));
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
    image(&mut view, 0.0, 0.0, [0, UNKNOWN_FRONT, UNKNOWN_FRONT, 0]);
    assert_eq!(at(&view, 3.0), Occupancy::Unknown(Unknown::NoReturn));
}

#[test]
fn far_background_needs_two_views_with_parallax() {
    let sky = [u16::MAX, value(10.0), NEVER_OCCUPIED, 0];
    let mut view = view();
    image(&mut view, 0.0, 0.0, sky);
    image(&mut view, 0.1, 0.1, sky);
    assert_eq!(at(&view, 3.0), Occupancy::Unknown(Unknown::NoReturn));
    image(&mut view, 0.2, -0.4, sky);
    assert_eq!(at(&view, 3.0), Occupancy::Free, "0.1 and -0.4, whatever the first is");
    assert_ne!(at(&view, 12.0), Occupancy::Free);
}

#[test]
fn the_order_of_keyframes_does_not_matter() {
    let walls = [(0.0, 4.0, 6.0), (1.0, 9.0, 12.0), (-2.0, 5.5, 8.0), (0.5, 3.0, 20.0)];
    let answers = |order: [usize; 4]| {
        let mut view = view();
        order.iter().for_each(|&i| wall_at(&mut view, i as f64, walls[i].0, walls[i].1, walls[i].2));
        (1..80).map(|i| view.score(Point::new(f64::from(i) * 0.2, 0.1, 0.0))).collect::<Vec<_>>()
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
    view.free_space_mut().set_path([Point::new(3.0, 0.0, 0.0)], |_| true);
    assert_eq!(at(&view, 3.4), Occupancy::Free);
    assert_ne!(at(&view, 3.6), Occupancy::Free);
    assert_eq!(at(&view, -50.5), Occupancy::Free, "home");
    wall(&mut view, 0.0, 2.0, 6.0);
    assert_eq!(at(&view, 3.4), Occupancy::Occupied, "an image says otherwise");
}

/// Without an image the vehicle may leave where images have shown free by the swept radius, and no farther however often.
#[test]
fn what_was_flown_through_unseen_vouches_for_hardly_more_than_itself() {
    let mut view = view();
    let way = |to: u32| (0..=to).map(|i| Point::new(0.5 + 0.25 * f64::from(i), 0.0, 0.0)).collect::<Vec<_>>();
    wall(&mut view, 0.0, 2.0, 6.0);
    view.set_path(way(4));
    // The image is forgotten, what it said of the way is not; then the vehicle goes on into what nothing shows.
    view.clear();
    view.set_path(way(4));
    assert_eq!(at(&view, 1.9), Occupancy::Free);
    assert!(matches!(at(&view, 2.01), Occupancy::Unknown(_)));
    for to in 7..20 {
        view.set_path(way(to));
        // The way itself stays open.
        let last_m = 0.5 + 0.25 * f64::from(to);
        assert_eq!((at(&view, 2.1), at(&view, last_m + 0.19)), (Occupancy::Free, Occupancy::Free), "{to}");
        assert!(matches!(at(&view, last_m + 0.21), Occupancy::Unknown(_)), "{to}");
    }
    // The oldest places are gone.
    view.set_path(way(20)[3..].to_vec());
    assert_eq!((at(&view, 0.5), at(&view, 1.9)), (Occupancy::Unknown(Unknown::OutOfView), Occupancy::Free));
    // Another path.
    view.set_path([Point::new(1.5, 0.0, 0.0)]);
    assert!(matches!(at(&view, 1.71), Occupancy::Unknown(_)));
    // At home, just inside the rim: being there shows nothing of what is beyond.
    view.set_path([Point::new(-49.01, 0.0, 0.0)]);
    assert_eq!((at(&view, -49.05), at(&view, -48.85)), (Occupancy::Free, Occupancy::Free));
    assert!(matches!(at(&view, -48.75), Occupancy::Unknown(_)));
}

#[test]
fn hostile_points_and_images_are_unknown() {
    let mut view = view();
    let now = FlightTime::from_nanos(0);
    assert!(!view.push(Pose::IDENTITY, now, vec![0; 5].into()));
    let nowhere = Pose { translation: Vector::new(f64::NAN, 0.0, 0.0), ..Pose::IDENTITY };
    assert!(!view.push(nowhere, now, vec![0; 4 * RIG.pixels()].into()));
    wall(&mut view, 0.0, 4.0, 6.0);
    for value in [f64::NAN, f64::INFINITY, 1e300, -1e300] {
        assert!(matches!(at(&view, value), Occupancy::Unknown(_)), "{value}");
    }
}

/// A phantom that ten views saw is gone once it has been looked at again for as long as `forget_s`, by three views.
#[test]
fn what_is_seen_free_again_for_long_enough_is_forgotten_and_nothing_else_is() {
    let phantom =
        |view: &mut View| (0..10).for_each(|i| wall_at(view, f64::from(i) * 0.1, 0.02 * f64::from(i), 4.0, 6.0));
    let looks = |looks: &[(f64, f64, f64)]| {
        let mut view = view();
        phantom(&mut view);
        looks
            .iter()
            .for_each(|&(exposure_s, x_m, front_m)| wall_at(&mut view, exposure_s, x_m, front_m, front_m + 3.0));
        at(&view, 5.0)
    };
    let clear_m = 12.0;
    assert_eq!(looks(&[]), Occupancy::Occupied);
    assert_eq!(looks(&[(1.0, 0.2, clear_m), (1.5, 0.2, clear_m)]), Occupancy::Occupied, "two views");
    assert_eq!(looks(&[(1.0, 0.2, clear_m), (1.1, 0.2, clear_m), (1.9, 0.2, clear_m)]), Occupancy::Occupied, "0.9 s");
    assert_eq!(looks(&[(1.0, 0.2, clear_m), (1.5, 0.2, clear_m), (2.0, 0.2, clear_m)]), Occupancy::Free);
    assert_eq!(
        looks(&[(1.0, -4.0, clear_m), (1.5, -4.0, clear_m), (2.0, -4.0, clear_m)]),
        Occupancy::Occupied,
        "from nearly twice the distance nothing is forgotten"
    );
    // A real one is missed now and then.
    assert_eq!(
        looks(&[(1.0, 0.2, clear_m), (1.5, 0.2, 4.0), (2.0, 0.2, clear_m), (2.5, 0.2, clear_m)]),
        Occupancy::Occupied
    );
}

#[test]
fn what_has_come_since_overrules_that_it_was_free() {
    let mut view = view();
    (0..5).for_each(|i| wall_at(&mut view, f64::from(i), 1.0, 12.0, 15.0));
    assert_eq!(at(&view, 5.0), Occupancy::Free);
    wall_at(&mut view, 4.3, -2.0, 6.0, 9.0);
    assert_eq!(at(&view, 5.0), Occupancy::Occupied, "the newest view sees it");
    wall_at(&mut view, 6.0, -2.0, 6.0, 9.0);
    assert_eq!(at(&view, 5.0), Occupancy::Occupied);
    wall_at(&mut view, 6.1, -2.0, 12.0, 15.0);
    assert_eq!(at(&view, 5.0), Occupancy::Occupied, "two views outweigh what is older");
}

/// Behind a branch there is free space again, if the image holds the next group.
#[test]
fn the_space_between_two_groups_is_free_with_four_layers() {
    let mut view = View::new(model(Layers::Four), FreeSpace::new(RULE, Point::new(-50.0, 0.0, 0.0)));
    let camera = Rotation::<World, ipc_types::Body>::IDENTITY * Rotation::camera_mount(0.0);
    let pose = Pose { rotation: camera, translation: Vector::ZERO };
    let mut elements = [value(0.3), value(2.0), value(3.0), value(4.0)].repeat(RIG.pixels());
    elements.extend([value(8.0), value(10.0)].repeat(RIG.pixels()));
    assert!(view.push(pose, FlightTime::from_nanos(0), elements.into()));
    let expected = [
        (1.0, Occupancy::Free),
        (2.5, Occupancy::Occupied),
        (3.5, Occupancy::Unknown(Unknown::Occluded)),
        (6.0, Occupancy::Free),
        (9.0, Occupancy::Occupied),
        (11.0, Occupancy::Unknown(Unknown::Occluded)),
    ];
    for (x_m, occupancy) in expected {
        assert_eq!(at(&view, x_m), occupancy, "{x_m}");
    }
}
