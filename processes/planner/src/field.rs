//! How far it is to the goal around what is known to stand in the way.
//!
//! A candidate is worth what remains to be flown from its end. The straight distance leads into every pocket; this
//! field is the length of the shortest way over a level grid around the vehicle, from whose rim it goes on straight.
//! What was once seen occupied and has left the map since is remembered as dear, not as closed: errors and drift
//! must not wall the vehicle in. The field prices candidates and admits none: that is [`crate::admission`]'s alone.

use crate::rollout::Sample;
use ipc_types::limits::Fence;
use ipc_types::{Point, Vector, World};
use memory::{Occupancy, Points, Scratch, Unknown, View};
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// Side of a cell, m.
const CELL_M: f64 = 0.4;
/// Cells along a side of what is remembered, which wraps around: more than the grid's.
const REMEMBERED: usize = 160;
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
/// Most that a metre of a trajectory costs, relative to a free one: what is closed at the middle of a cell may be open beside it.
const CLOSED_PRICE: f64 = 12.0;
/// What is no farther from a trajectory's start costs nothing, m.
const OWN_M: f64 = 0.7;
/// So often a way is smoothed: over about a metre.
const SMOOTHINGS: usize = 8;
/// How steeply a way gets back to its height.
const CLIMB: f64 = 0.2;

/// What a cell was when it was last known.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Memory {
    cell: (i64, i64),
    occupied: bool,
    /// Whether it was occupied when looked at from near.
    closed: bool,
}

/// Cost-to-go around the vehicle.
#[derive(Clone, Debug)]
pub(crate) struct Field {
    /// Cells to every side of the vehicle's.
    half: i64,
    first: (i64, i64),
    /// Centres of the cells: x, y and z, m; and what the map says of them.
    places: [Vec<f64>; 3],
    seen: Vec<Occupancy>,
    scratch: Scratch,
    /// How near something occupied is: 0 where nothing is.
    beside: Vec<u8>,
    /// Price of crossing a cell relative to a free one; infinite where closed.
    price: Vec<f32>,
    /// Length of the way to the goal, m.
    to_goal_m: Vec<f32>,
    queue: BinaryHeap<Reverse<(u32, u32)>>,
    memory: Vec<Option<Memory>>,
}

impl Field {
    /// A grid that reaches so far to every side of the vehicle, m.
    pub(crate) fn new(reach_m: f64) -> Self {
        let half = (reach_m / CELL_M).round().clamp(1.0, REMEMBERED as f64 / 2.0 - 1.0) as i64;
        let cells = (2 * half as usize + 1).pow(2);
        Self {
            half,
            first: (0, 0),
            places: [0; 3].map(|_| vec![0.0; cells]),
            seen: vec![Occupancy::Unknown(Unknown::OutOfView); cells],
            scratch: Scratch::default(),
            beside: vec![0; cells],
            price: vec![1.0; cells],
            to_goal_m: vec![f32::INFINITY; cells],
            queue: BinaryHeap::with_capacity(9 * cells),
            memory: vec![None; REMEMBERED * REMEMBERED],
        }
    }

    /// Asks the map anew around `at`, at its height.
    pub(crate) fn update(&mut self, view: &View, fence: &Fence, at: Point<World>, goal: Point<World>, ask: Ask) {
        let (x, y) = cell_of(at);
        self.first = (x - self.half, y - self.half);
        for index in 0..self.price.len() {
            let place = centre(self.cell(index), at.z);
            (self.places[0][index], self.places[1][index], self.places[2][index]) = (place.x, place.y, place.z);
        }
        let [x_m, y_m, z_m] = &self.places;
        let asked = view.occupancies(Points { x_m, y_m, z_m }, ask.threshold, &mut self.scratch, &mut self.seen);
        for index in 0..self.price.len() {
            let cell = self.cell(index);
            self.price[index] = if asked.is_ok() && fence.contains(centre(cell, at.z)) {
                let from_m = centre(cell, at.z).distance(at);
                self.price_of(cell, self.seen[index], from_m, ask.unknown_price)
            } else {
                f32::INFINITY
            };
        }
        self.keep_off(ask.clearance_price);
        self.spread(goal);
    }

