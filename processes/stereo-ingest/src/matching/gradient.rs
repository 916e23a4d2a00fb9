//! Horizontal gradient, for the block matcher: it does not depend on brightness, and large gradients are cut.

/// Largest gradient kept, grey levels (sum of three lines, weighted 1, 2, 1).
const LARGEST: i32 = 31;

/// Sobel's horizontal derivative of row `row`, cut to ±31 and moved to 0..=62.
#[inline(always)]
pub(crate) fn gradient(image: &[u8], width: usize, row: usize, out: &mut [u8]) {
    let height = image.len() / width;
    let line = |row: usize| &image[row * width..(row + 1) * width];
    let (above, here, below) = (line(row.saturating_sub(1)), line(row), line((row + 1).min(height - 1)));
    let column = |x: usize| i32::from(above[x]) + 2 * i32::from(here[x]) + i32::from(below[x]);
    for (x, out) in out.iter_mut().enumerate() {
        let difference = column((x + 1).min(width - 1)) - column(x.saturating_sub(1));
        *out = (difference.clamp(-LARGEST, LARGEST) + LARGEST) as u8;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_step_is_seen_and_brightness_is_not() {
        let image: Vec<u8> = (0..8 * 3).map(|i| if i % 8 < 4 { 40 } else { 45 }).collect();
        let brighter: Vec<u8> = image.iter().map(|&p| p + 100).collect();
        let (mut dark, mut bright) = ([0; 8], [0; 8]);
        gradient(&image, 8, 1, &mut dark);
        gradient(&brighter, 8, 1, &mut bright);
        assert_eq!(dark, [31, 31, 31, 51, 51, 31, 31, 31]);
        assert_eq!(dark, bright);
    }
}
