//! Cost of one expansion, single thread: two and four layers, on a forest, on noise (the worst case), on what is all near
//! and on what is all far. The window is as wide as the image where all is near: cost must hardly depend on it.

use criterion::{Criterion, criterion_group, criterion_main};
use expansion::{BackgroundRule, Config, Expander, Reach};
use ipc_types::StereoRig;
use ipc_types::disparity::{NO_MATCH, encode};
use ipc_types::messages::Layers;
use ipc_types::noise::NoiseModel;
use std::hint::black_box;

/// Spreads bits evenly: a hash of the pixel's number.
fn random(index: usize) -> u32 {
    let mixed = (index as u64 + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    ((mixed ^ mixed >> 29).wrapping_mul(0xbf58_476d_1ce4_e5b9) >> 40) as u32
}

/// Trunks before a slope.
fn forest(width: usize, height: usize, index: usize) -> u16 {
    let (row, column) = (index / width, index % width);
    let ground = 2.0 + 20.0 * row as f32 / height as f32;
    let trunk = if column % 61 < 9 { 4.0 + (column / 61) as f32 * 7.0 } else { 0.0 };
    encode(ground.max(trunk) + (random(index) % 64) as f32 / 128.0)
}

/// Every pixel at another range, one in five unmatched.
fn noise(_: usize, _: usize, index: usize) -> u16 {
    let value = random(index);
    if value.is_multiple_of(5) { NO_MATCH } else { encode(2.0 + (value % 6000) as f32 / 50.0) }
}

/// Pixel of an image of a width and height.
type Pixel = fn(usize, usize, usize) -> u16;

const SCENES: [(&str, Pixel); 4] = [
    ("forest", forest),
    ("noise", noise),
    ("near", |_, _, index| encode(100.0 + (random(index) % 64) as f32 / 64.0)),
    ("far", |_, _, index| encode(2.0 + (random(index) % 64) as f32 / 64.0)),
];

fn bench(criterion: &mut Criterion) {
    let model =
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
        for layers in [Layers::Two, Layers::Four] {
            for radius_m in [0.5, 1.5] {
                let config = Config {
                    layers,
                    body_radius_m: 0.3,
                    body_half_height_m: 0.2,
                    hole_px: 6,
                    patch_px: 0,
                    background: BackgroundRule { limit_m: 12.0, share: 0.7, textureless_share: 0.8 },
                    ..Config::for_sphere(radius_m)
                };
                let mut expander = Expander::new(rig, &model, Reach::Matched { most_px: 128.0 }, config);
                let mut elements = vec![0; expander.layout().elements()];
                for (scene, pixel) in SCENES {
                    let image: Vec<u16> =
                        (0..rig.pixels()).map(|index| pixel(width as usize, height as usize, index)).collect();
                    let name = format!("{width}x{height} {} layers r={radius_m} {scene}", layers.count());
                    criterion.bench_function(&name, |bencher| {
                        bencher.iter(|| expander.step(black_box(&image), black_box(&mut elements)));
                    });
                }
            }
        }
    }
}

criterion_group! {
    name = benches;
    config = Criterion::default().sample_size(20).measurement_time(std::time::Duration::from_secs(1))
        .warm_up_time(std::time::Duration::from_millis(300));
    targets = bench
}
criterion_main!(benches);
