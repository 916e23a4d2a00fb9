//! The next group of surfaces behind the nearest one, at half of the resolution.
//!
//! Half of the resolution is enough: what is inflated too much by it, two pixels at most, costs a little of the free
//! space between both groups. No surface is lost by it: a block keeps what lies behind its nearest pixel as well. Between
//! the groups it is free where nothing reaches, and the camera saw past the nearest group all around the body: no pixel that
//! hides something behind it is nearer than the body's width.

use crate::bins::{BinTables, bin};
use crate::clearance::{Body, Clearance};
use crate::inflate::Inflate;
use crate::range_groups::{RangeGroups, merge};
use crate::tables::Tables;
use crate::window::Axis;
use ipc_types::disparity::SCALE;
use ipc_types::messages::{ExpandedLayout, UNKNOWN_FRONT};
use multiversion::multiversion;

/// Pixels along a side of a block that is treated as one.
const BLOCK: usize = 2;

/// Finds the next group.
#[derive(Debug)]
pub(crate) struct NextGroup {
    bins: BinTables,
    inflate: Inflate<RangeGroups>,
    clearance: Clearance,
    /// Width and height of the camera's image, px.
    width: usize,
    height: usize,
    /// Binned values of blocks, column by column: nearest, nearest of a later bin, nearest two bins later.
    blocks: Vec<u16>,
    /// Values where nothing behind is hidden, else 0.
    unhidden: Vec<u16>,
    gap_limits: Vec<u16>,
}

impl NextGroup {
    pub(crate) fn new(tables: &Tables, body: Body, margin_px: usize, stretch: f64, threads: usize) -> Self {
        let rig = tables.rig();
        let (width, height) = (rig.width_px as usize, rig.height_px as usize);
        let axis = |centre_px: f64, length: usize, stretch: f64| {
            // The centre of the first block lies half a pixel from that of the first pixel.
            let (focal, centre) = (rig.focal_px / BLOCK as f64, (centre_px - 0.5) / BLOCK as f64);
            Axis::new(focal, centre, length.div_ceil(BLOCK), margin_px / BLOCK, stretch)
        };
        let (column_axis, row_axis) = (axis(rig.cy_px, height, stretch), axis(rig.cx_px, width, 1.0));
        Self {
            bins: BinTables::new(tables),
            blocks: vec![0; 3 * column_axis.length_px() * row_axis.length_px()],
            inflate: Inflate::new(column_axis, row_axis, threads),
            clearance: Clearance::new(rig, body),
            unhidden: vec![0; rig.pixels()],
            gap_limits: vec![0; rig.pixels()],
            width,
            height,
        }
    }

    /// Writes the gap limits of the nearest cells, whose fronts are known, and the next ones. `values` row by row.
    pub(crate) fn step(
        &mut self,
        tables: &Tables,
        values: &[u16],
        near_limits: &[u16],
        first: &[u16],
        layout: ExpandedLayout,
        elements: &mut [u16],
    ) {
        hide_edges(tables, values, self.width, &mut self.unhidden);
        self.clearance.step(&self.unhidden, near_limits, &mut self.gap_limits);
        self.gather_blocks(values);
        let wide = layout.width_px as usize;
        let (nearest, next) = elements.split_at_mut(4 * layout.cells());
        let inflated = self.inflate.step(&self.bins, &self.blocks);
        let coarse = wide.div_ceil(BLOCK);
        let cells = nearest.as_chunks_mut::<4>().0.chunks_exact_mut(wide);
        let next = next.as_chunks_mut::<2>().0.chunks_exact_mut(wide);
        for (row, ((cells, next), first)) in cells.zip(next).zip(first.chunks_exact(wide)).enumerate() {
            let groups = &inflated[row / BLOCK * 3 * coarse..][..3 * coarse];
            let third = &groups[2 * coarse..];
            for (column, next) in next.iter_mut().enumerate() {
                let third = third[column / BLOCK];
                *next = if third == 0 { [UNKNOWN_FRONT; 2] } else { self.bins.faces(third) };
            }
            let margin = layout.margin_px as usize;
            let Some(from) = row.checked_sub(margin).filter(|&row| row < self.height).map(|row| row * self.width)
            else {
                continue;
            };
            let own = values[from..from + self.width].iter().zip(&self.gap_limits[from..]);
            for ((column, cell), (&own, &limit)) in cells.iter_mut().enumerate().skip(margin).zip(own) {
                let block = column / BLOCK;
                if groups[2 * coarse + block] != 0 && limit != 0 {
                    let group = [groups[block], groups[coarse + block], groups[2 * coarse + block]];
                    cell[3] = limit.min(gap_limit(&self.bins, self.bins.binned(first[column]), group, own));
                }
            }
        }
    }

