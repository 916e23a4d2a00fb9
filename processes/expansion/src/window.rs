//! Which pixels an ellipsoid covers along one image axis.
//!
//! In the plane of the optical axis and one image axis, a sphere of radius r at slope x and depth z casts the shadow
//! of a circle. With q = r/z the slopes of the circle's two tangents through the camera are
//! (x ± q·√(1 + x² − q²)) / (1 − q²). They bound the sphere's silhouette whatever the other image coordinate is.
//! √(c² − q²) is at most c − q²/2c, which is used for it: less than a hundredth of q too much while q < 1/2.
//!
//! An ellipsoid that is flatter or taller than wide is a sphere once that axis has been stretched.

use crate::range_max::Cells;
use ipc_types::rounding::to_nearest;

/// One side of every pixel: its slope, c = √(1 + slope²), and 1/2c.
#[derive(Debug)]
struct Side {
    slope: Vec<f32>,
    c: Vec<f32>,
    half_per_c: Vec<f32>,
}

/// Of every pixel of a line, the first and last place of its window, and the cells of a sparse table that cover it.
#[derive(Debug)]
pub(crate) struct Windows {
    first: Vec<u32>,
    last: Vec<u32>,
    pub(crate) begins: Vec<u32>,
    pub(crate) ends: Vec<u32>,
}

impl Windows {
    /// For lines of a length.
    pub(crate) fn new(length: usize) -> Self {
        let line = || vec![0; length];
        Self { first: line(), last: line(), begins: line(), ends: line() }
    }

    /// Ends the windows of soft values ([`crate::tables`]) at the last of them, in a line with a margin of so many places.
    #[inline(always)]
    pub(crate) fn end_soft(&mut self, values: &[u16], margin: usize) {
        let Some(lowest) = values.iter().rposition(|value| value & 1 == 1) else { return };
        let end = (margin + lowest) as u32;
        for (last, value) in self.last.iter_mut().zip(values) {
            *last = if value & 1 == 1 { end.min(*last) } else { *last };
        }
    }

    /// Finds the cells ([`Cells`]) of the windows, in a table for lines of a length.
    #[inline(always)]
    pub(crate) fn find_cells(&mut self, length: usize) {
        let cells = self.begins.iter_mut().zip(&mut self.ends);
        for ((&first, &last), (begin, end)) in self.first.iter().zip(&self.last).zip(cells) {
            let cells = Cells::of(first, last, length as u32);
            (*begin, *end) = (cells.begin, cells.end);
        }
    }
}

/// Tangent windows along one axis of the image. Windows lie in an expanded line, longer by a margin at both ends.
#[derive(Debug)]
pub(crate) struct Axis {
    /// Pixels of the expanded line.
    expanded_px: usize,
    /// First and last side of every pixel.
    sides: [Side; 2],
    /// Stretched slope to pixels of the expanded line.
    scale_px: f32,
    offset_px: f32,
    stretch: f64,
}

impl Axis {
    /// For lines of `length_px` pixels. Along this axis the ellipsoid is `stretch` as wide as in depth.
    pub(crate) fn new(focal_px: f64, centre_px: f64, length_px: usize, margin_px: usize, stretch: f64) -> Self {
        // From anywhere in the pixel: half a pixel to both sides.
        let side = |half: f64| {
            let slope = |pixel: usize| (pixel as f64 - centre_px + half) / (focal_px * stretch);
            let each = |value: fn(f64) -> f64| (0..length_px).map(|pixel| value(slope(pixel)) as f32).collect();
            Side {
                slope: each(|x| x),
                c: each(|x| (1.0 + x * x).sqrt()),
                half_per_c: each(|x| 0.5 / (1.0 + x * x).sqrt()),
            }
        };
        Self {
            expanded_px: length_px + 2 * margin_px,
            sides: [side(-0.5), side(0.5)],
            scale_px: (focal_px * stretch) as f32,
            offset_px: (centre_px + margin_px as f64) as f32,
            stretch,
        }
    }

    /// Pixels of a line.
    pub(crate) fn length_px(&self) -> usize {
        self.sides[0].slope.len()
    }

    /// Whether the ellipsoid is at least as wide along this axis as in depth.
    pub(crate) fn is_upright(&self) -> bool {
        self.stretch >= 1.0
    }

    /// Pixels that an expanded line is longer by, at either end.
    pub(crate) fn margin_px(&self) -> usize {
        (self.expanded_px - self.length_px()) / 2
    }

    /// Pixels of an expanded line.
    pub(crate) fn expanded_px(&self) -> usize {
        self.expanded_px
    }

    /// First and last pixel of the expanded line whose rays may touch an ellipsoid of `q` = radius / depth centred
    /// anywhere in each pixel of the line. At q ≥ 1 the camera is inside: everything.
    #[inline(always)]
    pub(crate) fn windows(&self, radius_over_depth: &[f32], windows: &mut Windows) {
        let [left, right] = &self.sides;
        self.ends(radius_over_depth, left, -1.0, -0.001, 0.0, &mut windows.first);
        self.ends(radius_over_depth, right, 1.0, 0.001, self.expanded_px as f32 - 1.0, &mut windows.last);
    }

