//! Many "raise everything from a to b to at least v" updates on one row, in O(n + w log w).
//!
//! A sparse table read backwards: an update of length n touches two cells of level ⌊log₂ n⌋, and at the end
//! every level is pushed into the one below with two contiguous maxima, which vectorise.

use crate::inflate::Spread;

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
    fn raise(&mut self, first: usize, last: usize, value: u16) {
        let level = (last + 1 - first).ilog2() as usize;
        let row = level * self.length;
        let raise = |cell: &mut u16| *cell = std::hint::select_unpredictable(value > *cell, value, *cell);
        raise(&mut self.begins[row + first]);
        raise(&mut self.ends[row + last + 1 - (1 << level)]);
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
                    rows.raise(first, last, value);
                    expected[first..=last].iter_mut().for_each(|cell| *cell = value.max(*cell));
                }
                let mut out = vec![7; length];
                rows.finish(&mut out);
                assert_eq!(out, expected);
            }
        }
    }
}
