//! Random scenes and what brute force says of them.

#![allow(dead_code, reason = "each test uses its part")]

use expansion::{BackgroundRule, Config, Expander, Reach};
use ipc_types::disparity::{NO_MATCH, SCALE, decode, encode};
use ipc_types::messages::{ExpandedCells, ExpandedLayout, Layers, Seen};
use ipc_types::noise::NoiseModel;
use ipc_types::{Camera, Point, StereoRig};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

pub(crate) fn seeded(seed: u64) -> Pcg64Mcg {
    Pcg64Mcg::seed_from_u64(seed)
}

/// A point on the unit sphere.
pub(crate) fn random_offset(random: &mut Pcg64Mcg) -> [f64; 3] {
    loop {
        let direction = [0, 1, 2].map(|_| random.random_range(-1.0_f64..1.0));
        let norm = direction.iter().map(|c| c * c).sum::<f64>().sqrt();
        if (0.1..=1.0).contains(&norm) {
            return direction.map(|c| c / norm);
        }
    }
}

/// A camera, a vehicle and an image.
#[derive(Debug)]
pub(crate) struct Scene {
    pub(crate) rig: StereoRig,
    pub(crate) noise: NoiseModel,
    pub(crate) config: Config,
    pub(crate) image: Vec<u16>,
}

/// What became of a scene.
pub(crate) struct Expanded {
    rig: StereoRig,
    layout: ExpandedLayout,
    pub(crate) elements: Vec<u16>,
    pub(crate) unknown_share: f32,
}

impl Scene {
    pub(crate) fn random(seed: u64) -> (Self, Pcg64Mcg) {
        let mut random = seeded(seed);
        let rig = StereoRig {
            width_px: random.random_range(40..110),
            height_px: random.random_range(32..80),
            focal_px: random.random_range(40.0..110.0),
            cx_px: random.random_range(15.0..30.0) * 2.0,
            cy_px: random.random_range(10.0..20.0) * 2.0,
            baseline_m: random.random_range(0.1..0.4),
            doffs_px: if seed % 4 == 3 { random.random_range(-0.5..6.0) } else { 0.0 },
        };
        let noise = NoiseModel {
            sigma_px: random.random_range(0.02..0.5),
            // Every third has an error of depth, as of a time-of-flight camera.
            sigma_m: if seed % 3 == 2 { random.random_range(0.0..0.05) } else { 0.0 },
            lambda_near: 3.0,
            lambda_far: 1.0,
            near_px: 9.0,
            far_px: 3.0,
        };
        let radius_m = random.random_range(0.15_f32..1.6);
        let half_height_m =
            if seed.is_multiple_of(2) { radius_m } else { radius_m * random.random_range(0.4_f32..1.3) };
        let config = Config {
            radius_m,
            half_height_m,
            layers: if seed % 5 < 2 { Layers::Two } else { Layers::Four },
            margin_px: 2 * random.random_range(0..14),
            body_radius_m: radius_m * random.random_range(0.1_f32..1.0),
            body_half_height_m: half_height_m * random.random_range(0.1_f32..1.0),
            hole_px: random.random_range(0..5),
            patch_px: 0,
            background: BackgroundRule { limit_m: 12.0, share: 0.7, textureless_share: 0.8 },
            ..Config::for_sphere(radius_m)
        };
        let image = random_image(&rig, &mut random);
        (Self { rig, noise, config, image }, random)
    }

    pub(crate) fn expander(&self) -> Expander {
        Expander::new(self.rig, &self.noise, Reach::Matched { most_px: 1000.0 }, self.config)
    }

    pub(crate) fn expand(&mut self) -> Expanded {
        let mut expander = self.expander();
        let layout = expander.layout();
        let mut elements = vec![7; layout.elements()];
        let found = expander.step(&self.image, &mut elements).expect("sizes agree");
        Expanded { rig: self.rig, layout, elements, unknown_share: found.unknown_share }
    }

    /// Both ends of a measured disparity's interval.
    pub(crate) fn interval_px(&self, disparity_px: f32) -> (f32, f32) {
        let doffs_px = self.rig.doffs_px as f32;
        let (near, far) = self.noise.ends_px(disparity_px + doffs_px, self.rig.focal_baseline_px_m() as f32);
        (near - doffs_px, far - doffs_px)
    }

    /// The pixel that a place of the image lies in.
    pub(crate) fn pixel(&self, u: f64, v: f64) -> Option<u16> {
        let (column, row) = (u.round(), v.round());
        let inside =
            column >= 0.0 && row >= 0.0 && column < f64::from(self.rig.width_px) && row < f64::from(self.rig.height_px);
        inside.then(|| self.image[row as usize * self.rig.width_px as usize + column as usize])
    }

    fn surfaces(&self) -> impl Iterator<Item = (f64, f64, f64, f64)> {
        let width = self.rig.width_px as usize;
        self.image.iter().enumerate().filter_map(move |(index, &pixel)| {
            let (near, far) = self.interval_px(decode(pixel)?);
            let depth_m = |d: f32| self.rig.depth_m(f64::from(d));
            Some(((index % width) as f64, (index / width) as f64, depth_m(near), depth_m(far)))
        })
    }

