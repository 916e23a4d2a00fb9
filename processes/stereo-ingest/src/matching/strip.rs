//! The matching kernel: costs, aggregation and winners of a strip of rows, one row after the other.
//!
//! A row's matching costs (Hamming distances of census bits, or absolute differences) are averaged over a window by
//! running sums, then followed along up to five paths (Hirschmüller 2008, eq. 13): from the right, from the left, from
//! above, and from above on both diagonals. No path comes from below, so a row is finished when it is reached and no
//! cost volume is kept: everything lies in the cache. A pixel's costs are `K` vectors of bytes; path costs are kept
//! relative to their minimum, so they fit. Loops over vectors are plain: a closure would not be inlined.

use super::simd::Lanes;
use super::winners::{AMBIGUOUS, Winners};

/// Where the matching cost of a pixel comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Cost {
    /// Differing bits of the four census planes.
    Hamming,
    /// Absolute difference of the first plane.
    AbsoluteDifference,
}

/// Integer parameters of the kernel, in its units.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Weights {
    pub(crate) cost: Cost,
    /// Largest matching cost of a pixel; larger ones are cut.
    pub(crate) largest: u8,
    /// Side of the window, odd.
    pub(crate) window: usize,
    /// Right shifts of a column's sum and of the window's sum, so that both fit a byte.
    pub(crate) column_shift: u32,
    pub(crate) window_shift: u32,
    /// Penalties for a disparity step of one and for a larger one.
    pub(crate) small_step: u8,
    pub(crate) large_step: u8,
    /// 0, 3 or 5.
    pub(crate) paths: usize,
    /// Disparities searched.
    pub(crate) range: usize,
    /// Second-best costs up to this share (percent above the best) make a match ambiguous; 0 asks nothing.
    pub(crate) uniqueness_percent: u32,
}

/// Both images' features.
#[derive(Debug)]
pub(crate) struct Features {
    pub(crate) width: usize,
    pub(crate) height: usize,
    /// Length of a left row: the width and a vector.
    pub(crate) left_stride: usize,
    /// Length of a right row: the width and the range, rounded up to vectors, and a vector.
    pub(crate) right_stride: usize,
    /// Rows of planes: row × plane × column.
    pub(crate) left: Vec<u8>,
    /// Alike, but columns from the last to the first, so that growing disparities lie in order, and the first column
    /// repeated beyond.
    pub(crate) right: Vec<u8>,
    /// Planes of a row.
    pub(crate) planes: usize,
}

impl Features {
    fn left_plane(&self, row: usize, plane: usize) -> &[u8] {
        &self.left[(row * self.planes + plane) * self.left_stride..][..self.width]
    }

    /// As many windows of `length` as the image has columns.
    fn right_plane(&self, row: usize, plane: usize, length: usize) -> &[u8] {
        &self.right[(row * self.planes + plane) * self.right_stride..][..self.width + length - 1]
    }
}

/// Rows in hand at a time: each step along a row waits for the step before, and meanwhile the other row's is taken.
const ROWS: usize = 4;

/// Buffers of one strip.
#[derive(Debug)]
pub(crate) struct Strip<S, const K: usize> {
    weights: Weights,
    uniqueness: Uniqueness,
    /// Lanes beyond the range are raised to 255.
    beyond: [S; K],
    /// Costs of the rows under the window.
    ring: Vec<[S; K]>,
    oldest: usize,
    /// Their sums by column.
    columns: Vec<[S; K]>,
    /// Averaged costs of the rows in hand, and the path from the right.
    costs: [Vec<[S; K]>; ROWS],
    from_right: [Vec<[S; K]>; ROWS],
    /// Relative path costs of the row above: straight, and the two diagonals.
    from_above: [Vec<[S; K]>; 3],
    winners: [Winners; ROWS],
}

impl<S: Lanes, const K: usize> Strip<S, K> {
    pub(crate) fn new(width: usize, weights: Weights) -> Self {
        let zero = [S::splat(0); K];
        let line = |used: bool| vec![zero; if used { width } else { 0 }];
        let mut beyond = [0; 512];
        beyond[weights.range..].fill(u8::MAX);
        Self {
            weights,
            uniqueness: Uniqueness::new(&weights),
            beyond: std::array::from_fn(|k| S::load(&beyond[k * S::COUNT..])),
            ring: vec![zero; width * weights.window],
            oldest: 0,
            columns: line(true),
            costs: [(); ROWS].map(|()| line(true)),
            from_right: [(); ROWS].map(|()| line(weights.paths > 0)),
            from_above: [line(weights.paths > 0), line(weights.paths > 3), line(weights.paths > 3)],
            winners: [(); ROWS].map(|()| Winners::new(width, K * S::COUNT, weights.range)),
        }
    }

