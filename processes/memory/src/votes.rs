//! What the views' votes on a place come to.
//!
//! Table 3.1 adds votes up. Views err together, though, and things move:
//!
//! * Eq. 3.11 takes half of the safe votes' sum. What one view is too far away to resolve, such as a thin branch, its
//!   neighbours miss as well, and ten of them would outvote the one view that was near enough. So the safe sum counts for
//!   no more than the strongest free vote, and views from which the place is hidden clear nothing alone.
//! * Far views pad an obstacle by what they cannot resolve. So the occupied sum counts for no more than twice its
//!   strongest vote, or no number of views from half of the distance could clear what a row of them padded.
//! * A vote for occupied is **superseded** when the place has been looked at again and found free: by three newer views,
//!   hardly farther away than its own, where newer free views span the time after which things are forgotten, and none
//!   newer sees it occupied. What has not been looked at again is never forgotten.
//! * Free votes older than two that see the place occupied are overruled: something has come. So are those that are older
//!   by half of the time to forget than the newest view, where that sees it occupied.
//!
//! Votes are whole numbers, and views are taken from the newest to the oldest by their exposure, so that the order in
//! which they are held changes nothing.

/// Newer free views that supersede a vote for occupied weigh no less than this share of it, the third of them included.
const SHARE: (i32, i32) = (7, 10);
/// Newer views that see a place occupied and overrule older ones that see it free.
const WITNESSES: i32 = 2;

/// What a view says of a place, as numbers: a set of flags, one of them set.
pub(crate) mod flag {
    /// Not in its view.
    pub(crate) const OUT_OF_VIEW: i32 = 0;
    pub(crate) const UNMEASURED: i32 = 1;
    pub(crate) const OCCLUDED: i32 = 2;
    pub(crate) const FREE: i32 = 4;
    pub(crate) const FAR_BACKGROUND: i32 = 8;
    pub(crate) const OCCUPIED: i32 = 16;
}

/// What a view says of `N` places, and how much that weighs, one lane each; or what as many views say of one place.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Said<const N: usize> {
    pub(crate) flags: [i32; N],
    pub(crate) weights: [i32; N],
    /// Exposure before that of the newest view, ms. Of several views it is kept elsewhere.
    pub(crate) exposure_ms: i32,
}

impl<const N: usize> Said<N> {
    pub(crate) const NOTHING: Self = Self { flags: [flag::OUT_OF_VIEW; N], weights: [0; N], exposure_ms: 0 };

    /// Whether any of the places is seen occupied.
    #[inline(always)]
    pub(crate) fn is_occupied_anywhere(&self) -> bool {
        self.flags.iter().fold(0, |any, &flag| any | flag) & flag::OCCUPIED != 0
    }
}

/// What all votes on `N` places come to.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Tally<const N: usize> {
    occupied: [i32; N],
    safe: [i32; N],
    most_free: [i32; N],
    background: [i32; N],
    most_background: [i32; N],
    /// Flags of all views that counted.
    flags: [i32; N],
    /// Views whose votes for occupied count.
    witnesses: [i32; N],
}

impl<const N: usize> Tally<N> {
    /// Of views given from the newest to the oldest.
    #[inline(always)]
    pub(crate) fn of(said: &[Said<N>], forget_ms: i32) -> Self {
        if !said.iter().fold(false, |any, said| any | said.is_occupied_anywhere()) {
            return Self::unopposed(said);
        }
        let mut votes = Votes::none();
        for said in said {
            votes.cast(said, forget_ms);
        }
        votes.tally()
    }

    /// Where no view sees any of the places occupied: nothing is superseded or overruled, the order does not matter.
    #[inline(always)]
    fn unopposed(said: &[Said<N>]) -> Self {
        let none = [0; N];
        let mut tally = Self {
            occupied: none,
            safe: none,
            most_free: none,
            background: none,
            most_background: none,
            flags: none,
            witnesses: none,
        };
        for said in said {
            for lane in 0..N {
                let (flag, weight) = (said.flags[lane], said.weights[lane]);
                let take = |which: i32| if flag & which != 0 { weight } else { 0 };
                tally.safe[lane] += take(flag::FREE | flag::OCCLUDED);
                tally.most_free[lane] = tally.most_free[lane].max(take(flag::FREE));
                tally.background[lane] += take(flag::FAR_BACKGROUND);
                tally.most_background[lane] = tally.most_background[lane].max(take(flag::FAR_BACKGROUND));
                tally.flags[lane] |= flag;
            }
        }
        tally
    }

