//! One level of the grid: what the map says of its cells, and what crossing them costs.
//!
//! What was once seen occupied and has left the map since is remembered as dear, not as closed: errors and drift
//! must not wall the vehicle in.

use crate::grid::{CELL_M, Cell, Grid};
use memory::{Occupancy, Points, Scratch, Unknown, View};

/// Cells along a side of what is remembered, which wraps around: more than the grid's.
pub(crate) const REMEMBERED: usize = 160;
/// How near to something occupied a cell is dear, cells.
const CLEARANCE: usize = 2;
/// Price of a cell that was occupied when last seen, relative to a free one.
const ONCE_OCCUPIED: f32 = 5.0;

/// Least price of a cell near the vehicle that was looked at in vain, relative to a free one: something may fill the view.
const LOOKED_AT: f32 = 5.0;
/// So near, m. Cells a little beyond what a search shuns are dear before they are shunned.
const NEAR_M: f64 = 3.0;

/// Price of a cell that is occupied as far as can be told from afar, relative to a free one: noise makes walls of far trunks
/// that have gaps from near.
const FAR_OCCUPIED: f32 = 3.0;
/// So far, m.
const FAR_M: f64 = 6.0;

/// Heights that are nearer than this share of the levels' distance are the same.
const SAME_HEIGHT: f64 = 0.5;

/// What a cell was when it was last known.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Memory {
    cell: Cell,
    occupied: bool,
    /// Whether it was occupied when looked at from near.
    closed: bool,
}

/// What the map says of a grid's cells. Made once, for one level after the other.
#[derive(Clone, Debug)]
pub(crate) struct Survey {
    /// Where the map is asked, x, y and z, m; what it says there, and so of every cell.
    places: [Vec<f64>; 3],
    answers: Vec<Occupancy>,
    seen: Vec<Occupancy>,
    scratch: Scratch,
    /// How near something occupied is: 0 where nothing is.
    beside: Vec<u8>,
}

impl Survey {
    /// Of a grid of so many cells.
    pub(crate) fn new(cells: usize) -> Self {
        Self {
            places: [0; 3].map(|_| vec![0.0; cells]),
            answers: vec![Occupancy::Unknown(Unknown::OutOfView); cells],
            seen: vec![Occupancy::Unknown(Unknown::OutOfView); cells],
            scratch: Scratch::default(),
            beside: vec![0; cells],
        }
    }

    /// Asks the map at a height, once for every `block`² cells. False if it has no answer.
    pub(crate) fn ask(&mut self, grid: Grid, block: usize, z_m: f64, view: &View, threshold: f32) -> bool {
        let (side, blocks) = (grid.side(), grid.side().div_ceil(block));
        let middle_m = 0.5 * (block - 1) as f64 * CELL_M;
        for index in 0..blocks * blocks {
            let corner = grid.centre(index / blocks * block * side + index % blocks * block, z_m);
            (self.places[0][index], self.places[1][index]) = (corner.x + middle_m, corner.y + middle_m);
            self.places[2][index] = corner.z;
        }
        let [x_m, y_m, z_m] = self.places.each_ref().map(|places| &places[..blocks * blocks]);
        let answers = &mut self.answers[..blocks * blocks];
        let asked = view.occupancies(Points { x_m, y_m, z_m }, threshold, &mut self.scratch, answers);
        for (index, seen) in self.seen.iter_mut().enumerate() {
            *seen = self.answers[index / side / block * blocks + index % side / block];
        }
        asked.is_ok()
    }

    pub(crate) fn seen(&self, index: usize) -> Occupancy {
        self.seen[index]
    }

    /// Cells beside something occupied are dear: gaps that one barely fits through are flown slowly, if at all.
    pub(crate) fn keep_off(&mut self, side: usize, clearance_price: f32, price: &mut [f32]) {
        self.beside.fill(0);
        for index in (0..price.len()).filter(|&index| self.seen[index] == Occupancy::Occupied) {
            let (column, row) = (index % side, index / side);
            let around = |at: usize| at.saturating_sub(CLEARANCE)..=(at + CLEARANCE).min(side - 1);
            for other_row in around(row) {
                for other in around(column) {
                    let steps = other.abs_diff(column).max(other_row.abs_diff(row));
                    let beside = &mut self.beside[other_row * side + other];
                    *beside = (*beside).max((CLEARANCE + 1 - steps) as u8);
                }
            }
        }
        for (price, &beside) in price.iter_mut().zip(&self.beside) {
            *price += clearance_price * f32::from(beside) / CLEARANCE as f32;
        }
    }
}

/// See the module's documentation.
#[derive(Clone, Debug)]
pub(crate) struct Level {
    /// Height, m.
    pub(crate) z_m: f64,
    /// About which height something is remembered, m, and how far about it; and what.
    remembered_m: f64,
    about_m: f64,
    memory: Vec<Option<Memory>>,
}

