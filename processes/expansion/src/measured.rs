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
/// `limit_m`. A few returns on the way, such as the top edge of that wall or a twig before the sky, do not end the
/// column, but the nearest of them counts. A column without a foot, such as a blank wall that fills the view, grants
/// nothing.
/// Blank objects that hang in the air are not covered; memory asks for a second view with parallax.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BackgroundRule {
    /// Range never exceeded, m; 0 switches the rule off.
    pub limit_m: f32,
    /// Share of the depth of the first return below, 0..1.
    pub share: f32,
    /// Least share of textureless rather than unmatched pixels, in every stretch between returns, 0..1.
    pub textureless_share: f32,
}

impl BackgroundRule {
    pub(crate) fn check(&self, bounds: &mut Bounds) {
        bounds.range("limit_m", self.limit_m, 0.0..=50.0);
        bounds.range("share", self.share, 0.0..=0.9);
        bounds.range("textureless_share", self.textureless_share, 0.5..=1.0);
    }
}

/// More returns than this, one above the other, are the foot of a column of sky: an edge before the sky returns up to
/// the height of the matcher's window and of a filled hole.
const FOOT: usize = 12;
/// So many of its topmost returns decide what the column is worth.
const RETURNS_BELOW: usize = 4;

/// Fills runs of codes between two disparities with the nearer of the two, where the run is explained: by at most
/// `longest` stray pixels, or, along a row, by the shadow that a surface casts in the right image on a farther one to its
/// left, which is as wide as their disparities differ. What is not explained stays unknown.
pub(crate) fn fill_holes(line: &mut [u16], longest: usize, casts_shadows: bool) {
    let mut run = 0;
    let mut before = NO_MATCH;
    for index in 0..line.len() {
        let pixel = line[index];
        if !is_valid(pixel) {
            run += 1;
            continue;
        }
        let shadow = if casts_shadows { usize::from(pixel.saturating_sub(before)) / SCALE as usize } else { 0 };
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
    let (mut sky, mut nearest, mut is_open) = (0, NO_MATCH, false);
    let has_foot = loop {
        let rest = &column[sky..];
        let open = rest.iter().take_while(|&&pixel| !is_valid(pixel)).count();
        let textureless = rest[..open].iter().filter(|&&pixel| pixel == TEXTURELESS).count();
        // Every stretch between returns must pass: something unmatched below a twig is not sky.
        if (textureless as f32) < rule.textureless_share * open as f32 {
            return;
        }
        is_open |= open > 0;
        let returns = rest[open..].iter().take_while(|&&pixel| is_valid(pixel)).count();
        let is_foot = returns > FOOT;
        let decide = if is_foot { RETURNS_BELOW } else { returns };
        nearest = rest[open..open + decide].iter().fold(nearest, |nearest, &pixel| nearest.max(pixel));
        sky += open;
        if is_foot || returns == 0 {
            break is_foot;
        }
        sky += returns;
    };
    if !has_foot || !is_open {
        return;
    }
    let depth_m = rig.depth_m(f64::from(f32::from(nearest) / SCALE));
    let range_m = (f64::from(rule.share) * depth_m).min(f64::from(rule.limit_m));
    if range_m > 0.0 {
        let soft = soft_key(rig, range_m);
        keys[..sky].iter_mut().filter(|key| **key == 0).for_each(|key| *key = soft);
    }
}

/// Distance in pixels to the nearest pixel without a key (`u16::MAX` where there is none): the larger of the
/// horizontal distance and `stretch` (at least 1) times the vertical one, never more than that. A body that is wider
/// than high by `stretch` and fits sideways then fits upwards too.
pub(crate) fn distance_to_unmeasured(keys: &[u16], width: usize, stretch: f32, distance: &mut [u16]) {
    let height = keys.len() / width;
    // Rows lie whole pixels apart that sum up to the stretched height, so that distances stay whole too.
    let step = |row: usize| ((row as f32 * stretch) as usize - ((row - 1) as f32 * stretch) as usize).max(1);
    for row in 0..height {
        for column in 0..width {
            let index = row * width + column;
            let left = if column > 0 { distance[index - 1].saturating_add(1) } else { u16::MAX };
            let above = if row > 0 { from_row(distance, width, row - 1, column, step(row)) } else { u16::MAX };
            distance[index] = if keys[index] == 0 { 0 } else { left.min(above) };
        }
    }
    for row in (0..height).rev() {
        for column in (0..width).rev() {
            let index = row * width + column;
            let right = if column + 1 < width { distance[index + 1].saturating_add(1) } else { u16::MAX };
            let below =
                if row + 1 < height { from_row(distance, width, row + 1, column, step(row + 1)) } else { u16::MAX };
            distance[index] = distance[index].min(right.min(below));
        }
    }
    // The sum of rounded steps exceeds the stretched height by less than a pixel.
    if stretch.fract() != 0.0 {
        distance.iter_mut().filter(|distance| **distance > 1).for_each(|distance| *distance -= 1);
    }
}

/// Least distance by way of a row `step` away, from which that many columns to either side are as near.
#[inline(always)]
fn from_row(distance: &[u16], width: usize, row: usize, column: usize, step: usize) -> u16 {
    let line = &distance[row * width..(row + 1) * width];
    let (from, to) = (column.saturating_sub(step), (column + step + 1).min(width));
    line[from..to].iter().copied().fold(u16::MAX, u16::min).saturating_add(step as u16)
}

/// The vehicle's body as a cylinder about the vertical, for cameras that look about level.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Body {
    pub(crate) radius_m: f32,
    pub(crate) half_height_m: f32,
}

