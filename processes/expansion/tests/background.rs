//! The far-background rule: sky above a far slope is worth something; a blank wall is worth no more than the ground before
//! its foot.

mod common;

use common::Scene;
use expansion::{BackgroundRule, Config};
use ipc_types::disparity::{TEXTURELESS, encode};
use ipc_types::messages::{Layers, Seen};
use ipc_types::noise::NoiseModel;
use ipc_types::{Point, StereoRig};
use rand::RngExt;

const RIG: StereoRig =
    StereoRig { width_px: 96, height_px: 72, focal_px: 60.0, cx_px: 47.5, cy_px: 35.5, baseline_m: 0.3, doffs_px: 0.0 };

/// A vehicle with a radius of 0.5 m, to which sky is worth 0.7 of what stands below it.
fn sphere(layers: Layers) -> Config {
    Config {
        layers,
        body_radius_m: 0.3,
        body_half_height_m: 0.15,
        hole_px: 4,
        patch_px: 0,
        background: BackgroundRule { limit_m: 12.0, share: 0.7, textureless_share: 0.8 },
        ..Config::for_sphere(0.5)
    }
}

#[test]
fn clear_sky_grants_a_limited_range_and_a_blank_wall_none_beyond_it() {
    for layers in [Layers::Two, Layers::Four] {
        let image = |horizon: usize, below: f32| -> Vec<u16> {
            (0..RIG.pixels()).map(|i| if i / 96 < horizon { TEXTURELESS } else { encode(below) }).collect()
        };
        let ahead = |image: &[u16], depth_m: f64| {
            let config = sphere(layers);
            let noise = NoiseModel {
                sigma_px: 0.3,
                sigma_m: 0.0,
                lambda_near: 3.0,
                lambda_far: 1.0,
                near_px: 6.0,
                far_px: 1.5,
            };
            let mut scene = Scene { rig: RIG, noise, config, image: image.to_vec() };
            scene.expand().ask(Point::new(0.0, -0.1 * depth_m, depth_m)).expect("in view").0
        };
        let open = image(36, 0.5);
        assert_eq!(ahead(&open, 6.0), Seen::FarBackground);
        assert_eq!(ahead(&open, 20.0), Seen::Occluded);
        let wall = image(50, RIG.disparity_px(5.0) as f32);
        for tenths in 30..100 {
            let seen = ahead(&wall, f64::from(tenths) * 0.1);
            assert!(!matches!(seen, Seen::Free | Seen::FarBackground), "{tenths}: {seen:?}");
        }
        let filling = vec![TEXTURELESS; RIG.pixels()];
        assert_eq!(ahead(&filling, 2.0), Seen::Unmeasured);
    }
}

#[test]
fn the_sky_above_a_wall_does_not_hide_the_wall() {
    // 8 m away, its top three rows above the middle; the sky is worth 5.6 m.
    for layers in [Layers::Two, Layers::Four] {
        let wall = encode(RIG.disparity_px(8.0) as f32);
        let image = (0..RIG.pixels()).map(|i| if i / 96 < 33 { TEXTURELESS } else { wall }).collect();
        let config = sphere(layers);
        let noise =
            NoiseModel { sigma_px: 0.1, sigma_m: 0.0, lambda_near: 1.0, lambda_far: 1.0, near_px: 6.0, far_px: 1.5 };
        let mut scene = Scene { rig: RIG, noise, config, image };
        let expanded = scene.expand();
        let seen = |depth_m: f64, row: f64| {
            expanded.ask(Point::new(0.0, (row - RIG.cy_px) / RIG.focal_px * depth_m, depth_m)).expect("in view").0
        };
        for row in [33.6, 36.0, 50.0] {
            assert_eq!(seen(8.0, row), Seen::Occupied, "{layers:?} {row}");
            assert_eq!(seen(6.5, row), Seen::Free, "{layers:?} {row}");
        }
        assert_eq!(seen(5.0, 20.0), Seen::FarBackground);
        assert_eq!(seen(6.5, 20.0), Seen::Occluded);
    }
}

/// What a camera `height_m` above flat ground, pitched down by `pitch_rad`, sees of a blank pole that stands `depth_m` away.
fn before_a_pole(height_m: f64, pitch_rad: f64, depth_m: f64, half_width_m: f64) -> Vec<u16> {
    let (sin, cos) = pitch_rad.sin_cos();
    let pixel = |index: usize| {
        let x = ((index % 96) as f64 - RIG.cx_px) / RIG.focal_px;
        let y = ((index / 96) as f64 - RIG.cy_px) / RIG.focal_px;
        let (down, ahead) = (cos * y + sin, cos - sin * y);
        let pole = depth_m / ahead;
        if (x * pole).abs() <= half_width_m && down * pole <= height_m || down <= 0.0 {
            TEXTURELESS
        } else {
            encode(RIG.disparity_px(height_m / down) as f32)
        }
    };
    (0..RIG.pixels()).map(pixel).collect()
}

#[test]
fn nothing_near_a_blank_pole_on_the_ground_is_free() {
    let mut random = common::seeded(11);
    let mut asked = 0;
    for scene in 0..60 {
        let (height_m, pitch_rad) = (random.random_range(0.8..3.0), random.random_range(-0.1..0.5_f64));
        let (depth_m, half_width_m) = (random.random_range(2.0..7.0), random.random_range(0.1..0.3));
        let radius_m = random.random_range(0.3..0.9_f32);
        let config = Config {
            layers: if scene % 2 == 0 { Layers::Two } else { Layers::Four },
            half_height_m: radius_m * random.random_range(0.4..1.4),
            body_radius_m: 0.2,
            body_half_height_m: 0.1,
            background: BackgroundRule { limit_m: 18.0, share: 0.7, textureless_share: 0.8 },
            ..Config::for_sphere(radius_m)
        };
        let (radius_m, half_height_m) = (f64::from(radius_m), f64::from(config.half_height_m));
        let noise =
            NoiseModel { sigma_px: 0.05, sigma_m: 0.0, lambda_near: 1.0, lambda_far: 1.0, near_px: 6.0, far_px: 1.5 };
        let (sin, cos) = pitch_rad.sin_cos();
        let foot = (cos * height_m - sin * depth_m) / (sin * height_m + cos * depth_m);
        // Without its foot in view a pole is kept off by the body alone.
        if RIG.cy_px + RIG.focal_px * foot > 56.0 {
            continue;
        }
        let image = before_a_pole(height_m, pitch_rad, depth_m, half_width_m);
        let expanded = Scene { rig: RIG, noise, config, image }.expand();
        for _ in 0..4000 {
            // Down of the camera, level, and within the ellipsoid of a point of the pole.
            let offset = common::random_offset(&mut random).map(|part| 0.97 * part * random.random_range(0.0..1.0));
            let down = height_m - random.random_range(0.0..3.0) + offset[1] * half_height_m;
            let ahead = depth_m + offset[2] * radius_m;
            let x = random.random_range(-half_width_m..half_width_m) + offset[0] * radius_m;
            let point = Point::new(x, cos * down - sin * ahead, sin * down + cos * ahead);
            let Some((seen, _)) = expanded.ask(point) else { continue };
            asked += 1;
            let is_free = matches!(seen, Seen::Free | Seen::FarBackground);
            assert!(
                !is_free,
                "{scene}: {seen:?}, {down} below a camera at {height_m}, pitch {pitch_rad}, {ahead} of {depth_m}, {radius_m} {half_height_m}"
            );
        }
    }
    assert!(asked > 50_000, "{asked}");
}