    /// Matches `rows`, calling `finish` after each with the winners found in it.
    ///
    /// Paths from above start `warm_up` rows earlier, so that they have settled.
    #[inline(always)]
    pub(crate) fn run(
        &mut self,
        features: &Features,
        rows: std::ops::Range<usize>,
        warm_up: usize,
        mut finish: impl FnMut(usize, &mut Winners),
    ) {
        let zero = [S::splat(0); K];
        for line in [&mut self.ring, &mut self.columns].into_iter().chain(&mut self.from_above) {
            line.fill(zero);
        }
        let half = self.weights.window / 2;
        let inside = |row: usize| row.saturating_sub(half).min(features.height - 1);
        let first = rows.start - warm_up.min(rows.start);
        for row in first..first + 2 * half {
            self.take_in(features, inside(row));
        }
        let mut row = first;
        while row < rows.end {
            let left = if row < rows.start { rows.start - row } else { rows.end - row };
            let count = [4, 2, 1].into_iter().find(|count| *count <= left).unwrap_or(1);
            for index in 0..count {
                self.take_in(features, inside(row + index + 2 * half));
                self.average(index);
            }
            match (count, row < rows.start) {
                (1, false) => self.decide::<1>(),
                (1, true) => self.settle::<1>(),
                (2, false) => self.decide::<2>(),
                (2, true) => self.settle::<2>(),
                (_, false) => self.decide::<4>(),
                (_, true) => self.settle::<4>(),
            }
            if row >= rows.start {
                for (index, winners) in self.winners[..count].iter_mut().enumerate() {
                    finish(row + index, winners);
                }
            }
            row += count;
        }
    }

    /// Replaces the oldest row under the window.
    #[inline(always)]
    fn take_in(&mut self, features: &Features, row: usize) {
        let (width, length) = (features.width, K * S::COUNT);
        let largest = S::splat(self.weights.largest);
        let ring = &mut self.ring[self.oldest * width..(self.oldest + 1) * width];
        let left = |plane| features.left_plane(row, plane).iter().rev();
        let right = |plane| features.right_plane(row, plane, length).windows(length);
        let cells = self.columns.iter_mut().rev().zip(ring.iter_mut().rev());
        match self.weights.cost {
            Cost::Hamming => {
                let lefts = left(0).zip(left(1)).zip(left(2)).zip(left(3));
                let rights = right(0).zip(right(1)).zip(right(2)).zip(right(3));
                for (((column, old), (((l0, l1), l2), l3)), (((r0, r1), r2), r3)) in cells.zip(lefts).zip(rights) {
                    let (l0, l1, l2, l3) = (S::splat(*l0), S::splat(*l1), S::splat(*l2), S::splat(*l3));
                    for k in 0..K {
                        let at = k * S::COUNT;
                        let some = S::load(&r0[at..]).xor(l0).count_ones().add(S::load(&r1[at..]).xor(l1).count_ones());
                        let more = S::load(&r2[at..]).xor(l2).count_ones().add(S::load(&r3[at..]).xor(l3).count_ones());
                        replace(&mut column[k], &mut old[k], some.add(more).min(largest));
                    }
                }
            }
            Cost::AbsoluteDifference => {
                for (((column, old), left), right) in cells.zip(left(0)).zip(right(0)) {
                    let left = S::splat(*left);
                    for k in 0..K {
                        let right = S::load(&right[k * S::COUNT..]);
                        let cost = left.sub_saturating(right).add(right.sub_saturating(left));
                        replace(&mut column[k], &mut old[k], cost.min(largest));
                    }
                }
            }
        }
        self.oldest = (self.oldest + 1) % self.weights.window;
    }

    /// Costs of a row in hand: sums of the columns under the window.
    #[inline(always)]
    fn average(&mut self, index: usize) {
        let Weights { window, column_shift, window_shift, .. } = self.weights;
        let (half, last) = (window / 2, self.columns.len() - 1);
        let (columns, beyond) = (&self.columns[..], self.beyond);
        let mut sums = [S::splat(0); K];
        for cell in 0..window {
            // The window around the column left of the first one.
            let column = columns[cell.saturating_sub(half + 1)];
            for k in 0..K {
                sums[k] = sums[k].add(column[k].shift_right(column_shift));
            }
        }
        for (x, cost) in self.costs[index].iter_mut().enumerate() {
            let (entering, leaving) = (columns[(x + half).min(last)], columns[x.saturating_sub(half + 1)]);
            for k in 0..K {
                sums[k] = sums[k].add(entering[k].shift_right(column_shift)).sub(leaving[k].shift_right(column_shift));
                cost[k] = sums[k].shift_right(window_shift).add_saturating(beyond[k]);
            }
        }
    }