    /// Of one place that no view sees occupied, on which every lane is a view of its own.
    #[inline(always)]
    pub(crate) fn unopposed_on_one(views: &[Said<N>]) -> Tally<1> {
        let all = Self::unopposed(views);
        let sum = |votes: &[i32; N]| [votes.iter().sum()];
        let most = |votes: &[i32; N]| [votes.iter().fold(0, |most, &vote| most.max(vote))];
        Tally {
            occupied: [0],
            safe: sum(&all.safe),
            most_free: most(&all.most_free),
            background: sum(&all.background),
            most_background: most(&all.most_background),
            flags: [all.flags.iter().fold(0, |all, &flag| all | flag)],
            witnesses: [0],
        }
    }

    /// Whether views of far background are among the votes, and none of those that count may be overruled: what is seen
    /// occupied by anything newer is no background.
    #[inline(always)]
    pub(crate) fn has_background(&self, lane: usize) -> bool {
        self.flags[lane] & flag::FAR_BACKGROUND != 0 && self.witnesses[lane] == 0
    }

    /// The score of a place, in whole numbers, and what was said of it. Far background counts as free if it `has_parallax`.
    #[inline(always)]
    pub(crate) fn count(&self, lane: usize, has_parallax: bool) -> (i32, i32) {
        let (mut safe, mut most_free, mut flags) = (self.safe[lane], self.most_free[lane], self.flags[lane]);
        if has_parallax {
            safe += self.background[lane];
            most_free = most_free.max(self.most_background[lane]);
            flags |= flag::FREE;
        }
        (self.occupied[lane] - (safe / 2).min(most_free), flags)
    }
}

/// Votes on `N` places, one lane each, while they are counted.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Votes<const N: usize> {
    occupied: [i32; N],
    most_occupied: [i32; N],
    witnesses: [i32; N],
    /// 1 where the newest view sees the place occupied.
    is_fresh: [i32; N],
    safe: [i32; N],
    most_free: [i32; N],
    background: [i32; N],
    most_background: [i32; N],
    /// The three largest free votes so far, and when the newest and the oldest were exposed, ms.
    first_free: [i32; N],
    second_free: [i32; N],
    third_free: [i32; N],
    free_newest_ms: [i32; N],
    free_oldest_ms: [i32; N],
    /// Flags of all views that counted.
    flags: [i32; N],
}

impl<const N: usize> Votes<N> {
    pub(crate) const fn none() -> Self {
        Self {
            occupied: [0; N],
            most_occupied: [0; N],
            witnesses: [0; N],
            is_fresh: [0; N],
            safe: [0; N],
            most_free: [0; N],
            background: [0; N],
            most_background: [0; N],
            first_free: [0; N],
            second_free: [0; N],
            third_free: [0; N],
            free_newest_ms: [i32::MIN; N],
            free_oldest_ms: [i32::MIN; N],
            flags: [0; N],
        }
    }

