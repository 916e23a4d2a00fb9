//! From aggregated costs to disparities: winner, sub-pixel, uniqueness, left-right consistency.

use ipc_types::disparity::{NO_MATCH, encode};
use multiversion::multiversion;

/// What a winner must satisfy.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Consistency {
    pub(crate) uniqueness_percent: u32,
    pub(crate) left_right_px: u32,
}

/// Scratch of one row: the right image's best cost and disparity, columns reversed.
#[derive(Debug)]
pub(crate) struct RightMatches {
    costs: Vec<u16>,
    disparities: Vec<u16>,
}

impl RightMatches {
    pub(crate) fn new(width: usize) -> Self {
        Self { costs: vec![0; width], disparities: vec![0; width] }
    }
}

/// Disparities of one row from its summed costs (`D` a pixel).
#[multiversion(targets("x86_64+avx512f+avx512bw", "x86_64+avx2", "aarch64+neon"))]
pub(crate) fn select_row<const D: usize>(
    sums: &[u16],
    rules: Consistency,
    right: &mut RightMatches,
    disparities: &mut [u16],
) {
    let width = disparities.len();
    right.costs.fill(u16::MAX);
    for (x, sums) in sums.chunks_exact(D).enumerate() {
        // Right pixel x - d lies at reversed column width - 1 - x + d.
        let start = width - 1 - x;
        let end = width.min(start + D);
        let best = right.costs[start..end].iter_mut().zip(&mut right.disparities[start..end]);
        for (d, ((cost, disparity), &sum)) in best.zip(sums).enumerate() {
            let better = sum < *cost;
            *cost = if better { sum } else { *cost };
            *disparity = if better { d as u16 } else { *disparity };
        }
    }
    for (x, (sums, out)) in sums.chunks_exact(D).zip(disparities).enumerate() {
        let least = sums.iter().copied().min().unwrap_or(u16::MAX);
        let winner = sums.iter().position(|&sum| sum == least).unwrap_or(0);
        *out = NO_MATCH;
        if winner > x || !is_unique(sums, winner, least, rules.uniqueness_percent) {
            continue;
        }
        let seen_from_right = right.disparities[width - 1 - x + winner];
        if u32::from(seen_from_right).abs_diff(winner as u32) <= rules.left_right_px {
            *out = encode(winner as f32 + sub_pixel(sums, winner));
        }
    }
}

/// Whether every sum that is not next to the winner is at least `percent` worse.
#[inline(always)]
fn is_unique(sums: &[u16], winner: usize, least: u16, percent: u32) -> bool {
    let bound = u32::from(least) * (100 + percent) / 100;
    let bound = bound.min(u32::from(u16::MAX)) as u16;
    let rivals = |range: &[u16]| range.iter().fold(0_u32, |count, &sum| count + u32::from(sum <= bound));
    let (from, to) = (winner.saturating_sub(1), (winner + 2).min(sums.len()));
    percent == 0 || rivals(sums) == rivals(&sums[from..to])
}

/// Offset of the minimum of the parabola through the winner and its neighbours, in -0.5..0.5.
#[inline(always)]
fn sub_pixel(sums: &[u16], winner: usize) -> f32 {
    if winner == 0 || winner + 1 >= sums.len() {
        return 0.0;
    }
    let at = |d: usize| f32::from(sums[d]);
    let (below, here, above) = (at(winner - 1), at(winner), at(winner + 1));
    let curvature = below + above - 2.0 * here;
    if curvature > 0.0 { (below - above) / (2.0 * curvature) } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ipc_types::disparity::decode;

    const RULES: Consistency = Consistency { uniqueness_percent: 5, left_right_px: 1 };

    fn row(width: usize, cost: impl Fn(usize, usize) -> u16) -> Vec<Option<f32>> {
        let sums: Vec<u16> = (0..width * 32).map(|i| cost(i / 32, i % 32)).collect();
        let mut out = vec![0; width];
        select_row::<32>(&sums, RULES, &mut RightMatches::new(width), &mut out);
        out.into_iter().map(decode).collect()
    }

    #[test]
    fn finds_the_minimum_between_disparities() {
        let out = row(64, |_, d| (100.0 + 8.0 * (d as f32 - 7.25).powi(2)) as u16);
        assert!(out[20..].iter().all(|d| (d.expect("matched") - 7.25).abs() < 0.07), "{out:?}");
        assert!(out[..7].iter().all(Option::is_none), "no right pixel to match with");
    }

    #[test]
    fn rejects_what_is_ambiguous_or_inconsistent() {
        let ambiguous = row(64, |_, d| if d % 10 == 5 { 50 } else { 200 });
        assert!(ambiguous.iter().all(Option::is_none));
        // Column 40 claims disparity 9, the right pixel it points to belongs to column 33 at disparity 2.
        let occluded =
            row(64, |x, d| if d == (if x == 40 { 9 } else { 2 }) { if x == 40 { 60 } else { 50 } } else { 300 });
        assert!(occluded[40].is_none() && occluded[41].is_some());
    }
}
