//! A stereo camera and its matcher by a model of what they get wrong: disparity without images, for large campaigns.
//!
//! Every pixel belongs to a class by what the true depths around it are: sky, hidden from the other eye, a thin thing, an
//! edge, a blank surface, the inside of one. A class has shares of outcomes: measured, measured as what stands beside it,
//! no texture, no match. What decides is partly bound to the place in the world, so that the same trunk is missed in frame
//! after frame, and partly drawn anew. The shares are those that rendered pairs and the matcher have
//! (`tests/noise_camera.rs` measures both); they belong to a vehicle. Wrong matches that stand alone are none of the outcomes:
//! the matcher's speckle filter leaves none.

use crate::camera::generator;
use crate::render::Renderer;
use crate::world::World;
use ipc_types::bounds::Bounds;
use ipc_types::disparity::{NO_MATCH, TEXTURED, TEXTURELESS, encode};
use ipc_types::{Camera, Point, Pose, StereoRig, World as WorldFrame};
use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64Mcg;
use serde::{Deserialize, Serialize};
use statrs::distribution::{ContinuousCDF, Normal};
use std::sync::Arc;

/// What becomes of a class of pixels: shares that add up to one at most; the rest has no match.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Shares {
    /// Measured where it is.
    pub measured: f64,
    /// Measured as what stands beside it.
    pub beside: f64,
    /// Without enough texture.
    pub textureless: f64,
    /// Without a match, but with texture right there.
    pub textured: f64,
}

/// The model's parameters.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NoiseCameraConfig {
    /// Largest disparity that is matched, px.
    pub most_px: f32,
    /// Standard deviation of what is measured, px.
    pub error_px: f64,
    /// Share of the variance of what decides that is bound to the place in the world; the rest is drawn for every image.
    pub lasting: f64,
    /// Side of a patch that is decided about at once, px.
    pub patch_px: u32,
    /// Sky with nothing near it in the image.
    pub sky: Shares,
    /// Sky beside something.
    pub skyline: Shares,
    /// Seen by the left eye alone.
    pub hidden: Shares,
    /// Things up to 2 px wide.
    pub hair: Shares,
    /// Things up to 5 px wide.
    pub thin: Shares,
    /// Within 2 px of a jump in depth.
    pub edge: Shares,
    /// Within 6 px of one.
    pub rim: Shares,
    /// Surfaces with hardly any texture.
    pub blank: Shares,
    /// Surfaces of small disparity.
    pub far: Shares,
    /// All others.
    pub inside: Shares,
}

impl NoiseCameraConfig {
    /// Reports values out of range.
    pub fn check(&self, bounds: &mut Bounds) {
        bounds.range("most_px", self.most_px, 1.0..=512.0);
        bounds.range("error_px", self.error_px, 0.0..=5.0);
        bounds.range("lasting", self.lasting, 0.0..=1.0);
        bounds.range("patch_px", self.patch_px, 1..=64);
        for (class, shares) in Class::ALL.map(|class| (class.name(), self.shares(class))) {
            bounds.section(class, |bounds| {
                let all = [shares.measured, shares.beside, shares.textureless, shares.textured];
                let is_share =
                    all.iter().all(|share| (0.0..=1.0).contains(share)) && all.iter().sum::<f64>() <= 1.0 + 1e-9;
                bounds.require(is_share, "", format_args!("is {shares:?}, needs shares that add up to 1 at most"));
            });
        }
    }

    fn shares(&self, class: Class) -> Shares {
        match class {
            Class::Sky => self.sky,
            Class::Skyline => self.skyline,
            Class::Hidden => self.hidden,
            Class::Hair => self.hair,
            Class::Thin => self.thin,
            Class::Edge => self.edge,
            Class::Rim => self.rim,
            Class::Blank => self.blank,
            Class::Far => self.far,
            Class::Inside => self.inside,
        }
    }
}

/// Number of classes.
const CLASSES: usize = 10;

/// What surrounds a pixel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Class {
    /// Sky with nothing near it in the image.
    Sky,
    /// Sky beside something.
    Skyline,
    /// Seen by the left eye alone, or nearer than can be matched.
    Hidden,
    /// Things up to 2 px wide.
    Hair,
    /// Things up to 5 px wide.
    Thin,
    /// Within 2 px of a jump in depth.
    Edge,
    /// Within 6 px of one.
    Rim,
    /// Surfaces with hardly any texture.
    Blank,
    /// Surfaces of small disparity.
    Far,
    /// All others.
    Inside,
}