    /// Counts the votes of the next older view.
    #[inline(always)]
    pub(crate) fn cast(&mut self, said: &Said<N>, forget_ms: i32) {
        let Said { flags, weights, exposure_ms } = *said;
        for lane in 0..N {
            let (flag, weight) = (flags[lane], weights[lane]);
            let is = |which: i32| flag & which != 0;
            let (first, second, third) = (self.first_free[lane], self.second_free[lane], self.third_free[lane]);
            let span_ms = self.free_newest_ms[lane].wrapping_sub(self.free_oldest_ms[lane]);
            // No product overflows: weights stay below 2²².
            let looked_again = (third * SHARE.1 >= weight * SHARE.0)
                & (third > 0)
                & (span_ms >= forget_ms)
                & (self.witnesses[lane] == 0);
            let is_old = (self.is_fresh[lane] != 0) & (exposure_ms < -forget_ms / 2);
            let overruled = (self.witnesses[lane] >= WITNESSES) | is_old;
            let take = |condition: bool| if condition { weight } else { 0 };

            let occupied = take(is(flag::OCCUPIED) & !looked_again);
            self.occupied[lane] += occupied;
            self.most_occupied[lane] = self.most_occupied[lane].max(occupied);
            self.witnesses[lane] += i32::from(is(flag::OCCUPIED) & !looked_again);

            self.is_fresh[lane] |= i32::from(is(flag::OCCUPIED) & (exposure_ms == 0));

            let free = take(is(flag::FREE) & !overruled);
            self.safe[lane] += take(is(flag::FREE | flag::OCCLUDED) & !overruled);
            self.most_free[lane] = self.most_free[lane].max(free);
            let background = take(is(flag::FAR_BACKGROUND) & !overruled);
            self.background[lane] += background;
            self.most_background[lane] = self.most_background[lane].max(background);

            // The three largest, in order.
            self.first_free[lane] = first.max(free);
            self.second_free[lane] = second.max(first.min(free));
            self.third_free[lane] = third.max(second.min(free));
            let is_free = is(flag::FREE);
            let is_first = is_free & (self.free_newest_ms[lane] == i32::MIN);
            self.free_newest_ms[lane] = if is_first { exposure_ms } else { self.free_newest_ms[lane] };
            self.free_oldest_ms[lane] = if is_free { exposure_ms } else { self.free_oldest_ms[lane] };
            let counts = !(overruled & is(flag::FREE | flag::FAR_BACKGROUND));
            self.flags[lane] |= if counts { flag } else { 0 };
        }
    }

    /// What they come to.
    #[inline(always)]
    pub(crate) fn tally(&self) -> Tally<N> {
        let mut occupied = self.occupied;
        for (occupied, most) in occupied.iter_mut().zip(self.most_occupied) {
            *occupied = (*occupied).min(2 * most);
        }
        Tally {
            occupied,
            safe: self.safe,
            most_free: self.most_free,
            background: self.background,
            most_background: self.most_background,
            flags: self.flags,
            witnesses: self.witnesses,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};

    /// Where no view sees a place occupied, in lanes or across them, as if cast one by one.
    #[test]
    fn unopposed_votes_come_to_what_casting_them_does() {
        const N: usize = 16;
        let mut random = rand_pcg::Pcg64Mcg::seed_from_u64(4);
        for views in 0..40_usize {
            let flags = [flag::OUT_OF_VIEW, flag::UNMEASURED, flag::OCCLUDED, flag::FREE, flag::FAR_BACKGROUND];
            let mut view = |exposure_ms: i32| Said::<N> {
                flags: std::array::from_fn(|_| flags[random.random_range(0..flags.len())]),
                weights: std::array::from_fn(|_| random.random_range(0..5000)),
                exposure_ms,
            };
            let said: Vec<_> = (0..views).map(|age| view(-100 * age as i32)).collect();
            let found = Tally::of(&said, 1000);
            for lane in 0..N {
                let mut votes = Votes::<1>::none();
                let one = |said: &Said<N>| Said {
                    flags: [said.flags[lane]],
                    weights: [said.weights[lane]],
                    exposure_ms: said.exposure_ms,
                };
                said.iter().for_each(|said| votes.cast(&one(said), 1000));
                let expected = votes.tally();
                let mut across = vec![Said::<N>::NOTHING; views.div_ceil(N)];
                for (view, said) in said.iter().enumerate() {
                    across[view / N].flags[view % N] = said.flags[lane];
                    across[view / N].weights[view % N] = said.weights[lane];
                }
                let on_one = Tally::unopposed_on_one(&across);
                for has_parallax in [false, true] {
                    let expected = expected.count(0, has_parallax);
                    assert_eq!(found.count(lane, has_parallax), expected);
                    assert_eq!(on_one.count(0, has_parallax), expected);
                }
                assert_eq!(found.has_background(lane), expected.has_background(0));
                assert_eq!(on_one.has_background(0), expected.has_background(0));
            }
        }
    }
}
