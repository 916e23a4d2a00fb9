//! Cost of one expansion, front, back and near limit, single thread, on a synthetic scene of trunks before a slope.

use criterion::{Criterion, criterion_group, criterion_main};
use expansion::{BackgroundRule, Config, Expander, Reach};
use ipc_types::StereoRig;
use ipc_types::disparity::encode;
use ipc_types::noise::NoiseModel;
use std::hint::black_box;

fn scene(rig: &StereoRig) -> Vec<u16> {
    let (width, height) = (rig.width_px as usize, rig.height_px as usize);
    let pixel = |index: usize| {
        let (row, column) = (index / width, index % width);
        let ground = 2.0 + 20.0 * row as f32 / height as f32;
        let trunk = if column % 61 < 9 { 4.0 + (column / 61) as f32 * 7.0 } else { 0.0 };
        encode(ground.max(trunk))
    };
    (0..width * height).map(pixel).collect()
}

fn bench(criterion: &mut Criterion) {
    let noise =
        NoiseModel { sigma_px: 0.5, sigma_m: 0.0, lambda_near: 3.0, lambda_far: 1.0, near_px: 10.0, far_px: 4.0 };
    for (width, height) in [(320, 240), (640, 480)] {
        let rig = StereoRig {
            width_px: width,
            height_px: height,
            focal_px: f64::from(width) * 0.625,
            cx_px: f64::from(width) / 2.0,
            cy_px: f64::from(height) / 2.0,
            baseline_m: 0.3,
            doffs_px: 0.0,
        };
        for radius_m in [0.5, 1.5] {
            let background = BackgroundRule { limit_m: 12.0, share: 0.7, textureless_share: 0.8 };
            let config = Config { radius_m, body_radius_m: 0.3, body_half_height_m: 0.15, hole_px: 24, background };
            let mut expander = Expander::new(rig, &noise, Reach::Matched { most_px: 128.0 }, config);
            let image = scene(&rig);
            let mut planes = vec![0; 3 * image.len()];
            criterion.bench_function(&format!("expand {width}x{height} r={radius_m}"), |bencher| {
                bencher.iter(|| expander.step(black_box(&image), black_box(&mut planes)));
            });
        }
    }
}

criterion_group!(benches, bench);
criterion_main!(benches);
