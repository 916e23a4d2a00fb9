//! As [`crate::range_max`], but keeps what lies behind the nearest surface, too.
//!
//! A cell holds three values: the largest, the largest of a later bin than that one's, and the largest at least two bins
//! later. Such triples can be merged in any order and as often as one likes: the third value of a merger is the first,
//! second or third of what is merged, as their bins differ by two, one or none. The second value is kept for that alone.

use crate::bins::bin;
use crate::inflate::Spread;
use crate::range_max::Cells;
use std::hint::select_unpredictable as pick;

type Triple = [u16; 3];

/// Values merged at once.
const BLOCK: usize = 32;
type Block = [u16; BLOCK];

/// Scratch for rows of one length.
#[derive(Debug)]
pub(crate) struct RangeGroups {
    /// Triples, and nothing, which lie together while single values are put into them, and apart when all are merged at last.
    levels: Vec<[u16; 4]>,
    above: Planes,
    below: Planes,
    length: usize,
}

/// First, second and third values.
type Planes = [Vec<u16>; 3];

/// What both hold together.
#[inline(always)]
pub(crate) fn merge(a: Triple, b: Triple) -> Triple {
    let a_wins = a[0] >= b[0];
    let (first, second, third) = if a_wins { (a[0], a[1], a[2]) } else { (b[0], b[1], b[2]) };
    let (first2, second2, third2) = if a_wins { (b[0], b[1], b[2]) } else { (a[0], a[1], a[2]) };
    let (bins, bins2) = (bin(first), bin(first2));
    let behind = if bins == bins2 { second2 } else { first2 };
    let last = if bins == bins2 + 1 { second2 } else { first2 };
    let last = if bins == bins2 { third2 } else { last };
    [first, second.max(behind), third.max(last)]
}

/// What a cell holds together with a single value: as [`merge`], in half as many steps, and without a branch.
#[inline(always)]
fn put(cell: &mut [u16; 4], value: u16) {
    let [first, second, third, _] = *cell;
    let (bins, bins_of_value) = (bin(first), bin(value));
    let is_same = bins == bins_of_value;
    let is_next = bins + 1 == bins_of_value;
    // If the value is the nearest, the cell's are behind it; else it may be behind theirs.
    let wins = [value, pick(is_same, second, first), pick(is_same, third, pick(is_next, second, first))];
    let is_far = bins > bins_of_value + 1;
    let loses = [first, pick(is_same, second, second.max(value)), pick(is_far, third.max(value), third)];
    let is_nearest = value > first;
    *cell = [
        pick(is_nearest, wins[0], loses[0]),
        pick(is_nearest, wins[1], loses[1]),
        pick(is_nearest, wins[2], loses[2]),
        0,
    ];
}

impl Spread for RangeGroups {
    const VALUES: usize = 3;

    fn new(length: usize) -> Self {
        let count = length.max(1).ilog2() as usize + 1;
        let planes = || [0; 3].map(|_| vec![0; length]);
        Self { levels: vec![[0; 4]; count * length], above: planes(), below: planes(), length }
    }

    #[inline(always)]
    fn raise(&mut self, cells: Cells, value: u16) {
        if value != 0 {
            put(&mut self.levels[cells.begin as usize], value);
            put(&mut self.levels[cells.end as usize], value);
        }
    }

    #[inline(always)]
    fn finish(&mut self, out: &mut [u16]) {
        let Self { levels, above, below, length } = self;
        let mut rows = levels.chunks_exact(*length).enumerate().rev();
        if let Some((_, top)) = rows.next() {
            take_apart(top, above);
        }
        for (level, row) in rows {
            take_apart(row, below);
            let [first, second, third] = below;
            let above_planes = [&above[0][..], &above[1][..], &above[2][..]];
            merge_into([&mut *first, &mut *second, &mut *third], above_planes);
            let half = 1 << level;
            merge_into([&mut first[half..], &mut second[half..], &mut third[half..]], above_planes);
            std::mem::swap(above, below);
        }
        for (out, plane) in out.chunks_exact_mut(*length).zip(above) {
            out.copy_from_slice(plane);
        }
        levels.fill([0; 4]);
    }
}

