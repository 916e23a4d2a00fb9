//! The scene as one eye sees it, before the sensor.

use crate::ground::Ground;
use crate::noise3::Noise3;
use crate::raster::{EyeCapsule, EyeCuboid, Pinhole, draw_capsule, draw_cuboid, stride};
use crate::world::{Obstacle, Shape, World};
use ipc_types::{Camera, Point, Pose, Vector, World as WorldFrame};
use multiversion::multiversion;
use std::sync::Arc;

/// Grey level of the plain sky.
const SKY: f32 = 225.0;
/// Range of grey levels of the ground's texture.
const GROUND_CONTRAST: f32 = 90.0;
/// Nothing is rendered beyond this, m.
const FARTHEST_M: f32 = 90.0;
const NOTHING: u32 = u32::MAX;
const GROUND: u32 = u32::MAX - 1;

/// Renders a world for a pinhole.
#[derive(Debug)]
pub struct Renderer {
    world: Arc<World>,
    texture: Noise3,
    pinhole: Pinhole,
    depths: Vec<f32>,
    identities: Vec<u32>,
}

/// Rotation rows and origin of an eye, in single precision.
#[derive(Clone, Copy)]
struct Eye {
    /// Camera axes in world coordinates: right, down, forward.
    axes: [[f32; 3]; 3],
    origin: [f32; 3],
}

impl Eye {
    fn new(world_from_camera: Pose<WorldFrame, Camera>) -> Self {
        let m = world_from_camera.rotation.to_matrix();
        let column = |c: usize| [0, 1, 2].map(|row| m[row][c] as f32);
        let origin = world_from_camera.origin().to_array().map(|value| value as f32);
        Self { axes: [column(0), column(1), column(2)], origin }
    }

    /// A world point in camera coordinates.
    fn see(&self, point: Point<WorldFrame>) -> [f32; 3] {
        let p = point.to_array();
        let offset = [0, 1, 2].map(|axis| p[axis] as f32 - self.origin[axis]);
        self.axes.map(|axis| axis[0] * offset[0] + axis[1] * offset[1] + axis[2] * offset[2])
    }

    /// World direction of the ray through slopes x, y.
    #[inline(always)]
    fn ray(&self, x: f32, y: f32) -> [f32; 3] {
        let [right, down, forward] = self.axes;
        [0, 1, 2].map(|i| right[i] * x + down[i] * y + forward[i])
    }
}

impl Renderer {
    /// For a world and images of a size.
    pub fn new(world: Arc<World>, width: usize, height: usize, focal_px: f32, centre_px: (f32, f32)) -> Self {
        Self {
            world,
            texture: Noise3::new(0x7e47),
            pinhole: Pinhole { width, height, focal: focal_px, centre: centre_px },
            depths: vec![0.0; stride(width) * height],
            identities: vec![0; stride(width) * height],
        }
    }

    /// Grey levels, row-major, as seen from a pose.
    pub fn render(&mut self, world_from_camera: Pose<WorldFrame, Camera>, grey: &mut [f32]) {
        self.trace(world_from_camera);
        let eye = Eye::new(world_from_camera);
        let looks = Looks { texture: &self.texture, obstacles: self.world.obstacles() };
        let width = self.pinhole.width;
        let lines = self.depths.chunks_exact(stride(width)).zip(self.identities.chunks_exact(stride(width)));
        for (row, ((depths, identities), grey)) in lines.zip(grey.chunks_exact_mut(width)).enumerate() {
            shade(self.pinhole, &eye, row, looks, &depths[..width], &identities[..width], grey);
        }
    }

    /// What is seen from a pose, and how far it is, without its looks.
    pub fn trace(&mut self, world_from_camera: Pose<WorldFrame, Camera>) {
        let eye = Eye::new(world_from_camera);
        self.depths.fill(FARTHEST_M);
        self.identities.fill(NOTHING);
        let world = Arc::clone(&self.world);
        for (index, obstacle) in world.obstacles().iter().enumerate() {
            self.draw(&eye, obstacle, index as u32);
        }
        let width = self.pinhole.width;
        let lines = self.depths.chunks_exact_mut(stride(width)).zip(self.identities.chunks_exact_mut(stride(width)));
        for (row, (depths, identities)) in lines.enumerate() {
            draw_ground(self.pinhole, &eye, row, &world.ground, &mut depths[..width], &mut identities[..width]);
        }
    }

    /// Depth along the optical axis of every pixel of the last image, m; infinite where there is sky.
    pub fn depths(&self) -> impl Iterator<Item = f32> {
        self.seen().map(|(depth, identity)| if identity == NOTHING { f32::INFINITY } else { depth })
    }

    /// Depth and contrast (range of grey levels of the texture) of every pixel; infinite and none where there is sky.
    pub(crate) fn surfaces(&self) -> impl Iterator<Item = (f32, f32)> {
        let obstacles = self.world.obstacles();
        self.seen().map(|(depth, identity)| match identity {
            NOTHING => (f32::INFINITY, 0.0),
            GROUND => (depth, GROUND_CONTRAST),
            of => (depth, obstacles.get(of as usize).map_or(0.0, |obstacle| obstacle.contrast)),
        })
    }

