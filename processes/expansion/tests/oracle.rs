//! Invariant 1 against a brute-force oracle: nothing within the inflation of a measured surface is ever free, and around
//! what is free the whole body was measured and seen. Random rigs, radii, noise and scenes.

mod common;

use common::{Scene, random_offset};
use expansion::Config;
use ipc_types::disparity::{NO_MATCH, SCALE, decode, encode};
use ipc_types::messages::{Layers, Seen};
use ipc_types::noise::NoiseModel;
use ipc_types::{Point, StereoRig, Vector};
use rand::RngExt;

#[test]
fn no_point_near_a_measured_surface_is_free() {
    let (mut asked, mut occupied, mut in_margin) = (0_u64, 0_u64, 0_u64);
    for seed in 0..60 {
        let (mut scene, mut random) = Scene::random(seed);
        let expanded = scene.expand();
        for _ in 0..20_000 {
            let index = random.random_range(0..scene.image.len());
            let Some(d) = decode(scene.image[index]) else { continue };
            let (near, far) = scene.interval_px(d);
            let within =
                f64::from(far.max(0.02) + (near.min(1000.0) - far.max(0.02)) * random.random_range(0.0_f32..=1.0));
            let width = scene.rig.width_px as usize;
            let (u, v) = ((index % width) as f64, (index / width) as f64);
            let aside = |random: &mut rand_pcg::Pcg64Mcg| random.random_range(-0.5..0.5);
            let surface = scene.rig.back_project(u + aside(&mut random), v + aside(&mut random), within);
            // Most of the trials go to the ellipsoid's skin, where a miss would be.
            let skin = random.random_range(0.0_f64..0.999).powf(0.15);
            let [x, y, z] = random_offset(&mut random).map(|c| c * skin);
            let (r, h) = (f64::from(scene.config.radius_m), f64::from(scene.config.half_height_m));
            let point = surface + Vector::from_array([r * x, h * y, r * z]);
            let Some((answer, is_margin)) = expanded.ask(point) else { continue };
            let is_free = matches!(answer, Seen::Free | Seen::FarBackground);
            assert!(!is_free, "seed {seed}: {point:?} is {answer:?}, near {surface:?}; {:?}", scene.config);
            asked += 1;
            occupied += u64::from(answer == Seen::Occupied);
            in_margin += u64::from(is_margin && answer == Seen::Occupied);
        }
    }
    println!("{asked} points within the inflation: {occupied} occupied, {in_margin} of them in the margin, none free");
    assert!(asked > 500_000 && occupied > 100_000 && in_margin > 10_000);
}

#[test]
fn around_a_free_point_the_whole_body_was_measured_and_seen() {
    let (mut free, mut behind) = (0, 0);
    for seed in 100..150 {
        let (mut scene, mut random) = Scene::random(seed);
        scene.config.hole_px = 0;
        let expanded = scene.expand();
        for _ in 0..20_000 {
            let depth_m: f64 = random.random_range(0.3_f64..1.0).powi(3) * 30.0;
            let [u, v] =
                [scene.rig.width_px, scene.rig.height_px].map(|size| random.random_range(0.0..f64::from(size - 1)));
            let point = scene.rig.back_project(u, v, scene.rig.disparity_px(depth_m));
            if expanded.ask(point).map(|(answer, _)| answer) != Some(Seen::Free) {
                continue;
            }
            free += 1;
            behind += u32::from(expanded.is_behind_the_first(point));
            for _ in 0..20 {
                // A cylinder about the vertical: camera x and z across, y down.
                let turn = random.random_range(0.0..std::f64::consts::TAU);
                let out = f64::from(scene.config.body_radius_m) * random.random_range(0.0_f64..=1.0).sqrt();
                let up = f64::from(scene.config.body_half_height_m) * random.random_range(-1.0..=1.0);
                let part = point + Vector::from_array([out * turn.cos(), up, out * turn.sin()]);
                let (u, v, d) = scene.rig.project(part).expect("in front of the camera");
                let Some(pixel) = scene.pixel(u, v) else { panic!("seed {seed}: {part:?} is out of the image") };
                let Some(measured) = decode(pixel) else { panic!("seed {seed}: {part:?} was not measured") };
                let near = f64::from(scene.interval_px(measured).0);
                assert!(d > near, "seed {seed}: {part:?} of {point:?} is hidden; {:?}", scene.config);
            }
        }
    }
    println!("{free} free points, {behind} of them behind something nearer");
    assert!(free > 20_000 && behind > 2000);
}