    /// Rows before the strip: only the paths from above are followed.
    #[inline(always)]
    fn settle<const N: usize>(&mut self) {
        if self.weights.paths == 0 {
            return;
        }
        let penalties = Penalties::<S>::new(&self.weights);
        let [straight, ..] = &mut self.from_above;
        for costs in &self.costs[..N] {
            for (above, cost) in straight.iter_mut().zip(costs) {
                *above = penalties.advance_relative(*cost, *above).relative();
            }
        }
        if self.weights.paths > 3 {
            for index in 0..N {
                self.diagonals(index);
            }
        }
    }

    /// All paths of the rows in hand, and the winners.
    #[inline(always)]
    fn decide<const N: usize>(&mut self) {
        if self.weights.paths == 0 {
            for (costs, winners) in self.costs[..N].iter().zip(&mut self.winners) {
                for (x, cost) in costs.iter().enumerate() {
                    let (sums, out) = winners.pixel(x);
                    *out = choose(cost, &self.uniqueness, sums);
                }
            }
            return;
        }
        self.follow_from_right::<N>();
        if self.weights.paths > 3 {
            for index in 0..N {
                self.diagonals(index);
            }
        }
        self.follow_from_left::<N>();
        for index in 0..N {
            self.aggregate(index);
        }
    }

    #[inline(always)]
    fn follow_from_right<const N: usize>(&mut self) {
        let penalties = Penalties::<S>::new(&self.weights);
        let width = self.columns.len();
        let mut paths = [Path::start(); N];
        for x in (0..width).rev() {
            for (path, (costs, from_right)) in paths.iter_mut().zip(self.costs.iter().zip(&mut self.from_right)) {
                *path = penalties.advance(costs[x], *path);
                from_right[x] = path.costs;
            }
        }
    }

    /// Follows both diagonals through a row in hand, and adds them to its path from the right.
    #[inline(always)]
    fn diagonals(&mut self, index: usize) {
        let penalties = Penalties::<S>::new(&self.weights);
        let [_, from_left, from_right] = &mut self.from_above;
        let mut before = [S::splat(0); K];
        for (x, (cost, sums)) in self.costs[index].iter().zip(&mut self.from_right[index]).enumerate() {
            let left = penalties.advance_relative(*cost, before);
            before = std::mem::replace(&mut from_left[x], left.relative());
            let above = from_right.get(x + 1).copied().unwrap_or([S::splat(0); K]);
            let right = penalties.advance_relative(*cost, above);
            from_right[x] = right.relative();
            *sums = sum(*sums, sum(left.costs, right.costs));
        }
    }

    /// Adds the path from the left to the one from the right.
    #[inline(always)]
    fn follow_from_left<const N: usize>(&mut self) {
        let penalties = Penalties::<S>::new(&self.weights);
        let mut paths = [Path::start(); N];
        for x in 0..self.columns.len() {
            for (path, (costs, sums)) in paths.iter_mut().zip(self.costs.iter().zip(&mut self.from_right)) {
                *path = penalties.advance(costs[x], *path);
                sums[x] = sum(sums[x], path.costs);
            }
        }
    }

    /// The path from above, the sum of all, and the winners of a row in hand. No column waits for another.
    #[inline(always)]
    fn aggregate(&mut self, index: usize) {
        let penalties = Penalties::<S>::new(&self.weights);
        let [straight, ..] = &mut self.from_above;
        let cells = straight.iter_mut().zip(&self.costs[index]).zip(&self.from_right[index]);
        for (x, ((above, cost), others)) in cells.enumerate() {
            let down = penalties.advance_relative(*cost, *above);
            *above = down.relative();
            let (sums, out) = self.winners[index].pixel(x);
            *out = choose(&sum(down.costs, *others), &self.uniqueness, sums);
        }
    }
}

/// Penalties in every lane.
#[derive(Clone, Copy)]
struct Penalties<S> {
    small: S,
    large: S,
    none: S,
}

impl<S: Lanes> Penalties<S> {
    #[inline(always)]
    fn new(weights: &Weights) -> Self {
        Self { small: S::splat(weights.small_step), large: S::splat(weights.large_step), none: S::splat(u8::MAX) }
    }

