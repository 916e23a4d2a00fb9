//! True clearance and continuous collision of the whole hull, ground included, by parry3d.

use crate::ground::Ground;
use crate::world::{Shape, World};
use ipc_types::{Body, Pose, World as WorldFrame};
use parry3d::bounding_volume::{Aabb, BoundingVolume};
use parry3d::math::{Pose as Isometry, Rotation as Quaternion, Vector as Vec3};
use parry3d::partitioning::{Bvh, BvhBuildStrategy};
use parry3d::query::{self, ShapeCastOptions};
use parry3d::shape::{Capsule, Cuboid, Cylinder, HeightField, Shape as _, SharedShape};
use parry3d::utils::Array2;
use std::f32::consts::FRAC_PI_2;

/// Clearance is not measured beyond this, m.
const FARTHEST_M: f32 = 5.0;

/// Distances from the hull, m; at most 5 m are measured.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Clearance {
    /// To the nearest obstacle.
    pub obstacles_m: f64,
    /// To the ground.
    pub ground_m: f64,
}

/// The world's solids and the hull.
#[derive(Debug)]
pub struct Collider {
    hull: Cylinder,
    solids: Vec<(Isometry, SharedShapeDebug)>,
    tree: Bvh,
    ground: HeightField,
    ground_pose: Isometry,
}

/// A shape that prints as nothing: parry's does not implement `Debug`.
struct SharedShapeDebug(SharedShape);

impl std::fmt::Debug for SharedShapeDebug {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("shape")
    }
}

fn vector(p: [f64; 3]) -> Vec3 {
    Vec3::new(p[0] as f32, p[1] as f32, p[2] as f32)
}

/// parry's cylinders and height fields stand along y; ours along z.
fn upright() -> Quaternion {
    Quaternion::from_rotation_x(FRAC_PI_2)
}

impl Collider {
    /// For a hull of the given radius and height in a world.
    pub fn new(world: &World, hull_radius_m: f64, hull_height_m: f64) -> Self {
        let solids: Vec<_> = world.obstacles().iter().map(|obstacle| solid(&obstacle.shape)).collect();
        let boxes: Vec<Aabb> = solids.iter().map(|(pose, shape)| shape.0.compute_aabb(pose)).collect();
        let (ground, ground_pose) = height_field(&world.ground);
        Self {
            hull: Cylinder::new(hull_height_m as f32 / 2.0, hull_radius_m as f32),
            solids,
            tree: Bvh::from_leaves(BvhBuildStrategy::Binned, &boxes),
            ground,
            ground_pose,
        }
    }

    /// Clearance of the hull at a pose.
    pub fn clearance(&self, world_from_body: Pose<WorldFrame, Body>) -> Clearance {
        let pose = hull_pose(world_from_body);
        let around = self.hull.compute_aabb(&pose).loosened(FARTHEST_M);
        let mut nearest = FARTHEST_M;
        for leaf in self.tree.intersect_aabb(&around) {
            let (solid_pose, solid) = &self.solids[leaf as usize];
            if let Ok(found) = query::distance(&pose, &self.hull, solid_pose, &*solid.0) {
                nearest = nearest.min(found.distance);
            }
        }
        let contact = query::contact(&self.ground_pose, &self.ground, &pose, &self.hull, FARTHEST_M);
        let ground = contact.ok().flatten().map_or(FARTHEST_M, |contact| contact.dist);
        Clearance { obstacles_m: f64::from(nearest), ground_m: f64::from(ground) }
    }

    /// Whether the hull touches anything on the straight way between two poses, the ground only if `ground` is set.
    pub fn collides(&self, from: Pose<WorldFrame, Body>, to: Pose<WorldFrame, Body>, ground: bool) -> bool {
        let (start, end) = (hull_pose(from), hull_pose(to));
        let motion = vector((to.translation - from.translation).to_array());
        let swept = self.hull.compute_aabb(&start).merged(&self.hull.compute_aabb(&end));
        let options = ShapeCastOptions { max_time_of_impact: 1.0, ..ShapeCastOptions::default() };
        // The later orientation for the whole step: it turns by less than a degree in one.
        let begin = Isometry::from_parts(start.translation, end.rotation);
        let hits = |pose: &Isometry, shape: &dyn parry3d::shape::Shape| {
            let still = Vec3::ZERO;
            // An unsupported pair cannot occur; were it to, it counts as a hit.
            query::cast_shapes(&begin, motion, &self.hull, pose, still, shape, options)
                .map_or(true, |hit| hit.is_some())
        };
        let struck = self.tree.intersect_aabb(&swept).any(|leaf| {
            let (pose, solid) = &self.solids[leaf as usize];
            hits(pose, &*solid.0)
        });
        struck || (ground && hits(&self.ground_pose, &self.ground))
    }
}