    /// Whether a measured surface's silhouette has the point's ray in its bounding box, widened by `px` pixels, and its
    /// interval the point's depth within a radius and a `share` of the depth.
    pub(crate) fn has_box_about(&self, point: Point<Camera>, px: f64, share: f64) -> bool {
        let (r, h) = (f64::from(self.config.radius_m), f64::from(self.config.half_height_m));
        let (u, v, _) = self.rig.project(point).expect("in front of the camera");
        let within = |place: f64, surface: f64, centre: f64, q: f64, stretch: f64| {
            if q >= 0.99 {
                return true;
            }
            let tangent = |side: f64| {
                let x = (surface + side * 0.5 - centre) / self.rig.focal_px / stretch;
                let slope = (x + side * q * (1.0 + x * x - q * q).sqrt()) / (1.0 - q * q);
                centre + self.rig.focal_px * slope * stretch
            };
            (tangent(-1.0) - px..=tangent(1.0) + px).contains(&place)
        };
        self.surfaces().any(|(column, row, near_m, far_m)| {
            let near_m = near_m * (1.0 - share);
            let depths = (near_m - r) * (1.0 - share) - 0.01..=(far_m + r) * (1.0 + share) + 0.01;
            depths.contains(&point.z)
                && within(u, column, self.rig.cx_px, r / near_m, 1.0)
                && within(v, row, self.rig.cy_px, r / near_m, h / r)
        })
    }

    /// Depth at which a pixel's ray enters the first ellipsoid about a surface's near end, m.
    pub(crate) fn exact_front_m(&self, u: f64, v: f64) -> f64 {
        let (r, h) = (f64::from(self.config.radius_m), f64::from(self.config.half_height_m));
        let slope =
            |u: f64, v: f64| ((u - self.rig.cx_px) / self.rig.focal_px, (v - self.rig.cy_px) / self.rig.focal_px);
        let (x, y) = slope(u, v);
        let mut front_m = f64::INFINITY;
        for (column, row, near_m, _) in self.surfaces() {
            let (sx, sy) = slope(column, row);
            // |t·(x, y, 1) − z·(sx, sy, 1)|² = r², with y stretched.
            let (y, sy) = (y * r / h, sy * r / h);
            let (a, b) = (1.0 + x * x + y * y, near_m * (1.0 + x * sx + y * sy));
            let c = near_m * near_m * (1.0 + sx * sx + sy * sy) - r * r;
            let root = b * b - a * c;
            if root >= 0.0 {
                front_m = front_m.min(((b - root.sqrt()) / a).max(0.0));
            }
        }
        front_m
    }
}

impl Expanded {
    fn cells(&self) -> ExpandedCells<'_> {
        ExpandedCells::split(&self.elements, self.layout).expect("of the layout's length")
    }

    fn cell(&self, point: Point<Camera>) -> Option<(usize, f32, bool)> {
        let (u, v, d) = self.rig.project(point)?;
        let margin = f64::from(self.layout.margin_px);
        let (column, row) = ((u + margin).round(), (v + margin).round());
        let inside = column >= 0.0
            && row >= 0.0
            && column < f64::from(self.layout.width_px)
            && row < f64::from(self.layout.height_px);
        let is_margin = column < margin
            || row < margin
            || column >= f64::from(self.layout.width_px) - margin
            || row >= f64::from(self.layout.height_px) - margin;
        let index = || row as usize * self.layout.width_px as usize + column as usize;
        inside.then(|| (index(), (d * f64::from(SCALE)) as f32, is_margin))
    }

    /// What the image says of a point, and whether it lies in the margin; `None` out of view.
    pub(crate) fn ask(&self, point: Point<Camera>) -> Option<(Seen, bool)> {
        let (index, d, is_margin) = self.cell(point)?;
        Some((self.cells().at(index, d), is_margin))
    }

    pub(crate) fn is_behind_the_first(&self, point: Point<Camera>) -> bool {
        self.cell(point).is_some_and(|(index, d, _)| d < f32::from(self.cells().nearest[index][1]))
    }

    /// Depth of the front of a camera's pixel, m.
    pub(crate) fn front_m(&self, column: u32, row: u32) -> Option<f64> {
        let (front, _) = self.cells().interval_px(self.layout.cell_of(column, row))?;
        Some(self.rig.depth_m(f64::from(front)))
    }
}

/// A slope, or a wall that is not square to the camera; before it blobs, poles, wires of one pixel, points; some pixels
/// unmatched, some beyond the largest disparity.
fn random_image(rig: &StereoRig, random: &mut Pcg64Mcg) -> Vec<u16> {
    let (width, height) = (rig.width_px as usize, rig.height_px as usize);
    let (across, down) = (random.random_range(-4.0..4.0_f32), random.random_range(-1.0..6.0_f32));
    let base = random.random_range(0.5..3.0_f32);
    let plane = |index: usize| {
        let (x, y) = ((index % width) as f32 / width as f32, (index / width) as f32 / height as f32);
        (base + across * x + down * y).max(0.3)
    };
    let mut image: Vec<f32> = (0..width * height).map(plane).collect();
    for _ in 0..random.random_range(0..14) {
        let (wide, high) = match random.random_range(0..5) {
            0 => (1, 1),
            1 => (1, height),
            2 => (width, 1),
            3 => (random.random_range(2..7), height),
            _ => (random.random_range(1..20), random.random_range(1..20)),
        };
        let (left, top) = (random.random_range(0..width), random.random_range(0..height));
        let disparity = random.random_range(0.8_f32..5.0).exp2();
        for row in top..(top + high).min(height) {
            for column in left..(left + wide).min(width) {
                image[row * width + column] = disparity;
            }
        }
    }
    let unmatched = [0.0, 0.0, 0.02, 0.2][random.random_range(0..4)];
    let saturated = [0.0, 0.0, 0.0, 0.001][random.random_range(0..4)];
    let pixel = |random: &mut Pcg64Mcg, d: f32| match () {
        () if random.random_bool(unmatched) => NO_MATCH,
        () if random.random_bool(saturated) => u16::MAX,
        () => encode(d),
    };
    image.iter().map(|&d| pixel(random, d)).collect()
}