    /// One step along a path: its costs here.
    ///
    /// The least of the costs before takes long to find; what does not need it is done meanwhile.
    #[inline(always)]
    fn advance<const K: usize>(self, cost: [S; K], before: Path<S, K>) -> Path<S, K> {
        let jump = before.least.add_saturating(self.large);
        let mut here = [self.none; K];
        let mut smallest = self.none;
        for k in 0..K {
            let below = before.costs[k].take_below(if k > 0 { before.costs[k - 1] } else { self.none });
            let above = before.costs[k].take_above(if k + 1 < K { before.costs[k + 1] } else { self.none });
            let step = below.min(above).add_saturating(self.small).min(before.costs[k]);
            here[k] = cost[k].add_saturating(step.min(jump).sub(before.least));
            smallest = smallest.min(here[k]);
        }
        Path { costs: here, least: smallest.least() }
    }

    /// The same for a path whose costs before are relative to their least.
    #[inline(always)]
    fn advance_relative<const K: usize>(self, cost: [S; K], before: [S; K]) -> Path<S, K> {
        self.advance(cost, Path { costs: before, least: S::splat(0) })
    }
}

/// Costs of a path at a pixel, and the least of them in every lane.
#[derive(Clone, Copy)]
struct Path<S, const K: usize> {
    costs: [S; K],
    least: S,
}

impl<S: Lanes, const K: usize> Path<S, K> {
    /// Outside the image.
    #[inline(always)]
    fn start() -> Self {
        Self { costs: [S::splat(0); K], least: S::splat(0) }
    }

    #[inline(always)]
    fn relative(mut self) -> [S; K] {
        for costs in &mut self.costs {
            *costs = costs.sub(self.least);
        }
        self.costs
    }
}

#[inline(always)]
fn sum<S: Lanes, const K: usize>(mut a: [S; K], b: [S; K]) -> [S; K] {
    for (a, b) in a.iter_mut().zip(b) {
        *a = a.add_saturating(b);
    }
    a
}

/// Puts a new cost into a column's sum, in the place of the oldest.
#[inline(always)]
fn replace<S: Lanes>(column: &mut S, old: &mut S, new: S) {
    *column = column.add(new).sub(*old);
    *old = new;
}

/// The disparity of the least sum, [`AMBIGUOUS`] added where another one elsewhere is nearly as good. The sums are
/// written to `bytes`.
#[inline(always)]
fn choose<S: Lanes, const K: usize>(sums: &[S; K], uniqueness: &Uniqueness, bytes: &mut [u8]) -> u16 {
    let mut smallest = sums[0];
    for k in 0..K {
        sums[k].store(&mut bytes[k * S::COUNT..]);
        smallest = smallest.min(sums[k]);
    }
    let least = smallest.least();
    let mut good = [0; K];
    let mut disparity = 0;
    for k in (0..K).rev() {
        good[k] = sums[k].equal(least);
        if K == 1 || good[k] != 0 {
            disparity = k * S::COUNT + good[k].trailing_zeros() as usize;
        }
    }
    if let Some(bounds) = &uniqueness.bounds {
        let bound = S::splat(bounds[usize::from(least.first())]);
        for (good, sum) in good.iter_mut().zip(sums) {
            *good = sum.sub_saturating(bound).equal(S::splat(0));
        }
    }
    disparity as u16 | if is_unique::<S, K>(&good, uniqueness.range, disparity) { 0 } else { AMBIGUOUS }
}

/// Whether nothing is good but the winner and its neighbours. Where no share is asked for, good is what is the same as the
/// least: where all are, as in front of a covered lens, the first would be taken for infinitely far.
#[inline(always)]
fn is_unique<S: Lanes, const K: usize>(good: &[u64; K], range: usize, winner: usize) -> bool {
    let is_good = |index: usize| good[index / S::COUNT] >> (index % S::COUNT) & 1;
    let below = if winner > 0 { is_good(winner - 1) } else { 0 };
    let above = if winner + 1 < range { is_good(winner + 1) } else { 0 };
    let rivals: u32 = good.iter().map(|good| good.count_ones()).sum();
    u64::from(rivals) == 1 + below + above
}

/// When a winner is the only one.
#[derive(Debug)]
struct Uniqueness {
    range: usize,
    /// By the least sum: up to what another one is as good; `None` where only the same sum is.
    bounds: Option<Box<[u8; 256]>>,
}

impl Uniqueness {
    fn new(weights: &Weights) -> Self {
        let bound = |least: u32| (least * (100 + weights.uniqueness_percent) / 100).min(254) as u8;
        let bounds = || Box::new(std::array::from_fn(|least| bound(least as u32)));
        Self { range: weights.range, bounds: (weights.uniqueness_percent > 0).then(bounds) }
    }
}
