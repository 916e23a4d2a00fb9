//! Cost of a rendered stereo pair of a forest of 1,000+ trees on one core, against what well-kept crates offer: the same
//! rays cast through parry3d's bounding-volume hierarchy, and the same capsules as triangles through euc's software
//! rasteriser. Both only find what each pixel sees: no ground, no texture, no sensor.

use criterion::{Criterion, criterion_group, criterion_main};
use euc::buffer::Buffer2d;
use euc::rasterizer::{BackfaceCullingDisabled, Triangles};
use euc::{Pipeline, Target as _};
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
        octomap: None,
    };
    World::grow(&config, 7, &[]).expect("no file")
}

/// Corners of the triangles of all capsules: 12 sides, 6 rings, within the renderer's range.
fn tessellate(solids: &[Capsule]) -> Vec<[f32; 3]> {
    let near = solids.iter().filter(|solid| solid.segment.a.x > 0.0 && solid.segment.a.x < 90.0);
    near.flat_map(|solid| {
        let (corners, faces) = solid.to_trimesh(12, 6);
        faces.into_iter().flatten().map(move |corner| corners[corner as usize].to_array()).collect::<Vec<_>>()
    })
    .collect()
}

/// A pinhole at a height of 2 m that looks along the world's x axis.
struct Eye {
    y_m: f32,
}

impl Pipeline for Eye {
    type Vertex = [f32; 3];
    type VsOut = f32;
    type Pixel = u32;

    fn vert(&self, &[x, y, z]: &[f32; 3]) -> ([f32; 4], f32) {
        let (right, up) = (self.y_m - y, z - 2.0);
        ([right * 200.0 / 160.0, up * 200.0 / 120.0, x * (x - 0.1) / 90.0, x], x)
    }

    fn frag(&self, depth: &f32) -> u32 {
        depth.to_bits()
    }
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
    let triangles = tessellate(&solids);
    criterion.bench_function("pair 320x240, 1000+ trees, euc, no ground, no shading", |bencher| {
        let mut seen = Buffer2d::new([320, 240], 0_u32);
        let mut depths = Buffer2d::new([320, 240], 1.0_f32);
        bencher.iter(|| {
            for eye in 0..2 {
                seen.clear(0);
                depths.clear(1.0);
                let eye = Eye { y_m: -0.3 * eye as f32 };
                eye.draw::<Triangles<'_, Buffer2d<f32>, BackfaceCullingDisabled>, _>(
                    black_box(&triangles),
                    &mut seen,
                    Some(&mut depths),
                );
            }
            black_box(&seen);
        });
    });
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