    fn seen(&self) -> impl Iterator<Item = (f32, u32)> {
        let width = self.pinhole.width;
        let lines = self.depths.chunks_exact(stride(width)).zip(self.identities.chunks_exact(stride(width)));
        let pixels = lines.flat_map(move |(depths, identities)| depths[..width].iter().zip(&identities[..width]));
        pixels.map(|(&depth, &identity)| (depth, identity))
    }

    fn draw(&mut self, eye: &Eye, obstacle: &Obstacle, identity: u32) {
        let (depths, identities) = (&mut self.depths, &mut self.identities);
        match obstacle.shape {
            Shape::Capsule { from, to, radius_m } => {
                let capsule = EyeCapsule { from: eye.see(from), to: eye.see(to), radius: radius_m as f32 };
                let nearest = capsule.from[2].min(capsule.to[2]) - capsule.radius;
                if nearest > FARTHEST_M {
                    return;
                }
                if let Some(rectangle) = self.pinhole.rectangle(&[capsule.from, capsule.to], capsule.radius) {
                    draw_capsule(self.pinhole, rectangle, capsule, identity, depths, identities);
                }
            }
            Shape::Cuboid { centre, half_m, heading_rad } => {
                let (sin, cos) = (heading_rad.sin() as f32, heading_rad.cos() as f32);
                let turn = |v: [f32; 3]| [cos * v[0] + sin * v[1], cos * v[1] - sin * v[0], v[2]];
                let c = centre.to_array().map(|value| value as f32);
                let from_centre = turn([0, 1, 2].map(|axis| eye.origin[axis] - c[axis]));
                let [right, down, forward] = eye.axes.map(turn);
                let rays = [0, 1, 2].map(|axis| [right[axis], down[axis], forward[axis]]);
                let half = half_m.map(|value| value as f32);
                let corners = [0, 1, 2, 3, 4, 5, 6, 7].map(|corner: u8| {
                    let side = |axis: usize| if corner >> axis & 1 == 0 { half_m[axis] } else { -half_m[axis] };
                    let (along, across) = (side(0), side(1));
                    let (sin, cos) = heading_rad.sin_cos();
                    let offset = Vector::new(cos * along - sin * across, sin * along + cos * across, side(2));
                    eye.see(centre + offset)
                });
                if corners.iter().all(|corner| corner[2] > FARTHEST_M) {
                    return;
                }
                if let Some(rectangle) = self.pinhole.rectangle(&corners, 0.0) {
                    let cuboid = EyeCuboid { eye: from_centre, rays, half };
                    draw_cuboid(self.pinhole, rectangle, cuboid, identity, depths, identities);
                }
            }
        }
    }
}

/// Draws one row of the ground.
#[multiversion(targets("x86_64+avx512f+avx512bw", "x86_64+avx2+fma", "aarch64+neon"))]
fn draw_ground(pinhole: Pinhole, eye: &Eye, row: usize, ground: &Ground, depths: &mut [f32], identities: &mut [u32]) {
    let y = (row as f32 - pinhole.centre.1) / pinhole.focal;
    for (column, (depth, identity)) in depths.iter_mut().zip(identities).enumerate() {
        let x = (column as f32 - pinhole.centre.0) / pinhole.focal;
        let t = ground.meet(eye.origin, eye.ray(x, y), *depth);
        if t < *depth {
            (*depth, *identity) = (t, GROUND);
        }
    }
}

/// What gives surfaces their looks.
#[derive(Clone, Copy)]
struct Looks<'a> {
    texture: &'a Noise3,
    obstacles: &'a [Obstacle],
}

/// Grey levels of one row: brightness and texture of what each pixel sees.
#[multiversion(targets("x86_64+avx512f+avx512bw", "x86_64+avx2+fma", "aarch64+neon"))]
fn shade(
    pinhole: Pinhole,
    eye: &Eye,
    row: usize,
    looks: Looks<'_>,
    depths: &[f32],
    identities: &[u32],
    grey: &mut [f32],
) {
    let y = (row as f32 - pinhole.centre.1) / pinhole.focal;
    for (column, ((grey, &depth), &identity)) in grey.iter_mut().zip(depths).zip(identities).enumerate() {
        if identity == NOTHING {
            *grey = SKY;
            continue;
        }
        let ray = eye.ray((column as f32 - pinhole.centre.0) / pinhole.focal, y);
        let point = [0, 1, 2].map(|axis| eye.origin[axis] + depth * ray[axis]);
        let (brightness, contrast) = match looks.obstacles.get(identity as usize) {
            Some(obstacle) => (obstacle.brightness, obstacle.contrast),
            None => (105.0, GROUND_CONTRAST),
        };
        // Blank surfaces are lit evenly; textured ones show their texture at the scale of the pixel.
        let detail = if contrast > 0.0 { looks.texture.texture(point, depth / pinhole.focal) } else { 0.0 };
        *grey = brightness + contrast * detail;
    }
}
