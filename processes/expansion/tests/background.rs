//! The far-background rule: sky above a far slope is worth something; a blank wall is worth no more than the ground before
//! its foot.

mod common;

use common::Scene;
use expansion::{BackgroundRule, Config};
use ipc_types::disparity::{TEXTURELESS, encode};
use ipc_types::messages::{Layers, Seen};
use ipc_types::noise::NoiseModel;
use ipc_types::{Point, StereoRig};

const RIG: StereoRig =
    StereoRig { width_px: 96, height_px: 72, focal_px: 60.0, cx_px: 47.5, cy_px: 35.5, baseline_m: 0.3, doffs_px: 0.0 };

#[test]
fn clear_sky_grants_a_limited_range_and_a_blank_wall_none_beyond_it() {
    for layers in [Layers::Two, Layers::Four] {
        let image = |horizon: usize, below: f32| -> Vec<u16> {
            (0..RIG.pixels()).map(|i| if i / 96 < horizon { TEXTURELESS } else { encode(below) }).collect()
        };
        let ahead = |image: &[u16], depth_m: f64| {
            let config = Config {
                layers,
                body_radius_m: 0.3,
                body_half_height_m: 0.15,
                hole_px: 4,
                patch_px: 0,
                background: BackgroundRule { limit_m: 12.0, share: 0.7, textureless_share: 0.8 },
                ..Config::for_sphere(0.5)
            };
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