#[test]
fn what_is_occupied_lies_in_the_box_about_an_interval() {
    let mut asked = 0;
    for seed in 200..215 {
        let (mut scene, mut random) = Scene::random(seed);
        scene.config.hole_px = 0;
        let expanded = scene.expand();
        let layout = scene.config.layout(&scene.rig);
        for _ in 0..1500 {
            let [u, v] = [layout.width_px, layout.height_px].map(|size| f64::from(random.random_range(0..size)));
            let margin = f64::from(layout.margin_px);
            let depth_m: f64 = random.random_range(0.2_f64..1.0).powi(3) * 30.0;
            let point = scene.rig.back_project(u - margin, v - margin, scene.rig.disparity_px(depth_m));
            if expanded.ask(point).map(|(answer, _)| answer) == Some(Seen::Occupied) {
                // Blocks of two pixels and of one, and steps of a thousandth of a bin.
                assert!(scene.has_box_about(point, 2.5, 0.02), "seed {seed}: {point:?}; {:?}", scene.config);
                asked += 1;
            }
        }
    }
    assert!(asked > 2000, "{asked}");
}

#[test]
fn a_gap_of_two_radii_and_two_pixels_between_poles_stays_open() {
    let noise =
        NoiseModel { sigma_px: 0.01, sigma_m: 0.0, lambda_near: 0.0, lambda_far: 0.0, near_px: 6.0, far_px: 1.5 };
    let mut open = 0;
    for seed in 0..400 {
        let mut random = common::seeded(seed);
        let rig = StereoRig {
            width_px: 160,
            height_px: 48,
            focal_px: random.random_range(80.0..160.0),
            cx_px: 79.5,
            cy_px: 23.5,
            baseline_m: 0.3,
            doffs_px: 0.0,
        };
        let layers = if seed % 2 == 0 { Layers::Two } else { Layers::Four };
        // A disparity that a value can hold.
        let disparity_px = (rig.disparity_px(random.random_range(2.0..8.0)) * 32.0).round() / 32.0;
        let (depth_m, radius_m) = (rig.depth_m(disparity_px), random.random_range(0.2_f32..0.6));
        let left = random.random_range(8..100);
        let config = Config { layers, body_radius_m: 0.1, body_half_height_m: 0.1, ..Config::for_sphere(radius_m) };
        // Where the left pole ends and the right one begins: tangents to both, half a pixel for each surface.
        let slope = |column: f64| (column - rig.cx_px) / rig.focal_px;
        let q = f64::from(radius_m) / depth_m;
        let tangent = |x: f64, sign: f64| (x + sign * q * (1.0 + x * x - q * q).sqrt()) / (1.0 - q * q);
        let last_of_left = rig.cx_px + rig.focal_px * tangent(slope(f64::from(left) + 0.5), 1.0);
        let Some(right) = (left + 1..150).find(|&right| {
            rig.cx_px + rig.focal_px * tangent(slope(f64::from(right) - 0.5), -1.0) - last_of_left > 2.01
        }) else {
            continue;
        };
        let (near, far) = (encode(rig.disparity_px(depth_m) as f32), encode(rig.disparity_px(40.0) as f32));
        let is_pole = |column: i32| (left - 3..=left).contains(&column) || (right..right + 4).contains(&column);
        let image = (0..160 * 48).map(|i| if is_pole(i % 160) { near } else { far }).collect();
        let mut scene = Scene { rig, noise, config, image };
        let expanded = scene.expand();
        let middle = (last_of_left + rig.cx_px + rig.focal_px * tangent(slope(f64::from(right) - 0.5), -1.0)) / 2.0;
        let through = rig.back_project(middle, 23.5, rig.disparity_px(depth_m));
        assert_eq!(expanded.ask(through).expect("in view").0, Seen::Free, "seed {seed}: {left} to {right}, {config:?}");
        let beside = rig.back_project(f64::from(left) + 1.0, 23.5, rig.disparity_px(depth_m));
        assert_eq!(expanded.ask(beside).expect("in view").0, Seen::Occupied);
        open += 1;
    }
    assert!(open > 200, "{open}");
}

