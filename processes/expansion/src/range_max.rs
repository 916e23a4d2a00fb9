//! Many "raise everything from a to b to at least v" updates on one row, in O(n + w log w).
//!
//! A sparse table read backwards: an update of length n touches two cells of level ⌊log₂ n⌋, and at the end
//! every level is pushed into the one below with two contiguous maxima, which vectorise.

use crate::inflate::Spread;

/// Scratch for rows of one length.
#[derive(Debug)]
pub(crate) struct RangeMax {
    levels: Vec<u16>,
    length: usize,
}

impl Spread for RangeMax {
    const VALUES: usize = 1;

    fn new(length: usize) -> Self {
        let count = length.max(1).ilog2() as usize + 1;
        Self { levels: vec![0; count * length], length }
    }

    #[inline(always)]
    fn raise(&mut self, first: usize, last: usize, value: u16) {
        let level = (last + 1 - first).ilog2() as usize;
        let row = &mut self.levels[level * self.length..(level + 1) * self.length];
        row[first] = row[first].max(value);
        let second = last + 1 - (1 << level);
        row[second] = row[second].max(value);
    }

    #[inline(always)]
    fn finish(&mut self, out: &mut [u16]) {
        let length = self.length;
        for level in (1..self.levels.len() / length).rev() {
            let (below, this) = self.levels.split_at_mut(level * length);
            let below = &mut below[(level - 1) * length..];
            let this = &mut this[..length];
            push_down(below, this, 1 << (level - 1));
            this.fill(0);
        }
        out.copy_from_slice(&self.levels[..length]);
        self.levels[..length].fill(0);
    }
}

/// Every cell of `this` covers two cells of `below`: its own, and the one `half` further on.
#[inline(always)]
fn push_down(below: &mut [u16], this: &[u16], half: usize) {
    for (cell, &value) in below.iter_mut().zip(this) {
        *cell = (*cell).max(value);
    }
    for (cell, &value) in below[half..].iter_mut().zip(this) {
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
