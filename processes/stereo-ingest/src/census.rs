//! Sparse census transform: which of 32 neighbours in a 9×7 chequerboard are brighter than the centre.
//!
//! One `u32` a pixel. It depends on order alone, so gain and exposure differences between the two cameras do not
//! matter. Zabih and Woodfill 1994; the chequerboard halves the bits at little loss.

use multiversion::multiversion;

/// Bits of a descriptor, and so the largest Hamming distance.
pub(crate) const BITS: u8 = 32;
const HALF_WIDTH: usize = 4;
const HALF_HEIGHT: usize = 3;

/// Descriptors of a row-major image. Neighbours outside the image are those at its border.
///
/// `padded` is scratch of [`padded_len`] elements.
pub(crate) fn census(image: &[u8], width: usize, padded: &mut [u8], descriptors: &mut [u32]) {
    let height = image.len() / width;
    let stride = width + 2 * HALF_WIDTH;
    for (row, line) in padded.chunks_exact_mut(stride).enumerate() {
        let source = row.saturating_sub(HALF_HEIGHT).min(height - 1);
        let source = &image[source * width..(source + 1) * width];
        line[..HALF_WIDTH].fill(source[0]);
        line[HALF_WIDTH..HALF_WIDTH + width].copy_from_slice(source);
        line[HALF_WIDTH + width..].fill(source[width - 1]);
    }
    for (row, descriptors) in descriptors.chunks_exact_mut(width).enumerate() {
        census_row(&padded[row * stride..(row + 2 * HALF_HEIGHT + 1) * stride], stride, descriptors);
    }
}

/// Scratch that [`census`] needs.
pub(crate) const fn padded_len(width: usize, height: usize) -> usize {
    (width + 2 * HALF_WIDTH) * (height + 2 * HALF_HEIGHT)
}

#[multiversion(targets("x86_64+avx512f+avx512bw", "x86_64+avx2", "aarch64+neon"))]
fn census_row(lines: &[u8], stride: usize, descriptors: &mut [u32]) {
    let width = descriptors.len();
    let centre = &lines[HALF_HEIGHT * stride + HALF_WIDTH..][..width];
    descriptors.fill(0);
    for dy in 0..=2 * HALF_HEIGHT {
        for dx in 0..=2 * HALF_WIDTH {
            // The chequerboard's colour that the centre does not have: 32 of the 63 cells.
            if (dx + HALF_WIDTH + dy + HALF_HEIGHT).is_multiple_of(2) {
                continue;
            }
            let neighbour = &lines[dy * stride + dx..][..width];
            for ((descriptor, &centre), &neighbour) in descriptors.iter_mut().zip(centre).zip(neighbour) {
                *descriptor = (*descriptor << 1) | u32::from(neighbour > centre);
            }
        }
    }
}

/// Hamming distances of one left row against the right one, for every pixel and disparity.
///
/// `right_reversed` is the right row from its last pixel to its first, so that growing disparities lie in order.
/// A match outside the right image costs the most.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512vpopcntdq", "x86_64+avx2", "aarch64+neon"))]
pub(crate) fn distances<const D: usize>(left: &[u32], right_reversed: &[u32], costs: &mut [u8]) {
    let width = left.len();
    for (x, (&left, costs)) in left.iter().zip(costs.chunks_exact_mut(D)).enumerate() {
        let candidates = &right_reversed[width - 1 - x..];
        let inside = candidates.len().min(D);
        for (cost, &right) in costs[..inside].iter_mut().zip(candidates) {
            *cost = (left ^ right).count_ones() as u8;
        }
        costs[inside..].fill(BITS);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn descriptors(image: &[u8], width: usize) -> Vec<u32> {
        let mut padded = vec![0; padded_len(width, image.len() / width)];
        let mut out = vec![0; image.len()];
        census(image, width, &mut padded, &mut out);
        out
    }

    #[test]
    fn brightness_and_gain_do_not_matter() {
        let image: Vec<u8> = (0..20 * 12_u32).map(|i| (i * i * 7 % 91) as u8).collect();
        let brighter: Vec<u8> = image.iter().map(|&p| p * 2 + 11).collect();
        assert_eq!(descriptors(&image, 20), descriptors(&brighter, 20));
    }

    #[test]
    fn uses_32_neighbours() {
        let mut image = vec![200; 20 * 12];
        image[6 * 20 + 10] = 0;
        assert_eq!(descriptors(&image, 20)[6 * 20 + 10].count_ones(), u32::from(BITS));
    }

    #[test]
    fn distances_compare_with_pixels_to_the_left() {
        let left: Vec<u32> = (0..40).map(|i| 1 << (i % 31)).collect();
        let mut reversed: Vec<u32> = left.iter().skip(5).chain(&[0; 5]).copied().collect();
        reversed.reverse();
        let mut costs = vec![9; 40 * 32];
        distances::<32>(&left, &reversed, &mut costs);
        // The right row shows the left row's pixel x at x - 5.
        assert!((5..40).all(|x| costs[x * 32 + 5] == 0));
        assert_eq!(costs[2 * 32 + 3], BITS);
    }
}
