//! Invariant 1 against a brute-force sphere oracle: nothing within the radius of a measured surface is ever free.

use expansion::{BackgroundRule, Config, Expander, Reach};
use ipc_types::disparity::{NO_MATCH, SCALE, TEXTURELESS, decode, encode};
use ipc_types::messages::{ExpandedPlanes, NEVER_OCCUPIED, UNKNOWN_FRONT};
use ipc_types::noise::NoiseModel;
use ipc_types::{Camera, Point, StereoRig};
use rand::{RngExt, SeedableRng};

const RIG: StereoRig =
    StereoRig { width_px: 96, height_px: 72, focal_px: 60.0, cx_px: 47.5, cy_px: 35.5, baseline_m: 0.3, doffs_px: 0.0 };
const REACH: Reach = Reach::Matched { most_px: 1000.0 };
const NOISE: NoiseModel =
    NoiseModel { sigma_px: 0.3, sigma_m: 0.0, lambda_near: 3.0, lambda_far: 1.0, near_px: 6.0, far_px: 1.5 };
const BACKGROUND: BackgroundRule = BackgroundRule { limit_m: 12.0, share: 0.7, textureless_share: 0.8 };

fn config(radius_m: f32, hole_px: u32) -> Config {
    Config { radius_m, body_radius_m: 0.3_f32.min(radius_m), body_half_height_m: 0.15, hole_px, background: BACKGROUND }
}

#[derive(Debug, PartialEq)]
enum Answer {
    Free,
    Occupied,
    Unknown,
}

fn ask(planes: &ExpandedPlanes, point: Point<Camera>) -> Option<Answer> {
    let (u, v, d) = RIG.project(point)?;
    let (column, row) = (u.round(), v.round());
    let inside = (0.0..f64::from(RIG.width_px)).contains(&column) && (0.0..f64::from(RIG.height_px)).contains(&row);
    if !inside {
        return None;
    }
    let index = row as usize * RIG.width_px as usize + column as usize;
    let d = d * f64::from(SCALE);
    let (front, back, near) = (planes.front[index], planes.back[index], planes.near_limit[index]);
    Some(if front == UNKNOWN_FRONT || d > f64::from(near) && d > f64::from(front) {
        Answer::Unknown
    } else if d > f64::from(front) {
        Answer::Free
    } else if back != NEVER_OCCUPIED && d > f64::from(back) {
        Answer::Occupied
    } else {
        Answer::Unknown
    })
}

/// Trunks, a slope, and a few blobs, at random depths; some pixels unmatched.
fn random_scene(seed: u64, unmatched: f64) -> Vec<u16> {
    let mut random = rand_pcg::Pcg64Mcg::seed_from_u64(seed);
    let (width, height) = (RIG.width_px as usize, RIG.height_px as usize);
    let mut image = vec![0.0_f32; width * height];
    for (index, pixel) in image.iter_mut().enumerate() {
        *pixel = 1.0 + 5.0 * (index / width) as f32 / height as f32;
    }
    for _ in 0..6 {
        let (left, top) = (random.random_range(0..width), random.random_range(0..height));
        let (right, bottom) = (left + random.random_range(1..12), top + random.random_range(1..60));
        let disparity = random.random_range(1.5..20.0);
        for row in top..bottom.min(height) {
            for column in left..right.min(width) {
                image[row * width + column] = disparity;
            }
        }
    }
    let code = |random: &mut rand_pcg::Pcg64Mcg| random.random_bool(unmatched);
    image.iter().map(|&d| if code(&mut random) { NO_MATCH } else { encode(d) }).collect()
}

