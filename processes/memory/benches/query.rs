//! Cost of asking the map: one point, batches, and the voxel grid of thesis section 5.2, over 10 keyframes.
//!
//! Where the points of a batch lie decides how much of its time is waiting for memory: ten keyframes of 640 × 480 are 25 MB.

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use expansion::{Config, Expander, Reach};
use ipc_types::disparity::encode;
use ipc_types::messages::Layers;
use ipc_types::noise::NoiseModel;
use ipc_types::{Body, FlightTime, Point, Pose, Rotation, StereoRig, Vector, World};
use memory::{FreeSpace, FreeSpaceRule, Inference, MapModel, Occupancy, Points, Scratch, View};
use rand::{RngExt, SeedableRng};
use std::hint::black_box;

fn map(width_px: u32, layers: Layers, inference: Inference) -> View {
    let height_px = width_px * 3 / 4;
    let rig = StereoRig {
        width_px,
        height_px,
        focal_px: 514.17 * f64::from(width_px) / 640.0,
        cx_px: f64::from(width_px - 1) / 2.0,
        cy_px: f64::from(height_px - 1) / 2.0,
        baseline_m: 0.35,
        doffs_px: 0.0,
    };
    let noise =
        NoiseModel { sigma_px: 0.5, sigma_m: 0.0, lambda_near: 3.0, lambda_far: 1.0, near_px: 10.0, far_px: 4.0 };
    let config = Config { layers, body_radius_m: 0.3, body_half_height_m: 0.3, ..Config::for_sphere(0.5) };
    let mut expander = Expander::new(rig, &noise, Reach::Matched { most_px: 128.0 }, config);
    let rule =
        FreeSpaceRule { home_radius_m: 0.0, home_height_m: 0.0, swept_radius_m: 0.0, background_parallax_m: 0.5 };
    let layout = expander.layout();
    let model = MapModel { rig, noise, layout, radius_m: 0.5, inference, forget_s: 1.0 };
    let mut view = View::new(model, FreeSpace::new(rule, Point::ZERO));
    for key in 0..10 {
        // Trunks before a slope, a little elsewhere in every view.
        let pixel = |index: usize| {
            let (row, column) = (index * 480 / rig.pixels(), index % width_px as usize * 640 / width_px as usize);
            let trunk = if (column + 17 * key) % 90 < 12 { 6.0 + ((column + 17 * key) / 90) as f32 * 6.0 } else { 0.0 };
            encode((2.0 + 20.0 * row as f32 / 480.0).max(trunk))
        };
        let image: Vec<u16> = (0..rig.pixels()).map(pixel).collect();
        let mut elements = vec![0; layout.elements()];
        expander.step(&image, &mut elements).expect("sizes agree");
        let pose = Pose {
            rotation: Rotation::<World, Body>::from_roll_pitch_yaw(0.0, 0.0, 0.03 * key as f64)
                * Rotation::camera_mount(0.0),
            translation: Vector::new(1.5 * key as f64, 0.0, 2.0),
        };
        assert!(view.push(pose, FlightTime::from_secs_f64(key as f64 * 0.3), elements.into()));
    }
    view
}

fn bench(criterion: &mut Criterion) {
    let mut random = rand_pcg::Pcg64Mcg::seed_from_u64(1);
    // Anywhere ahead, and along the vehicle's way: what planners ask.
    let anywhere: Vec<[f64; 3]> = (0..100_000)
        .map(|_| [random.random_range(10.0..60.0), random.random_range(-15.0..15.0), random.random_range(0.5..6.0)])
        .collect();
    let along: Vec<[f64; 3]> = (0..100_000)
        .map(|i| {
            let (candidate, step) = (i / 100, i % 100);
            let (turn, s) = ((candidate % 40) as f64 * 0.05 - 1.0, step as f64 * 0.15);
            [14.0 + s * turn.cos(), s * turn.sin(), 2.0 + (candidate / 40) as f64 * 0.02 * s]
        })
        .collect();
    let split =
        |points: &[[f64; 3]]| [0, 1, 2].map(|axis| points.iter().map(|point| point[axis]).collect::<Vec<f64>>());
    for (name, width_px, layers, inference) in [
        ("320x240 2 layers", 320, Layers::Two, Inference::Confidence),
        ("320x240 4 layers", 320, Layers::Four, Inference::Confidence),
        ("320x240 log-odds", 320, Layers::Two, Inference::LogOdds { prior: 0.1 }),
        ("640x480 2 layers", 640, Layers::Two, Inference::Confidence),
        ("640x480 4 layers", 640, Layers::Four, Inference::Confidence),
    ] {
        let (view, mut scratch) = (map(width_px, layers, inference), Scratch::default());
        let mut group = criterion.benchmark_group(name);
        for (where_, points) in [("anywhere", &anywhere), ("along candidates", &along)] {
            group.throughput(Throughput::Elements(points.len() as u64));
            group.bench_with_input(BenchmarkId::new("single", where_), points, |bencher, points| {
                bencher.iter(|| {
                    let asked = points.iter().map(|&point| view.occupancy(Point::from_array(point), 0.9));
                    asked.filter(|answer| black_box(*answer) == Occupancy::Free).count()
                });
            });
            let [x, y, z] = split(points);
            let mut answers = vec![Occupancy::Free; points.len()];
            group.bench_with_input(BenchmarkId::new("batched", where_), points, |bencher, _| {
                bencher.iter(|| {
                    let points = Points { x_m: &x, y_m: &y, z_m: &z };
                    view.occupancies(black_box(points), 0.9, &mut scratch, &mut answers).expect("one length");
                });
            });
        }
        // 100 × 100 × 20 m at 0.5 m: 200 × 200 × 40 voxels; and a million of them.
        let voxels: Vec<[f64; 3]> = (0..1_000_000)
            .map(|i: u32| [f64::from(i % 200), f64::from(i / 200 % 200), f64::from(i / 40_000)].map(|c| c * 0.5))
            .map(|[x, y, z]| [x - 20.0, y - 50.0, z])
            .collect();
        let [x, y, z] = split(&voxels);
        let mut answers = vec![Occupancy::Free; voxels.len()];
        group.throughput(Throughput::Elements(voxels.len() as u64)).sample_size(10);
        group.bench_function("voxel grid", |bencher| {
            bencher.iter(|| {
                let points = Points { x_m: &x, y_m: &y, z_m: &z };
                view.occupancies(black_box(points), 0.9, &mut scratch, &mut answers).expect("one length");
            });
        });
        group.finish();
    }
}

criterion_group! {
    name = benches;
    config = Criterion::default().sample_size(15).measurement_time(std::time::Duration::from_secs(1))
        .warm_up_time(std::time::Duration::from_millis(300));
    targets = bench
}
criterion_main!(benches);
