//! Cost of a rendered stereo pair of a forest of 1,000+ trees on one core, against casting the same rays through
//! parry3d's bounding-volume hierarchy, which is what a well-kept crate offers.

use criterion::{Criterion, criterion_group, criterion_main};
use ipc_types::{Pose, Rotation, StereoRig, Vector};
use parry3d::math::{Pose as Isometry, Vector as Vec3};
use parry3d::partitioning::{Bvh, BvhBuildStrategy};
use parry3d::query::{Ray, RayCast};
use parry3d::shape::{Capsule, Shape as _};
use simulator::{CameraConfig, Forest, Shape, StereoCamera, World, WorldConfig};
use std::hint::black_box;
use std::sync::Arc;

const RIG: StereoRig = StereoRig {
    width_px: 320,
    height_px: 240,
    focal_px: 200.0,
    cx_px: 159.5,
    cy_px: 119.5,
    baseline_m: 0.3,
    doffs_px: 0.0,
};

fn forest() -> World {
    let forest = Forest {
        trees_per_m2: 0.05,
        trunk_radius_m: (0.1, 0.25),
        height_m: (6.0, 14.0),
        lean_deg: 6.0,
        blank_share: 0.1,
        branches: (0, 4),
        branch_radius_m: (0.03, 0.06),
        branch_length_m: (0.5, 1.5),
        branch_height_m: 1.8,
        canopy_balls: (1, 4),
        canopy_radius_m: (0.8, 1.8),
        bushes_per_m2: 0.01,
        bush_radius_m: (0.25, 0.6),
        clearing_m: 3.0,
    };
    let config = WorldConfig {
        least_m: [-25.0, -80.0],
        most_m: [105.0, 80.0],
        ground_amplitude_m: 0.25,
        ground_wavelength_m: 14.0,
        forest,
        walls: Vec::new(),
    };
    World::grow(&config, 7, &[])
}

fn bench(criterion: &mut Criterion) {
    let world = Arc::new(forest());
    assert!(world.trees() > 1000, "{} trees", world.trees());
    let pose = Pose { rotation: Rotation::IDENTITY, translation: Vector::new(0.0, 0.0, 2.0) }
        * Pose { rotation: Rotation::camera_mount(0.0), translation: Vector::ZERO };
    let config =
        CameraConfig { rate_hz: 12.5, latency_ms: 0.0, noise: 2.0, blur: 0.1, right_gain: 1.02, right_roll_deg: 0.0 };
    let mut camera = StereoCamera::new(Arc::clone(&world), RIG, config, 1);
    let mut pixels = vec![0; 2 * RIG.pixels()];
    criterion.bench_function("pair 320x240, 1000+ trees, ours", |bencher| {
        bencher.iter(|| camera.expose(black_box(pose), black_box(&mut pixels)));
    });
    let solids: Vec<Capsule> = world
        .obstacles()
        .iter()
        .filter_map(|obstacle| match obstacle.shape {
            Shape::Capsule { from, to, radius_m } => {
                let vector = |p: [f64; 3]| Vec3::new(p[0] as f32, p[1] as f32, p[2] as f32);
                Some(Capsule::new(vector(from.to_array()), vector(to.to_array()), radius_m as f32))
            }
            Shape::Cuboid { .. } => None,
        })
        .collect();
    let boxes: Vec<_> = solids.iter().map(|solid| solid.compute_aabb(&Isometry::IDENTITY)).collect();
    let tree = Bvh::from_leaves(BvhBuildStrategy::Ploc, &boxes);
    criterion.bench_function("rays of a pair 320x240, 1000+ trees, parry3d Bvh, no ground, no shading", |bencher| {
        bencher.iter(|| {
            let mut hits = 0;
            for eye in 0..2 {
                for index in 0..RIG.pixels() {
                    let x = ((index % 320) as f32 - 159.5) / 200.0;
                    let y = ((index / 320) as f32 - 119.5) / 200.0;
                    let ray = Ray::new(Vec3::new(0.0, -0.3 * eye as f32, 2.0), Vec3::new(1.0, -x, -y));
                    let hit = tree.cast_ray(&ray, 90.0, |leaf, best| {
                        solids[leaf as usize].cast_ray(&Isometry::IDENTITY, &ray, best, true)
                    });
                    hits += u32::from(hit.is_some());
                }
            }
            black_box(hits)
        });
    });
}

criterion_group!(benches, bench);
criterion_main!(benches);