impl Class {
    /// Every class, in the order of their numbers.
    pub const ALL: [Self; CLASSES] = [
        Self::Sky,
        Self::Skyline,
        Self::Hidden,
        Self::Hair,
        Self::Thin,
        Self::Edge,
        Self::Rim,
        Self::Blank,
        Self::Far,
        Self::Inside,
    ];

    /// Its name in the configuration.
    pub const fn name(self) -> &'static str {
        ["sky", "skyline", "hidden", "hair", "thin", "edge", "rim", "blank", "far", "inside"][self as usize]
    }
}

/// Neighbours differ by more than this across a jump in depth, px.
const JUMP_PX: f32 = 1.5;
/// So far from a jump pixels are edges, px.
const EDGE_PX: usize = 2;
/// And so far they are its rim, px.
const RIM_PX: usize = 6;
/// Disparity up to which surfaces are far, px.
const FAR_PX: f32 = 10.0;
/// So far to the sides, above and below, something makes a skyline, px.
const SKYLINE_PX: usize = 6;
/// So far to the sides what hides something is looked for, px.
const HIDDEN_PX: usize = 16;
/// Widths of what is a hair and what is thin, px.
const HAIR_PX: usize = 2;
const THIN_PX: usize = 5;
/// Less contrast than this is blank, grey levels.
const BLANK: f32 = 10.0;
/// Side of what fails together in the world, as it is seen, px: details, and whole surfaces.
const PLACE_PX: [f64; 2] = [10.0, 30.0];
/// Patches of surfaces are so many times as large as those of details.
const SURFACE: usize = 8;
/// Where the sky stands, m.
const SKY_M: f64 = 60.0;
/// Normal numbers drawn once.
const TABLE: usize = 1 << 14;

/// Delivers disparity.
#[derive(Debug)]
pub struct NoiseCamera {
    config: NoiseCameraConfig,
    rig: StereoRig,
    renderer: Renderer,
    /// By class: below the first it is measured, below the next beside, then textureless, below the last textured.
    limits: [[f32; 4]; CLASSES],
    truth: Vec<f32>,
    contrast: Vec<f32>,
    classes: Vec<Class>,
    /// What decides about the patches of a row, normal: of details, and of surfaces.
    details: Vec<f32>,
    surfaces: Vec<f32>,
    noise: Vec<f32>,
    random: Pcg64Mcg,
}

impl NoiseCamera {
    /// For a world; `seed` drives the noise.
    pub fn new(world: Arc<World>, rig: StereoRig, config: NoiseCameraConfig, seed: u64) -> Self {
        let (width, height) = (rig.width_px as usize, rig.height_px as usize);
        let centre = (rig.cx_px as f32, rig.cy_px as f32);
        let mut random = generator(seed, 7);
        let limits = Class::ALL.map(|class| {
            let Shares { measured, beside, textureless, textured } = config.shares(class);
            let mut sum = 0.0;
            [measured, beside, textureless, textured].map(|share| {
                sum += share;
                normal_quantile(sum)
            })
        });
        Self {
            renderer: Renderer::new(world, width, height, rig.focal_px as f32, centre),
            limits,
            truth: vec![0.0; width * height],
            contrast: vec![0.0; width * height],
            classes: vec![Class::Sky; width * height],
            details: vec![0.0; width.div_ceil(config.patch_px as usize)],
            surfaces: vec![0.0; width.div_ceil(SURFACE * config.patch_px as usize)],
            noise: (0..TABLE).map(|_| StandardNormal.sample(&mut random)).collect(),
            random,
            config,
            rig,
        }
    }

    /// True disparities at a pose, px, zero in the sky; and the class of every pixel.
    pub fn look(&mut self, world_from_camera: Pose<WorldFrame, Camera>) -> (&[f32], &[Class]) {
        self.renderer.trace(world_from_camera);
        for ((depth_m, contrast), (truth, out)) in
            self.renderer.surfaces().zip(self.truth.iter_mut().zip(&mut self.contrast))
        {
            *truth = if depth_m.is_finite() { self.rig.disparity_px(f64::from(depth_m)) as f32 } else { 0.0 };
            *out = contrast;
        }
        self.classify();
        (&self.truth, &self.classes)
    }

