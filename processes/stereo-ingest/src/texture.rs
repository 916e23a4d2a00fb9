//! Where there is nothing to match: windows whose horizontal differences are no larger than noise.

/// Half height and half width of the window, px.
const HALF: (usize, usize) = (3, 6);

/// Sums of absolute horizontal differences over a window, by running sums.
#[derive(Debug)]
pub(crate) struct Texture {
    width: usize,
    /// Per column: sum over the rows of the window.
    columns: Vec<u32>,
    /// The same, summed up from the left.
    prefix: Vec<u32>,
}

impl Texture {
    pub(crate) fn new(width: usize) -> Self {
        Self { width, columns: vec![0; width], prefix: vec![0; width + 1] }
    }

    /// Calls `mark` with row, column for every pixel whose mean absolute difference is below `least`.
    pub(crate) fn find_blank(&mut self, image: &[u8], least: f32, mut mark: impl FnMut(usize, usize)) {
        let (width, height) = (self.width, image.len() / self.width);
        let (half_rows, half_columns) = HALF;
        let line = |row: usize| &image[row * width..(row + 1) * width];
        self.columns.fill(0);
        (0..half_rows.min(height)).for_each(|row| accumulate(&mut self.columns, line(row), 1));
        for row in 0..height {
            if row + half_rows < height {
                accumulate(&mut self.columns, line(row + half_rows), 1);
            }
            if row > half_rows {
                accumulate(&mut self.columns, line(row - half_rows - 1), -1);
            }
            for column in 0..width {
                self.prefix[column + 1] = self.prefix[column] + self.columns[column];
            }
            let rows = (row + half_rows + 1).min(height) - row.saturating_sub(half_rows);
            for column in 0..width {
                let (from, to) = (column.saturating_sub(half_columns), (column + half_columns + 1).min(width));
                let sum = self.prefix[to] - self.prefix[from];
                if (sum as f32) < least * (rows * (to - from)) as f32 {
                    mark(row, column);
                }
            }
        }
    }
}

/// Adds or removes a row's absolute differences |I(x+1) − I(x)|.
fn accumulate(columns: &mut [u32], line: &[u8], sign: i32) {
    for (sum, pair) in columns.iter_mut().zip(line.windows(2)) {
        *sum = sum.wrapping_add_signed(sign * i32::from(pair[0].abs_diff(pair[1])));
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
        let mut blank = vec![false; image.len()];
        Texture::new(width).find_blank(&image, 2.0, |row, column| blank[row * width + column] = true);
        for row in 0..height {
            assert!((0..23).all(|column| blank[row * width + column]), "row {row}");
            assert!((30..60).all(|column| !blank[row * width + column]), "row {row}");
        }
    }
}
