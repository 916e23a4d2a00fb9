//! Where there is nothing to match: windows whose horizontal differences are no larger than noise.

/// Half height and half width of the window, px.
const HALF: (usize, usize) = (3, 6);

/// Mean absolute horizontal differences over a window, a row after the other, by running sums.
#[derive(Debug)]
pub(crate) struct Texture {
    /// Per column: sum of |I(x+1) − I(x)| over the rows of the window, with a margin of zeros on both sides.
    columns: Vec<u16>,
    /// Columns under the window around each column.
    under: Vec<f32>,
    /// Partial sums over 2, 4 and 8 columns from each on.
    partial: [Vec<u16>; 3],
    next: usize,
}

impl Texture {
    pub(crate) fn new(width: usize) -> Self {
        let padded = width + 4 * HALF.1;
        let under = |x: usize| ((x + HALF.1 + 1).min(width) - x.saturating_sub(HALF.1)) as f32;
        Self {
            columns: vec![0; padded],
            under: (0..width).map(under).collect(),
            partial: [(); 3].map(|()| vec![0; padded]),
            next: 0,
        }
    }

    /// Puts `mark` in `out` where the mean difference around the row's pixels is below `least`.
    ///
    /// Rows are to be asked for in order; any other row than the next one starts anew.
    #[inline(always)]
    pub(crate) fn mark_blank(&mut self, image: &[u8], row: usize, least: f32, mark: u16, out: &mut [u16]) {
        let width = out.len();
        let height = image.len() / width;
        let line = |row: usize| &image[row * width..(row + 1) * width];
        if row != self.next || row == 0 {
            self.columns.fill(0);
            for row in row.saturating_sub(HALF.0)..(row + HALF.0).min(height) {
                self.accumulate(line(row), u16::wrapping_add);
            }
        } else if row > HALF.0 {
            self.accumulate(line(row - HALF.0 - 1), u16::wrapping_sub);
        }
        if row + HALF.0 < height {
            self.accumulate(line(row + HALF.0), u16::wrapping_add);
        }
        self.next = row + 1;
        let [two, four, eight] = &mut self.partial;
        sum_shifted(two, &self.columns, &self.columns, 1);
        sum_shifted(four, two, two, 2);
        sum_shifted(eight, four, four, 4);
        let rows = ((row + HALF.0 + 1).min(height) - row.saturating_sub(HALF.0)) as f32;
        // 13 columns from x on, which is 6 before the middle one: 8 and 4 and 1.
        let sums = eight.iter().zip(&four[8..]).zip(&self.columns[12..]);
        for ((((eight, four), one), columns), out) in sums.zip(&self.under).zip(out) {
            let sum = eight + four + one;
            *out = if f32::from(sum) < least * rows * columns { mark } else { *out };
        }
    }

    /// Adds or removes a row's absolute differences.
    #[inline(always)]
    fn accumulate(&mut self, line: &[u8], change: impl Fn(u16, u16) -> u16) {
        for ((sum, a), b) in self.columns[HALF.1..].iter_mut().zip(line).zip(&line[1..]) {
            *sum = change(*sum, u16::from(a.abs_diff(*b)));
        }
    }
}

/// `out[x] = a[x] + b[x + shift]`, as far as there is one.
#[inline(always)]
fn sum_shifted(out: &mut [u16], a: &[u16], b: &[u16], shift: usize) {
    for ((out, a), b) in out.iter_mut().zip(a).zip(&b[shift..]) {
        *out = a + b;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_blank_area_is_found_and_stripes_are_not() {
        let (width, height) = (60, 30);
        let image: Vec<u8> =
            (0..width * height).map(|i| if i % width < 30 { 90 + (i % 2) as u8 } else { (i % 3 * 40) as u8 }).collect();
        let mut texture = Texture::new(width);
        let mut blank = vec![0; image.len()];
        let rows = |from: usize| (from..height).chain(0..from);
        for row in rows(11) {
            texture.mark_blank(&image, row, 2.0, 1, &mut blank[row * width..(row + 1) * width]);
        }
        for row in 0..height {
            assert!((0..23).all(|column| blank[row * width + column] == 1), "row {row}");
            assert!((30..60).all(|column| blank[row * width + column] == 0), "row {row}");
        }
    }

    #[test]
    fn agrees_with_the_definition() {
        let (width, height) = (40, 20);
        let image: Vec<u8> = (0..width * height).map(|i| (i * i % 251 % 37) as u8).collect();
        let mut texture = Texture::new(width);
        for row in 0..height {
            let mut out = vec![0; width];
            texture.mark_blank(&image, row, 12.5, 1, &mut out);
            for (x, out) in out.into_iter().enumerate() {
                let (mut sum, mut cells) = (0, 0);
                for y in row.saturating_sub(3)..(row + 4).min(height) {
                    for x in x.saturating_sub(6)..(x + 7).min(width) {
                        cells += 1;
                        sum += if x + 1 < width {
                            i32::from(image[y * width + x].abs_diff(image[y * width + x + 1]))
                        } else {
                            0
                        };
                    }
                }
                assert_eq!(out == 1, (sum as f32) < 12.5 * cells as f32, "row {row}, column {x}");
            }
        }
    }
}