    /// Writes the disparity image of a pose ([`ipc_types::disparity`]).
    pub fn expose(&mut self, world_from_camera: Pose<WorldFrame, Camera>, disparity: &mut [u16]) {
        self.look(world_from_camera);
        let (width, patch) = (self.rig.width_px as usize, self.config.patch_px as usize);
        let (mut details, mut surfaces) = (std::mem::take(&mut self.details), std::mem::take(&mut self.surfaces));
        for row in 0..self.rig.height_px as usize {
            if row % patch == 0 {
                self.decide(world_from_camera, row, patch, PLACE_PX[0], &mut details);
            }
            if row % (SURFACE * patch) == 0 {
                self.decide(world_from_camera, row, SURFACE * patch, PLACE_PX[1], &mut surfaces);
            }
            let offset = self.random.random_range(0..TABLE);
            let (mut decision, mut was_thin) = (0.0, false);
            for column in 0..width {
                let pixel = row * width + column;
                // What is thin is found or missed from side to side.
                let class = self.classes[pixel];
                let is_thin = matches!(class, Class::Hair | Class::Thin);
                if matches!(class, Class::Far | Class::Blank) {
                    decision = surfaces[column / (SURFACE * patch)];
                } else if !(is_thin && was_thin) {
                    decision = details[column / patch];
                }
                was_thin = is_thin;
                let limits = self.limits[class as usize];
                let error = self.noise[(offset + column) % TABLE] * self.config.error_px as f32;
                disparity[pixel] = if decision < limits[0] {
                    encode(self.truth[pixel] + error)
                } else if decision < limits[1] {
                    self.beside(row, column).map_or(NO_MATCH, |beside| encode(beside + error))
                } else if decision < limits[2] {
                    TEXTURELESS
                } else if decision < limits[3] {
                    TEXTURED
                } else {
                    NO_MATCH
                };
            }
        }
        (self.details, self.surfaces) = (details, surfaces);
    }

    /// Decides about a row of patches.
    fn decide(
        &mut self,
        world_from_camera: Pose<WorldFrame, Camera>,
        row: usize,
        patch: usize,
        place_px: f64,
        decisions: &mut [f32],
    ) {
        let (width, height) = (self.rig.width_px as usize, self.rig.height_px as usize);
        let fresh = (1.0 - self.config.lasting).sqrt() as f32;
        let lasting = self.config.lasting.sqrt() as f32;
        for (index, decision) in decisions.iter_mut().enumerate() {
            let (row, column) = ((row + patch / 2).min(height - 1), (index * patch + patch / 2).min(width - 1));
            let drawn = self.noise[self.random.random_range(0..TABLE)];
            let of_place = self.lasting_at(world_from_camera, row * width + column, place_px);
            *decision = fresh * drawn + lasting * of_place;
        }
    }

    /// A normal number that belongs to the place that a pixel sees.
    fn lasting_at(&self, world_from_camera: Pose<WorldFrame, Camera>, pixel: usize, place_px: f64) -> f32 {
        // The sky fails as if it stood somewhere far.
        let truth = self.truth[pixel].max(self.rig.disparity_px(SKY_M) as f32);
        let (u, v) = (pixel % self.rig.width_px as usize, pixel / self.rig.width_px as usize);
        let seen = self.rig.back_project(u as f64, v as f64, f64::from(truth));
        let place: Point<WorldFrame> = world_from_camera * seen;
        // As fine as the image is there, in powers of two, so that it hardly changes while the vehicle comes nearer.
        let size_m = (place_px * seen.z / self.rig.focal_px).log2().round().exp2();
        let cell = place.to_array().map(|value| (value / size_m).floor() as i64 as u64);
        let mut mixed = cell.iter().fold(0x9e37_79b9_7f4a_7c15_u64, |mixed, cell| {
            (mixed ^ cell).wrapping_mul(0xff51_afd7_ed55_8ccd).rotate_left(31)
        });
        mixed ^= mixed >> 29;
        self.noise[mixed as usize % TABLE]
    }

    /// Disparity of what stands beside a pixel: the nearest thing, or what is behind where the pixel itself sees that.
    fn beside(&self, row: usize, column: usize) -> Option<f32> {
        let width = self.rig.width_px as usize;
        let line = &self.truth[row * width..(row + 1) * width];
        let reach = if self.classes[row * width + column] == Class::Hidden { HIDDEN_PX } else { SKYLINE_PX };
        let around = &line[column.saturating_sub(reach)..(column + reach + 1).min(width)];
        let found = around.iter().copied().filter(|&truth| truth > 0.0);
        let nearest = found.clone().reduce(f32::max)?;
        let is_nearest = nearest - line[column] <= JUMP_PX;
        if is_nearest { found.reduce(f32::min) } else { Some(nearest) }
    }

