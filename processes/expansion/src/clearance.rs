//! How far around a pixel all is clear, and how near a body may therefore be.

use ipc_types::StereoRig;
use ipc_types::disparity::SCALE;
use ipc_types::rounding::to_nearest;
use multiversion::multiversion;

/// The vehicle's body as a cylinder about the vertical, for cameras that look about level.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Body {
    pub(crate) radius_m: f32,
    pub(crate) half_height_m: f32,
}

/// Rows higher than this are not told apart: a flatter body is treated as if it were so high.
const MOST_STRETCH: f32 = 8.0;

/// For every pixel the disparity up to which a body on its ray stays within what is clear around it.
#[derive(Debug)]
pub(crate) struct Clearance {
    width: usize,
    /// Height of a row in the distance that is measured: a body that is wider than high by this and fits sideways then
    /// fits upwards too.
    stretch: f32,
    /// Of every column: |slope| and √(1 + slope²).
    columns: Vec<[f32; 2]>,
    /// Of every row: |slope|.
    rows: Vec<f32>,
    focal_px: f32,
    /// f·b over the body's radius, and half of the body's height over its radius.
    focal_baseline_per_radius: f32,
    height_per_radius: f32,
    doffs_px: f32,
    distance: Vec<u16>,
    /// A row of distances between two margins that are never nearer.
    padded: Vec<u16>,
}

impl Clearance {
    pub(crate) fn new(rig: &StereoRig, body: Body) -> Self {
        let (width, focal_px) = (rig.width_px as usize, rig.focal_px as f32);
        let slope = |pixel: u32, centre: f64| ((f64::from(pixel) - centre) / rig.focal_px).abs() as f32;
        let column = |column| {
            let x = slope(column, rig.cx_px);
            [x, (1.0 + x * x).sqrt()]
        };
        let stretch = (body.radius_m / body.half_height_m).clamp(1.0, MOST_STRETCH);
        Self {
            columns: (0..rig.width_px).map(column).collect(),
            rows: (0..rig.height_px).map(|row| slope(row, rig.cy_px)).collect(),
            focal_baseline_per_radius: rig.focal_baseline_px_m() as f32 / body.radius_m,
            height_per_radius: body.half_height_m / body.radius_m,
            doffs_px: rig.doffs_px as f32,
            distance: vec![0; rig.pixels()],
            padded: vec![u16::MAX; width + 2 * (stretch.ceil() as usize)],
            width,
            stretch,
            focal_px,
        }
    }

    /// Limits of an image in which everything is clear but what lies beyond the border, and what `most` says.
    pub(crate) fn border_limits(&mut self, most: impl Fn(usize, usize) -> u16) -> Vec<u16> {
        let (width, height, stretch) = (self.width, self.rows.len(), self.stretch);
        let to_border = |pixel: usize, length: usize| (pixel + 1).min(length - pixel);
        for (index, distance) in self.distance.iter_mut().enumerate() {
            let (row, column) = (index / width, index % width);
            let up = (to_border(row, height) as f32 * stretch) as usize;
            *distance = to_border(column, width).min(up).min(usize::from(u16::MAX)) as u16;
        }
        let unlimited: Vec<u16> = (0..self.distance.len()).map(|index| most(index / width, index % width)).collect();
        let mut limits = vec![0; unlimited.len()];
        self.write_limits(&unlimited, &mut limits);
        limits
    }

    /// Writes the limits, none above `most`, of an image in which the pixels that hold 0 are not clear.
    pub(crate) fn step(&mut self, values: &[u16], most: &[u16], limits: &mut [u16]) {
        distances(values, self.width, self.stretch, &mut self.padded, &mut self.distance);
        self.write_limits(most, limits);
    }

    fn write_limits(&self, most: &[u16], limits: &mut [u16]) {
        let lines = self.distance.chunks_exact(self.width).zip(most.chunks_exact(self.width));
        for ((limits, (distance, most)), &y) in limits.chunks_exact_mut(self.width).zip(lines).zip(&self.rows) {
            write_row(self, y, distance, most, limits);
        }
    }
}