/// Triples to planes.
#[inline(always)]
fn take_apart(row: &[[u16; 4]], [first, second, third]: &mut Planes) {
    let planes = first.iter_mut().zip(second).zip(third);
    for (&[a, b, c, _], ((first, second), third)) in row.iter().zip(planes) {
        (*first, *second, *third) = (a, b, c);
    }
}

/// Every cell covers two cells of the level below: its own, and the one half of its length further on.
#[inline(always)]
fn merge_into([first, second, third]: [&mut [u16]; 3], [first2, second2, third2]: [&[u16]; 3]) {
    let length = first.len();
    let (second, third) = (&mut second[..length], &mut third[..length]);
    let (first2, second2, third2) = (&first2[..length], &second2[..length], &third2[..length]);
    // Blocks that are read whole before they are written vectorise: nothing then depends on what is where.
    let blocks = first.as_chunks_mut::<BLOCK>().0.iter_mut().zip(second.as_chunks_mut().0).zip(third.as_chunks_mut().0);
    let others = first2.as_chunks::<BLOCK>().0.iter().zip(second2.as_chunks().0).zip(third2.as_chunks().0);
    for (((first, second), third), ((first2, second2), third2)) in blocks.zip(others) {
        merge_block([first, second, third], [first2, second2, third2]);
    }
    for i in length / BLOCK * BLOCK..length {
        [first[i], second[i], third[i]] = merge([first[i], second[i], third[i]], [first2[i], second2[i], third2[i]]);
    }
}

#[inline(always)]
fn merge_block([a1, a2, a3]: [&mut Block; 3], [b1, b2, b3]: [&Block; 3]) {
    let (x1, x2, x3, y1, y2, y3) = (*a1, *a2, *a3, *b1, *b2, *b3);
    let (mut first, mut second, mut third) = ([0; BLOCK], [0; BLOCK], [0; BLOCK]);
    for i in 0..BLOCK {
        [first[i], second[i], third[i]] = merge([x1[i], x2[i], x3[i]], [y1[i], y2[i], y3[i]]);
    }
    (*a1, *a2, *a3) = (first, second, third);
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};

    #[test]
    fn putting_a_value_is_merging_it() {
        let mut random = rand_pcg::Pcg64Mcg::seed_from_u64(3);
        // Values of a few neighbouring bins up to the last, equal ones and none among them.
        let mut value = || match random.random_range(0..5) {
            0 => 0,
            1 => u16::MAX,
            _ => random.random_range(58_u16..64) << 10 | random.random_range(0..3),
        };
        for _ in 0..200_000 {
            let (triple, value) = ([value(), value(), value()], value());
            let mut cell = [triple[0], triple[1], triple[2], 0];
            put(&mut cell, value);
            assert_eq!(cell[..3], merge(triple, [value, 0, 0]), "{triple:?} {value}");
        }
    }

    #[test]
    fn keeps_the_nearest_and_what_lies_one_and_two_bins_behind() {
        let mut random = rand_pcg::Pcg64Mcg::seed_from_u64(2);
        for length in [1_usize, 2, 3, 17, 320] {
            let mut rows = RangeGroups::new(length);
            for _ in 0..5 {
                let mut covering = vec![Vec::new(); length];
                for _ in 0..60 {
                    let first = random.random_range(0..length);
                    let last = random.random_range(first..length);
                    let value = random.random_range(1_u16..9) << 10 | random.random_range(0..1024);
                    rows.raise(Cells::of(first as u32, last as u32, length as u32), value);
                    covering[first..=last].iter_mut().for_each(|values| values.push(value));
                }
                let mut out = vec![7; 3 * length];
                rows.finish(&mut out);
                for (place, values) in covering.iter().enumerate() {
                    let nearest = values.iter().copied().max().unwrap_or(0);
                    let behind = |bins: u16| {
                        let is_behind = |value: &&u16| bin(**value) + bins <= bin(nearest);
                        values.iter().filter(is_behind).copied().max().unwrap_or(0)
                    };
                    let found = [0, 1, 2].map(|value| out[value * length + place]);
                    assert_eq!(found, [nearest, behind(1), behind(2)], "{values:?}");
                }
            }
        }
    }
}
