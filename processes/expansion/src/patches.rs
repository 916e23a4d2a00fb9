//! Small unmatched patches within what was measured.
//!
//! A body near the camera covers much of the image, and all of it must have been measured. A few unmatched pixels that
//! stand together, too many for a run ([`crate::measured`]), would keep it from everything within metres. What is as small
//! as they are and stands alone is kept off by the body alone, as is what is smaller than a speckle; what is long, such
//! as a branch, leaves a patch that is long, too, and stays unknown.

use ipc_types::disparity::is_valid;

/// Finds patches line by line: runs of unmatched pixels, joined to those that they touch in the line before.
#[derive(Debug)]
pub(crate) struct Patches {
    runs: Vec<Run>,
}

/// Unmatched pixels of a line.
#[derive(Clone, Copy, Debug)]
struct Run {
    line: usize,
    first: usize,
    /// One after the last.
    end: usize,
    /// Another run of the patch, or itself for the one that stands for all.
    parent: usize,
    /// Of the patch, where this run stands for it: extent in lines and along them, largest value around it.
    lines: [usize; 2],
    along: [usize; 2],
    around: u16,
}

impl Patches {
    /// For images of so many pixels.
    pub(crate) fn new(pixels: usize) -> Self {
        // Every run but the last of a line is followed by a pixel that was measured.
        Self { runs: Vec::with_capacity(pixels.div_ceil(2) + pixels.isqrt()) }
    }

    /// Fills patches that are no longer than `longest`, in either direction, and do not touch the border, with the nearest
    /// of what surrounds them. `image` is made of lines of `length` pixels.
    pub(crate) fn fill(&mut self, image: &mut [u16], length: usize, longest: usize) {
        if longest == 0 || length == 0 {
            return;
        }
        self.find(image, length);
        let lines = image.len() / length;
        for index in 0..self.runs.len() {
            let root = self.root(index);
            if self.runs[root].is_small(longest, lines, length) {
                let nearest = nearest_around(&self.runs[index], image, length);
                self.runs[root].around = self.runs[root].around.max(nearest);
            }
        }
        for index in 0..self.runs.len() {
            let (run, root) = (self.runs[index], self.root(index));
            let patch = self.runs[root];
            if patch.is_small(longest, lines, length) && is_valid(patch.around) {
                image[run.line * length..][run.first..run.end].fill(patch.around);
            }
        }
    }

    fn find(&mut self, image: &[u16], length: usize) {
        self.runs.clear();
        // Runs of the line before.
        let mut above = 0..0;
        for (line, pixels) in image.chunks_exact(length).enumerate() {
            let (start, mut next) = (self.runs.len(), above.start);
            let mut at = 0;
            while let Some(first) = pixels[at..].iter().position(|&pixel| !is_valid(pixel)).map(|gap| at + gap) {
                let end = pixels[first..].iter().position(|&pixel| is_valid(pixel)).map_or(length, |run| first + run);
                let index = self.runs.len();
                let (lines, along) = ([line, line + 1], [first, end]);
                self.runs.push(Run { line, first, end, parent: index, lines, along, around: 0 });
                // Runs that end before this one begins touch none of the rest either.
                while next < above.end && self.runs[next].end < first {
                    next += 1;
                }
                let mut other = next;
                while other < above.end && self.runs[other].first <= end {
                    self.join(other, index);
                    other += 1;
                }
                at = end;
            }
            above = start..self.runs.len();
        }
    }

    /// The run that stands for a run's patch.
    fn root(&mut self, mut index: usize) -> usize {
        while self.runs[index].parent != index {
            self.runs[index].parent = self.runs[self.runs[index].parent].parent;
            index = self.runs[index].parent;
        }
        index
    }

    fn join(&mut self, one: usize, other: usize) {
        let (one, other) = (self.root(one), self.root(other));
        // The earlier one stands for both.
        let (keeps, goes) = (one.min(other), one.max(other));
        if keeps != goes {
            let gone = self.runs[goes];
            let kept = &mut self.runs[keeps];
            kept.lines = [kept.lines[0].min(gone.lines[0]), kept.lines[1].max(gone.lines[1])];
            kept.along = [kept.along[0].min(gone.along[0]), kept.along[1].max(gone.along[1])];
            self.runs[goes].parent = keeps;
        }
    }
}

impl Run {
    /// Whether the patch it stands for is small, and lies within the image.
    fn is_small(&self, longest: usize, lines: usize, length: usize) -> bool {
        let ([top, bottom], [first, end]) = (self.lines, self.along);
        (bottom - top).max(end - first) <= longest && top > 0 && first > 0 && bottom < lines && end < length
    }
}

