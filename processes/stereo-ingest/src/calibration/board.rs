//! A chessboard's inner corners, in the order of the board.
//!
//! `chess-corners` finds the corners (ChESS, Bennett and Lasenby 2014, refined to the saddle point); here a grid is
//! grown over them. The order is a property of the printed board, not of the view: rows of `columns`, right-handed in
//! the image, and which of the two ends is first is told by the colours, for which one side must be even, the other odd.

use chess_corners::{CornerDescriptor, Detector, DetectorConfig, ImageRefiner, OnRefinerReject};
use std::collections::{HashMap, VecDeque};
use std::f64::consts::PI;

/// Position in an image, px.
pub type Pixel = [f64; 2];

/// Finds one board.
pub struct BoardFinder {
    detector: Detector,
    columns: usize,
    rows: usize,
}

impl std::fmt::Debug for BoardFinder {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(formatter, "BoardFinder({} x {})", self.columns, self.rows)
    }
}

/// Corners by cell of a grid whose origin is any of them.
type Grid = HashMap<(i32, i32), usize>;

/// The detector's corners that the grid is started from, strongest first.
const SEEDS: usize = 64;
/// Largest deviation of a corner from the middle of its neighbours, of their distance: lens distortion bends less.
const IRREGULARITY: f64 = 0.10;

impl BoardFinder {
    /// For a board of so many inner corners, 9 × 6, say.
    ///
    /// # Errors
    /// Fewer than 3 either way, or both sides even or odd.
    pub fn new(columns: usize, rows: usize) -> Result<Self, String> {
        if columns.min(rows) < 3 || columns.max(rows) > 40 || (columns + rows).is_multiple_of(2) {
            return Err(format!(
                "board of {columns} x {rows} inner corners; expected 3 to 40, one side even and the other odd, so that its ends differ"
            ));
        }
        let config = DetectorConfig::chess()
            .with_refiner(ImageRefiner::saddle_point())
            .with_chess(|chess| chess.on_refiner_reject = OnRefinerReject::KeepCenterOfMass);
        let detector = Detector::new(config).map_err(|error| error.to_string())?;
        Ok(Self { detector, columns, rows })
    }

    /// All corners of the board, row by row, or `None` where it is not seen whole.
    ///
    /// # Errors
    /// The image is smaller than the detector can work on.
    pub fn find(&mut self, image: &[u8], width: usize, height: usize) -> Result<Option<Vec<Pixel>>, String> {
        let found = self.detector.detect_u8(image, width as u32, height as u32);
        let mut corners = found.map_err(|error| error.to_string())?;
        corners.retain(|corner| corner.axes.is_some());
        corners.sort_by(|a, b| b.response.total_cmp(&a.response));
        let grey = |at: Pixel| {
            let clamp = |value: f64, side: usize| (value.round().max(0.0) as usize).min(side - 1);
            f64::from(image[clamp(at[1], height) * width + clamp(at[0], width)])
        };
        for seed in 0..corners.len().min(SEEDS) {
            let grid = grow(&corners, seed);
            if grid.len() < self.columns * self.rows {
                continue;
            }
            let boards = self.boards(&corners, &grid);
            if let Some(board) = boards.into_iter().find_map(|board| self.in_order(board, &grey)) {
                return Ok(Some(board));
            }
        }
        Ok(None)
    }

    /// Boards that the grid holds, either way round; those whose weakest corner is strongest first.
    fn boards(&self, corners: &[CornerDescriptor], grid: &Grid) -> Vec<Vec<Pixel>> {
        let mut boards = Vec::new();
        for &(u, v) in grid.keys() {
            for transposed in [false, true] {
                let cell = |index: usize| {
                    let (i, j) = ((index % self.columns) as i32, (index / self.columns) as i32);
                    grid.get(&if transposed { (u + j, v + i) } else { (u + i, v + j) }).copied()
                };
                let Some(cells) = (0..self.columns * self.rows).map(cell).collect::<Option<Vec<usize>>>() else {
                    continue;
                };
                let weakest = cells.iter().map(|&index| corners[index].response).fold(f32::MAX, f32::min);
                boards.push((
                    weakest,
                    (u, v, transposed),
                    cells.iter().map(|&index| position(&corners[index])).collect(),
                ));
            }
        }
        boards.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        boards.into_iter().map(|(_, _, board)| board).collect()
    }