    /// The values of every block, column by column: a block holds up to four, of which none that matters may be lost.
    fn gather_blocks(&mut self, values: &[u16]) {
        let tall = self.height.div_ceil(BLOCK);
        for (row, values) in values.chunks(BLOCK * self.width).enumerate() {
            let (above, below) = values.split_at(self.width);
            for (column, above) in above.chunks(BLOCK).enumerate() {
                let below = below.get(column * BLOCK..).unwrap_or_default();
                let block = above.iter().chain(below.iter().take(above.len()));
                let groups = block.fold([0; 3], |groups, &value| merge(groups, [self.bins.binned(value), 0, 0]));
                for (number, value) in groups.into_iter().enumerate() {
                    self.blocks[(3 * column + number) * tall + row] = value;
                }
            }
        }
    }
}

/// How near it may be free behind the nearest group, whose front is that of `first`. Where a block's nearest surface is
/// not the pixel's, what the block knows is used as far as it holds for the pixel as well.
#[inline(always)]
fn gap_limit(bins: &BinTables, first: u16, [nearest, second, third]: [u16; 3], own: u16) -> u16 {
    let group = bin(first);
    // The pixel itself must see past the nearest group, and something must lie two bins behind.
    if own == 0 || bins.binned(own) > third || bin(third) + 2 > group {
        return 0;
    }
    // Behind what only the far-background rule grants anything may stand unseen.
    if [first, nearest, second].iter().any(|value| value & 1 == 1) {
        return 0;
    }
    let is_alone = bin(nearest) == group && bin(second) + 2 <= group;
    bins.back(if is_alone { group } else { group - 1 })
}

/// Copies the values, but 0 where something hides what is more than the radius behind it, at its edge.
///
/// Between two pixels a surface may fall back by the radius at most without hiding anything that matters: what lies
/// between them is within the radius of one of them, and occupied.
fn hide_edges(tables: &Tables, values: &[u16], width: usize, unhidden: &mut [u16]) {
    unhidden.copy_from_slice(values);
    let (rig, scale) = (tables.rig(), f64::from(SCALE));
    // f·b/z − f·b/z' in values: rounding is on the side of hiding.
    let behind = Behind {
        most: (rig.focal_baseline_px_m() * scale / tables.radius_m() * 1.0001) as f32,
        doffs: (rig.doffs_px * scale) as f32,
    };
    let rows: usize = values.len() / width;
    for row in 0..rows {
        let line = |row: usize| &values[row * width..(row + 1) * width];
        let (here, out) = (line(row), &mut unhidden[row * width..(row + 1) * width]);
        hide(behind, &here[1..], &here[..width - 1], &mut out[1..]);
        hide(behind, &here[..width - 1], &here[1..], &mut out[..width - 1]);
        if row > 0 {
            hide(behind, here, line(row - 1), out);
        }
        if row + 1 < rows {
            hide(behind, here, line(row + 1), out);
        }
    }
}

/// When a surface is the radius behind another.
#[derive(Clone, Copy)]
struct Behind {
    most: f32,
    doffs: f32,
}

/// With inverse depths a and b, 1/b − 1/a exceeds the radius where (a − b)·f·b/r exceeds a·b.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512vl", "x86_64+avx2+fma", "x86_64+sse4.1", "aarch64+neon"))]
fn hide(behind: Behind, here: &[u16], there: &[u16], out: &mut [u16]) {
    for ((out, &here), &there) in out.iter_mut().zip(here).zip(there) {
        let (a, b) = (f32::from(here) + behind.doffs, f32::from(there) + behind.doffs);
        let hides = (there != 0) & ((a - b) * behind.most > a * b);
        *out = if hides { 0 } else { *out };
    }
}