#[test]
fn no_point_near_a_measured_surface_is_free() {
    // The last ones with an error of depth, as of a time-of-flight camera.
    for (seed, radius_m, unmatched, sigma_m) in [
        (1, 0.4_f32, 0.0, 0.0),
        (2, 0.7, 0.05, 0.0),
        (3, 1.5, 0.2, 0.0),
        (4, 0.7, 0.0, 0.0),
        (5, 0.3, 0.1, 0.0),
        (6, 0.7, 0.1, 0.02),
        (7, 0.4, 0.0, 0.1),
    ] {
        let noise = NoiseModel { sigma_m, ..NOISE };
        let image = random_scene(seed, unmatched);
        let mut planes = vec![0; 3 * image.len()];
        Expander::new(RIG, &noise, REACH, config(radius_m, 4)).step(&image, &mut planes).expect("sizes agree");
        let planes = ExpandedPlanes::split(&planes, image.len()).expect("three planes");
        let mut random = rand_pcg::Pcg64Mcg::seed_from_u64(seed + 100);
        let mut checked = 0;
        while checked < 60_000 {
            let index = random.random_range(0..image.len());
            let Some(d) = decode(image[index]) else { continue };
            let (near, far) = noise.ends_px(d, RIG.focal_baseline_px_m() as f32);
            let within = f64::from(far + (near.min(1000.0) - far) * random.random_range(0.0_f32..=1.0));
            let (u, v) = ((index % 96) as f64, (index / 96) as f64);
            let surface = RIG.back_project(
                u + random.random_range(-0.5..0.5),
                v + random.random_range(-0.5..0.5),
                within.max(0.05),
            );
            // Most of the trials go to the sphere's skin, where a miss would be.
            let reach = f64::from(radius_m) * random.random_range(0.0_f64..0.999).powf(0.15);
            let direction = [0, 1, 2].map(|_| random.random_range(-1.0_f64..1.0));
            let norm = direction.iter().map(|c| c * c).sum::<f64>().sqrt();
            if !(0.1..=1.0).contains(&norm) {
                continue;
            }
            let offset = ipc_types::Vector::from_array(direction.map(|c| c / norm * reach));
            let answer = ask(&planes, surface + offset);
            assert_ne!(answer, Some(Answer::Free), "seed {seed}: {:?} is {reach} m from {surface:?}", surface + offset);
            checked += 1;
        }
    }
}

#[test]
fn around_a_free_point_the_whole_body_was_measured() {
    for (seed, holes) in [(11, 0), (12, 3), (13, 14), (14, 60)] {
        let mut random = rand_pcg::Pcg64Mcg::seed_from_u64(seed);
        // Far and level: no hole is explained by a shadow.
        let mut image = vec![encode(1.0); RIG.pixels()];
        (0..holes).for_each(|_| image[random.random_range(0..RIG.pixels())] = NO_MATCH);
        let config = config(0.4, 0);
        let mut planes = vec![0; 3 * image.len()];
        Expander::new(RIG, &NOISE, REACH, config).step(&image, &mut planes).expect("sizes agree");
        let planes = ExpandedPlanes::split(&planes, image.len()).expect("three planes");
        let mut free = 0;
        for _ in 0..400_000 {
            let depth_m: f64 = random.random_range(0.5..12.0);
            let [u, v] = [RIG.width_px, RIG.height_px].map(|size| random.random_range(0.0..f64::from(size - 1)));
            let point = RIG.back_project(u, v, RIG.disparity_px(depth_m));
            if ask(&planes, point) != Some(Answer::Free) {
                continue;
            }
            free += 1;
            // A cylinder about the vertical: camera x and z across, y down.
            let (turn, out) = (random.random_range(0.0..std::f64::consts::TAU), f64::from(config.body_radius_m));
            let up = f64::from(config.body_half_height_m) * random.random_range(-1.0..=1.0);
            let offset = ipc_types::Vector::from_array([out * turn.cos(), up, out * turn.sin()]);
            let (u, v, _) = RIG.project(point + offset).expect("in front of the camera");
            let (column, row) = (u.round(), v.round());
            let inside = (0.0..96.0).contains(&column) && (0.0..72.0).contains(&row);
            assert!(inside, "seed {seed}: {point:?} is free, {offset:?} off it is out of the image");
            let pixel = image[row as usize * 96 + column as usize];
            assert_ne!(pixel, NO_MATCH, "seed {seed}: {point:?} is free, {offset:?} off it was not measured");
        }
        assert!(free > 1000, "seed {seed}: {free}");
    }
}

