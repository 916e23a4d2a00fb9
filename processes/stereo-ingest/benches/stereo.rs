//! Cost of one match and of one look at whether the pair is sound, on a synthetic pair, single thread.

use criterion::{Criterion, criterion_group, criterion_main};
use ipc_types::StereoRig;
use rand::{RngExt, SeedableRng};
use std::hint::black_box;
use stereo_ingest::{Config, Matcher, PairCheck};

fn bench(criterion: &mut Criterion) {
    let mut random = rand_pcg::Pcg64Mcg::seed_from_u64(1);
    for (width, height) in [(320_usize, 240_usize), (640, 480)] {
        let left: Vec<u8> = (0..width * height).map(|_| random.random()).collect();
        let right: Vec<u8> = (0..width * height).map(|i| left[(i + 9).min(width * height - 1)]).collect();
        let rig = StereoRig {
            width_px: width as u32,
            height_px: height as u32,
            focal_px: 200.0,
            cx_px: 100.0,
            cy_px: 100.0,
            baseline_m: 0.3,
            doffs_px: 0.0,
        };
        let config = Config::dense(64);
        let mut matcher = Matcher::new(&rig, config);
        let mut disparity = vec![0; width * height];
        criterion.bench_function(&format!("stereo {width}x{height}x64"), |bencher| {
            bencher.iter(|| matcher.step(black_box(&left), black_box(&right), black_box(&mut disparity)));
        });
        let mut check = PairCheck::new(&rig, 64);
        criterion.bench_function(&format!("pair check {width}x{height}x64"), |bencher| {
            bencher.iter(|| check.step(black_box(&left), black_box(&right)));
        });
    }
}

criterion_group!(benches, bench);
criterion_main!(benches);
