//! Many "raise everything from a to b to at least v" updates on one row, in O(n + w log w).
//!
//! A sparse table read backwards: an update of length n touches two cells of level ⌊log₂ n⌋, and at the end
//! every level is pushed into the one below with two contiguous maxima, which vectorise.

use crate::inflate::Spread;

/// The two cells that cover a range: of the level whose cells are the longest that fit, from its beginning and to its end.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Cells {
    pub(crate) begin: u32,
    pub(crate) end: u32,
}

impl Cells {
    /// Of the range from first to last, in a table whose levels lie one after the other, each as long as the row.
    #[inline(always)]
    pub(crate) fn of(first: u32, last: u32, length: u32) -> Self {
        // The exponent of a float is the logarithm, rounded down; unlike `ilog2` this vectorises everywhere.
        let level = (((last + 1 - first) as f32).to_bits() >> 23) - 127;
        Self { begin: level * length + first, end: level * length + last + 1 - (1 << level) }
    }
}

/// Scratch for rows of one length.
#[derive(Debug)]
pub(crate) struct RangeMax {
    /// Cells that updates begin with, and those that they end with: apart, so that an update seldom waits for the one
    /// before it.
    begins: Vec<u16>,
    ends: Vec<u16>,
    length: usize,
}

impl Spread for RangeMax {
    const VALUES: usize = 1;

    fn new(length: usize) -> Self {
        let count = length.max(1).ilog2() as usize + 1;
        Self { begins: vec![0; count * length], ends: vec![0; count * length], length }
    }

    #[inline(always)]
    fn raise(&mut self, cells: Cells, value: u16) {
        let raise = |cell: &mut u16| *cell = std::hint::select_unpredictable(value > *cell, value, *cell);
        raise(&mut self.begins[cells.begin as usize]);
        raise(&mut self.ends[cells.end as usize]);
    }

    #[inline(always)]
    fn finish(&mut self, out: &mut [u16]) {
        let Self { begins, ends, length } = self;
        raise_all(begins, ends);
        for level in (1..begins.len() / *length).rev() {
            let (below, this) = begins.split_at_mut(level * *length);
            let below = &mut below[(level - 1) * *length..];
            let this = &this[..*length];
            // Every cell covers two of the level below: its own, and the one half of its length further on.
            raise_all(below, this);
            raise_all(&mut below[1 << (level - 1)..], this);
        }
        out.copy_from_slice(&begins[..*length]);
        begins.fill(0);
        ends.fill(0);
    }
}

#[inline(always)]
fn raise_all(cells: &mut [u16], to: &[u16]) {
    for (cell, &value) in cells.iter_mut().zip(to) {
        *cell = (*cell).max(value);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};

    #[test]
    fn cells_are_the_longest_that_fit() {
        for length in 1..=5000_u32 {
            let cells = Cells::of(3, 2 + length, 6000);
            let level = length.ilog2();
            let [begin, end] = [cells.begin, cells.end].map(|cell| (cell / 6000, cell % 6000));
            assert_eq!((begin, end), ((level, 3), (level, 3 + length - (1 << level))), "{length}");
        }
    }

    #[test]
    fn equals_the_naive_loop() {
        let mut random = rand_pcg::Pcg64Mcg::seed_from_u64(1);
        for length in [1_usize, 2, 3, 17, 320] {
            let mut rows = RangeMax::new(length);
            for _ in 0..3 {
                let mut expected = vec![0; length];
                for _ in 0..50 {
                    let first = random.random_range(0..length);
                    let last = random.random_range(first..length);
                    let value = random.random_range(0..=u16::MAX);
                    rows.raise(Cells::of(first as u32, last as u32, length as u32), value);
                    expected[first..=last].iter_mut().for_each(|cell| *cell = value.max(*cell));
                }
                let mut out = vec![7; length];
                rows.finish(&mut out);
                assert_eq!(out, expected);
            }
        }
    }
}
