//! What of the image was measured: holes and clear sky.

use crate::tables::Tables;
use ipc_types::StereoRig;
use ipc_types::bounds::Bounds;
use ipc_types::disparity::{NO_MATCH, SCALE, TEXTURED, TEXTURELESS, is_valid};
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
///
/// What is textured throughout such a shadow has no match because it is hidden, as a rule, and so lies no nearer than what
/// hides it there: `k` px to the left of a surface at disparity `d` only what has `d − k` at most is hidden from the right
/// camera. It takes that, with `longest` stray pixels for where the edge is: `d` at first, then `d − (k − longest)`. Blank
/// things have no match whether hidden or not, so that a shadow with any of them takes the nearer end.
pub(crate) fn fill_holes(line: &mut [u16], longest: usize, casts_shadows: bool) {
    let (mut run, mut textured) = (0, 0);
    let mut before = NO_MATCH;
    for index in 0..line.len() {
        let pixel = line[index];
        if !is_valid(pixel) {
            run += 1;
            textured += usize::from(pixel == TEXTURED);
            continue;
        }
        let shadow = if casts_shadows { usize::from(pixel.saturating_sub(before)) / SCALE as usize } else { 0 };
        if run > 0 && run <= longest + shadow && is_valid(before) {
            let is_hidden = run > longest && textured == run;
            for (place, hidden) in (1_usize..).zip(line[index - run..index].iter_mut().rev()) {
                let nearest =
                    if is_hidden { pixel - (place.saturating_sub(longest) * SCALE as usize) as u16 } else { pixel };
                *hidden = before.max(nearest);
            }
        }
        (run, textured, before) = (0, 0, pixel);
    }
}

/// Values of one column: hard where there is a disparity, soft where the far-background rule grants a range, else 0.
pub(crate) fn column_values(
    column: &[u16],
    tables: &Tables,
    rig: &StereoRig,
    rule: &BackgroundRule,
    values: &mut [u16],
) {
    for (value, &pixel) in values.iter_mut().zip(column) {
        *value = tables.hard(pixel);
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
        let soft = tables.soft(range_m);
        values[..sky].iter_mut().filter(|value| **value == 0).for_each(|value| *value = soft);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ipc_types::disparity::{MINIMUM, encode};
    use ipc_types::noise::NoiseModel;
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64Mcg;

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
    fn what_is_filled_lies_between_the_ends_and_never_beyond_what_can_be_hidden() {
        let mut random = Pcg64Mcg::seed_from_u64(7);
        for _ in 0..20_000 {
            let any = |random: &mut Pcg64Mcg| match random.random_range(0..3) {
                0 => random.random_range(MINIMUM..640),
                1 => random.random_range(u16::MAX - 640..=u16::MAX),
                _ => random.random_range(MINIMUM..=u16::MAX),
            };
            let (before, after, longest) = (any(&mut random), any(&mut random), random.random_range(0..6_usize));
            let shadow = usize::from(after.saturating_sub(before) / SCALE as u16);
            // As long as is explained, one longer, or any.
            let run = [longest + shadow, longest + shadow + 1, 40][random.random_range(0..3_usize)].min(1100);
            let mut line = [&[before][..], &vec![TEXTURED; run], &[after]].concat();
            fill_holes(&mut line, longest, true);
            for (place, &filled) in (1_usize..).zip(line[1..=run].iter().rev()) {
                if run > longest + shadow {
                    assert_eq!(filled, TEXTURED);
                    continue;
                }
                let hidden = i64::from(after) - (place * SCALE as usize) as i64;
                assert!((before.min(after)..=before.max(after)).contains(&filled), "{before} {filled} {after}");
                assert!(i64::from(filled) >= hidden, "{place}: {filled}, {hidden}");
            }
        }
    }

    #[test]
    fn a_shadow_on_something_textured_takes_what_it_can_hide() {
        let px = |disparity_px: u16| disparity_px * SCALE as u16;
        let shadowed = |code: u16| {
            let mut line = [&[px(2)][..], &[TEXTURED; 4], &[code], &[TEXTURED; 3], &[px(10)]].concat();
            fill_holes(&mut line, 2, true);
            line[1..9].iter().map(|pixel| pixel / SCALE as u16).collect::<Vec<_>>()
        };
        // From the right: 2 stray pixels of the edge, then one px of disparity less with every pixel.
        assert_eq!(shadowed(TEXTURED), [4, 5, 6, 7, 8, 9, 10, 10]);
        assert_eq!(shadowed(TEXTURELESS), [10; 8], "something blank may stand there");
        assert_eq!(shadowed(NO_MATCH), [10; 8]);
        let mut column = [&[px(2)][..], &[TEXTURED; 8], &[px(10)]].concat();
        fill_holes(&mut column, 2, false);
        assert_eq!(column[1..9], [TEXTURED; 8], "no shadow falls upwards");
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
        let tables = Tables::new(rig, noise, 0.5);
        let at = |depth_m: f64| encode(rig.disparity_px(depth_m) as f32);
        let granted = |stretches: &[(u16, usize)]| {
            let column: Vec<u16> = stretches.iter().flat_map(|&(pixel, count)| vec![pixel; count]).collect();
            let mut values = vec![0; column.len()];
            column_values(&column, &tables, &rig, &rule, &mut values);
            (values[0], values[column.len() - 40])
        };
        let (edge, foot) = ((at(20.0), 6), (at(15.0), 40));
        let sky = tables.soft(0.7 * f64::from(rig.depth_m(f64::from(f32::from(at(15.0)) / SCALE)) as f32));
        let (above, _) = granted(&[(TEXTURELESS, 100), edge, (TEXTURELESS, 20), foot]);
        assert!(above.abs_diff(sky) <= 2, "{above} {sky}");
        let (near_edge, _) = granted(&[(TEXTURELESS, 100), (at(5.0), 6), (TEXTURELESS, 20), foot]);
        assert!(near_edge > 2 * sky, "the nearest return decides: {near_edge}");
        assert_eq!(granted(&[(TEXTURELESS, 100), edge, (NO_MATCH, 20), foot]).0, 0, "something hangs below the edge");
        assert_eq!(granted(&[(TEXTURELESS, 100), edge, (TEXTURELESS, 60)]).0, 0, "no foot");
        assert_eq!(granted(&[(TEXTURELESS, 100), (at(5.0), FOOT), (TEXTURELESS, 60)]).0, 0, "too low for a foot");
    }
}
