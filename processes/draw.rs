//! What the planner knew and planned at an instant of a flight, from above and over the camera's view (DROAN,
//! Figs 5.3 to 5.6): a slice of the map at the vehicle's height, keyframes, the way to the goal, the plan.
//!
//! The truth is drawn, too: nothing that flies sees it.

use crate::config::FlightConfig;
use crate::graph::Scene;
use image::{Rgb, RgbImage};
use ipc_types::rig::CameraMount;
use ipc_types::{Body, Camera, FlightTime, Point, Pose, StereoRig, Vector, World};
use memory::{Occupancy, Points, Scratch, Unknown, View};
use simulator::{CameraConfig, Shape, StereoCamera};
use std::error::Error;
use std::path::{Path, PathBuf};

/// How far the picture from above reaches to every side, m.
const REACH_M: f64 = 20.0;
/// Side of its pixels, m.
const PIXEL_M: f64 = 0.05;
/// Spacing of the slice's voxels in the camera's view, m, and how far they are drawn.
const VOXEL_M: f64 = 0.25;
const VOXELS_M: f64 = 15.0;
/// The camera's view is enlarged to about this width, px.
const VIEW_PX: u32 = 960;

const FREE: Rgb<u8> = Rgb([232, 244, 232]);
const OCCUPIED: Rgb<u8> = Rgb([240, 160, 110]);
const TRUTH: Rgb<u8> = Rgb([40, 40, 40]);
const KEYFRAME: Rgb<u8> = Rgb([40, 110, 220]);
const WAY: Rgb<u8> = Rgb([150, 60, 200]);
const PLAN: Rgb<u8> = Rgb([220, 20, 30]);
const VEHICLE: Rgb<u8> = Rgb([10, 140, 60]);

/// Draws at the instants asked for.
pub(crate) struct Pictures {
    scene: Scene,
    rig: StereoRig,
    mount: CameraMount,
    camera: CameraConfig,
    hull_m: [f64; 2],
    threshold: f32,
    seed: u64,
    /// Instants still to come, the next one last.
    due_s: Vec<f64>,
    folder: PathBuf,
}

impl Pictures {
    pub(crate) fn new(config: &FlightConfig, scene: Scene, at_s: &[f64], folder: &Path) -> Self {
        let mut due_s = at_s.to_vec();
        due_s.sort_by(|a, b| b.total_cmp(a));
        let vehicle = &config.vehicle;
        let hull = vehicle.simulator.vehicle;
        Self {
            scene,
            rig: vehicle.rig,
            mount: vehicle.mount,
            camera: vehicle.simulator.camera,
            hull_m: [hull.hull_radius_m, hull.hull_height_m],
            threshold: vehicle.planner.gamma_low,
            seed: config.seed,
            due_s,
            folder: folder.to_owned(),
        }
    }

    /// Draws what has become due by `now`.
    pub(crate) fn draw_due(&mut self, now: FlightTime) -> Result<(), Box<dyn Error>> {
        while self.due_s.last().is_some_and(|&due_s| due_s <= now.as_secs_f64()) {
            let due_s = self.due_s.pop().unwrap_or_default();
            let planner = self.scene.planner.borrow();
            let pose = self.scene.simulator.borrow().world_from_body();
            let plan: Vec<_> = planner.points().iter().map(|point| Point::from_array(point.position_m)).collect();
            let drawn = Drawn { view: planner.view(), pose, plan: &plan, way: planner.way() };
            let pictures = [("above", self.above(&drawn)?), ("view", self.over_camera(&drawn)?)];
            for (name, picture) in pictures {
                let path = self.folder.join(format!("{name}-{due_s:.2}s.png"));
                picture.save(&path).map_err(|error| format!("{}: {error}", path.display()))?;
            }
        }
        Ok(())
    }

