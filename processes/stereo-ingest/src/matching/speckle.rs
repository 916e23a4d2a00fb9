//! Removes small connected areas: what is left of noise after the consistency checks.
//!
//! Small in the image, or small in the world: a false match at a large disparity would stand right before the
//! vehicle, where even a leaf covers many pixels. Areas are joined run by run (union-find over horizontal runs of equal
//! enough disparities), not pixel by pixel.

use ipc_types::disparity::{NO_MATCH, SCALE, is_valid};
use memchr::memchr;

/// What is too small to keep.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Least {
    /// Area in the image, px.
    pub(crate) area_px: usize,
    /// Side of a square in the world, in baselines: at disparity d it is as many times d pixels wide.
    pub(crate) side_baselines: f32,
    /// Difference of the principal points, px: what is added to a disparity to make it inverse depth.
    pub(crate) doffs_px: f32,
}

impl Least {
    /// Least area at a disparity, px.
    fn area_px(self, disparity_px: f32) -> usize {
        let side_px = self.side_baselines * (disparity_px + self.doffs_px).max(0.0);
        self.area_px.max((side_px * side_px) as usize)
    }
}

/// Pixels of a row, `start..end`, whose neighbours differ by no more than the step; and the area they belong to.
#[derive(Clone, Copy, Debug)]
struct Run {
    start: u32,
    end: u32,
    /// Index of a run of the same area; of itself for the run that stands for the area.
    parent: u32,
    /// Of the area, where this run stands for it: pixels and sum of disparities.
    pixels: u32,
    sum: u64,
}

/// Scratch: every run of an image, and where each row's begin.
#[derive(Debug)]
pub(crate) struct Speckles {
    width: usize,
    runs: Vec<Run>,
    rows: Vec<usize>,
    /// Of the row in hand: 1 where a pixel belongs to its left neighbour's run, and a 0 behind the last.
    goes_on: Vec<u8>,
}

impl Speckles {
    pub(crate) fn new(width: usize, height: usize) -> Self {
        Self {
            width,
            runs: Vec::with_capacity(width * height),
            rows: Vec::with_capacity(height + 1),
            goes_on: vec![0; width + 1],
        }
    }

    /// Replaces areas that are too small, within which neighbours differ by at most `step` (fixed point), by
    /// [`NO_MATCH`].
    pub(crate) fn remove(&mut self, disparities: &mut [u16], least: Least, step: u16) {
        self.runs.clear();
        self.rows.clear();
        let mut above: &[u16] = &[];
        for row in disparities.chunks_exact(self.width) {
            self.rows.push(self.runs.len());
            self.add_runs(row, step);
            if !above.is_empty() {
                self.join_rows(above, row, step);
            }
            above = row;
        }
        self.rows.push(self.runs.len());
        for (row, line) in disparities.chunks_exact_mut(self.width).enumerate() {
            for index in self.rows[row]..self.rows[row + 1] {
                let root = self.find(index as u32);
                let area = self.runs[root as usize];
                let mean_px = area.sum as f32 / (area.pixels as f32 * SCALE);
                if (area.pixels as usize) < least.area_px(mean_px) {
                    let run = self.runs[index];
                    line[run.start as usize..run.end as usize].fill(NO_MATCH);
                }
            }
        }
    }

    /// Cuts a row into runs.
    fn add_runs(&mut self, row: &[u16], step: u16) {
        for ((goes_on, &pixel), &before) in self.goes_on[1..].iter_mut().zip(&row[1..]).zip(row) {
            *goes_on = u8::from(is_valid(before) & is_valid(pixel) & (pixel.abs_diff(before) <= step));
        }
        let mut x = 0;
        while x < row.len() {
            let start = x;
            x += 1 + memchr(0, &self.goes_on[x + 1..]).unwrap_or_default();
            if !is_valid(row[start]) {
                continue;
            }
            let sum = row[start..x].iter().map(|&pixel| u64::from(pixel)).sum();
            let parent = self.runs.len() as u32;
            self.runs.push(Run { start: start as u32, end: x as u32, parent, pixels: (x - start) as u32, sum });
        }
    }

    /// Joins the last row's runs with those above that they touch.
    fn join_rows(&mut self, above: &[u16], row: &[u16], step: u16) {
        let last = self.rows.len() - 1;
        let (mut upper, end) = (self.rows[last - 1], self.rows[last]);
        for lower in end..self.runs.len() {
            let Run { start, end: stop, .. } = self.runs[lower];
            while upper < end && self.runs[upper].end <= start {
                upper += 1;
            }
            let mut candidate = upper;
            while candidate < end && self.runs[candidate].start < stop {
                let overlap =
                    start.max(self.runs[candidate].start) as usize..stop.min(self.runs[candidate].end) as usize;
                let pixels = above[overlap.clone()].iter().zip(&row[overlap]);
                if self.find(candidate as u32) != self.find(lower as u32)
                    && pixels.into_iter().any(|(a, b)| a.abs_diff(*b) <= step)
                {
                    self.join(candidate as u32, lower as u32);
                }
                candidate += 1;
            }
        }
    }

    /// The run that stands for the area of `run`.
    fn find(&mut self, mut run: u32) -> u32 {
        while self.runs[run as usize].parent != run {
            let parent = self.runs[run as usize].parent;
            self.runs[run as usize].parent = self.runs[parent as usize].parent;
            run = parent;
        }
        run
    }

    fn join(&mut self, a: u32, b: u32) {
        let (a, b) = (self.find(a), self.find(b));
        let (root, child) = (a.min(b), a.max(b));
        let Run { pixels, sum, .. } = self.runs[child as usize];
        self.runs[child as usize].parent = root;
        self.runs[root as usize].pixels += pixels;
        self.runs[root as usize].sum += sum;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LEAST: Least = Least { area_px: 3, side_baselines: 0.1, doffs_px: 0.0 };

    fn is_kept(area: &[usize], value: u16) -> bool {
        let width = 8;
        let mut image = vec![SCALE as u16; width * 6];
        area.iter().for_each(|&pixel| image[pixel] = value);
        Speckles::new(width, 6).remove(&mut image, LEAST, 10);
        assert_eq!(image.iter().filter(|&&pixel| pixel == SCALE as u16).count(), width * 6 - area.len());
        let kept = area.iter().filter(|&&pixel| image[pixel] == value).count();
        assert!(kept == 0 || kept == area.len());
        kept > 0
    }

    #[test]
    fn small_areas_go_and_large_ones_stay() {
        let value = (10.0 * SCALE) as u16;
        assert!(!is_kept(&[19, 20], value));
        assert!(is_kept(&[19, 20, 28], value));
        // Joined around a corner only by a row further down: a U.
        assert!(is_kept(&[17, 19, 25, 27, 33, 34, 35], (25.0 * SCALE) as u16));
    }

    #[test]
    fn the_nearer_an_area_the_larger_it_must_be() {
        // 0.1 baselines are 4 pixels at a disparity of 40: an area of 16.
        let square = [17, 18, 19, 20, 25, 26, 27, 28];
        assert!(is_kept(&square, (20.0 * SCALE) as u16));
        assert!(!is_kept(&square, (40.0 * SCALE) as u16));
    }
}
