//! Cells of a level grid around the vehicle.

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
    /// With so many cells to every side of the vehicle's.
    pub(crate) fn new(half: i64) -> Self {
        Self { first: (0, 0), half }
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

    /// The cell so many to the east and north of a point's, if there is one.
    pub(crate) fn beside(self, point: Point<World>, east: i64, north: i64) -> Option<usize> {
        let (x, y) = cell_of(point);
        let (column, row, side) = (x + east - self.first.0, y + north - self.first.1, self.side() as i64);
        ((0..side).contains(&column) && (0..side).contains(&row)).then(|| (row * side + column) as usize)
    }

    /// The same, or where there is none the nearest one on the rim.
    pub(crate) fn nearest(self, point: Point<World>, east: i64, north: i64) -> usize {
        let ((x, y), last) = (cell_of(point), self.side() as i64 - 1);
        let (column, row) = ((x + east - self.first.0).clamp(0, last), (y + north - self.first.1).clamp(0, last));
        row as usize * self.side() + column as usize
    }

    /// Whether a cell has none beside it on some side.
    pub(crate) fn is_rim(self, index: usize) -> bool {
        let (column, row, last) = (index % self.side(), index / self.side(), self.side() - 1);
        column == 0 || row == 0 || column == last || row == last
    }

    /// Cells beside a cell, numbered through several grids one after the other: west, east, south, north.
    pub(crate) fn neighbours(self, index: usize) -> [Option<usize>; 4] {
        let (side, within) = (self.side(), index % self.cells());
        let (column, row) = (within % side, within / side);
        [
            (column > 0).then(|| index - 1),
            (column + 1 < side).then(|| index + 1),
            (row > 0).then(|| index - side),
            (row + 1 < side).then(|| index + side),
        ]
    }
}

/// The cell that a point lies in.
pub(crate) fn cell_of(point: Point<World>) -> Cell {
    // No world is larger, and no sum of cells overflows.
    let cell = |value: f64| (value / CELL_M).floor().clamp(-1e12, 1e12) as i64;
    (cell(point.x), cell(point.y))
}
