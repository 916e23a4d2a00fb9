//! Census transform: which of 32 neighbours in a 9×7 chequerboard are brighter than the centre.
//!
//! It depends on order alone, so gain and exposure differences between the two cameras do not matter; a neighbour must
//! be brighter by more than one grey level, so that noise on blank areas does not look like texture. Zabih and Woodfill
//! 1994; the chequerboard halves the bits at little loss. The 32 bits lie in four planes of a byte a pixel.

use super::simd::Lanes;

/// Planes of a descriptor.
pub(crate) const PLANES: usize = 4;
const HALF_WIDTH: usize = 4;
const HALF_HEIGHT: usize = 3;
/// Offsets of the neighbours within the window: the chequerboard's colour that the centre does not have.
const NEIGHBOURS: [(usize, usize); 8 * PLANES] = neighbours();

const fn neighbours() -> [(usize, usize); 8 * PLANES] {
    let mut list = [(0, 0); 8 * PLANES];
    let (mut cell, mut count) = (0, 0);
    while cell < (2 * HALF_WIDTH + 1) * (2 * HALF_HEIGHT + 1) {
        // With an odd width the parity of the running number is the colour; the centre's is odd.
        if cell % 2 == 0 {
            list[count] = (cell / (2 * HALF_WIDTH + 1), cell % (2 * HALF_WIDTH + 1));
            count += 1;
        }
        cell += 1;
    }
    list
}

/// Grey levels by which a neighbour must exceed the centre.
const THRESHOLD: u8 = 1;

/// Scratch of one thread: the lines under the window, their borders repeated outwards.
#[derive(Debug)]
pub(crate) struct Window {
    lines: Vec<u8>,
    stride: usize,
}

impl Window {
    /// For images of a width; `lanes` is the largest vector, by which lines are longer.
    pub(crate) fn new(width: usize, lanes: usize) -> Self {
        let stride = width + 2 * HALF_WIDTH + lanes;
        Self { lines: vec![0; stride * (2 * HALF_HEIGHT + 1)], stride }
    }

    /// Descriptors of row `row` of a row-major image: each of `planes` gets a byte for every pixel, and beyond.
    ///
    /// A plane's slice must be longer than the width by a vector.
    #[inline(always)]
    pub(crate) fn describe<S: Lanes>(&mut self, image: &[u8], width: usize, row: usize, planes: [&mut [u8]; PLANES]) {
        let height = image.len() / width;
        for (dy, line) in self.lines.chunks_exact_mut(self.stride).enumerate() {
            let source = (row + dy).saturating_sub(HALF_HEIGHT).min(height - 1);
            let source = &image[source * width..(source + 1) * width];
            line[..HALF_WIDTH].fill(source[0]);
            line[HALF_WIDTH..HALF_WIDTH + width].copy_from_slice(source);
            line[HALF_WIDTH + width..].fill(source[width - 1]);
        }
        let (one, threshold) = (S::splat(1), S::splat(THRESHOLD));
        for (plane, neighbours) in planes.into_iter().zip(NEIGHBOURS.as_chunks::<8>().0) {
            for x in (0..width).step_by(S::COUNT) {
                let centre = S::load(&self.lines[HALF_HEIGHT * self.stride + HALF_WIDTH + x..]);
                let centre = centre.add_saturating(threshold);
                let mut bits = S::splat(0);
                for &(dy, dx) in neighbours {
                    let neighbour = S::load(&self.lines[dy * self.stride + dx + x..]);
                    bits = bits.add(bits).add(neighbour.sub_saturating(centre).min(one));
                }
                bits.store(&mut plane[x..]);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::simd::Portable;
    use super::*;

    fn descriptors(image: &[u8], width: usize) -> Vec<[u8; PLANES]> {
        let mut window = Window::new(width, 64);
        let mut out = Vec::new();
        for row in 0..image.len() / width {
            let mut planes = [(); PLANES].map(|()| vec![0; width + 64]);
            window.describe::<Portable>(image, width, row, planes.each_mut().map(Vec::as_mut_slice));
            out.extend((0..width).map(|x| planes.each_ref().map(|plane| plane[x])));
        }
        out
    }

    #[test]
    fn brightness_and_gain_do_not_matter() {
        let image: Vec<u8> = (0..20 * 12_u32).map(|i| (i * i * 7 % 13 * 9) as u8).collect();
        let brighter: Vec<u8> = image.iter().map(|&p| p * 2 + 11).collect();
        assert_eq!(descriptors(&image, 20), descriptors(&brighter, 20));
    }

    #[test]
    fn uses_32_neighbours_around_the_centre() {
        let mut image = vec![200; 20 * 12];
        image[6 * 20 + 10] = 0;
        let found = descriptors(&image, 20);
        assert_eq!(found[6 * 20 + 10], [255; PLANES]);
        let others: u32 = found.iter().flatten().map(|byte| byte.count_ones()).sum();
        assert_eq!(others, 32, "the dark pixel is nobody's brighter neighbour");
    }

    #[test]
    fn one_grey_level_is_noise() {
        let image: Vec<u8> = (0..20 * 12_usize).map(|i| 90 + (i * 7 % 3 == 0) as u8).collect();
        assert!(descriptors(&image, 20).iter().all(|bits| *bits == [0; PLANES]));
    }
}
