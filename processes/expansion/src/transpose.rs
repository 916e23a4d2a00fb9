//! Rows to columns and back.

/// Transposes a row-major image of rows of `width`, in blocks that fit the first-level cache.
pub(crate) fn transpose(from: &[u16], width: usize, to: &mut [u16]) {
    const BLOCK: usize = 32;
    let height = from.len() / width;
    for top in (0..height).step_by(BLOCK) {
        for left in (0..width).step_by(BLOCK) {
            for column in left..(left + BLOCK).min(width) {
                for row in top..(top + BLOCK).min(height) {
                    to[column * height + row] = from[row * width + column];
                }
            }
        }
    }
}