    /// One end of every window: `inside` where the camera is inside.
    #[inline(always)]
    fn ends(&self, radius_over_depth: &[f32], side: &Side, sign: f32, slack: f32, inside: f32, ends: &mut [u32]) {
        let end = self.expanded_px as f32 - 1.0;
        // A query is looked up in the pixel nearest to it, so rounding of the tangents is to the nearest too; the
        // thousandth of `slack` absorbs single-precision error.
        let offset = self.offset_px + slack;
        // One length for all, so that the loop vectorises.
        let length = ends.len();
        let (radius_over_depth, slope) = (&radius_over_depth[..length], &side.slope[..length]);
        let (c, half_per_c) = (&side.c[..length], &side.half_per_c[..length]);
        for i in 0..length {
            let outside = radius_over_depth[i] < 0.999;
            // Computed either way, without a branch.
            let q = if outside { radius_over_depth[i] } else { 0.5 };
            let square = q * q;
            let tangent = (slope[i] + sign * q * (c[i] - square * half_per_c[i])) / (1.0 - square);
            let place = (offset + self.scale_px * tangent).max(0.0).min(end);
            ends[i] = to_nearest(if outside { place } else { inside });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn window(axis: &Axis, pixel: usize, q: f32) -> (u32, u32) {
        let mut windows = Windows::new(axis.length_px());
        axis.windows(&vec![q; axis.length_px()], &mut windows);
        (windows.first[pixel], windows.last[pixel])
    }

    #[test]
    fn contains_the_projection_of_every_point_of_the_ellipsoid_and_little_else() {
        for (stretch, margin) in [(1.0, 0), (0.5, 7), (1.6, 40)] {
            let axis = Axis::new(200.0, 159.5, 320, margin, stretch);
            for pixel in [0, 40, 159, 300, 319] {
                for q in [0.01_f32, 0.1, 0.5, 0.9] {
                    let (first, last) = window(&axis, pixel, q);
                    let (mut least, mut most) = (f64::INFINITY, f64::NEG_INFINITY);
                    for step in 0..3600 {
                        let x = (pixel as f64 - 159.5 + if step % 2 == 0 { 0.5 } else { -0.5 }) / 200.0;
                        let angle = (f64::from(step) * 0.1).to_radians();
                        let (dx, dz) = (f64::from(q) * angle.cos() * stretch, f64::from(q) * angle.sin());
                        let column = 159.5 + margin as f64 + 200.0 * (x + dx) / (1.0 + dz);
                        (least, most) = (least.min(column), most.max(column));
                    }
                    let end = axis.expanded_px() as f64 - 1.0;
                    let [least, most] = [least, most].map(|column| column.round().clamp(0.0, end) as u32);
                    assert!(first <= least && last >= most, "{pixel} {q}: {first}..{last}, {least}..{most}");
                    let slack = 2 + (0.03 * f64::from(most - least)) as u32;
                    assert!(q > 0.5 || least - first <= slack && last - most <= slack, "{pixel} {q}");
                }
            }
        }
    }

    #[test]
    fn nearer_spheres_cover_what_farther_ones_do() {
        let axis = Axis::new(200.0, 159.5, 320, 20, 1.0);
        let mut previous = window(&axis, 100, 0.0);
        for q in (1..=1200).map(|i| i as f32 * 0.001) {
            let next = window(&axis, 100, q);
            assert!(next.0 <= previous.0 && next.1 >= previous.1, "{q}: {previous:?} {next:?}");
            previous = next;
        }
        assert_eq!(previous, (0, 359));
    }

    #[test]
    fn soft_windows_end_at_the_last_soft_value_and_hard_ones_do_not() {
        let axis = Axis::new(200.0, 9.5, 20, 6, 1.0);
        let mut windows = Windows::new(20);
        let ends = |values: &[u16], windows: &mut Windows| {
            axis.windows(&[0.02; 20], windows);
            let before = windows.last.clone();
            windows.end_soft(values, axis.margin_px());
            (before, windows.last.clone())
        };
        let values: Vec<u16> = (0..20).map(|place| if place < 9 && place != 4 { 801 } else { 400 }).collect();
        let (before, after) = ends(&values, &mut windows);
        for place in 0..20 {
            let is_soft = values[place] & 1 == 1;
            assert_eq!(after[place], if is_soft { before[place].min(8 + 6) } else { before[place] }, "{place}");
            assert!(windows.first[place] <= after[place]);
        }
        assert_eq!(before[8], 8 + 6 + 5, "one ends farther on without");
        let (before, after) = ends(&[400; 20], &mut windows);
        assert_eq!(before, after);
    }
}