    fn classify(&mut self) {
        let width = self.rig.width_px as usize;
        for row in 0..self.rig.height_px as usize {
            let lines = row * width..(row + 1) * width;
            let (truth, contrast) = (&self.truth[lines.clone()], &self.contrast[lines.clone()]);
            classify_row(truth, contrast, self.config.most_px, &mut self.classes[lines]);
        }
        // Sky below or above something is a skyline, too.
        for row in 0..self.rig.height_px as usize {
            for column in 0..width {
                let pixel = row * width + column;
                if self.classes[pixel] == Class::Sky {
                    let near = [row.saturating_sub(SKYLINE_PX / 2), row + SKYLINE_PX / 2];
                    let is_beside =
                        near.iter().any(|&row| self.truth.get(row * width + column).is_some_and(|&t| t > 0.0));
                    self.classes[pixel] = if is_beside { Class::Skyline } else { Class::Sky };
                }
            }
        }
    }
}

/// Value below which a share of a normal distribution lies.
fn normal_quantile(share: f64) -> f32 {
    match share {
        share if share <= 0.0 => f32::NEG_INFINITY,
        share if share >= 1.0 - 1e-9 => f32::INFINITY,
        share => Normal::standard().inverse_cdf(share) as f32,
    }
}

/// Classes of a row's pixels.
fn classify_row(truth: &[f32], contrast: &[f32], most_px: f32, classes: &mut [Class]) {
    let width = truth.len();
    for (class, (&truth, &contrast)) in classes.iter_mut().zip(truth.iter().zip(contrast)) {
        *class = match (truth > 0.0, contrast < BLANK) {
            (false, _) => Class::Sky,
            (true, true) => Class::Blank,
            (true, false) => Class::Inside,
        };
    }
    let mut start = 0;
    for end in 1..=width {
        if end < width && (truth[end] - truth[end - 1]).abs() <= JUMP_PX {
            continue;
        }
        let is_near = |outside: Option<&f32>| outside.is_none_or(|&outside| truth[start] > outside + JUMP_PX);
        let stands_out = start > 0 && end < width && is_near(truth.get(start - 1)) && is_near(truth.get(end));
        let run = end - start;
        for column in start..end {
            let to_edge = (column - start).min(end - 1 - column);
            let outer = (start > 0 && column - start <= to_edge) || (end < width && end - 1 - column <= to_edge);
            classes[column] = match classes[column] {
                Class::Sky if outer && to_edge < SKYLINE_PX => Class::Skyline,
                Class::Sky => Class::Sky,
                _ if stands_out && run <= HAIR_PX => Class::Hair,
                _ if stands_out && run <= THIN_PX => Class::Thin,
                _ if outer && to_edge < EDGE_PX => Class::Edge,
                Class::Inside if outer && to_edge < RIM_PX => Class::Rim,
                Class::Inside if truth[column] <= FAR_PX => Class::Far,
                class => class,
            };
        }
        start = end;
    }
    // What lies to the right covers it in the other eye's image.
    let mut covered = f32::INFINITY;
    for column in (0..width).rev() {
        let seen = column as f32 - truth[column];
        if truth[column] > 0.0 {
            if seen >= covered - 0.25 || seen < 0.0 || truth[column] > most_px {
                classes[column] = Class::Hidden;
            }
            covered = covered.min(seen);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn classes(truth: &[f32]) -> Vec<Class> {
        let mut classes = vec![Class::Sky; truth.len()];
        classify_row(truth, &vec![50.0; truth.len()], 64.0, &mut classes);
        classes
    }

    #[test]
    fn a_row_falls_into_classes() {
        let mut truth = vec![3.0; 80];
        truth[40..44].fill(12.0);
        truth[60..].fill(0.0);
        let found = classes(&truth);
        assert!(found[..3].iter().all(|&class| class == Class::Hidden), "seen by the left eye alone: {found:?}");
        assert_eq!((found[20], found[41], found[45], found[48]), (Class::Far, Class::Thin, Class::Edge, Class::Rim));
        assert_eq!(found[33], Class::Hidden, "the shadow of the thin thing, 9 px wide, to its left");
        assert_eq!((found[62], found[75], found[79]), (Class::Skyline, Class::Sky, Class::Sky));
        assert_eq!(classes(&[100.0; 120])[110], Class::Hidden, "nearer than can be matched");
    }

    #[test]
    fn shares_are_met() {
        let limits = [0.2, 0.5, 0.9].map(normal_quantile);
        let mut random = generator(3, 7);
        let mut counts = [0; 3];
        for _ in 0..20_000 {
            let drawn: f32 = StandardNormal.sample(&mut random);
            counts.iter_mut().zip(limits).for_each(|(count, limit)| *count += usize::from(drawn < limit));
        }
        for (count, share) in counts.iter().zip([0.2, 0.5, 0.9]) {
            assert!((*count as f64 / 20_000.0 - share).abs() < 0.015, "{counts:?}");
        }
        assert_eq!((normal_quantile(0.0), normal_quantile(1.0)), (f32::NEG_INFINITY, f32::INFINITY));
    }
}