/// With q = radius/depth and the slope m of what is clear, sideways the cylinder's circle is within it while
/// (q·c + q²·|x|)/(1 − q²) ≤ m, where c = √(1 + x²): the left side bounds both tangents of [`crate::window`].
/// Upwards its near rim is while (|y| + q·h/r)/(1 − q) − |y| ≤ m.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512vl", "x86_64+avx2+fma", "x86_64+sse4.1", "aarch64+neon"))]
fn write_row(clearance: &Clearance, y: f32, distance: &[u16], most: &[u16], limits: &mut [u16]) {
    let (per_focal, per_stretch) = (1.0 / clearance.focal_px, 1.0 / clearance.stretch);
    let pixels = limits.iter_mut().zip(distance).zip(most).zip(&clearance.columns);
    for (((limit, &distance), &most), &[x, c]) in pixels {
        // From a point anywhere in its pixel to the near side of the pixel that far away.
        let across = (f32::from(distance) - 1.0).max(0.0) * per_focal;
        let up = (f32::from(distance) * per_stretch - 1.0).max(0.0) * per_focal;
        // The root without the cancellation: 2m/(c + √) for (√ − c)/2a.
        let q_across = 2.0 * across / (c + (c * c + 4.0 * (x + across) * across).sqrt());
        let q_up = up / (y + clearance.height_per_radius + up);
        let limit_px = q_across.min(q_up) * clearance.focal_baseline_per_radius - clearance.doffs_px;
        // To the nearest of half less: never up.
        let fixed = to_nearest((limit_px * SCALE - 0.5).max(0.0).min(f32::from(u16::MAX))) as u16;
        *limit = if across > 0.0 && up > 0.0 { fixed.min(most) } else { 0 };
    }
}

/// Distance in pixels to the nearest pixel that holds 0 (`u16::MAX` where there is none): the larger of the horizontal
/// distance and `stretch` (at least 1) times the vertical one, never more than that.
///
/// A way along a row, then down or up with a step aside in every row, is the shortest: rows are scanned first, then
/// handed down, then up.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512vl", "x86_64+avx2+fma", "x86_64+sse4.1", "aarch64+neon"))]
fn distances(values: &[u16], width: usize, stretch: f32, padded: &mut [u16], distance: &mut [u16]) {
    let height = values.len() / width;
    // Rows lie whole pixels apart that sum up to the stretched height, so that distances stay whole too.
    let step = |row: usize| ((row as f32 * stretch) as usize - ((row - 1) as f32 * stretch) as usize).max(1);
    for (distance, values) in distance.chunks_exact_mut(width).zip(values.chunks_exact(width)) {
        scan_row(values, distance);
    }
    for row in 1..height {
        let (before, this) = distance.split_at_mut(row * width);
        hand_on(&before[(row - 1) * width..], &mut this[..width], step(row), padded);
    }
    for row in (1..height).rev() {
        let (before, this) = distance.split_at_mut(row * width);
        hand_on(&this[..width], &mut before[(row - 1) * width..], step(row), padded);
    }
    // The sum of rounded steps exceeds the stretched height by less than a pixel.
    if stretch.fract() != 0.0 {
        distance.iter_mut().for_each(|distance| *distance -= u16::from(*distance > 1));
    }
}

/// Distances along one row, both ways.
#[inline(always)]
fn scan_row(values: &[u16], distance: &mut [u16]) {
    if values.iter().fold(u16::MAX, |least, &value| least.min(value)) > 0 {
        distance.fill(u16::MAX);
        return;
    }
    let mut last = u16::MAX;
    for (distance, &value) in distance.iter_mut().zip(values) {
        last = if value == 0 { 0 } else { last.saturating_add(1) };
        *distance = last;
    }
    let mut last = u16::MAX;
    for distance in distance.iter_mut().rev() {
        last = last.saturating_add(1).min(*distance);
        *distance = last;
    }
}

/// Least distance by way of a row `step` away, from which that many columns to either side are as near.
#[inline(always)]
fn hand_on(from: &[u16], to: &mut [u16], step: usize, padded: &mut [u16]) {
    let margin = (padded.len() - from.len()) / 2;
    padded[margin..margin + from.len()].copy_from_slice(from);
    for aside in margin - step..=margin + step {
        for (to, &from) in to.iter_mut().zip(&padded[aside..]) {
            *to = (*to).min(from.saturating_add(step as u16));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distance_is_the_larger_of_both_axes_and_never_too_large() {
        let (width, height) = (31, 27);
        let mut values = vec![50; width * height];
        values[13 * width + 14] = 0;
        for stretch in [1.0_f32, 1.4, 1.667, 2.0, 3.3] {
            let mut distance = vec![0; values.len()];
            let mut padded = vec![u16::MAX; width + 2 * (stretch.ceil() as usize)];
            distances(&values, width, stretch, &mut padded, &mut distance);
            for row in 0..height {
                for column in 0..width {
                    let (across, up) = (column.abs_diff(14) as f32, row.abs_diff(13) as f32 * stretch);
                    let (exact, found) = (across.max(up), f32::from(distance[row * width + column]));
                    assert!(
                        found <= exact && found > exact - 2.0 - f32::from(stretch.fract() != 0.0),
                        "{row} {column}: {found}"
                    );
                    assert!(stretch.fract() != 0.0 || found == exact, "{row} {column}: {found}");
                }
            }
        }
    }
}
