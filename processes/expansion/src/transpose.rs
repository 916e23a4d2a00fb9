//! Rows to columns and back.

use multiversion::multiversion;

/// Places along a side of a block: 2⁵.
const SIDE: usize = 32;
type Block = [u16; SIDE * SIDE];

/// Transposes a row-major image of rows of `width`.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512vl", "x86_64+avx2+fma", "x86_64+sse4.1", "aarch64+neon"))]
pub(crate) fn transpose(from: &[u16], width: usize, to: &mut [u16]) {
    let height = from.len() / width;
    let (mut block, mut other) = ([0; SIDE * SIDE], [0; SIDE * SIDE]);
    for top in (0..height).step_by(SIDE) {
        let tall = SIDE.min(height - top);
        for left in (0..width).step_by(SIDE) {
            let wide = SIDE.min(width - left);
            for (row, line) in block.chunks_exact_mut(SIDE).enumerate().take(tall) {
                copy(&from[(top + row) * width + left..], line, wide);
            }
            shuffle(&block, &mut other);
            shuffle(&other, &mut block);
            shuffle(&block, &mut other);
            shuffle(&other, &mut block);
            shuffle(&block, &mut other);
            for (column, line) in other.chunks_exact(SIDE).enumerate().take(wide) {
                copy(line, &mut to[(left + column) * height + top..], tall);
            }
        }
    }
}

/// Copies so many of the first [`SIDE`] elements: all of them at once, mostly.
#[inline(always)]
fn copy(from: &[u16], to: &mut [u16], count: usize) {
    match (from.first_chunk::<SIDE>(), to.first_chunk_mut::<SIDE>()) {
        (Some(from), Some(to)) if count == SIDE => *to = *from,
        _ => to[..count].copy_from_slice(&from[..count]),
    }
}

/// Interleaves both halves, which turns the bits of an index by one place: five times exchange row and column.
#[inline(always)]
fn shuffle(from: &Block, to: &mut Block) {
    const HALF: usize = SIDE * SIDE / 2;
    for place in 0..HALF {
        to[2 * place] = from[place];
        to[2 * place + 1] = from[place + HALF];
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_become_columns() {
        for (width, height) in [(32, 32), (1, 1), (1, 70), (65, 3), (100, 77)] {
            let image: Vec<u16> = (0..width * height).map(|place| place as u16).collect();
            let mut turned = vec![0; image.len()];
            transpose(&image, width, &mut turned);
            for (place, &value) in image.iter().enumerate() {
                assert_eq!(turned[place % width * height + place / width], value, "{width} x {height}");
            }
        }
    }
}