    /// The board's own order, or `None` for what is no chessboard: bent, or not of alternating colours.
    fn in_order(&self, mut board: Vec<Pixel>, grey: &impl Fn(Pixel) -> f64) -> Option<Vec<Pixel>> {
        let (columns, rows) = (self.columns, self.rows);
        for index in 0..board.len() {
            let (i, j) = (index % columns, index / columns);
            for (fits, step) in [(i + 2 < columns, 1), (j + 2 < rows, columns)] {
                if fits && bend(board[index], board[index + step], board[index + 2 * step]) > IRREGULARITY {
                    return None;
                }
            }
        }
        let [origin, along, down] = [board[0], board[columns - 1], board[(rows - 1) * columns]];
        let (a, b) = ([along[0] - origin[0], along[1] - origin[1]], [down[0] - origin[0], down[1] - origin[1]]);
        if a[0] * b[1] < a[1] * b[0] {
            board = board.chunks(columns).rev().flatten().copied().collect();
        }
        let mut shades = [Vec::new(), Vec::new()];
        for index in (0..columns * (rows - 1)).filter(|index| index % columns + 1 < columns) {
            let cell = [board[index], board[index + 1], board[index + columns], board[index + columns + 1]];
            let middle = [0, 1].map(|axis| cell.iter().map(|corner| corner[axis]).sum::<f64>() / 4.0);
            shades[(index % columns + index / columns) % 2].push(grey(middle));
        }
        shades.iter_mut().for_each(|shades| shades.sort_by(f64::total_cmp));
        let median = |shades: &[f64]| shades[shades.len() / 2];
        let light_first = median(&shades[0]) > median(&shades[1]);
        let (light, dark) = if light_first { (&shades[0], &shades[1]) } else { (&shades[1], &shades[0]) };
        // All but a tenth of each must be told apart: a reflection may be anywhere.
        if light[light.len() / 10] <= dark[dark.len() - 1 - dark.len() / 10] {
            return None;
        }
        if !light_first {
            board.reverse();
        }
        Some(board)
    }
}

fn position(corner: &CornerDescriptor) -> Pixel {
    [f64::from(corner.x), f64::from(corner.y)]
}

/// Deviation of the middle one of three corners from the middle, of the distance of the others.
fn bend(a: Pixel, middle: Pixel, b: Pixel) -> f64 {
    let off = [0, 1].map(|axis| a[axis] - 2.0 * middle[axis] + b[axis]);
    off[0].hypot(off[1]) / (a[0] - b[0]).hypot(a[1] - b[1])
}

/// Angle between two undirected axes, rad.
fn between_axes(a: f64, b: f64) -> f64 {
    let difference = (a - b).rem_euclid(PI);
    difference.min(PI - difference)
}

/// Breadth-first from a seed. Neighbours on a chessboard have their two axes swapped.
fn grow(corners: &[CornerDescriptor], seed: usize) -> Grid {
    let axis = |index: usize, which: usize| corners[index].axes.map_or(0.0, |axes| f64::from(axes[which].angle));
    let near = |a: f64, b: f64| between_axes(a, b) < 30_f64.to_radians();
    let swapped = |a: usize, b: usize| near(axis(a, 0), axis(b, 1)) && near(axis(a, 1), axis(b, 0));
    let mut grid = Grid::from([((0, 0), seed)]);
    let mut used = vec![false; corners.len()];
    used[seed] = true;
    // Cell, directions of its axes, and the last step's length along each.
    let mut queue = VecDeque::from([((0, 0), [axis(seed, 0), axis(seed, 1)], [0.0_f64; 2])]);
    while let Some(((u, v), directions, mut steps)) = queue.pop_front() {
        let here = grid[&(u, v)];
        for (which, sign) in [(0, 1), (0, -1), (1, 1), (1, -1)] {
            let cell = if which == 0 { (u + sign, v) } else { (u, v + sign) };
            if grid.contains_key(&cell) {
                continue;
            }
            let toward = [directions[which].cos(), directions[which].sin()].map(|part| part * f64::from(sign));
            let reach = reach(steps[which], steps[1 - which]);
            let candidates = (0..corners.len()).filter(|&other| !used[other] && swapped(here, other));
            let nearest = candidates
                .filter_map(|other| {
                    let (from, to) = (position(&corners[here]), position(&corners[other]));
                    let off = [to[0] - from[0], to[1] - from[1]];
                    let ahead = off[0] * toward[0] + off[1] * toward[1];
                    let aside = (off[0] * toward[1] - off[1] * toward[0]).abs();
                    (reach.contains(&ahead) && aside <= 0.2 * ahead).then_some((ahead, other))
                })
                .min_by(|a, b| a.0.total_cmp(&b.0));
            let Some((ahead, next)) = nearest else { continue };
            used[next] = true;
            grid.insert(cell, next);
            steps[which] = ahead;
            let follow = |wanted: f64| {
                let angle =
                    axis(next, usize::from(between_axes(axis(next, 0), wanted) > between_axes(axis(next, 1), wanted)));
                if (angle - wanted).cos() < 0.0 { angle + PI } else { angle }
            };
            queue.push_back((cell, directions.map(follow), steps));
        }
    }
    grid
}

