//! Removes small connected areas: what is left of noise after the consistency checks.
//!
//! Small in the image, or small in the world: a false match at a large disparity would stand right before the
//! vehicle, where even a leaf covers many pixels.

use ipc_types::disparity::{NO_MATCH, SCALE, is_valid};

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

/// Scratch of the flood fill.
#[derive(Debug)]
pub(crate) struct Speckles {
    seen: Vec<bool>,
    area: Vec<u32>,
}

impl Speckles {
    pub(crate) fn new(pixels: usize) -> Self {
        Self { seen: vec![false; pixels], area: Vec::with_capacity(pixels) }
    }

    /// Replaces areas that are too small, within which neighbours differ by at most `step` (fixed point), by
    /// [`NO_MATCH`].
    pub(crate) fn remove(&mut self, disparities: &mut [u16], width: usize, least: Least, step: u16) {
        self.seen.fill(false);
        for start in 0..disparities.len() {
            if self.seen[start] || !is_valid(disparities[start]) {
                continue;
            }
            self.flood(disparities, width, start, step);
            let sum: u64 = self.area.iter().map(|&pixel| u64::from(disparities[pixel as usize])).sum();
            let mean_px = sum as f32 / (self.area.len() as f32 * SCALE);
            if self.area.len() < least.area_px(mean_px) {
                self.area.iter().for_each(|&pixel| disparities[pixel as usize] = NO_MATCH);
            }
        }
    }

    /// Collects the area around `start` in `self.area`, which serves as the queue too.
    fn flood(&mut self, disparities: &[u16], width: usize, start: usize, step: u16) {
        self.area.clear();
        self.area.push(start as u32);
        self.seen[start] = true;
        let mut next = 0;
        while next < self.area.len() {
            let pixel = self.area[next] as usize;
            next += 1;
            let column = pixel % width;
            let neighbours = [
                (column > 0).then(|| pixel - 1),
                (column + 1 < width).then(|| pixel + 1),
                pixel.checked_sub(width),
                Some(pixel + width).filter(|&below| below < disparities.len()),
            ];
            for neighbour in neighbours.into_iter().flatten() {
                let joined =
                    is_valid(disparities[neighbour]) && disparities[neighbour].abs_diff(disparities[pixel]) <= step;
                if joined && !self.seen[neighbour] {
                    self.seen[neighbour] = true;
                    self.area.push(neighbour as u32);
                }
            }
        }
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
        Speckles::new(image.len()).remove(&mut image, width, LEAST, 10);
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
    }

    #[test]
    fn the_nearer_an_area_the_larger_it_must_be() {
        // 0.1 baselines are 4 pixels at a disparity of 40: an area of 16.
        let square = [17, 18, 19, 20, 25, 26, 27, 28];
        assert!(is_kept(&square, (20.0 * SCALE) as u16));
        assert!(!is_kept(&square, (40.0 * SCALE) as u16));
    }
}
