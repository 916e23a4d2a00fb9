//! Uneven ground: a grid of heights, interpolated.

use crate::world::WorldConfig;
use rand::RngExt;
use rand_pcg::Pcg64Mcg;
use std::f64::consts::TAU;

/// Spacing of the grid, m.
const SPACING_M: f64 = 0.5;
/// The ground continues beyond the world by this much, so that its edge is not in view, m.
const MARGIN_M: f64 = 60.0;

#[derive(Clone, Debug)]
pub(crate) struct Ground {
    pub(crate) origin: [f32; 2],
    pub(crate) columns: usize,
    pub(crate) rows: usize,
    pub(crate) heights: Vec<f32>,
    /// No height is farther from zero.
    pub(crate) amplitude: f32,
}

impl Ground {
    /// Three waves of different lengths and directions.
    pub(crate) fn new(config: &WorldConfig, random: &mut Pcg64Mcg) -> Self {
        let waves: Vec<[f64; 4]> = [1.0, 1.7, 2.9]
            .map(|stretch| {
                let (direction, phase) = (random.random::<f64>() * TAU, random.random::<f64>() * TAU);
                let number = TAU / (config.ground_wavelength_m * stretch);
                [number * direction.cos(), number * direction.sin(), phase, config.ground_amplitude_m / 3.0]
            })
            .to_vec();
        let origin = [0, 1].map(|axis| config.least_m[axis] - MARGIN_M);
        let cells = |axis: usize| ((config.most_m[axis] + MARGIN_M - origin[axis]) / SPACING_M) as usize + 2;
        let (columns, rows) = (cells(0), cells(1));
        let height = |index: usize| {
            let x = origin[0] + (index % columns) as f64 * SPACING_M;
            let y = origin[1] + (index / columns) as f64 * SPACING_M;
            waves.iter().map(|[kx, ky, phase, amplitude]| amplitude * (kx * x + ky * y + phase).sin()).sum::<f64>()
                as f32
        };
        Self {
            origin: origin.map(|value| value as f32),
            columns,
            rows,
            heights: (0..columns * rows).map(height).collect(),
            amplitude: config.ground_amplitude_m as f32,
        }
    }

    pub(crate) const fn spacing() -> f32 {
        SPACING_M as f32
    }

    /// Height at a place; beyond the grid, that of its border.
    #[inline(always)]
    pub(crate) fn height(&self, x: f32, y: f32) -> f32 {
        let gx = ((x - self.origin[0]) / Self::spacing()).clamp(0.0, (self.columns - 2) as f32);
        let gy = ((y - self.origin[1]) / Self::spacing()).clamp(0.0, (self.rows - 2) as f32);
        let (column, row) = (gx as usize, gy as usize);
        let (fx, fy) = (gx - column as f32, gy - row as f32);
        let index = row * self.columns + column;
        let h = &self.heights[index..];
        let below = h[0] + (h[1] - h[0]) * fx;
        let above = h[self.columns] + (h[self.columns + 1] - h[self.columns]) * fx;
        below + (above - below) * fy
    }

    /// Ray parameter at which a ray from above meets the ground, or infinity.
    ///
    /// Marches between the levels that no wave exceeds, then interpolates within the step that crosses.
    #[inline(always)]
    pub(crate) fn meet(&self, origin: [f32; 3], direction: [f32; 3], farthest: f32) -> f32 {
        if direction[2] >= 0.0 {
            return f32::INFINITY;
        }
        let enter = ((self.amplitude - origin[2]) / direction[2]).max(0.0);
        let leave = (-self.amplitude - origin[2]) / direction[2];
        if enter > farthest {
            return f32::INFINITY;
        }
        let above = |t: f32| {
            origin[2] + t * direction[2] - self.height(origin[0] + t * direction[0], origin[1] + t * direction[1])
        };
        // Steep rays cross the ground's band within centimetres; grazing ones need the steps.
        let steps = if leave - enter < 1.0 { 1 } else { 6 };
        let (mut low, mut gap_low) = (enter, above(enter).max(0.0));
        for step in 1..=steps {
            let high = enter + (leave - enter) * step as f32 / steps as f32;
            let gap_high = above(high);
            if gap_high <= 0.0 {
                let mut t = low + (high - low) * gap_low / (gap_low - gap_high).max(1e-6);
                let correction = above(t);
                let slope = (gap_high - gap_low) / (high - low).max(1e-6);
                if slope < 0.0 {
                    t = (t - correction / slope).clamp(low, high);
                }
                return t;
            }
            (low, gap_low) = (high, gap_high);
        }
        leave
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::world::tests::config;
    use rand::SeedableRng;

    #[test]
    fn rays_meet_the_surface() {
        let ground = Ground::new(&config(), &mut Pcg64Mcg::seed_from_u64(5));
        for tenths in 1..40 {
            for azimuth in 0..36 {
                let (sin, cos) = (azimuth as f32 * 0.1745).sin_cos();
                let direction = [cos, sin, -0.05 * tenths as f32];
                let t = ground.meet([3.0, -4.0, 2.0], direction, 200.0);
                let z = 2.0 + t * direction[2];
                let height = ground.height(3.0 + t * direction[0], -4.0 + t * direction[1]);
                assert!((z - height).abs() < 0.03, "{direction:?}: ray at {z}, ground at {height}");
            }
        }
        assert_eq!(ground.meet([0.0, 0.0, 2.0], [1.0, 0.0, 0.1], 200.0), f32::INFINITY);
    }
}
