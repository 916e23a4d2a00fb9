//! The ways to ask agree: batched with single to the bit, lines with the points on them.

use expansion::{Config, Expander, Reach};
use ipc_types::disparity::{NO_MATCH, TEXTURELESS, encode};
use ipc_types::messages::Layers;
use ipc_types::noise::NoiseModel;
use ipc_types::{Body, FlightTime, Point, Pose, Rotation, StereoRig, Vector, World};
use memory::{Demand, FINEST_M, FreeSpace, FreeSpaceRule, Inference, MapModel, Occupancy, Points, Scratch, View};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

const GAMMA: f32 = 0.9;

/// Some keyframes of random scenes from about one place.
fn random_view(seed: u64) -> (View, Pcg64Mcg) {
    let mut random = Pcg64Mcg::seed_from_u64(seed);
    let rig = StereoRig {
        width_px: 96,
        height_px: 72,
        focal_px: 60.0,
        cx_px: 47.5,
        cy_px: 35.5,
        baseline_m: 0.3,
        doffs_px: if seed.is_multiple_of(3) { 1.5 } else { 0.0 },
    };
    let noise =
        NoiseModel { sigma_px: 0.2, sigma_m: 0.0, lambda_near: 3.0, lambda_far: 1.0, near_px: 6.0, far_px: 1.5 };
    let layers = if seed.is_multiple_of(2) { Layers::Four } else { Layers::Two };
    let background = expansion::BackgroundRule { limit_m: 12.0, share: 0.7, textureless_share: 0.8 };
    let config = Config {
        layers,
        margin_px: 8,
        body_radius_m: 0.2,
        body_half_height_m: 0.15,
        hole_px: 2,
        patch_px: 0,
        background,
        ..Config::for_sphere(0.4)
    };
    let mut expander = Expander::new(rig, &noise, Reach::Matched { most_px: 60.0 }, config);
    let layout = expander.layout();
    let inference = if seed % 4 < 2 { Inference::Confidence } else { Inference::LogOdds { prior: 0.1 } };
    let rule =
        FreeSpaceRule { home_radius_m: 1.0, home_height_m: 2.0, swept_radius_m: 0.5, background_parallax_m: 0.3 };
    let model = MapModel { rig, noise, layout, radius_m: 0.4, inference, forget_s: 0.5 };
    let mut view = View::new(model, FreeSpace::new(rule, Point::new(-3.0, 0.0, 0.0)));
    for key in 0..random.random_range(1..62) {
        let horizon = random.random_range(5..25);
        let mut image: Vec<u16> = (0..rig.pixels())
            .map(|i| if i / 96 < horizon { TEXTURELESS } else { encode(0.8 + (i / 96) as f32 * 0.06) })
            .collect();
        for _ in 0..random.random_range(0..5) {
            let (left, top) = (random.random_range(0..90), random.random_range(0..60));
            let value = if random.random_bool(0.2) { NO_MATCH } else { encode(random.random_range(1.5..14.0)) };
            for row in top..(top + random.random_range(2..70)).min(72) {
                image[row * 96 + left..row * 96 + (left + random.random_range(1..9)).min(96)].fill(value);
            }
        }
        let mut elements = vec![0; layout.elements()];
        expander.step(&image, &mut elements).expect("sizes agree");
        let turn = |random: &mut Pcg64Mcg, most: f64| random.random_range(-most..most);
        let rotation = Rotation::<World, Body>::from_roll_pitch_yaw(
            turn(&mut random, 0.1),
            turn(&mut random, 0.1),
            turn(&mut random, 0.6),
        ) * Rotation::camera_mount(0.0);
        let translation = Vector::new(turn(&mut random, 1.5), turn(&mut random, 1.5), 1.0 + turn(&mut random, 0.5));
        let exposure = FlightTime::from_secs_f64(key as f64 * 0.1);
        assert!(view.push(Pose { rotation, translation }, exposure, elements.into()));
    }
    view.free_space_mut().set_path((0..40).map(|i| Point::new(-3.0 + 0.1 * f64::from(i), 0.0, 1.0)), |_| true);
    (view, random)
}

fn somewhere(random: &mut Pcg64Mcg) -> Point<World> {
    Point::new(random.random_range(-4.0..14.0), random.random_range(-7.0..7.0), random.random_range(-0.5..3.0))
}

#[test]
fn batches_answer_as_single_points_do() {
    let mut kinds = [0; 3];
    for seed in 0..40 {
        let (view, mut random) = random_view(seed);
        let mut points: Vec<Point<World>> = (0..1000).map(|_| somewhere(&mut random)).collect();
        points.extend([f64::NAN, f64::INFINITY, 1e300, -1e300].map(|x| Point::new(x, 0.0, 1.0)));
        let axis = |axis: usize| points.iter().map(|point| point.to_array()[axis]).collect::<Vec<f64>>();
        let (x, y, z) = (axis(0), axis(1), axis(2));
        for count in [0, 1, 31, 32, 33, points.len()] {
            let mut answers = vec![Occupancy::Occupied; count];
            let batch = Points { x_m: &x[..count], y_m: &y[..count], z_m: &z[..count] };
            view.occupancies(batch, GAMMA, &mut Scratch::default(), &mut answers).expect("one length");
            for (point, answer) in points.iter().zip(answers) {
                assert_eq!(answer, view.occupancy(*point, GAMMA), "seed {seed}: {point:?}");
                kinds[match answer {
                    Occupancy::Free => 0,
                    Occupancy::Occupied => 1,
                    Occupancy::Unknown(_) => 2,
                }] += 1;
            }
        }
        let batch = Points { x_m: &x[..3], y_m: &y[..2], z_m: &z[..3] };
        assert!(view.occupancies(batch, GAMMA, &mut Scratch::default(), &mut [Occupancy::Free; 3]).is_err());
    }
    println!("free, occupied, unknown: {kinds:?}");
    assert!(kinds.iter().all(|&count| count > 1000), "{kinds:?}");
}

