//! Where there is nothing to match: windows whose horizontal differences are no larger than noise. And where there is
//! something right here.

/// Half height of the windows, px.
const HALF_HEIGHT: usize = 3;
/// Half widths: of the one in which there must be texture to match at all, and of the one in which there is some right
/// here, px. An edge beside a blank thing reaches into the first, and not far into the second.
const HALF_WIDTHS: [usize; 2] = [6, 2];

/// Mean absolute horizontal differences over two windows, a row after the other, by running sums.
#[derive(Debug)]
pub(crate) struct Texture {
    /// Per column: sum of |I(x+1) − I(x)| over the rows of the window, with a margin of zeros on both sides.
    columns: Vec<u16>,
    /// Columns under the windows around each column.
    under: [Vec<f32>; 2],
    /// Partial sums over 2, 4 and 8 columns from each on.
    partial: [Vec<u16>; 3],
    /// Rows under the windows.
    rows: f32,
    next: usize,
}

impl Texture {
    pub(crate) fn new(width: usize) -> Self {
        let padded = width + 4 * HALF_WIDTHS[0];
        let under =
            |half: usize| (0..width).map(|x| ((x + half + 1).min(width) - x.saturating_sub(half)) as f32).collect();
        Self {
            columns: vec![0; padded],
            under: HALF_WIDTHS.map(under),
            partial: [(); 3].map(|()| vec![0; padded]),
            rows: 0.0,
            next: 0,
        }
    }

    /// Takes in a row of an image of this width. Rows are to come in order; any other than the next one starts anew.
    #[inline(always)]
    pub(crate) fn take_in(&mut self, image: &[u8], row: usize) {
        let width = self.under[0].len();
        let height = image.len() / width;
        let line = |row: usize| &image[row * width..(row + 1) * width];
        if row != self.next || row == 0 {
            self.columns.fill(0);
            for row in row.saturating_sub(HALF_HEIGHT)..(row + HALF_HEIGHT).min(height) {
                self.accumulate(line(row), u16::wrapping_add);
            }
        } else if row > HALF_HEIGHT {
            self.accumulate(line(row - HALF_HEIGHT - 1), u16::wrapping_sub);
        }
        if row + HALF_HEIGHT < height {
            self.accumulate(line(row + HALF_HEIGHT), u16::wrapping_add);
        }
        self.next = row + 1;
        self.rows = ((row + HALF_HEIGHT + 1).min(height) - row.saturating_sub(HALF_HEIGHT)) as f32;
        let [two, four, eight] = &mut self.partial;
        sum_shifted(two, &self.columns, &self.columns, 1);
        sum_shifted(four, two, two, 2);
        sum_shifted(eight, four, four, 4);
    }

    /// Puts `mark` in `out` where the mean difference in the wide window around the row's pixels is below `least`.
    #[inline(always)]
    pub(crate) fn mark_blank(&self, least: f32, mark: u16, out: &mut [u16]) {
        let [_, four, eight] = &self.partial;
        // 13 columns from x on, which is 6 before the middle one: 8 and 4 and 1.
        let sums = eight.iter().zip(&four[8..]).zip(&self.columns[12..]);
        for ((((eight, four), one), columns), out) in sums.zip(&self.under[0]).zip(out) {
            let sum = eight + four + one;
            *out = if f32::from(sum) < least * self.rows * columns { mark } else { *out };
        }
    }

    /// Puts `mark` in place of `code` where the mean difference in the narrow window is `least` or more.
    #[inline(always)]
    pub(crate) fn mark_textured(&self, least: f32, code: u16, mark: u16, out: &mut [u16]) {
        // 5 columns, 2 before the middle one, which lies 6 from the margin's end: 4 and 1.
        let sums = self.partial[1][4..].iter().zip(&self.columns[8..]);
        for (((four, one), columns), out) in sums.zip(&self.under[1]).zip(out) {
            let is_textured = f32::from(four + one) >= least * self.rows * columns;
            *out = if is_textured && *out == code { mark } else { *out };
        }
    }

    /// Adds or removes a row's absolute differences.
    #[inline(always)]
    fn accumulate(&mut self, line: &[u8], change: impl Fn(u16, u16) -> u16) {
        for ((sum, a), b) in self.columns[HALF_WIDTHS[0]..].iter_mut().zip(line).zip(&line[1..]) {
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
        let mut marks = vec![0; image.len()];
        let rows = |from: usize| (from..height).chain(0..from);
        for row in rows(11) {
            let marks = &mut marks[row * width..(row + 1) * width];
            texture.take_in(&image, row);
            texture.mark_blank(2.0, 1, marks);
            texture.mark_textured(3.0, 0, 2, marks);
        }
        for row in marks.chunks(width) {
            assert!((0..23).all(|column| row[column] == 1), "{row:?}");
            assert!((23..27).all(|column| row[column] == 0), "an edge beside a blank area: {row:?}");
            assert!((30..60).all(|column| row[column] == 2), "{row:?}");
        }
    }

    #[test]
    fn agrees_with_the_definition() {
        let (width, height) = (40, 20);
        let image: Vec<u8> = (0..width * height).map(|i| (i * i % 251 % 37) as u8).collect();
        let difference = |y: usize, x: usize| image[y * width + x].abs_diff(image[y * width + (x + 1).min(width - 1)]);
        let mean = |row: usize, column: usize, half: usize| {
            let rows = row.saturating_sub(3)..(row + 4).min(height);
            let columns = column.saturating_sub(half)..(column + half + 1).min(width);
            let cells = (rows.len() * columns.len()) as f32;
            let sum = |y: usize| columns.clone().map(|x| u32::from(difference(y, x))).sum::<u32>();
            (rows.map(sum).sum::<u32>() as f32, cells)
        };
        let mut texture = Texture::new(width);
        for row in 0..height {
            let (mut blank, mut textured) = (vec![0; width], vec![0; width]);
            texture.take_in(&image, row);
            texture.mark_blank(12.5, 1, &mut blank);
            texture.mark_textured(12.5, 0, 1, &mut textured);
            for x in 0..width {
                let (sum, cells) = mean(row, x, HALF_WIDTHS[0]);
                assert_eq!(blank[x] == 1, sum < 12.5 * cells, "row {row}, column {x}");
                let (sum, cells) = mean(row, x, HALF_WIDTHS[1]);
                assert_eq!(textured[x] == 1, sum >= 12.5 * cells, "row {row}, column {x}");
            }
        }
    }
}
