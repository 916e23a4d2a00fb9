//! Cells of a level grid around the vehicle. Its outermost cells are a border that is never crossed, so that whatever goes from
//! cell to cell need not ask whether there is a next one.

use ipc_types::{Point, World};

/// Side of a cell, m.
pub(crate) const CELL_M: f64 = 0.4;

/// A cell's place among all: towards east and north.
pub(crate) type Cell = (i64, i64);

/// Which cells a grid holds.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Grid {
    /// South-western cell: even, so that what is asked once for two cells is asked at the same place wherever the vehicle is.
    first: Cell,
    /// Cells to every side of the vehicle's.
    half: i64,
}

impl Grid {
    /// With so many cells to every side of the vehicle's, and the border.
    pub(crate) fn new(half: i64) -> Self {
        Self { first: (0, 0), half: half + 1 }
    }

    /// Moves it to where the vehicle is.
    pub(crate) fn move_to(&mut self, at: Point<World>) {
        let (x, y) = cell_of(at);
        self.first = ((x - self.half) & !1, (y - self.half) & !1);
    }

    /// How far it reaches, m.
    pub(crate) fn reach_m(self) -> f64 {
        self.half as f64 * CELL_M
    }

    /// Cells along a side.
    pub(crate) fn side(self) -> usize {
        2 * self.half as usize + 1
    }

    /// Cells in all.
    pub(crate) fn cells(self) -> usize {
        self.side().pow(2)
    }

    pub(crate) fn cell(self, index: usize) -> Cell {
        (self.first.0 + (index % self.side()) as i64, self.first.1 + (index / self.side()) as i64)
    }

    /// The middle of a cell.
    pub(crate) fn centre(self, index: usize, z_m: f64) -> Point<World> {
        let (x, y) = self.cell(index);
        Point::new((x as f64 + 0.5) * CELL_M, (y as f64 + 0.5) * CELL_M, z_m)
    }

    /// The cell that a point lies in, if it is one within the border: [`cell_of`] and [`Self::beside`] in one, without rounding
    /// down first, for the prices of some fifty places of every candidate.
    pub(crate) fn at(self, point: Point<World>) -> Option<usize> {
        let [column, row] = [(point.x, self.first.0), (point.y, self.first.1)]
            .map(|(value, first)| value * (1.0 / CELL_M) - first as f64);
        let (within, side) = (1.0..(self.side() - 1) as f64, self.side());
        (within.contains(&column) && within.contains(&row)).then(|| row as usize * side + column as usize)
    }

    /// The cell so many to the east and north of another, if there is one within the border.
    pub(crate) fn beside(self, (x, y): Cell, east: i64, north: i64) -> Option<usize> {
        let (column, row, last) = (x + east - self.first.0, y + north - self.first.1, self.side() as i64 - 1);
        ((1..last).contains(&column) && (1..last).contains(&row)).then(|| row as usize * self.side() + column as usize)
    }

    /// The same, or where there is none the nearest one on the rim.
    pub(crate) fn nearest(self, (x, y): Cell, east: i64, north: i64) -> usize {
        let last = self.side() as i64 - 2;
        let (column, row) = ((x + east - self.first.0).clamp(1, last), (y + north - self.first.1).clamp(1, last));
        row as usize * self.side() + column as usize
    }

    /// The outermost cells within the border, the corners twice.
    pub(crate) fn rim(self) -> impl Iterator<Item = usize> {
        let (side, last) = (self.side(), self.side() - 2);
        (1..=last).flat_map(move |along| [side + along, last * side + along, along * side + 1, along * side + last])
    }

    /// Whether a cell belongs to the border.
    pub(crate) fn is_border(self, index: usize) -> bool {
        let (column, row, last) = (index % self.side(), index / self.side(), self.side() - 1);
        column == 0 || row == 0 || column == last || row == last
    }

    /// Cells beside a cell within the border: west, east, south, north.
    pub(crate) fn neighbours(self, index: usize) -> [usize; 4] {
        [index - 1, index + 1, index - self.side(), index + self.side()]
    }
}

/// The cell that a point lies in.
pub(crate) fn cell_of(point: Point<World>) -> Cell {
    // No world is larger, and no sum of cells overflows.
    let cell = |value: f64| {
        let cells = (value * (1.0 / CELL_M)).clamp(-1e12, 1e12);
        // Rounds towards zero, unlike `floor`, which is a call.
        let towards_zero = cells as i64;
        towards_zero - i64::from((towards_zero as f64) > cells)
    };
    (cell(point.x), cell(point.y))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_point_lies_in_the_cell_that_is_asked_for_either_way() {
        let mut grid = Grid::new(5);
        grid.move_to(Point::new(-7.3, 12.1, 0.0));
        let mut within = 0;
        for (east, north) in (0..60).flat_map(|east| (0..60).map(move |north| (east, north))) {
            let point = Point::new(-10.33 + 0.1 * f64::from(east), 9.07 + 0.1 * f64::from(north), 1.0);
            assert_eq!(grid.at(point), grid.beside(cell_of(point), 0, 0), "{point:?}");
            within += usize::from(grid.at(point).is_some());
        }
        assert!((1500..2500).contains(&within), "{within}");
        for hostile in [f64::NAN, f64::INFINITY, -1e300] {
            assert_eq!(grid.at(Point::new(hostile, 12.1, 0.0)), None);
        }
    }
}