/// What was measured around a pixel: so many pixels to either side, up and down, and the slopes of its ray.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Clear {
    pub(crate) across_px: f32,
    pub(crate) up_px: f32,
    pub(crate) x: f32,
    pub(crate) y: f32,
}

/// Near limit: the disparity up to which a body on the pixel's ray stays within what is clear around it.
///
/// With q = radius/depth and the slope m of what is clear, sideways the cylinder's circle is within it while
/// (q·c + q²·|x|)/(1 − q²) ≤ m, where c = √(1 + x²): the left side bounds both tangents of [`crate::window`].
/// Upwards its near rim is while (|y| + q·h/r)/(1 − q) − |y| ≤ m.
#[inline(always)]
pub(crate) fn near_limit(rig: &StereoRig, body: Body, clear: Clear) -> u16 {
    // From a point anywhere in its pixel to the near side of the pixel that far away.
    let slope = |pixels: f32| (pixels - 1.0) / rig.focal_px as f32;
    if clear.across_px <= 1.0 || clear.up_px <= 1.0 {
        return 0;
    }
    let (across, up) = (slope(clear.across_px), slope(clear.up_px));
    let a = clear.x.abs() + across;
    let c = (1.0 + clear.x * clear.x).sqrt();
    // The root without the cancellation: 2m/(c + √) for (√ − c)/2a.
    let q_across = 2.0 * across / (c + (c * c + 4.0 * a * across).sqrt());
    let q_up = up / (clear.y.abs() + body.half_height_m / body.radius_m + up);
    let limit_px = q_across.min(q_up) * rig.focal_baseline_px_m() as f32 / body.radius_m - rig.doffs_px as f32;
    (limit_px * SCALE).floor() as u16
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Config;
    use ipc_types::disparity::encode;
    use ipc_types::noise::NoiseModel;

    #[test]
    fn short_holes_take_the_nearer_end_and_long_ones_stay() {
        let holed = [100, 0, 1, 300, 0, 0, 0, 0, 0, 0, 50, 0];
        let mut line = holed;
        fill_holes(&mut line, 2, false);
        assert_eq!(line, [100, 300, 300, 300, 0, 0, 0, 0, 0, 0, 50, 0]);
        // 300 and 50 are 3 px apart: a shadow of 3 px and 2 stray pixels explain 5, not 6.
        let mut line = [50, 0, 0, 0, 0, 0, 0, 300, 300, 0, 0, 0, 0, 50];
        fill_holes(&mut line, 2, true);
        assert_eq!(line[1..7], [0; 6]);
        fill_holes(&mut line, 3, true);
        assert_eq!(line[1..7], [300; 6]);
        assert_eq!(line[9..13], [0; 4], "no shadow falls to the right");
    }

    #[test]
    fn a_thin_edge_does_not_end_the_sky_but_what_is_unmatched_below_it_does() {
        let rig = StereoRig {
            width_px: 4,
            height_px: 200,
            focal_px: 200.0,
            cx_px: 1.5,
            cy_px: 99.5,
            baseline_m: 0.3,
            doffs_px: 0.0,
        };
        let noise =
            NoiseModel { sigma_px: 0.3, sigma_m: 0.0, lambda_near: 3.0, lambda_far: 1.0, near_px: 6.0, far_px: 1.5 };
        let rule = BackgroundRule { limit_m: 50.0, share: 0.7, textureless_share: 0.8 };
        let body = (0.3, 0.15);
        let config =
            Config { radius_m: 0.5, body_radius_m: body.0, body_half_height_m: body.1, hole_px: 0, background: rule };
        let tables = Tables::new(&rig, &noise, &config);
        let at = |depth_m: f64| encode(rig.disparity_px(depth_m) as f32);
        let granted = |stretches: &[(u16, usize)]| {
            let column: Vec<u16> = stretches.iter().flat_map(|&(pixel, count)| vec![pixel; count]).collect();
            let mut keys = vec![0; column.len()];
            column_keys(&column, &tables, &rig, &rule, &mut keys);
            (keys[0], keys[column.len() - 40])
        };
        let (edge, foot) = ((at(20.0), 6), (at(15.0), 40));
        let sky = soft_key(&rig, 0.7 * f64::from(rig.depth_m(f64::from(f32::from(at(15.0)) / SCALE)) as f32));
        let (above, _) = granted(&[(TEXTURELESS, 100), edge, (TEXTURELESS, 20), foot]);
        assert!(above.abs_diff(sky) <= 2, "{above} {sky}");
        let (near_edge, _) = granted(&[(TEXTURELESS, 100), (at(5.0), 6), (TEXTURELESS, 20), foot]);
        assert!(near_edge > 2 * sky, "the nearest return decides: {near_edge}");
        assert_eq!(granted(&[(TEXTURELESS, 100), edge, (NO_MATCH, 20), foot]).0, 0, "something hangs below the edge");
        assert_eq!(granted(&[(TEXTURELESS, 100), edge, (TEXTURELESS, 60)]).0, 0, "no foot");
        assert_eq!(granted(&[(TEXTURELESS, 100), (at(5.0), FOOT), (TEXTURELESS, 60)]).0, 0, "too low for a foot");
    }

    #[test]
    fn distance_is_the_larger_of_both_axes_and_never_too_large() {
        let (width, height) = (31, 27);
        let mut keys = vec![50; width * height];
        keys[13 * width + 14] = 0;
        for stretch in [1.0_f32, 1.4, 1.667, 2.0, 3.3] {
            let mut distance = vec![0; keys.len()];
            distance_to_unmeasured(&keys, width, stretch, &mut distance);
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
