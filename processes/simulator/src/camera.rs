//! The stereo camera: two eyes, optics, sensor noise.

use crate::render::Renderer;
use crate::world::World;
use ipc_types::bounds::Bounds;
use ipc_types::{Body, Camera, Pose, Rotation, StereoRig, Vector, World as WorldFrame};
use multiversion::multiversion;
use rand::{Rng, RngExt, SeedableRng};
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64Mcg;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// What the simulated camera does to the light.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CameraConfig {
    /// Stereo pairs per second.
    pub rate_hz: f64,
    /// From exposure to delivery, ms.
    pub latency_ms: f64,
    /// Standard deviation of the sensor's noise, grey levels.
    pub noise: f32,
    /// Share of a pixel's light that falls on each neighbour along an axis (0: sharp, 1/3: a box of three).
    pub blur: f32,
    /// Gain of the right camera relative to the left.
    pub right_gain: f32,
    /// Rotation of the right camera about its optical axis that rectification left, degrees.
    pub right_roll_deg: f64,
}

impl CameraConfig {
    /// Reports values out of range.
    pub fn check(&self, bounds: &mut Bounds) {
        bounds.range("rate_hz", self.rate_hz, 1.0..=120.0);
        bounds.range("latency_ms", self.latency_ms, 0.0..=500.0);
        bounds.range("noise", self.noise, 0.0..=50.0);
        bounds.range("blur", self.blur, 0.0..=1.0 / 3.0);
        bounds.range("right_gain", self.right_gain, 0.3..=3.0);
        bounds.range("right_roll_deg", self.right_roll_deg, -5.0..=5.0);
    }
}

/// Gaussian numbers drawn once; every row starts at a random place among them.
const NOISE_TABLE: usize = 1 << 14;

/// Renders stereo pairs.
#[derive(Debug)]
pub struct StereoCamera {
    config: CameraConfig,
    rig: StereoRig,
    renderer: Renderer,
    light: Vec<f32>,
    blurred: Vec<f32>,
    noise: Vec<f32>,
    random: Pcg64Mcg,
}

impl StereoCamera {
    /// For a world; `seed` drives the noise.
    pub fn new(world: Arc<World>, rig: StereoRig, config: CameraConfig, seed: u64) -> Self {
        let mut random = Pcg64Mcg::seed_from_u64(seed);
        let (width, height) = (rig.width_px as usize, rig.height_px as usize);
        let centre = (rig.cx_px as f32, rig.cy_px as f32);
        let noise = |_| -> f32 { StandardNormal.sample(&mut random) };
        let table = (0..NOISE_TABLE + width).map(noise).collect();
        Self {
            renderer: Renderer::new(world, width, height, rig.focal_px as f32, centre),
            light: vec![0.0; width * height],
            blurred: vec![0.0; width * height],
            noise: table,
            random,
            config,
            rig,
        }
    }

    /// Writes the left image, then the right one, to `pixels` (twice the rig's size).
    pub fn expose(&mut self, world_from_camera: Pose<WorldFrame, Camera>, pixels: &mut [u8]) {
        let right_from_left = Pose::<Camera, Camera> {
            rotation: Rotation::from_roll_pitch_yaw(0.0, 0.0, self.config.right_roll_deg.to_radians()),
            translation: Vector::new(self.rig.baseline_m, 0.0, 0.0),
        };
        let (left, right) = pixels.split_at_mut(self.rig.pixels());
        self.eye(world_from_camera, 1.0, left);
        self.eye(world_from_camera * right_from_left, self.config.right_gain, right);
    }

    /// True disparities of the left image at a pose, px; zero where there is sky.
    pub fn true_disparity(&mut self, world_from_camera: Pose<WorldFrame, Camera>) -> Vec<f32> {
        self.renderer.render(world_from_camera, &mut self.light);
        let rig = self.rig;
        self.renderer
            .depths()
            .map(|depth| if depth.is_finite() { rig.disparity_px(f64::from(depth)) as f32 } else { 0.0 })
            .collect()
    }

    fn eye(&mut self, world_from_camera: Pose<WorldFrame, Camera>, gain: f32, pixels: &mut [u8]) {
        let width = self.rig.width_px as usize;
        self.renderer.render(world_from_camera, &mut self.light);
        blur_rows(&self.light, width, self.config.blur, &mut self.blurred);
        blur_columns(&self.blurred, width, self.config.blur, &mut self.light);
        for (line, pixels) in self.light.chunks_exact(width).zip(pixels.chunks_exact_mut(width)) {
            let start = self.random.random_range(0..NOISE_TABLE);
            digitise(line, &self.noise[start..start + width], gain, self.config.noise, pixels);
        }
    }
}

#[multiversion(targets("x86_64+avx512f+avx512bw", "x86_64+avx2+fma", "aarch64+neon"))]
fn blur_rows(from: &[f32], width: usize, share: f32, to: &mut [f32]) {
    for (from, to) in from.chunks_exact(width).zip(to.chunks_exact_mut(width)) {
        to.copy_from_slice(from);
        for x in 1..width - 1 {
            to[x] = from[x] + share * (from[x - 1] + from[x + 1] - 2.0 * from[x]);
        }
    }
}

#[multiversion(targets("x86_64+avx512f+avx512bw", "x86_64+avx2+fma", "aarch64+neon"))]
fn blur_columns(from: &[f32], width: usize, share: f32, to: &mut [f32]) {
    to.copy_from_slice(from);
    for index in width..from.len() - width {
        to[index] = from[index] + share * (from[index - width] + from[index + width] - 2.0 * from[index]);
    }
}

#[multiversion(targets("x86_64+avx512f+avx512bw", "x86_64+avx2+fma", "aarch64+neon"))]
fn digitise(light: &[f32], noise: &[f32], gain: f32, deviation: f32, pixels: &mut [u8]) {
    for ((pixel, &light), &noise) in pixels.iter_mut().zip(light).zip(noise) {
        *pixel = (light * gain + noise * deviation + 0.5).clamp(0.0, 255.0) as u8;
    }
}

/// Pose of the left camera for a body pose.
pub(crate) fn camera_pose(
    world_from_body: Pose<WorldFrame, Body>,
    body_from_camera: Pose<Body, Camera>,
) -> Pose<WorldFrame, Camera> {
    world_from_body * body_from_camera
}

/// A generator for one purpose, independent of the others of the same run.
pub(crate) fn generator(seed: u64, purpose: u64) -> Pcg64Mcg {
    let mut mixed = Pcg64Mcg::seed_from_u64(seed ^ purpose.wrapping_mul(0x9e37_79b9_7f4a_7c15));
    mixed.next_u64();
    mixed
}
