//! Band-limited texture: value noise on a periodic lattice, at the scale of the pixel.
//!
//! A surface shows detail down to about two pixels whatever its distance, as bark and leaves do, and no aliasing
//! beyond it: the lattice is scaled in octaves to the pixel's footprint and adjacent octaves are blended.

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

const SIDE: usize = 32;
const MASK: usize = SIDE - 1;
/// Finest lattice cell in pixels.
const PIXELS_PER_CELL: f32 = 1.6;

#[derive(Clone, Debug)]
pub(crate) struct Noise3 {
    lattice: Vec<f32>,
}

impl Noise3 {
    pub(crate) fn new(seed: u64) -> Self {
        let mut random = Pcg64Mcg::seed_from_u64(seed);
        Self { lattice: (0..SIDE * SIDE * SIDE).map(|_| random.random::<f32>() - 0.5).collect() }
    }

    /// Texture at a point (m) seen with a footprint of `footprint` m/px, about -0.5..0.5.
    #[inline(always)]
    pub(crate) fn texture(&self, p: [f32; 3], footprint: f32) -> f32 {
        let cell = footprint * PIXELS_PER_CELL;
        // Floor of log2 from the exponent, and the rest from the mantissa: exact powers of two as cells.
        let bits = cell.max(1e-6).to_bits();
        let exponent = (bits >> 23) as i32 - 127;
        let blend = (bits & 0x7f_ffff) as f32 / 8_388_608.0;
        let scale = f32::from_bits(((127 - exponent) as u32) << 23);
        let (fine, coarse) = (self.lattice_at(p, scale), self.lattice_at(p, scale * 0.5));
        // The finer octave fades out as the footprint grows towards the next.
        fine * (1.0 - blend) + coarse * (0.5 + 0.5 * blend)
    }

    #[inline(always)]
    fn lattice_at(&self, p: [f32; 3], scale: f32) -> f32 {
        // A rotation that lines up with no surface, so that lattice planes do not show.
        let [x, y, z] = [
            (0.80 * p[0] + 0.48 * p[1] + 0.36 * p[2]) * scale,
            (-0.60 * p[0] + 0.64 * p[1] + 0.48 * p[2]) * scale,
            (-0.60 * p[1] + 0.80 * p[2]) * scale,
        ];
        let (fx, fy, fz) = (x.floor(), y.floor(), z.floor());
        let (dx, dy, dz) = (x - fx, y - fy, z - fz);
        let (ix, iy, iz) = (fx as i32 as usize & MASK, fy as i32 as usize & MASK, fz as i32 as usize & MASK);
        let (jx, jy, jz) = ((ix + 1) & MASK, (iy + 1) & MASK, (iz + 1) & MASK);
        let at = |x: usize, y: usize, z: usize| self.lattice[(z * SIDE + y) * SIDE + x];
        let along = |y: usize, z: usize| {
            let (a, b) = (at(ix, y, z), at(jx, y, z));
            a + (b - a) * dx
        };
        let plane = |z: usize| {
            let (a, b) = (along(iy, z), along(jy, z));
            a + (b - a) * dy
        };
        let (a, b) = (plane(iz), plane(jz));
        a + (b - a) * dz
    }
}
