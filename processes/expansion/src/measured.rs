//! What of the image was measured: holes, clear sky, and how far the next unmeasured pixel is.

use crate::tables::{Tables, soft_key};
use ipc_types::StereoRig;
use ipc_types::bounds::Bounds;
use ipc_types::disparity::{NO_MATCH, SCALE, TEXTURELESS, is_valid};
use serde::{Deserialize, Serialize};

/// The far-background rule: what a column of textureless pixels that reaches the image's top is worth.
///
/// Anything that stands on the ground meets it no nearer than the first return below the column: a blank wall ends
/// at its foot. So the column grants free space up to `share` of that return's depth, and never beyond
/// `limit_m`. A column without a return below it, such as a blank wall that fills the view, grants nothing.
/// Blank objects that hang in the air are not covered; memory asks for a second view with parallax.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BackgroundRule {
    /// Range never exceeded, m; 0 switches the rule off.
    pub limit_m: f32,
    /// Share of the depth of the first return below, 0..1.
    pub share: f32,
    /// Least share of the column's pixels that must be textureless rather than unmatched, 0..1.
    pub textureless_share: f32,
}

impl BackgroundRule {
    pub(crate) fn check(&self, bounds: &mut Bounds) {
        bounds.range("limit_m", self.limit_m, 0.0..=50.0);
        bounds.range("share", self.share, 0.0..=0.9);
        bounds.range("textureless_share", self.textureless_share, 0.5..=1.0);
    }
}

/// Pixels below a column of sky whose nearest return decides the grant.
const RETURNS_BELOW: usize = 4;

/// Fills runs of codes between two disparities with the nearer of the two, where the run is explained: by at most
/// `longest` stray pixels, or, along a row, by the shadow that the nearer surface casts on the farther one in the
/// right image, which is as wide as their disparities differ. What is not explained stays unknown.
pub(crate) fn fill_holes(line: &mut [u16], longest: usize, casts_shadows: bool) {
    let mut run = 0;
    let mut before = NO_MATCH;
    for index in 0..line.len() {
        let pixel = line[index];
        if !is_valid(pixel) {
            run += 1;
            continue;
        }
        let shadow = if casts_shadows { usize::from(before.abs_diff(pixel)) / SCALE as usize } else { 0 };
        if run > 0 && run <= longest + shadow && is_valid(before) {
            line[index - run..index].fill(before.max(pixel));
        }
        (run, before) = (0, pixel);
    }
}

/// Keys of one column: hard where there is a disparity, soft where the far-background rule grants a range, else 0.
pub(crate) fn column_keys(column: &[u16], tables: &Tables, rig: &StereoRig, rule: &BackgroundRule, keys: &mut [u16]) {
    for (key, &pixel) in keys.iter_mut().zip(column) {
        *key = tables.hard_key(pixel);
    }
    let sky = column.iter().position(|&pixel| is_valid(pixel)).unwrap_or(0);
    let textureless = column[..sky].iter().filter(|&&pixel| pixel == TEXTURELESS).count();
    if sky == 0 || (textureless as f32) < rule.textureless_share * sky as f32 {
        return;
    }
    let below = column[sky..].iter().take(RETURNS_BELOW).copied().max().unwrap_or(NO_MATCH);
    let depth_m = rig.depth_m(f64::from(f32::from(below) / SCALE));
    let range_m = (f64::from(rule.share) * depth_m).min(f64::from(rule.limit_m));
    if range_m > 0.0 {
        keys[..sky].fill(soft_key(rig, range_m));
    }
}

/// Chebyshev distance in pixels to the nearest pixel without a key (`u16::MAX` where there is none).
pub(crate) fn distance_to_unmeasured(keys: &[u16], width: usize, distance: &mut [u16]) {
    let height = keys.len() / width;
    for row in 0..height {
        for column in 0..width {
            let index = row * width + column;
            let left = if column > 0 { distance[index - 1] } else { u16::MAX };
            let above = if row > 0 { least_of_three(distance, width, row - 1, column) } else { u16::MAX };
            distance[index] = if keys[index] == 0 { 0 } else { left.min(above).saturating_add(1) };
        }
    }
    for row in (0..height).rev() {
        for column in (0..width).rev() {
            let index = row * width + column;
            let right = if column + 1 < width { distance[index + 1] } else { u16::MAX };
            let below = if row + 1 < height { least_of_three(distance, width, row + 1, column) } else { u16::MAX };
            distance[index] = distance[index].min(right.min(below).saturating_add(1));
        }
    }
}

/// Least of a pixel and its two neighbours in its row.
#[inline(always)]
fn least_of_three(distance: &[u16], width: usize, row: usize, column: usize) -> u16 {
    let line = &distance[row * width..(row + 1) * width];
    let (from, to) = (column.saturating_sub(1), (column + 2).min(width));
    line[from..to].iter().copied().fold(u16::MAX, u16::min)
}

/// Near limit: the disparity up to which a ball of `radius_m` on the ray with slope `x` (the larger of the two
/// axes) stays within `clear_px` pixels of it. Solves (q·c + q²·|x|)/(1 − q²) = m for q = radius/depth, where
/// c = √(1 + x²) and m the slope of `clear_px`; the left side bounds both tangents of [`crate::window`].
#[inline(always)]
pub(crate) fn near_limit(rig: &StereoRig, radius_m: f32, clear_px: u16, x: f32) -> u16 {
    if clear_px == 0 {
        return 0;
    }
    let m = (f32::from(clear_px) - 0.5) / rig.focal_px as f32;
    let a = x.abs() + m;
    let c = (1.0 + x * x).sqrt();
    let q = ((c * c + 4.0 * a * m).sqrt() - c) / (2.0 * a);
    let limit_px = q * rig.focal_baseline_px_m() as f32 / radius_m - rig.doffs_px as f32;
    (limit_px * SCALE).floor() as u16
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn short_holes_take_the_nearer_end_and_long_ones_stay() {
        let holed = [100, 0, 1, 300, 0, 0, 0, 0, 0, 0, 50, 0];
        let mut line = holed;
        fill_holes(&mut line, 2, false);
        assert_eq!(line, [100, 300, 300, 300, 0, 0, 0, 0, 0, 0, 50, 0]);
        // 300 and 50 are 3 px apart: a shadow of 3 px and 2 stray pixels explain 5, not 6.
        fill_holes(&mut line, 2, true);
        assert_eq!(line[4..10], [0; 6]);
        fill_holes(&mut line, 3, true);
        assert_eq!(line[4..10], [300; 6]);
    }

    #[test]
    fn distance_is_chebyshev() {
        let (width, height) = (9, 7);
        let mut keys = vec![50; width * height];
        keys[3 * width + 4] = 0;
        let mut distance = vec![0; keys.len()];
        distance_to_unmeasured(&keys, width, &mut distance);
        for row in 0..height {
            for column in 0..width {
                let hole = row.abs_diff(3).max(column.abs_diff(4));
                assert_eq!(usize::from(distance[row * width + column]), hole, "{row} {column}");
            }
        }
    }
}