/// How far the next corner may be, px, after the last step along this axis and along the other one.
fn reach(own: f64, other: f64) -> std::ops::RangeInclusive<f64> {
    if own > 0.0 {
        0.65 * own..=1.5 * own
    } else if other > 0.0 {
        0.3 * other..=3.0 * other
    } else {
        6.0..=f64::MAX
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A board of `cell` px squares, turned by `angle`, seen from above.
    fn picture(angle: f64, cell: f64) -> Vec<u8> {
        let (sin, cos) = angle.sin_cos();
        // Four by four samples a pixel.
        let shade = |x: f64, y: f64| {
            let (x, y) = (x - 160.0, y - 120.0);
            let (u, v) = ((cos * x + sin * y) / cell + 4.0, (cos * y - sin * x) / cell + 3.5);
            let inside = (0.0..8.0).contains(&u) && (0.0..7.0).contains(&v);
            if inside && (u.floor() + v.floor()) as i32 % 2 == 1 { 30.0 } else { 220.0 }
        };
        let pixel = |x: usize, y: usize| {
            let samples = (0..16)
                .map(|i| shade(x as f64 + f64::from(i % 4) / 4.0 - 0.375, y as f64 + f64::from(i / 4) / 4.0 - 0.375));
            (samples.sum::<f64>() / 16.0) as u8
        };
        (0..320 * 240).map(|i| pixel(i % 320, i / 320)).collect()
    }

    #[test]
    fn every_corner_is_found_in_the_same_order_however_the_board_is_turned() {
        // Eight by seven squares have seven by six inner corners.
        let mut finder = BoardFinder::new(7, 6).expect("possible");
        for angle in [0.0, 0.4, 1.5, 3.0, -2.0] {
            let found = finder.find(&picture(angle, 22.0), 320, 240).expect("large enough").expect("seen whole");
            let (sin, cos) = f64::sin_cos(angle);
            for (index, [x, y]) in found.into_iter().enumerate() {
                let (u, v) = ((index % 7) as f64 - 3.0, (index / 7) as f64 - 2.5);
                let expected = [160.0 + 22.0 * (cos * u - sin * v), 120.0 + 22.0 * (sin * u + cos * v)];
                let off = (x - expected[0]).hypot(y - expected[1]);
                let opposite = (x - 320.0 + expected[0]).hypot(y - 240.0 + expected[1]);
                assert!(off.min(opposite) < 0.3, "angle {angle}, corner {index}: {x}, {y}, expected {expected:?}");
                assert!(off < 0.3, "angle {angle}: the board's other end came first");
            }
        }
    }

    #[test]
    fn what_is_not_there_is_not_found() {
        let mut finder = BoardFinder::new(7, 6).expect("possible");
        assert_eq!(finder.find(&vec![128; 320 * 240], 320, 240), Ok(None));
        let mut covered = picture(0.4, 22.0);
        for y in 100..150 {
            covered[y * 320 + 150..y * 320 + 200].fill(128);
        }
        assert_eq!(finder.find(&covered, 320, 240), Ok(None));
        assert!(BoardFinder::new(6, 6).is_err() && BoardFinder::new(2, 5).is_err());
    }
}
