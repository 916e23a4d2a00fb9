//! Removes small connected areas: what is left of noise after the consistency checks.

use ipc_types::disparity::{NO_MATCH, is_valid};

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

    /// Replaces areas of fewer than `least_area` pixels, within which neighbours differ by at most `step`
    /// (fixed point), by [`NO_MATCH`].
    pub(crate) fn remove(&mut self, disparities: &mut [u16], width: usize, least_area: usize, step: u16) {
        self.seen.fill(false);
        for start in 0..disparities.len() {
            if self.seen[start] || !is_valid(disparities[start]) {
                continue;
            }
            self.flood(disparities, width, start, step);
            if self.area.len() < least_area {
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

    #[test]
    fn small_areas_go_and_large_ones_stay() {
        let width = 8;
        let mut image = vec![100; width * 6];
        image[2 * width + 3] = 900;
        image[2 * width + 4] = 905;
        Speckles::new(image.len()).remove(&mut image, width, 3, 10);
        assert_eq!((image[2 * width + 3], image[2 * width + 4]), (NO_MATCH, NO_MATCH));
        assert_eq!(image.iter().filter(|&&pixel| pixel == 100).count(), width * 6 - 2);
    }
}
