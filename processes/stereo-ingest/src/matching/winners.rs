//! From a row's winners to disparities: left-right consistency, bridging, sub-pixel.

use ipc_types::disparity::{MINIMUM, NO_MATCH, SCALE};

/// What a winner must satisfy.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Consistency {
    /// Largest difference between a match and the one that the right pixel prefers, px.
    pub(crate) left_right_px: u16,
    /// Longest run of inconsistent pixels that may keep their winners, if these continue both neighbours.
    pub(crate) bridge_px: usize,
}

/// Largest difference between a bridged pixel and the ends of its run, fixed point.
const BRIDGE_STEP: u16 = 2 * SCALE as u16;
/// Columns left of the image, for matches outside of it: no disparity is larger, px.
const MARGIN: usize = 256;

/// Added to a winner that is not unique.
pub(crate) const AMBIGUOUS: u16 = 1 << 15;

/// No left pixel may match here.
const NOBODY: u16 = u16::MAX;

/// Winners of a row, and scratch.
#[derive(Debug)]
pub(crate) struct Winners {
    /// By column: the disparity of the least cost, perhaps with [`AMBIGUOUS`].
    winners: Vec<u16>,
    /// Summed costs of the last few columns, `stride` each with a margin of [`AHEAD`] on both sides; `range` mean something.
    sums: Vec<u8>,
    stride: usize,
    range: usize,
    /// By right column, after the margin: the least cost that points to it, above the disparity it has.
    right: Vec<u16>,
    /// Bytes from the lowest: the sums below, at and above the winner.
    around: Vec<u32>,
    /// What the right column prefers that the winner points to, as in `right`.
    opposite: Vec<u16>,
    /// Disparities of all winners, consistent or not.
    found: Vec<u16>,
}

/// Bytes before and after the sums, so that four bytes from the one below any winner can be read.
const AHEAD: usize = 4;
/// Columns whose sums are kept. They are looked at when half as many more have been written: a read right after the write
/// would have to wait for it, and sums of a whole row would not stay in the nearest cache.
const KEPT: usize = 8;

impl Winners {
    pub(crate) fn new(width: usize, stride: usize, range: usize) -> Self {
        Self {
            winners: vec![0; width],
            sums: vec![u8::MAX; KEPT * (AHEAD + stride + AHEAD)],
            stride: AHEAD + stride + AHEAD,
            range,
            right: vec![0; MARGIN + width],
            around: vec![0; width],
            opposite: vec![0; width],
            found: vec![NO_MATCH; width],
        }
    }

    /// Where to put a column's sums and its winner, column by column from the first on.
    #[inline(always)]
    pub(crate) fn pixel(&mut self, x: usize) -> (&mut [u8], &mut u16) {
        if x >= KEPT / 2 {
            self.look_around(x - KEPT / 2);
        }
        let start = (x % KEPT) * self.stride + AHEAD;
        (&mut self.sums[start..start + self.stride - 2 * AHEAD], &mut self.winners[x])
    }

    /// Keeps the sums below, at and above a column's winner.
    #[inline(always)]
    fn look_around(&mut self, x: usize) {
        let disparity = usize::from(self.winners[x] & !AMBIGUOUS);
        let bytes = self.sums[(x % KEPT) * self.stride + AHEAD - 1 + disparity..].first_chunk();
        self.around[x] = u32::from_le_bytes(bytes.copied().unwrap_or_default());
    }