    /// North up, the vehicle in the middle.
    fn above(&self, drawn: &Drawn<'_>) -> Result<RgbImage, Box<dyn Error>> {
        let at = drawn.pose.origin();
        let side = (2.0 * REACH_M / PIXEL_M) as u32;
        let place = |pixel: usize| {
            let (column, row) = (pixel as u32 % side, pixel as u32 / side);
            let (right, up) = (f64::from(column) - f64::from(side) / 2.0, f64::from(side) / 2.0 - f64::from(row));
            Point::new(at.x + right * PIXEL_M, at.y + up * PIXEL_M, at.z)
        };
        let mut image = slice(drawn.view, self.threshold, side, place)?;
        let simulator = self.scene.simulator.borrow();
        let near: Vec<_> =
            simulator.world().obstacles().iter().filter(|obstacle| is_near(&obstacle.shape, at)).collect();
        for (index, pixel) in image.pixels_mut().enumerate() {
            if near.iter().any(|obstacle| obstacle.shape.contains(place(index))) {
                *pixel = TRUTH;
            }
        }
        let pixel_of = |point: Point<World>| {
            let offset = point - at;
            Some((offset.x / PIXEL_M + f64::from(side) / 2.0, f64::from(side) / 2.0 - offset.y / PIXEL_M))
        };
        for (place, axis) in drawn.view.cameras() {
            line(&mut image, &[place, place + axis * 0.6], KEYFRAME, 1, pixel_of);
        }
        line(&mut image, drawn.view.free_space().path(), VEHICLE, 1, pixel_of);
        line(&mut image, drawn.way, WAY, 1, pixel_of);
        line(&mut image, drawn.plan, PLAN, 2, pixel_of);
        let hull: Vec<_> = (0..=36)
            .map(|step| f64::from(step).to_radians() * 10.0)
            .map(|angle| at + Vector::new(angle.cos(), angle.sin(), 0.0) * self.hull_m[0])
            .collect();
        line(&mut image, &hull, VEHICLE, 1, pixel_of);
        let ahead = drawn.pose.rotation * Vector::new(2.0 * self.hull_m[0], 0.0, 0.0);
        line(&mut image, &[at, at + ahead], VEHICLE, 2, pixel_of);
        Ok(image)
    }

    /// What the left camera sees, under it all.
    fn over_camera(&self, drawn: &Drawn<'_>) -> Result<RgbImage, Box<dyn Error>> {
        let world_from_camera = drawn.pose * self.mount.body_from_camera();
        let mut pixels = vec![0; 2 * self.rig.pixels()];
        let world = std::sync::Arc::clone(self.scene.simulator.borrow().world());
        StereoCamera::new(world, self.rig, self.camera, self.seed).expose(world_from_camera, &mut pixels);
        let scale = VIEW_PX.div_ceil(self.rig.width_px).max(1);
        let mut image = RgbImage::from_fn(scale * self.rig.width_px, scale * self.rig.height_px, |x, y| {
            Rgb([pixels[((y / scale) * self.rig.width_px + x / scale) as usize]; 3])
        });
        let camera_from_world: Pose<Camera, World> = world_from_camera.inverse();
        let pixel_of = |point: Point<World>| {
            let (u_px, v_px, _) = self.rig.project(camera_from_world * point)?;
            Some(((u_px + 0.5) * f64::from(scale), (v_px + 0.5) * f64::from(scale)))
        };
        // Below the vehicle by a hull: what is at its own height is seen edge on.
        let at = drawn.pose.origin() - Vector::new(0.0, 0.0, self.hull_m[1]);
        let side = (2.0 * VOXELS_M / VOXEL_M) as usize;
        let place = |index: usize| {
            let offset = |steps: usize| (steps as f64 + 0.5) * VOXEL_M - VOXELS_M;
            at + Vector::new(offset(index % side), offset(index / side), 0.0)
        };
        let answers = ask(drawn.view, self.threshold, side * side, place)?;
        for (index, _) in answers.iter().enumerate().filter(|(_, answer)| **answer == Occupancy::Occupied) {
            line(&mut image, &[place(index)], OCCUPIED, 2, pixel_of);
        }
        for (keyframe, _) in drawn.view.cameras() {
            line(&mut image, &[keyframe], KEYFRAME, 4, pixel_of);
        }
        line(&mut image, drawn.way, WAY, 2, pixel_of);
        line(&mut image, drawn.plan, PLAN, 3, pixel_of);
        Ok(image)
    }
}