fn hull_pose(world_from_body: Pose<WorldFrame, Body>) -> Isometry {
    let [w, x, y, z] = world_from_body.rotation.to_wxyz().map(|value| value as f32);
    let rotation = Quaternion::from_xyzw(x, y, z, w) * upright();
    Isometry::from_parts(vector(world_from_body.origin().to_array()), rotation)
}

fn solid(shape: &Shape) -> (Isometry, SharedShapeDebug) {
    let (pose, shape) = match *shape {
        Shape::Capsule { from, to, radius_m } => {
            let (from, to, radius) = (vector(from.to_array()), vector(to.to_array()), radius_m as f32);
            // A capsule without length is a ball.
            let shape = if from == to {
                SharedShape::ball(radius)
            } else {
                SharedShape::new(Capsule::new(Vec3::ZERO, to - from, radius))
            };
            (Isometry::from_parts(from, Quaternion::IDENTITY), shape)
        }
        Shape::Cuboid { centre, half_m, heading_rad } => {
            let rotation = Quaternion::from_rotation_z(heading_rad as f32);
            (Isometry::from_parts(vector(centre.to_array()), rotation), SharedShape::new(Cuboid::new(vector(half_m))))
        }
    };
    (pose, SharedShapeDebug(shape))
}

/// The ground as parry's height field: centred, heights along y, rows along z, which `upright` turns to south.
fn height_field(ground: &Ground) -> (HeightField, Isometry) {
    let (rows, columns) = (ground.rows, ground.columns);
    let heights = Array2::from_fn(rows, columns, |row, column| ground.heights[(rows - 1 - row) * columns + column]);
    let spacing = Ground::spacing();
    let size = ((columns - 1) as f32 * spacing, (rows - 1) as f32 * spacing);
    let centre = Vec3::new(ground.origin[0] + size.0 / 2.0, ground.origin[1] + size.1 / 2.0, 0.0);
    (HeightField::new(heights, Vec3::new(size.0, 1.0, size.1)), Isometry::from_parts(centre, upright()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::world::tests::config;
    use crate::world::{Forest, Wall, WorldConfig};
    use ipc_types::{Rotation, Vector};

    fn pose(x: f64, y: f64, z: f64) -> Pose<WorldFrame, Body> {
        Pose { rotation: Rotation::IDENTITY, translation: Vector::new(x, y, z) }
    }

    fn wall_world() -> World {
        let wall = Wall { centre_m: [10.0, 0.0], size_m: [40.0, 0.2, 6.0], heading_deg: 90.0, blank: false };
        let bare = Forest { trees_per_m2: 0.0, bushes_per_m2: 0.0, ..config().forest };
        World::grow(&WorldConfig { walls: vec![wall], forest: bare, ..config() }, 1, &[]).expect("no file")
    }

    #[test]
    fn clearance_to_a_wall_and_to_the_ground() {
        let world = wall_world();
        let collider = Collider::new(&world, 0.25, 0.2);
        for (x, y) in [(7.0, 0.0), (8.5, -3.0), (6.5, 11.0)] {
            let clearance = collider.clearance(pose(x, y, 2.0));
            assert!((clearance.obstacles_m - (10.0 - 0.1 - 0.25 - x)).abs() < 1e-3, "{clearance:?}");
            let expected = 2.0 - 0.1 - world.ground_height_m(x, y);
            assert!((clearance.ground_m - expected).abs() < 0.05, "{clearance:?}, expected {expected}");
        }
    }

    #[test]
    fn a_fast_step_through_a_thin_wall_is_caught() {
        let collider = Collider::new(&wall_world(), 0.25, 0.2);
        assert!(collider.collides(pose(5.0, 0.0, 2.0), pose(15.0, 0.0, 2.0), false));
        assert!(!collider.collides(pose(5.0, 0.0, 2.0), pose(9.5, 0.0, 2.0), false));
        assert!(collider.collides(pose(5.0, 0.0, 2.0), pose(5.0, 0.0, -1.0), true));
        assert!(!collider.collides(pose(5.0, 0.0, 2.0), pose(5.0, 0.0, 1.0), true));
    }

    #[test]
    fn a_forest_is_solid_where_it_is_drawn() {
        let world = World::grow(&config(), 4, &[]).expect("no file");
        let collider = Collider::new(&world, 0.25, 0.2);
        for obstacle in world.obstacles().iter().take(300) {
            if let Shape::Capsule { from, to, .. } = obstacle.shape {
                let middle = from.lerp(to, 0.5);
                assert_eq!(collider.clearance(pose(middle.x, middle.y, middle.z)).obstacles_m, 0.0);
            }
        }
    }
}