    /// Cells beside something occupied are dear: gaps that one barely fits through are flown slowly, if at all.
    fn keep_off(&mut self, clearance_price: f32) {
        let side = self.side();
        self.beside.fill(0);
        for index in (0..self.price.len()).filter(|&index| self.seen[index] == Occupancy::Occupied) {
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
        for (price, &beside) in self.price.iter_mut().zip(&self.beside) {
            *price += clearance_price * f32::from(beside) / CLEARANCE as f32;
        }
    }

    /// Cells along a side.
    fn side(&self) -> usize {
        2 * self.half as usize + 1
    }

    fn cell(&self, index: usize) -> (i64, i64) {
        (self.first.0 + (index % self.side()) as i64, self.first.1 + (index / self.side()) as i64)
    }

    fn price_of(&mut self, cell: (i64, i64), seen: Occupancy, from_m: f64, unknown_price: f32) -> f32 {
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

    /// Fast marching (Sethian 1996) from the goal and the grid's rim inwards: distances as they are, not as the grid's
    /// eight directions make them.
    fn spread(&mut self, goal: Point<World>) {
        self.to_goal_m.fill(f32::INFINITY);
        self.queue.clear();
        let (goal_cell, side) = (cell_of(goal), self.side());
        for index in 0..self.price.len() {
            let (column, row) = (index % side, index / side);
            let is_rim = column == 0 || row == 0 || column == side - 1 || row == side - 1;
            let cell = self.cell(index);
            if cell == goal_cell || (is_rim && self.price[index].is_finite()) {
                self.reach(index, centre(cell, goal.z).distance(goal) as f32);
            }
        }
        while let Some(Reverse((bits, index))) = self.queue.pop() {
            let (so_far_m, index) = (f32::from_bits(bits), index as usize);
            if so_far_m > self.to_goal_m[index] {
                continue;
            }
            let (column, row) = (index % side, index / side);
            let neighbours = [
                (column > 0).then(|| index - 1),
                (column + 1 < side).then(|| index + 1),
                (row > 0).then(|| index - side),
                (row + 1 < side).then(|| index + side),
            ];
            for next in neighbours.into_iter().flatten() {
                let across_m = self.across(next);
                self.reach(next, across_m);
            }
        }
    }

    /// Distance of a cell by its neighbours: the upwind solution of |grad d| = price.
    fn across(&self, index: usize) -> f32 {
        let side = self.side();
        let (column, row) = (index % side, index / side);
        let at = |is_inside: bool, other: usize| if is_inside { self.to_goal_m[other] } else { f32::INFINITY };
        let west_east = at(column > 0, index.wrapping_sub(1)).min(at(column + 1 < side, index + 1));
        let south_north = at(row > 0, index.wrapping_sub(side)).min(at(row + 1 < side, index + side));
        let step = CELL_M as f32 * self.price[index];
        let (near, far) = (west_east.min(south_north), west_east.max(south_north));
        if far - near >= step {
            return near + step;
        }
        // (d − near)² + (d − far)² = step².
        0.5 * (near + far + (2.0 * step * step - (far - near) * (far - near)).max(0.0).sqrt())
    }

    fn reach(&mut self, index: usize, to_goal_m: f32) {
        if to_goal_m < self.to_goal_m[index] {
            self.to_goal_m[index] = to_goal_m;
            // Positive floats order as their bits do.
            self.queue.push(Reverse((to_goal_m.to_bits(), index as u32)));
        }
    }

    /// Length of the way from a point to the goal, m, or more; infinite where the grid knows none.
    pub(crate) fn to_goal_m(&self, point: Point<World>) -> f64 {
        let (x, y) = cell_of(point);
        let (side, mut least) = (self.side(), f64::INFINITY);
        for (right, down) in (-1..=1).flat_map(|right| (-1..=1).map(move |down| (right, down))) {
            // What lies beyond the grid is reached straight from its rim.
            let inside = |value: i64| value.clamp(0, side as i64 - 1);
            let (column, row) = (inside(x + right - self.first.0), inside(y + down - self.first.1));
            let index = row as usize * side + column as usize;
            let to_goal_m = f64::from(self.to_goal_m[index]);
            least = least.min(to_goal_m + centre(self.cell(index), point.z).distance(point));
        }
        least
    }

    /// What a trajectory costs beyond its length, m: for what is unknown, beside or in something occupied. The vehicle's own
    /// surroundings cost nothing: it is there.
    pub(crate) fn beyond_length_m(&self, going: &[Sample]) -> f64 {
        let Some(start) = going.first().map(|sample| sample.position) else { return 0.0 };
        let mut cost_m = 0.0;
        for pair in going.windows(2) {
            let length_m = pair[0].position.distance(pair[1].position);
            let pieces = (length_m / CELL_M).ceil().max(1.0) as usize;
            for piece in 1..=pieces {
                let place = pair[0].position.lerp(pair[1].position, piece as f64 / pieces as f64);
                if place.distance(start) > OWN_M {
                    cost_m += (self.price_at(place).min(CLOSED_PRICE) - 1.0) * length_m / pieces as f64;
                }
            }
        }
        cost_m
    }

    /// Price of a metre at a place, relative to a free one; beyond the grid nothing is known to stand.
    fn price_at(&self, place: Point<World>) -> f64 {
        let ((x, y), side) = (cell_of(place), self.side() as i64);
        let (column, row) = (x - self.first.0, y - self.first.1);
        let is_inside = (0..side).contains(&column) && (0..side).contains(&row);
        if is_inside { f64::from(self.price[(row * side + column) as usize]) } else { 1.0 }
    }

    /// The way to the goal from a place, downhill, as far as the grid knows it and `most_m` long at most.
    pub(crate) fn way(&self, from: Point<World>, height_m: f64, most_m: f64, way: &mut Vec<Point<World>>) {
        way.clear();
        way.push(from);
        let mut at = from;
        for _ in 0..(most_m / CELL_M) as usize {
            let Some(downhill) = self.downhill(at) else { break };
            at += downhill * CELL_M;
            at.z += (height_m - at.z).clamp(-CLIMB * CELL_M, CLIMB * CELL_M);
            way.push(at);
        }
        smooth(way);
    }

    /// Level direction in which the way to the goal gets shorter fastest; `None` at its end, beyond the grid and where
    /// it knows no way.
    pub(crate) fn downhill(&self, point: Point<World>) -> Option<Vector<World>> {
        let (x, y) = cell_of(point);
        let at = |right: i64, up: i64| {
            let (column, row, side) = (x + right - self.first.0, y + up - self.first.1, self.side() as i64);
            let is_inside = (0..side).contains(&column) && (0..side).contains(&row);
            let value = is_inside.then(|| self.to_goal_m[(row * side + column) as usize])?;
            value.is_finite().then_some(f64::from(value))
        };
        let here = at(0, 0)?;
        // Towards the lower of two open neighbours; away from a closed one.
        let slope = |before: Option<f64>, after: Option<f64>| match (before, after) {
            (Some(before), Some(after)) => (before - after) / 2.0,
            (Some(before), None) => (before - here).min(0.0),
            (None, Some(after)) => (here - after).max(0.0),
            (None, None) => 0.0,
        };
        Vector::new(slope(at(-1, 0), at(1, 0)), slope(at(0, -1), at(0, 1)), 0.0).direction()
    }
}

/// How the map is asked.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Ask {
    /// γ.
    pub(crate) threshold: f32,
    /// What an unknown metre costs beyond a free one.
    pub(crate) unknown_price: f32,
    /// What a metre right beside something occupied costs beyond a free one.
    pub(crate) clearance_price: f32,
}

/// Takes out the corners that the grid makes: every place moves to the middle of itself and what lies beside it.
fn smooth(way: &mut [Point<World>]) {
    for _ in 0..SMOOTHINGS {
        for index in 1..way.len().max(1) - 1 {
            let between = way[index - 1].lerp(way[index + 1], 0.5);
            way[index] = way[index].lerp(between, 0.5);
        }
    }
}

fn cell_of(point: Point<World>) -> (i64, i64) {
    // No world is larger, and no sum of cells overflows.
    let cell = |value: f64| (value / CELL_M).floor().clamp(-1e12, 1e12) as i64;
    (cell(point.x), cell(point.y))
}

fn centre(cell: (i64, i64), z: f64) -> Point<World> {
    Point::new((cell.0 as f64 + 0.5) * CELL_M, (cell.1 as f64 + 0.5) * CELL_M, z)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::{FENCE, home_only};

    const ASK: Ask = Ask { threshold: 0.9, unknown_price: 0.3, clearance_price: 0.0 };
    const GOAL: Point<World> = Point::new(40.0, 0.0, 2.0);
    const AT: Point<World> = Point::new(0.0, 0.0, 2.0);

    #[test]
    fn it_is_the_straight_distance_where_all_is_free() {
        let mut field = Field::new(10.0);
        field.update(&home_only(200.0), &FENCE, AT, GOAL, ASK);
        for point in [AT, Point::new(5.0, 3.0, 2.0), Point::new(-4.0, -6.0, 2.0)] {
            let (found, straight) = (field.to_goal_m(point), point.distance(GOAL));
            assert!((straight - 0.1..straight * 1.09).contains(&found), "{point:?}: {found}, straight {straight}");
        }
        let beyond = field.to_goal_m(Point::new(13.0, 0.0, 2.0));
        assert!((27.0..35.0).contains(&beyond), "beyond the grid there is no cliff: {beyond}");
    }

    #[test]
    fn unknown_space_is_dear_and_a_closed_rim_dearer() {
        let mut field = Field::new(10.0);
        field.update(&home_only(3.0), &FENCE, AT, GOAL, ASK);
        let known = field.to_goal_m(AT);
        assert!(known > 40.0 + 0.2 * (10.0 - 3.0), "{known}");
        let narrow = Fence { most_m: [6.0, 50.0, 6.0], ..FENCE };
        field.update(&home_only(200.0), &narrow, AT, GOAL, ASK);
        assert!(field.to_goal_m(AT) > known, "the rim towards the goal is closed");
    }

    #[test]
    fn far_walls_are_dear_until_they_were_seen_from_near() {
        let (mut field, cell) = (Field::new(10.0), (30, 4));
        let mut price = |seen, from_m| field.price_of(cell, seen, from_m, 0.3);
        assert_eq!(price(Occupancy::Occupied, FAR_M + 2.0), FAR_OCCUPIED);
        assert!(price(Occupancy::Occupied, FAR_M - 1.0).is_infinite());
        assert!(price(Occupancy::Occupied, FAR_M + 2.0).is_infinite(), "seen from near, it stays closed");
        assert_eq!(price(Occupancy::Free, FAR_M + 2.0), 1.0);
        assert_eq!(price(Occupancy::Occupied, FAR_M + 2.0), FAR_OCCUPIED, "seen free since");
    }

    #[test]
    fn the_way_leads_downhill() {
        let mut field = Field::new(10.0);
        field.update(&home_only(200.0), &FENCE, AT, GOAL, ASK);
        let downhill = field.downhill(Point::new(1.0, 0.5, 2.0)).expect("a way");
        assert!(downhill.x > 0.98 && (downhill.norm() - 1.0).abs() < 1e-9, "{downhill:?}");
        assert_eq!(field.downhill(Point::new(50.0, 0.0, 2.0)), None, "beyond the grid");
    }

    #[test]
    fn a_way_leads_to_the_goal_and_costs_what_it_crosses() {
        let (mut field, mut way) = (Field::new(10.0), Vec::new());
        let going = |way: &[Point<World>]| -> Vec<Sample> {
            way.iter().map(|&position| Sample { position, velocity: Vector::ZERO }).collect()
        };
        field.update(&home_only(200.0), &FENCE, AT, GOAL, ASK);
        field.way(AT, 3.0, 8.0, &mut way);
        let end = way.last().expect("a way");
        assert!((end.x - 8.0).abs() < 0.3 && end.y.abs() < 0.3 && (end.z - 3.0).abs() < 0.1, "{end:?}");
        assert_eq!(field.beyond_length_m(&going(&way)), 0.0);
        // Known for 3 m alone, and never seen before: what lies beyond costs its price.
        let mut field = Field::new(10.0);
        field.update(&home_only(3.0), &FENCE, AT, GOAL, ASK);
        let cost_m = field.beyond_length_m(&going(&way));
        assert!((cost_m - 0.3 * 5.0).abs() < 0.2, "{cost_m}");
        // Across the fence all is closed.
        let narrow = Fence { most_m: [4.0, 50.0, 6.0], ..FENCE };
        field.update(&home_only(200.0), &narrow, AT, GOAL, ASK);
        let cost_m = field.beyond_length_m(&going(&way));
        assert!((cost_m - (CLOSED_PRICE - 1.0) * 4.0).abs() < 6.0, "{cost_m}");
        assert_eq!(field.beyond_length_m(&[]), 0.0);
    }

    #[test]
    fn what_was_occupied_stays_dear_and_hostile_points_are_far() {
        let mut field = Field::new(10.0);
        let cell = cell_of(Point::new(2.0, 0.0, 2.0));
        assert!(field.price_of(cell, Occupancy::Occupied, 4.0, 0.3).is_infinite());
        let unknown = Occupancy::Unknown(memory::Unknown::OutOfView);
        assert_eq!(field.price_of(cell, unknown, 4.0, 0.3), ONCE_OCCUPIED);
        assert_eq!(field.price_of((cell.0 + REMEMBERED as i64, cell.1), unknown, 4.0, 0.3), 1.3, "another cell's slot");
        let unmeasured = Occupancy::Unknown(Unknown::NoReturn);
        assert_eq!(field.price_of((7, 9), unmeasured, 4.0, 0.3), 1.3);
        assert_eq!(field.price_of((7, 9), unmeasured, 1.0, 0.3), LOOKED_AT, "something may fill the view");
        assert_eq!(field.price_of(cell, Occupancy::Free, 4.0, 0.3), 1.0);
        assert_eq!(field.price_of(cell, unknown, 4.0, 0.3), 1.0);
        field.update(&home_only(200.0), &FENCE, AT, GOAL, ASK);
        for hostile in [f64::NAN, f64::INFINITY, -1e300] {
            assert!(!field.to_goal_m(Point::new(hostile, 0.0, 2.0)).is_finite() || hostile.is_finite());
            field.update(&home_only(200.0), &FENCE, Point::new(hostile, 1e300, hostile), GOAL, ASK);
            field.update(&home_only(200.0), &FENCE, AT, Point::new(hostile, hostile, 2.0), ASK);
        }
    }
}
