//! Places looked up in keyframes, one lane each: many places in one keyframe, or one place in many keyframes.
//!
//! Every lane goes through the same operations in the same order, so that both ways agree to the bit.

use crate::view::MapModel;
use crate::votes::flag;
use ipc_types::disparity::SCALE;
use ipc_types::messages::{NEVER_OCCUPIED, UNKNOWN_FRONT};
use ipc_types::rounding::to_nearest;

/// Nearer than this to the image plane nothing is asked, m.
pub(crate) const NEAREST_M: f32 = 0.05;

/// Places relative to the view's anchor, m.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Places<const N: usize> {
    pub(crate) x: [f32; N],
    pub(crate) y: [f32; N],
    pub(crate) z: [f32; N],
}

impl<const N: usize> Places<N> {
    pub(crate) const NONE: Self = Self { x: [0.0; N], y: [0.0; N], z: [0.0; N] };
}

/// Camera from world: three rows of a rotation, each followed by where the anchor is.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Transforms<const N: usize>(pub(crate) [[f32; N]; 12]);

impl<const N: usize> Transforms<N> {
    pub(crate) const NONE: Self = Self([[0.0; N]; 12]);

    /// The same in every lane.
    #[inline(always)]
    pub(crate) fn splat(transform: &[f32; 12]) -> Self {
        let mut lanes = Self::NONE;
        for (lanes, &value) in lanes.0.iter_mut().zip(transform) {
            *lanes = [value; N];
        }
        lanes
    }
}

/// Where places lie in images.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Projected<const N: usize> {
    /// 1 where in view, else 0.
    pub(crate) inside: [u32; N],
    /// The cell; 0 out of view.
    pub(crate) cell: [u32; N],
    /// Disparity, fixed point.
    d: [f32; N],
    /// f·b/z, px.
    pub(crate) inverse_depth_px: [f32; N],
    /// The first four layers of the cell, once gathered.
    pub(crate) gathered: [[u32; 2]; N],
}

impl<const N: usize> Projected<N> {
    pub(crate) const NOTHING: Self =
        Self { inside: [0; N], cell: [0; N], d: [0.0; N], inverse_depth_px: [0.0; N], gathered: [[0; 2]; N] };

    /// Projects places into keyframes.
    #[inline(always)]
    pub(crate) fn locate(model: &MapModel, transforms: &Transforms<N>, at: &Places<N>) -> Self {
        let MapModel { rig, layout, .. } = model;
        let (focal, focal_baseline) = (rig.focal_px as f32, rig.focal_baseline_px_m() as f32);
        let margin = layout.margin_px as f32;
        let (centre_u, centre_v) = (rig.cx_px as f32 + margin, rig.cy_px as f32 + margin);
        let (end_u, end_v) = (layout.width_px as f32 - 0.5, layout.height_px as f32 - 0.5);
        let (wide, doffs) = (layout.width_px, rig.doffs_px as f32);
        let [xx, xy, xz, xa, yx, yy, yz, ya, zx, zy, zz, za] = &transforms.0;
        let mut seen = Self::NOTHING;
        for i in 0..N {
            let x = xx[i] * at.x[i] + xy[i] * at.y[i] + xz[i] * at.z[i] + xa[i];
            let y = yx[i] * at.x[i] + yy[i] * at.y[i] + yz[i] * at.z[i] + ya[i];
            let z = zx[i] * at.x[i] + zy[i] * at.y[i] + zz[i] * at.z[i] + za[i];
            let inverse = 1.0 / z;
            let u = centre_u + focal * x * inverse;
            let v = centre_v + focal * y * inverse;
            // Written so that what is not a number is out of view.
            let inside = (z >= NEAREST_M) & (u > -0.5) & (v > -0.5) & (u < end_u) & (v < end_v);
            let (u, v) = if inside { (u, v) } else { (0.0, 0.0) };
            let inverse = if inside { inverse } else { 1.0 };
            seen.cell[i] = to_nearest(v.max(0.0)) * wide + to_nearest(u.max(0.0));
            seen.inside[i] = u32::from(inside);
            seen.inverse_depth_px[i] = focal_baseline * inverse;
            seen.d[i] = (seen.inverse_depth_px[i] - doffs) * SCALE;
        }
        seen
    }

