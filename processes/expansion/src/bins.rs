//! Depth in bins, by which groups of surfaces are told apart.
//!
//! A *binned value* numbers a bin of depth in its upper bits, from far to near, and rises with the near end of a surface
//! within it; as a value it is even or odd ([`crate::tables`]). A bin is as deep as the interval of a surface at its near
//! edge and twice the radius besides (`range` = 2 r_v of Algorithm 1): what lies less than that behind a surface is in its
//! bin or the next.

use crate::tables::{NEAREST, Radii, Tables, near_px};
use ipc_types::disparity::{MINIMUM, SCALE};
use ipc_types::messages::NEVER_OCCUPIED;

/// Bits of a binned value below its bin.
const BIN_BITS: u32 = 10;
/// Bins are numbered from 1, the farthest, to this, the nearest.
const BINS: usize = 63;
/// Steps within a bin: even values.
const STEPS: f32 = 510.0;

/// The bin of a binned value.
#[inline(always)]
pub(crate) const fn bin(binned: u16) -> u16 {
    binned >> BIN_BITS
}

#[derive(Debug)]
pub(crate) struct BinTables {
    /// Binned value of a value.
    binned: Vec<u16>,
    /// Of a binned value: radius over depth, front and back.
    radius_over_depth: Vec<f32>,
    faces: Vec<[u16; 2]>,
    /// For every bin the back of the farthest surface that it can hold, fixed point.
    backs: Vec<u16>,
}

impl BinTables {
    pub(crate) fn new(tables: &Tables) -> Self {
        let values = usize::from(u16::MAX) + 1;
        let edges = edges(tables);
        let binned: Vec<u16> = (0..values).map(|value| binned(&edges, value as u16)).collect();
        let near_px: Vec<f64> = (0..values).map(|value| f64::from(near_end_px(&edges, value as u16))).collect();
        let mut backs = vec![0; BINS + 1];
        let mut faces: Vec<[u16; 2]> = near_px.iter().map(|&near| [tables.front_of(near), NEVER_OCCUPIED]).collect();
        // Going down from the nearest, the farthest of what shares a place writes last.
        for pixel in (MINIMUM..=u16::MAX).rev() {
            let (place, back) = (binned[usize::from(tables.hard(pixel))], tables.back_of(pixel));
            faces[usize::from(place)][1] = back;
            backs[usize::from(bin(place))] = back;
        }
        let radius_over_depth = |&near: &f64| (tables.radius_m() / tables.rig().depth_m(near)) as f32;
        Self { radius_over_depth: near_px.iter().map(radius_over_depth).collect(), binned, faces, backs }
    }

    #[inline(always)]
    pub(crate) fn binned(&self, value: u16) -> u16 {
        self.binned[usize::from(value)]
    }

    /// Front and back.
    #[inline(always)]
    pub(crate) fn faces(&self, binned: u16) -> [u16; 2] {
        self.faces[usize::from(binned)]
    }

    /// Disparity at and below which, in fixed point, nothing is left of surfaces in a bin and nearer ones.
    #[inline(always)]
    pub(crate) fn back(&self, bin: u16) -> u16 {
        self.backs[usize::from(bin)]
    }
}

impl Radii for BinTables {
    #[inline(always)]
    fn over_depths(&self, values: &[u16], out: &mut [f32]) {
        for (q, &value) in out.iter_mut().zip(values) {
            *q = self.radius_over_depth[usize::from(value)];
        }
    }
}

/// Far and near edges of the bins: 0 is nothing, 1 ends at infinity.
fn edges(tables: &Tables) -> Vec<(f32, f32)> {
    let (rig, nearest_px) = (tables.rig(), f32::from(NEAREST) / SCALE);
    let disparity = |depth_m: f64| (rig.disparity_px(depth_m) as f32).clamp(0.0, nearest_px);
    let mut edges = vec![(0.0, 0.0); BINS + 1];
    let mut near_m = rig.depth_m(f64::from(nearest_px));
    for bin in (1..=BINS).rev() {
        let far_end_m = far_end_m(tables, disparity(near_m));
        let far_m = if bin == 1 { f64::INFINITY } else { far_end_m + 2.0 * tables.radius_m() };
        edges[bin] = (disparity(far_m), if bin == BINS { nearest_px } else { disparity(near_m) });
        near_m = far_m;
    }
    edges
}