/// A branch before a far wall: with four layers the space between is neither lost nor invented.
#[test]
fn between_a_near_branch_and_a_far_wall_it_is_free_with_four_layers_alone() {
    for depth_m in [1.5, 2.0, 2.6, 3.1, 3.7, 4.4] {
        let (mut scene, _) = Scene::random(1);
        let (rig, wall_m) = (
            StereoRig {
                focal_px: 90.0,
                cx_px: 63.5,
                cy_px: 47.5,
                width_px: 128,
                height_px: 96,
                baseline_m: 0.3,
                doffs_px: 0.0,
            },
            15.0,
        );
        scene.rig = rig;
        scene.noise = NoiseModel { sigma_px: 0.1, ..scene.noise };
        scene.config = Config { body_radius_m: 0.2, body_half_height_m: 0.2, ..Config::for_sphere(0.5) };
        let at = |depth_m: f64| encode(rig.disparity_px(depth_m) as f32);
        scene.image = (0..rig.pixels()).map(|i| at(if i % 128 == 64 { depth_m } else { wall_m })).collect();
        for layers in [Layers::Two, Layers::Four] {
            scene.config.layers = layers;
            let expanded = scene.expand();
            // Beside the branch, but within its inflation; behind it.
            let column = 64.0 + rig.focal_px * 0.42 / depth_m;
            let answers: Vec<Seen> = (0..400)
                .map(|step| {
                    let z = 0.4 + f64::from(step) * 0.05;
                    expanded.ask(rig.back_project(column, 48.0, rig.disparity_px(z))).expect("in view").0
                })
                .collect();
            let free_m =
                answers.iter().skip_while(|&&seen| seen != Seen::Occupied).filter(|&&seen| seen == Seen::Free).count();
            let behind_branch = expanded.ask(rig.back_project(64.0, 48.0, rig.disparity_px(0.5 * (depth_m + wall_m))));
            assert_eq!(behind_branch.expect("in view").0, Seen::Occluded, "never straight behind it");
            match layers {
                Layers::Two => assert_eq!(free_m, 0),
                Layers::Four => {
                    let free_m = free_m as f64 * 0.05;
                    // Up to where the wall's inflation begins; from where no more than two bins can hold of the branch.
                    println!("branch at {depth_m} m: {free_m:.1} of {:.1} m free", wall_m - depth_m - 1.0);
                    assert!(free_m > 0.5 * (wall_m - depth_m - 1.0), "{depth_m}: {free_m}");
                    assert!(free_m < wall_m - depth_m - 0.9, "{depth_m}: {free_m}");
                }
            }
        }
    }
}

/// Two wires beside each other, the farther one in the nearer one's block of pixels: neither may be lost.
#[test]
fn a_wire_beside_a_nearer_one_is_not_lost_with_four_layers() {
    let mut behind = 0;
    for column in [180, 181] {
        for (near_m, far_m, wall_m, radius_m) in
            [(2.0, 6.0, 20.0, 0.65), (3.0, 8.0, 25.0, 0.65), (3.0, 10.0, 28.0, 1.0)]
        {
            let rig = StereoRig {
                width_px: 320,
                height_px: 40,
                focal_px: 200.0,
                cx_px: 159.5,
                cy_px: 19.5,
                baseline_m: 0.3,
                doffs_px: 0.0,
            };
            let (mut scene, mut random) = Scene::random(1);
            scene.noise = NoiseModel { sigma_px: 0.4, sigma_m: 0.0, ..scene.noise };
            scene.rig = rig;
            scene.config = Config {
                layers: Layers::Four,
                body_radius_m: 0.3,
                body_half_height_m: 0.1,
                ..Config::for_sphere(radius_m)
            };
            let at = |depth_m: f64| encode(rig.disparity_px(depth_m) as f32);
            let depth_m = |i: usize| match i as i32 % 320 - column {
                0 => near_m,
                1 => far_m,
                _ => wall_m,
            };
            scene.image = (0..rig.pixels()).map(|i| at(depth_m(i))).collect();
            let expanded = scene.expand();
            let wire = rig.back_project(f64::from(column + 1), 19.5, rig.disparity_px(far_m));
            for _ in 0..100_000 {
                let [x, y, z] = random_offset(&mut random).map(|c| c * 0.999 * f64::from(radius_m));
                let point = wire + Vector::from_array([x, y, z]);
                let Some((seen, _)) = expanded.ask(point) else { continue };
                assert_ne!(seen, Seen::Free, "wires at {near_m} and {far_m} m, column {column}: {point:?}");
                behind += u32::from(expanded.is_behind_the_first(point));
            }
        }
    }
    assert!(behind > 10_000, "{behind}");
}

