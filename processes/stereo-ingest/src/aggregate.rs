//! Semi-global aggregation (Hirschmüller 2008, eq. 13) along one path, one pixel at a time.
//!
//! A path's costs lie in lines of `D + 2` bytes: a sentinel, `D` costs, a sentinel; so that the neighbours d ± 1 are
//! shifted views and the loop vectorises. Costs are kept relative to the previous minimum and fit a byte.

/// Sentinel beyond the ends of the disparity range: never the minimum.
pub(crate) const SENTINEL: u8 = u8::MAX;

/// Penalties in census bits.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Penalties {
    pub(crate) small: u8,
    pub(crate) large: u8,
}

/// One step along a path: writes the pixel's path costs to `here` (its sentinels are left alone), adds them to
/// `sums`, and returns their minimum. `before` is the previous pixel's line and `least_before` its minimum.
#[inline(always)]
pub(crate) fn advance<const D: usize>(
    costs: &[u8; D],
    before: &[u8],
    least_before: u8,
    penalties: Penalties,
    here: &mut [u8],
    sums: &mut [u16; D],
) -> u8 {
    let (lower, rest): (&[u8; D], _) = (array(&before[..D]), &before[1..]);
    let (same, upper): (&[u8; D], &[u8; D]) = (array(&rest[..D]), array(&rest[1..=D]));
    let here: &mut [u8; D] = array_mut(&mut here[1..=D]);
    let jump = least_before.saturating_add(penalties.large);
    for d in 0..D {
        let step = lower[d].min(upper[d]).saturating_add(penalties.small);
        let best = same[d].min(step).min(jump);
        // The best is never below the previous minimum.
        here[d] = costs[d].saturating_add(best - least_before);
    }
    let mut least = SENTINEL;
    for d in 0..D {
        least = least.min(here[d]);
        sums[d] += u16::from(here[d]);
    }
    least
}

/// The first `D` elements as an array.
#[inline(always)]
pub(crate) fn array<T, const D: usize>(slice: &[T]) -> &[T; D] {
    slice.first_chunk().unwrap_or_else(|| unreachable!("the caller cut {D} elements"))
}

/// The first `D` elements as a mutable array.
#[inline(always)]
pub(crate) fn array_mut<T, const D: usize>(slice: &mut [T]) -> &mut [T; D] {
    slice.first_chunk_mut().unwrap_or_else(|| unreachable!("the caller cut {D} elements"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn follows_the_recurrence() {
        const D: usize = 32;
        let costs: [u8; D] = std::array::from_fn(|d| (d * 7 % 31) as u8);
        let mut before = [SENTINEL; D + 2];
        for d in 0..D {
            before[d + 1] = (d * 13 % 29) as u8 + 3;
        }
        let least_before = before.iter().copied().min().expect("not empty");
        let mut here = [SENTINEL; D + 2];
        let mut sums = [100; D];
        let penalties = Penalties { small: 4, large: 20 };
        let least = advance(&costs, &before, least_before, penalties, &mut here, &mut sums);
        for d in 0..D {
            let at = |i: usize| i32::from(before[i + 1]);
            let mut best = at(d).min(i32::from(least_before) + 20);
            if d > 0 {
                best = best.min(at(d - 1) + 4);
            }
            if d + 1 < D {
                best = best.min(at(d + 1) + 4);
            }
            let expected = i32::from(costs[d]) + best - i32::from(least_before);
            assert_eq!(i32::from(here[d + 1]), expected, "disparity {d}");
            assert_eq!(i32::from(sums[d]), 100 + expected);
        }
        assert_eq!(least, here[1..=D].iter().copied().min().expect("not empty"));
    }
}