    /// Whether nothing is in view.
    #[inline(always)]
    pub(crate) fn is_nothing(&self) -> bool {
        self.inside.iter().fold(0, |any, &inside| any | inside) == 0
    }

    /// What the gathered cells say ([`ipc_types::messages::ExpandedCells::at`]), as flags; the second is 1 where the next
    /// group decides.
    #[inline(always)]
    pub(crate) fn classify(&self) -> ([i32; N], [u32; N]) {
        let (unknown, never) = (f32::from(UNKNOWN_FRONT), f32::from(NEVER_OCCUPIED));
        let (mut flags, mut past) = ([0; N], [0; N]);
        for i in 0..N {
            let ([first, second], d) = (self.gathered[i], self.d[i]);
            let (near, front) = ((first & 0xffff) as f32, (first >> 16) as f32);
            let (back, gap) = ((second & 0xffff) as f32, (second >> 16) as f32);
            let is_before = d > front;
            let free = if back == never { flag::FAR_BACKGROUND } else { flag::FREE };
            let behind = if (d > back) & (back != never) { flag::OCCUPIED } else { flag::OCCLUDED };
            let said = if is_before { free } else { behind };
            let unmeasured = (front == unknown) | (is_before & (d > near));
            let said = if unmeasured { flag::UNMEASURED } else { said };
            let inside = self.inside[i] != 0;
            past[i] = u32::from(inside & (said == flag::OCCLUDED) & (d <= gap));
            flags[i] = if inside { said } else { flag::OUT_OF_VIEW };
        }
        (flags, past)
    }

    /// What the next group says of a lane.
    #[inline(always)]
    pub(crate) fn next(&self, lane: usize, [front, back]: [u16; 2]) -> i32 {
        let d = self.d[lane];
        if d > f32::from(front) {
            if back == NEVER_OCCUPIED { flag::FAR_BACKGROUND } else { flag::FREE }
        } else if d > f32::from(back) && back != NEVER_OCCUPIED {
            flag::OCCUPIED
        } else {
            flag::OCCLUDED
        }
    }
}

/// A cell of four as two numbers of two.
#[inline(always)]
pub(crate) fn halves([a, b, c, d]: [u16; 4]) -> [u32; 2] {
    [u32::from(a) | u32::from(b) << 16, u32::from(c) | u32::from(d) << 16]
}

#[cfg(test)]
mod tests {
    use super::*;
    use ipc_types::messages::{ExpandedCells, Seen};
    use rand::{RngExt, SeedableRng};

    /// The same table as [`ExpandedCells::at`], whatever the cell holds.
    #[test]
    fn lanes_say_what_cells_say() {
        const N: usize = 8;
        let mut random = rand_pcg::Pcg64Mcg::seed_from_u64(1);
        let mut met = std::collections::HashSet::new();
        for _ in 0..100_000 {
            // Few different values, so that equal ones meet.
            let mut value = || match random.random_range(0..6) {
                0 => UNKNOWN_FRONT,
                1 => 0,
                _ => random.random_range(0..12),
            };
            let nearest: [[u16; 4]; N] = std::array::from_fn(|_| std::array::from_fn(|_| value()));
            let next: [[u16; 2]; N] = std::array::from_fn(|_| std::array::from_fn(|_| value()));
            let d: [f32; N] = std::array::from_fn(|_| random.random_range(-4..28) as f32 * 0.5);
            let projected = Projected {
                inside: [1; N],
                cell: [0; N],
                d,
                inverse_depth_px: [1.0; N],
                gathered: nearest.map(halves),
            };
            let (flags, past) = projected.classify();
            for lane in 0..N {
                let flag = if past[lane] == 0 { flags[lane] } else { projected.next(lane, next[lane]) };
                let cells = ExpandedCells { nearest: &nearest[lane..=lane], next: &next[lane..=lane] };
                let seen = cells.at(0, d[lane]);
                let expected = match seen {
                    Seen::Unmeasured => flag::UNMEASURED,
                    Seen::Free => flag::FREE,
                    Seen::FarBackground => flag::FAR_BACKGROUND,
                    Seen::Occupied => flag::OCCUPIED,
                    Seen::Occluded => flag::OCCLUDED,
                };
                assert_eq!(flag, expected, "{:?} {:?} at {}", nearest[lane], next[lane], d[lane]);
                met.insert(expected);
            }
        }
        assert_eq!(met.len(), 5);
    }
}