#[test]
fn unknown_exceeds_the_unmatched_share_only_by_a_rim_of_one_pixel() {
    let (mut scene, _) = Scene::random(8);
    // As wide as high: distances in the image are then whole.
    scene.config.body_half_height_m = scene.config.body_radius_m;
    let rig = scene.rig;
    let (width, height) = (f64::from(rig.width_px), f64::from(rig.height_px));
    scene.image = vec![encode(3.0); rig.pixels()];
    let whole = scene.expand().unknown_share;
    let rim = 2.0 * (width + height - 2.0) / (width * height);
    assert!((f64::from(whole) - rim).abs() < 1e-3, "{whole}, rim {rim}");
    let holed = scene.image.iter_mut().take(rig.width_px as usize * 20);
    holed.for_each(|pixel| *pixel = NO_MATCH);
    let holed = f64::from(scene.expand().unknown_share);
    let rim = 2.0 * (width + height - 22.0) / (width * height);
    assert!((holed - 20.0 / height - rim).abs() < 1e-3, "{holed}, rim {rim}");
}

/// How far the front lies before that of exact ellipsoids. The figures depend on the scenes; the bound on the box does not.
#[test]
fn over_expansion_against_exact_ellipsoids_is_reported() {
    let (mut sum_m, mut count, mut quarter, mut half) = (0.0, 0_u32, 0_u32, 0_u32);
    for seed in 300..312 {
        let (mut scene, _) = Scene::random(seed);
        scene.config.hole_px = 0;
        let expanded = scene.expand();
        for row in (0..scene.rig.height_px).step_by(3) {
            for column in (0..scene.rig.width_px).step_by(3) {
                let Some(front_m) = expanded.front_m(column, row) else { continue };
                let exact_m = scene.exact_front_m(f64::from(column), f64::from(row));
                let nearest_m = scene.rig.depth_m(f64::from(u16::MAX - 1) / f64::from(SCALE));
                let exact_m = exact_m.max(nearest_m);
                assert!(front_m <= exact_m + 1e-3, "seed {seed}: {front_m} behind {exact_m} at {column}, {row}");
                let over_m = (exact_m - front_m).min(20.0);
                (sum_m, count) = (sum_m + over_m, count + 1);
                quarter += u32::from(over_m > 0.25);
                half += u32::from(over_m > 0.5);
            }
        }
    }
    let percent = |part: u32| 100.0 * f64::from(part) / f64::from(count);
    println!(
        "front before the exact one: mean {:.3} m; {:.1} % by more than 0.25 m, {:.1} % by more than 0.5 m, of {count} pixels",
        sum_m / f64::from(count),
        percent(quarter),
        percent(half)
    );
    assert!(count > 5000);
}

#[test]
fn results_do_not_depend_on_threads() {
    for seed in 400..408 {
        let (mut scene, _) = Scene::random(seed);
        let one = scene.expand().elements;
        for threads in [2, 3, 5] {
            scene.config.threads = threads;
            assert_eq!(scene.expand().elements, one, "seed {seed}, {threads} threads");
        }
    }
}

#[test]
fn hostile_images_are_refused_or_answered_without_panic() {
    let (mut scene, _) = Scene::random(3);
    scene.config.layers = Layers::Four;
    let mut expander = scene.expander();
    let mut elements = vec![0; expander.layout().elements()];
    assert!(expander.step(&[], &mut elements).is_err());
    assert!(expander.step(&vec![0; scene.rig.pixels()], &mut elements[1..]).is_err());
    for fill in [0, 1, 2, 15, 16, u16::MAX - 1, u16::MAX] {
        expander.step(&vec![fill; scene.rig.pixels()], &mut elements).expect("sizes agree");
    }
    scene.image = vec![u16::MAX; scene.rig.pixels()];
    let expanded = scene.expand();
    let centre = scene.rig.back_project(scene.rig.cx_px, scene.rig.cy_px, f64::from(u16::MAX) / f64::from(SCALE) * 0.5);
    assert_ne!(expanded.ask(centre).expect("in view").0, Seen::Free, "the largest disparity is an obstacle");
    let beyond = Point::new(0.0, 0.0, 1e9);
    assert_ne!(expanded.ask(beyond).expect("in view").0, Seen::Free);
}