/// Depth of the far end of a surface of which the near end has a disparity, m: infinite where the interval is.
fn far_end_m(tables: &Tables, near_px: f32) -> f64 {
    // The near end rises with the disparity: the measured one is found by halving.
    let (mut least, mut most) = (0.0_f32, near_px.max(0.0));
    for _ in 0..40 {
        let middle = 0.5 * (least + most);
        if tables.interval_px(middle).0 < near_px { least = middle } else { most = middle }
    }
    tables.rig().depth_m(f64::from(tables.interval_px(least).1))
}

/// Least binned value that stands for at least a value's near end, as hard or soft as that. A soft one is the nearest of its
/// bin: no hard one hides it there, for behind what is soft nothing may be called free.
fn binned(edges: &[(f32, f32)], value: u16) -> u16 {
    if value == 0 {
        return 0;
    }
    let near_px = near_px(value) as f32;
    let bin = (1..BINS).find(|&bin| near_px <= edges[bin].1).unwrap_or(BINS);
    let (far_px, edge_px) = edges[bin];
    let share = (near_px - far_px).max(0.0) / (edge_px - far_px).max(f32::MIN_POSITIVE);
    let is_soft = value & 1 == 1;
    let step = if is_soft { STEPS as u16 } else { (share * STEPS).ceil().min(STEPS) as u16 };
    ((bin << BIN_BITS) as u16) | (2 * step) | u16::from(is_soft)
}

/// The near end that a binned value stands for, px.
fn near_end_px(edges: &[(f32, f32)], binned: u16) -> f32 {
    let (far_px, near_px) = edges[usize::from(bin(binned))];
    let step = f32::from((binned & ((1 << BIN_BITS) - 1)) >> 1);
    // The last step is the edge itself, whatever single precision makes of the product. A little more than the product
    // for the others.
    if step >= STEPS { near_px } else { (far_px + (near_px - far_px) * step / STEPS) * (1.0 + 2.0 * f32::EPSILON) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ipc_types::StereoRig;
    use ipc_types::noise::NoiseModel;

    /// Algorithm 1's `range`: what lies less than two radii behind a surface belongs to its group.
    #[test]
    fn what_lies_less_than_two_radii_behind_a_surface_is_in_its_bin_or_the_next() {
        for (baseline_m, sigma_px, radius_m) in [(0.35, 0.5, 1.5), (0.17, 0.5, 0.5), (0.3, 0.1, 0.2), (0.1, 1.0, 0.3)] {
            let rig = StereoRig {
                width_px: 640,
                height_px: 480,
                focal_px: 514.17,
                cx_px: 320.0,
                cy_px: 240.0,
                baseline_m,
                doffs_px: 0.0,
            };
            let noise =
                NoiseModel { sigma_px, sigma_m: 0.0, lambda_near: 3.0, lambda_far: 1.0, near_px: 20.0, far_px: 4.0 };
            let tables = Tables::new(rig, noise, radius_m);
            let bins = BinTables::new(&tables);
            let value_at = |depth_m: f64| (rig.disparity_px(depth_m) * f64::from(SCALE)) as u16 & !1;
            let mut previous = u16::MAX;
            for step in 1..4000 {
                let depth_m = 0.3 + f64::from(step) * 0.02;
                let binned = bins.binned(value_at(depth_m));
                assert!(binned <= previous, "values rise with disparity");
                previous = binned;
                let edges = edges(&tables);
                assert!(f64::from(near_end_px(&edges, binned)) >= near_px(value_at(depth_m)) - 1e-6, "{depth_m} m");
                for share in [0.3, 0.7, 0.99] {
                    let behind = bins.binned(value_at(depth_m + share * 2.0 * radius_m));
                    assert!(bin(binned) <= bin(behind) + 1, "{depth_m} m, {share} of {}", 2.0 * radius_m);
                }
            }
        }
    }
}