    /// Writes the row's disparities. Right columns that are not zero in `blank` have no texture: a match with one is
    /// none, since smoothness alone put it there.
    #[inline(always)]
    pub(crate) fn finish(&mut self, rules: Consistency, blank: &[u16], out: &mut [u16]) {
        let width = self.winners.len();
        (width.saturating_sub(KEPT / 2)..width).for_each(|x| self.look_around(x));
        self.right.fill(NOBODY);
        for (x, (&winner, &around)) in self.winners.iter().zip(&self.around).enumerate() {
            let disparity = winner & !AMBIGUOUS;
            let [_, cost, ..] = around.to_le_bytes();
            let right = &mut self.right[MARGIN + x - usize::from(disparity)];
            *right = (*right).min(u16::from(cost) << 8 | disparity);
        }
        for (right, &blank) in self.right[MARGIN..].iter_mut().zip(blank) {
            *right = if blank == 0 { *right } else { NOBODY };
        }
        let last = self.range as u16 - 1;
        for ((&winner, &around), found) in self.winners.iter().zip(&self.around).zip(&mut self.found) {
            let [below, cost, above, _] = around.to_le_bytes();
            let disparity = winner & !AMBIGUOUS;
            let inside = disparity > 0 && disparity < last && below != u8::MAX && above != u8::MAX;
            *found = fixed_point(disparity, below, cost, above, inside);
        }
        // Looked up apart from what follows, so that only this takes the columns one by one.
        for (x, (&winner, opposite)) in self.winners.iter().zip(&mut self.opposite).enumerate() {
            *opposite = self.right[MARGIN + x - usize::from(winner & !AMBIGUOUS)];
        }
        let columns = self.winners.iter().zip(&self.opposite).zip(&mut self.found).zip(out.iter_mut());
        for (x, (((&winner, &opposite), found), out)) in (0_u16..).zip(columns) {
            let disparity = winner & !AMBIGUOUS;
            let is_consistent = (opposite & 0xff).abs_diff(disparity) <= rules.left_right_px;
            // Bridging must not bring it back.
            *found = if opposite == NOBODY { NO_MATCH } else { *found };
            let is_sound = is_consistent && winner < AMBIGUOUS && disparity <= x;
            *out = if is_sound { *found } else { NO_MATCH };
        }
        if rules.bridge_px > 0 {
            self.bridge(rules.bridge_px, out);
        }
    }

    /// Short inconsistent or ambiguous runs whose winners continue what lies on both sides are kept: the right image was
    /// wrong about them, not the left one. A run beside a step in disparity, which is how an occlusion looks, is not.
    #[inline(always)]
    fn bridge(&self, longest: usize, out: &mut [u16]) {
        let near = |a: u16, b: u16| a.abs_diff(b) <= BRIDGE_STEP;
        let mut x = 0;
        while let Some(gap) = out[x..].iter().position(|&pixel| pixel == NO_MATCH) {
            let start = x + gap;
            x = out[start..].iter().position(|&pixel| pixel != NO_MATCH).map_or(out.len(), |length| start + length);
            if start == 0 || x == out.len() || x - start > longest || !near(out[start - 1], out[x]) {
                continue;
            }
            let (before, after) = (out[start - 1], out[x]);
            for ((column, out), &found) in (start..).zip(&mut out[start..x]).zip(&self.found[start..]) {
                let in_image = usize::from(found / SCALE as u16) < column;
                if in_image && near(found, before) && near(found, after) {
                    *out = found;
                }
            }
        }
    }
}

/// Disparity between the steps, rounded to fixed point, as [`ipc_types::disparity::encode`] does.
///
/// The minimum lies where two lines of equal and opposite slope meet that pass through the winner and its neighbours:
/// sums of absolute values are wedges, not parabolas (Shimizu and Okutomi 2005).
#[inline(always)]
fn fixed_point(disparity: u16, below: u8, cost: u8, above: u8, inside: bool) -> u16 {
    let (below, cost, above) = (f32::from(below), f32::from(cost), f32::from(above));
    let slope = below.max(above) - cost;
    let offset = if inside && slope > 0.0 { (below - above) / (2.0 * slope) } else { 0.0 };
    let fixed = ((f32::from(disparity) + offset) * SCALE + 0.5) as i32;
    (fixed as u16).max(MINIMUM)
}

#[cfg(test)]
mod tests {
    use super::*;
    use ipc_types::disparity::decode;

    const RULES: Consistency = Consistency { left_right_px: 1, bridge_px: 4 };