/// What is drawn.
struct Drawn<'a> {
    view: &'a View,
    pose: Pose<World, Body>,
    plan: &'a [Point<World>],
    way: &'a [Point<World>],
}

/// Whether a solid may be seen in the picture from above.
fn is_near(shape: &Shape, at: Point<World>) -> bool {
    match *shape {
        Shape::Capsule { from, to, radius_m } => {
            let is_level = (from.z.min(to.z) - radius_m..=from.z.max(to.z) + radius_m).contains(&at.z);
            is_level && from.distance(at) < 2.0 * REACH_M + from.distance(to)
        }
        Shape::Cuboid { centre, half_m, .. } => (centre.z - at.z).abs() <= half_m[2],
    }
}

/// Asks about so many places.
fn ask(
    view: &View,
    threshold: f32,
    count: usize,
    place: impl Fn(usize) -> Point<World>,
) -> Result<Vec<Occupancy>, Box<dyn Error>> {
    let axis = |axis: usize| (0..count).map(|index| place(index).to_array()[axis]).collect::<Vec<f64>>();
    let (x_m, y_m, z_m) = (axis(0), axis(1), axis(2));
    let mut answers = vec![Occupancy::Unknown(Unknown::OutOfView); count];
    view.occupancies(Points { x_m: &x_m, y_m: &y_m, z_m: &z_m }, threshold, &mut Scratch::default(), &mut answers)?;
    Ok(answers)
}

/// What the map says of every pixel's place.
fn slice(
    view: &View,
    threshold: f32,
    side: u32,
    place: impl Fn(usize) -> Point<World>,
) -> Result<RgbImage, Box<dyn Error>> {
    let answers = ask(view, threshold, (side * side) as usize, place)?;
    let colour = |x: u32, y: u32| match answers[(y * side + x) as usize] {
        Occupancy::Free => FREE,
        Occupancy::Occupied => OCCUPIED,
        Occupancy::Unknown(Unknown::OutOfView) => Rgb([150; 3]),
        Occupancy::Unknown(Unknown::Occluded) => Rgb([170, 170, 190]),
        Occupancy::Unknown(Unknown::NoReturn) => Rgb([200, 200, 160]),
    };
    Ok(RgbImage::from_fn(side, side, colour))
}

/// A line through places, as far as it is in the picture.
fn line(
    image: &mut RgbImage,
    places: &[Point<World>],
    colour: Rgb<u8>,
    half_px: i64,
    pixel_of: impl Fn(Point<World>) -> Option<(f64, f64)>,
) {
    let mut dot = |place: Point<World>| {
        let Some((x, y)) = pixel_of(place) else { return };
        for (dx, dy) in (-half_px..=half_px).flat_map(|dx| (-half_px..=half_px).map(move |dy| (dx, dy))) {
            let (x, y) = (x as i64 + dx, y as i64 + dy);
            let inside = (0..i64::from(image.width())).contains(&x) && (0..i64::from(image.height())).contains(&y);
            if inside {
                image.put_pixel(x as u32, y as u32, colour);
            }
        }
    };
    places.iter().for_each(|&place| dot(place));
    for leg in places.windows(2) {
        let dots = (leg[0].distance(leg[1]) / PIXEL_M).ceil().min(1e4) as usize;
        (1..dots).for_each(|step| dot(leg[0].lerp(leg[1], step as f64 / dots as f64)));
    }
}