#[test]
fn a_gap_of_two_radii_and_two_pixels_between_poles_stays_open() {
    let (depth_m, radius_m) = (6.0, 0.5_f32);
    let noise = NoiseModel { sigma_px: 0.01, sigma_m: 0.0, lambda_near: 0.0, lambda_far: 0.0, ..NOISE };
    let (near, far) = (encode(RIG.disparity_px(depth_m) as f32), encode(RIG.disparity_px(40.0) as f32));
    let half_gap = (f64::from(radius_m) * RIG.focal_px / depth_m + 1.0).ceil() as usize + 1;
    let (width, height) = (RIG.width_px as usize, RIG.height_px as usize);
    let is_pole = |column: usize| column.abs_diff(width / 2) >= half_gap && column.abs_diff(width / 2) < half_gap + 4;
    let image: Vec<u16> = (0..width * height).map(|i| if is_pole(i % width) { near } else { far }).collect();
    let mut planes = vec![0; 3 * image.len()];
    Expander::new(RIG, &noise, REACH, config(radius_m, 0)).step(&image, &mut planes).expect("sizes agree");
    let planes = ExpandedPlanes::split(&planes, image.len()).expect("three planes");
    let through = Point::new(0.5 * depth_m / RIG.focal_px, 0.0, depth_m);
    assert_eq!(ask(&planes, through), Some(Answer::Free));
    let at_pole = Point::new((half_gap as f64 + 1.0) * depth_m / RIG.focal_px, 0.0, depth_m);
    assert_eq!(ask(&planes, at_pole), Some(Answer::Occupied));
}

#[test]
fn unknown_exceeds_the_unmatched_share_only_by_a_rim_of_one_pixel() {
    let image = random_scene(7, 0.0);
    let mut planes = vec![0; 3 * image.len()];
    let expansion = Expander::new(RIG, &NOISE, REACH, config(0.5, 0)).step(&image, &mut planes).expect("sizes agree");
    let rim = 2.0 * (96.0 + 70.0) / (96.0 * 72.0);
    assert!((expansion.unknown_share - rim).abs() < 0.001, "{}", expansion.unknown_share);
    let mut holed = image.clone();
    holed.iter_mut().take(96 * 20).for_each(|pixel| *pixel = NO_MATCH);
    let expansion = Expander::new(RIG, &NOISE, REACH, config(0.5, 0)).step(&holed, &mut planes).expect("sizes agree");
    let rim = 2.0 * (96.0 + 50.0) / (96.0 * 72.0);
    assert!((expansion.unknown_share - 20.0 / 72.0 - rim).abs() < 0.001, "{}", expansion.unknown_share);
}

/// Sky above a far slope is worth something; a blank wall is worth no more than the ground before its foot.
#[test]
fn clear_sky_grants_a_limited_range_and_a_blank_wall_none_beyond_it() {
    let (width, height) = (RIG.width_px as usize, RIG.height_px as usize);
    let scene = |horizon: usize, below: f32| -> Vec<u16> {
        let pixel = |i: usize| if i / width < horizon { TEXTURELESS } else { encode(below) };
        (0..width * height).map(pixel).collect()
    };
    let ahead = |image: &[u16], depth_m: f64| {
        let mut planes = vec![0; 3 * image.len()];
        Expander::new(RIG, &NOISE, REACH, config(0.5, 0)).step(image, &mut planes).expect("sizes agree");
        let planes = ExpandedPlanes::split(&planes, image.len()).expect("three planes");
        ask(&planes, Point::new(0.0, -0.1 * depth_m, depth_m)).expect("in view")
    };
    let open = scene(36, 0.5);
    assert_eq!(ahead(&open, 6.0), Answer::Free);
    assert_eq!(ahead(&open, 20.0), Answer::Unknown);
    let foot_m = 5.0;
    let wall = scene(50, RIG.disparity_px(foot_m) as f32);
    for tenths in 30..100 {
        assert_ne!(ahead(&wall, f64::from(tenths) * 0.1), Answer::Free, "{tenths}");
    }
    let filling = vec![TEXTURELESS; width * height];
    assert_eq!(ahead(&filling, 2.0), Answer::Unknown);
}

#[test]
fn hostile_images_are_refused_or_answered_without_panic() {
    let mut expander = Expander::new(RIG, &NOISE, REACH, config(0.5, 4));
    let mut planes = vec![0; 3 * RIG.pixels()];
    assert!(expander.step(&[], &mut planes).is_err());
    assert!(expander.step(&vec![0; RIG.pixels()], &mut planes[1..]).is_err());
    for fill in [0, 1, 2, 15, 16, u16::MAX - 1, u16::MAX] {
        expander.step(&vec![fill; RIG.pixels()], &mut planes).expect("sizes agree");
    }
    let split = ExpandedPlanes::split(&planes, RIG.pixels()).expect("three planes");
    assert!(split.front.iter().all(|&front| front == UNKNOWN_FRONT - 1), "nearer than the radius saturates");
}