impl Level {
    /// One of levels that lie so far above each other, m.
    pub(crate) fn new(rise_m: f64) -> Self {
        let about_m = SAME_HEIGHT * rise_m;
        Self { z_m: 0.0, remembered_m: 0.0, about_m, memory: vec![None; REMEMBERED * REMEMBERED] }
    }

    /// Moves it to a height. What is remembered is of about one height.
    pub(crate) fn move_to(&mut self, z_m: f64) {
        if (z_m - self.remembered_m).abs() > self.about_m {
            self.memory.fill(None);
            self.remembered_m = z_m;
        }
        self.z_m = z_m;
    }

    /// The most that crossing a cell costs, relative to a free one, where it is not closed.
    pub(crate) fn dearest(unknown_price: f32, clearance_price: f32) -> f32 {
        let beside = clearance_price * (CLEARANCE + 1) as f32 / CLEARANCE as f32;
        (1.0 + unknown_price).max(LOOKED_AT).max(ONCE_OCCUPIED).max(FAR_OCCUPIED) + beside
    }

    /// Price of crossing a cell relative to a free one; infinite where closed. Remembers what was seen.
    pub(crate) fn price_of(&mut self, cell: Cell, seen: Occupancy, from_m: f64, unknown_price: f32) -> f32 {
        let side = REMEMBERED as i64;
        let slot = (cell.1.rem_euclid(side) * side + cell.0.rem_euclid(side)) as usize;
        let occupied = match seen {
            Occupancy::Free => false,
            Occupancy::Occupied => true,
            Occupancy::Unknown(why) => {
                return match self.memory[slot].filter(|memory| memory.cell == cell) {
                    Some(Memory { occupied: true, .. }) => ONCE_OCCUPIED,
                    Some(_) => 1.0,
                    None if from_m < NEAR_M && why == Unknown::NoReturn => LOOKED_AT.max(1.0 + unknown_price),
                    None => 1.0 + unknown_price,
                };
            }
        };
        let known = self.memory[slot].filter(|memory| memory.cell == cell);
        let closed = occupied && (from_m < FAR_M || known.is_some_and(|memory| memory.closed));
        self.memory[slot] = Some(Memory { cell, occupied, closed });
        match (occupied, closed) {
            (_, true) => f32::INFINITY,
            (true, false) => FAR_OCCUPIED,
            (false, _) => 1.0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn far_walls_are_dear_until_they_were_seen_from_near() {
        let (mut level, cell) = (Level::new(1.0), (30, 4));
        let mut price = |seen, from_m| level.price_of(cell, seen, from_m, 0.3);
        assert_eq!(price(Occupancy::Occupied, FAR_M + 2.0), FAR_OCCUPIED);
        assert!(price(Occupancy::Occupied, FAR_M - 1.0).is_infinite());
        assert!(price(Occupancy::Occupied, FAR_M + 2.0).is_infinite(), "seen from near, it stays closed");
        assert_eq!(price(Occupancy::Free, FAR_M + 2.0), 1.0);
        assert_eq!(price(Occupancy::Occupied, FAR_M + 2.0), FAR_OCCUPIED, "seen free since");
    }

    #[test]
    fn what_was_occupied_stays_dear_at_its_height() {
        let (mut level, cell) = (Level::new(1.0), (5, 0));
        assert!(level.price_of(cell, Occupancy::Occupied, 4.0, 0.3).is_infinite());
        let unknown = Occupancy::Unknown(Unknown::OutOfView);
        assert_eq!(level.price_of(cell, unknown, 4.0, 0.3), ONCE_OCCUPIED);
        assert_eq!(level.price_of((cell.0 + REMEMBERED as i64, cell.1), unknown, 4.0, 0.3), 1.3, "another cell's slot");
        let unmeasured = Occupancy::Unknown(Unknown::NoReturn);
        assert_eq!(level.price_of((7, 9), unmeasured, 4.0, 0.3), 1.3);
        assert_eq!(level.price_of((7, 9), unmeasured, 1.0, 0.3), LOOKED_AT, "something may fill the view");
        level.move_to(0.4);
        assert_eq!(level.price_of(cell, unknown, 4.0, 0.3), ONCE_OCCUPIED, "hardly moved");
        level.move_to(0.8);
        assert_eq!(level.price_of(cell, unknown, 4.0, 0.3), 1.3);
        assert!(level.price_of(cell, Occupancy::Occupied, 4.0, 0.3).is_infinite());
        assert_eq!(level.price_of(cell, Occupancy::Free, 4.0, 0.3), 1.0);
        assert_eq!(level.price_of(cell, unknown, 4.0, 0.3), 1.0);
        let mut close = Level::new(0.3);
        assert!(close.price_of(cell, Occupancy::Occupied, 4.0, 0.3).is_infinite());
        close.move_to(0.2);
        assert_eq!(close.price_of(cell, unknown, 4.0, 0.3), 1.3, "nearer to the next level");
    }
}