/// The largest disparity beside a run that lies within the image; 0 if there is none.
fn nearest_around(run: &Run, image: &[u16], length: usize) -> u16 {
    let line = |line: usize| &image[line * length..][..length];
    let beside = line(run.line - 1)[run.first..run.end].iter().chain(&line(run.line + 1)[run.first..run.end]);
    let ends = [line(run.line)[run.first - 1], line(run.line)[run.end]];
    beside.copied().chain(ends).filter(|&pixel| is_valid(pixel)).max().unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};

    fn filled(rows: &[&str], longest: usize) -> Vec<String> {
        let length = rows[0].len();
        let mut image: Vec<u16> = rows
            .iter()
            .flat_map(|row| row.bytes())
            .map(|byte| if byte == b'.' { 0 } else { u16::from(byte) })
            .collect();
        Patches::new(64).fill(&mut image, length, longest);
        let text = |row: &[u16]| row.iter().map(|&pixel| if pixel == 0 { '.' } else { pixel as u8 as char }).collect();
        image.chunks_exact(length).map(text).collect()
    }

    #[test]
    fn a_small_patch_takes_the_nearest_around_it_and_a_long_one_stays() {
        assert_eq!(filled(&["aaaaa", "ab..a", "a..da", "aaaca"], 3), ["aaaaa", "abdda", "addda", "aaaca"]);
        let branch = ["aaaaaaa", "a.....a", "aaaaaaa"];
        assert_eq!(filled(&branch, 4), branch);
        assert_eq!(filled(&branch, 5), ["aaaaaaa"; 3]);
        let leaning = ["aaaaaa", "a.aaaa", "aa.aaa", "aaa.aa", "aaaa.a", "aaaaaa"];
        assert_eq!(filled(&leaning, 3), leaning, "touching at corners it is one");
        assert_eq!(filled(&leaning, 4), ["aaaaaa"; 6]);
    }

    #[test]
    fn what_touches_the_border_stays() {
        let rows = ["a.aaa", "aaaa.", ".aaaa", "aaa.a"];
        assert_eq!(filled(&rows, 4), rows);
        assert_eq!(filled(&["...", "...", "..."], 9), ["..."; 3]);
        assert_eq!(filled(&["aaa", "a.a", "aaa"], 0), ["aaa", "a.a", "aaa"]);
    }

    /// Patches found by flooding.
    fn flooded(image: &[u16], length: usize, longest: usize) -> Vec<u16> {
        let (mut result, mut seen) = (image.to_vec(), vec![false; image.len()]);
        let lines = image.len() / length;
        for start in 0..image.len() {
            if is_valid(image[start]) || seen[start] {
                continue;
            }
            let (mut patch, mut next) = (vec![start], 0);
            seen[start] = true;
            while next < patch.len() {
                let (line, along) = (patch[next] / length, patch[next] % length);
                next += 1;
                for other_line in line.saturating_sub(1)..=(line + 1).min(lines - 1) {
                    for other in along.saturating_sub(1)..=(along + 1).min(length - 1) {
                        let index = other_line * length + other;
                        if !is_valid(image[index]) && !std::mem::replace(&mut seen[index], true) {
                            patch.push(index);
                        }
                    }
                }
            }
            let extent = |of: &dyn Fn(usize) -> usize| {
                let values = patch.iter().map(|&pixel| of(pixel));
                (values.clone().min().expect("one"), values.max().expect("one"))
            };
            let ((top, bottom), (left, right)) = (extent(&|pixel| pixel / length), extent(&|pixel| pixel % length));
            let inside = top > 0 && left > 0 && bottom + 1 < lines && right + 1 < length;
            if !inside || (bottom - top).max(right - left) + 1 > longest {
                continue;
            }
            let around = patch.iter().flat_map(|&pixel| [pixel - 1, pixel + 1, pixel - length, pixel + length]);
            let nearest = around.map(|pixel| image[pixel]).filter(|&pixel| is_valid(pixel)).max();
            patch.iter().for_each(|&pixel| result[pixel] = nearest.unwrap_or(image[pixel]));
        }
        result
    }

    #[test]
    fn it_finds_what_flooding_finds() {
        let mut random = rand_pcg::Pcg64Mcg::seed_from_u64(1);
        let mut patches = Patches::new(64);
        for _ in 0..500 {
            let (length, lines) = (random.random_range(1..24), random.random_range(1..24));
            let share = random.random_range(0.1..0.9);
            let mut image: Vec<u16> = (0..length * lines)
                .map(|_| if random.random_bool(share) { 0 } else { random.random_range(100..200) })
                .collect();
            let longest = random.random_range(1..8);
            let expected = flooded(&image, length, longest);
            patches.fill(&mut image, length, longest);
            assert_eq!(image, expected);
        }
    }
}