    /// A pixel's winner and the sums at it and around it.
    #[derive(Clone, Copy)]
    struct Pixel(u16, [u8; 3]);

    fn finish(pixels: &[Pixel]) -> Vec<Option<f32>> {
        let mut winners = Winners::new(pixels.len(), 16, 16);
        for (x, Pixel(winner, costs)) in pixels.iter().enumerate() {
            let (sums, out) = winners.pixel(x);
            *out = *winner;
            let disparity = usize::from(winner & !AMBIGUOUS);
            for (sum, cost) in sums[disparity.saturating_sub(1)..].iter_mut().zip(&costs[usize::from(disparity == 0)..])
            {
                *sum = *cost;
            }
        }
        let mut out = vec![0; pixels.len()];
        winners.finish(RULES, &vec![0; pixels.len()], &mut out);
        out.into_iter().map(decode).collect()
    }

    #[test]
    fn finds_the_minimum_between_disparities() {
        // A wedge of slope 20 whose tip lies at 7.25.
        let out = finish(&[Pixel(7, [25, 5, 15]); 40]);
        assert_eq!(out[20], Some(7.25));
        assert!(out[..7].iter().all(Option::is_none), "no right pixel to match with");
        assert_eq!(finish(&[Pixel(15, [25, 5, 15]); 40])[20], Some(15.0), "at the end of the range");
        assert_eq!(finish(&[Pixel(0, [25, 5, 15]); 40])[20], Some(0.25), "and at infinity, which is never reported");
    }

    #[test]
    fn a_blank_right_column_matches_nothing() {
        let mut winners = Winners::new(60, 16, 16);
        for x in 0..60 {
            let (sums, out) = winners.pixel(x);
            *out = 5;
            sums[4..7].copy_from_slice(&[90, 50, 90]);
        }
        let (mut blank, mut out) = (vec![0; 60], vec![0; 60]);
        blank[30..40].fill(1);
        blank[20..22].fill(1);
        winners.finish(RULES, &blank, &mut out);
        assert!(out[35..45].iter().chain(&out[25..27]).all(|&pixel| pixel == NO_MATCH), "nor is it bridged");
        assert!(out[5..25].iter().chain(&out[27..35]).chain(&out[45..]).all(|&pixel| decode(pixel) == Some(5.0)));
    }

    #[test]
    fn what_the_right_image_contradicts_is_unmatched() {
        // Columns 30 to 34 see something at 9 that only the left image sees: what they claim belongs to columns 23 to 27.
        let mut row = [Pixel(2, [90, 50, 90]); 60];
        row[30..35].fill(Pixel(9, [90, 60, 90]));
        let out = finish(&row);
        assert!(out[30..35].iter().all(Option::is_none), "{out:?}");
        assert!(out[2..30].iter().chain(&out[35..]).all(|d| *d == Some(2.0)));
    }

    #[test]
    fn short_gaps_are_bridged_by_their_own_winners_only() {
        let mut row = [Pixel(5, [90, 50, 90]); 60];
        row[30].0 |= AMBIGUOUS;
        row[20] = Pixel(9 | AMBIGUOUS, [90, 50, 90]);
        row[34..36].fill(Pixel(8, [90, 60, 90]));
        row[40..42].fill(Pixel(7, [90, 60, 90]));
        // Right columns 43 to 46 are taken by what lies further right, so columns 48 to 51 seem inconsistent.
        row[54..58].fill(Pixel(11, [90, 40, 90]));
        let out = finish(&row);
        assert_eq!(out[30], Some(5.0), "ambiguous, but it continues both sides");
        assert_eq!(out[20], None, "ambiguous and elsewhere");
        assert_eq!(out[34..36], [None; 2], "3 px off what is around them");
        assert_eq!(out[40..42], [Some(7.0); 2], "contradicted, but they continue both sides");
        assert_eq!(out[48..52], [Some(5.0); 4], "as long as is allowed");
        row[53] = Pixel(11, [90, 40, 90]);
        assert_eq!(finish(&row)[47..52], [None; 5], "too long");
    }
}