#[test]
fn no_point_of_a_line_is_worse_than_the_line() {
    let (mut clear, mut hits) = (0, 0);
    for seed in 0..40 {
        let (view, mut random) = random_view(seed);
        for _ in 0..150 {
            let (from, to) = (somewhere(&mut random), somewhere(&mut random));
            let to = from.lerp(to, random.random_range(0.05..1.0));
            let length_m = from.distance(to);
            for demand in [Demand::Free, Demand::NotOccupied] {
                let hit = view.segment(from, to, GAMMA, demand);
                let until_m = hit.map_or(length_m, |hit| hit.distance_m);
                for _ in 0..200 {
                    let at_m = random.random_range(0.0..=1.0) * until_m;
                    let point = from.lerp(to, at_m / length_m);
                    let seen = view.occupancy(point, GAMMA);
                    let is_fine = match demand {
                        Demand::Free => seen == Occupancy::Free,
                        Demand::NotOccupied => seen != Occupancy::Occupied,
                    };
                    assert!(is_fine || at_m == until_m, "seed {seed}: {seen:?} at {at_m} of {until_m} m");
                }
                (clear, hits) = (clear + u32::from(until_m > 0.5), hits + u32::from(hit.is_some()));
            }
        }
    }
    println!("{clear} stretches of more than half a metre, {hits} hits");
    assert!(clear > 1500 && hits > 2000);
}

#[test]
fn a_line_is_hit_where_its_points_are() {
    let (mut agree, mut earlier) = (0, 0);
    for seed in 0..40 {
        let (view, mut random) = random_view(seed);
        for _ in 0..60 {
            let (from, to) = (somewhere(&mut random), somewhere(&mut random));
            let length_m = from.distance(to);
            let Some(hit) = view.segment(from, to, GAMMA, Demand::NotOccupied) else { continue };
            let step = (0..=4000).map(|step| f64::from(step) / 4000.0);
            let first = step.map(|share| (share, view.occupancy(from.lerp(to, share), GAMMA)));
            let first =
                first.filter(|(_, seen)| *seen == Occupancy::Occupied).map(|(share, _)| share * length_m).next();
            match first {
                Some(first_m) => {
                    assert!(hit.distance_m <= first_m + 1e-9);
                    agree += u32::from(first_m - hit.distance_m <= 2.0 * FINEST_M);
                    earlier += u32::from(first_m - hit.distance_m > 2.0 * FINEST_M);
                }
                None => earlier += 1,
            }
        }
    }
    println!("{agree} hits where the points are occupied, {earlier} before");
    assert!(agree > 20 * earlier, "{agree} {earlier}");
}

#[test]
fn rays_and_trajectories_stop_at_the_first_obstacle() {
    let mut found = 0;
    for seed in 0..40 {
        let (view, mut random) = random_view(seed);
        for _ in 0..40 {
            let from = somewhere(&mut random);
            let direction = Vector::new(random.random_range(-1.0..1.0), random.random_range(-1.0..1.0), 0.1);
            let ray = view.obstacle_m(from, direction, 9.0, GAMMA);
            let to = from + direction * (9.0 / direction.norm());
            let segment = view.segment(from, to, GAMMA, Demand::NotOccupied);
            assert_eq!(ray, segment.map(|hit| hit.distance_m));
            // The same way at 3 m/s, in three legs.
            let samples = (0..=3).map(|leg| (f64::from(leg), from.lerp(to, f64::from(leg) / 3.0)));
            let timed = view.trajectory(samples, GAMMA, Demand::NotOccupied);
            assert_eq!(timed.is_some(), ray.is_some());
            if let (Some(timed), Some(ray)) = (timed, ray) {
                found += 1;
                assert!((timed.time_s * 3.0 - ray).abs() < 2.0 * FINEST_M + 1e-6, "{} {ray}", timed.time_s * 3.0);
                assert!(timed.place.distance(from) <= ray + 2.0 * FINEST_M + 1e-6);
            }
        }
        let nowhere = Point::new(f64::NAN, 0.0, 0.0);
        assert!(view.segment(nowhere, Point::ZERO, GAMMA, Demand::Free).is_some());
        assert!(view.obstacle_m(Point::ZERO, Vector::new(1.0, 0.0, 0.0), f64::NAN, GAMMA).is_some());
        assert!(view.segment(Point::ZERO, Point::new(1e300, 1e300, 1e300), GAMMA, Demand::Free).is_some());
    }
    assert!(found > 200, "{found}");
}
