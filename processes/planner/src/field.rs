//! How far it is to the goal around what is known to stand in the way, and over it.
//!
//! A candidate is worth what remains to be flown from its end. The straight distance leads into every pocket; this
//! field is the length of the shortest way over level grids around the vehicle, from whose rims it goes on straight.
//! One grid lies at the height to keep. Only where its way is longer than a straight one that climbs, or the vehicle is at
//! another height, the map is asked about those above and below, too: a way may change from one to the next anywhere, at a
//! price. The field prices candidates and admits none: that is [`crate::admission`]'s alone.

use crate::buckets::Buckets;
use crate::level::{Level, Place, REMEMBERED};
use crate::rollout::Sample;
use ipc_types::limits::Fence;
use ipc_types::{Point, Vector, World};
use memory::View;
use std::ops::Range;

/// Side of a cell, m.
pub(crate) const CELL_M: f64 = 0.4;
/// Distance of the grids from each other, m: what any but a tiny vehicle keeps off by lies in one at least.
const RISE_M: f64 = 1.0;
/// Grids at most, and how many of them below the one at the height to keep.
const LEVELS: usize = 5;
const BELOW: usize = 1;
/// Those others are asked about once for so many cells along either side: 0.8 m, less than a margin is wide.
const COARSE: usize = 2;
/// Most that a metre of a trajectory costs, relative to a free one: what is closed at the middle of a cell may be open beside it.
const CLOSED_PRICE: f64 = 12.0;
/// What is no farther from a trajectory's start costs nothing, m.
const OWN_M: f64 = 0.7;
/// So often a way is smoothed: over about a metre.
const SMOOTHINGS: usize = 8;
/// How steeply a way rises to another grid ...
const CLIMB: f64 = 1.0;
/// ... and sinks: flatter, so that the camera sees where it leads.
const DESCENT: f64 = 0.2;
/// A way changes to another grid where that costs no more than this beyond staying, m: rather early than at the last moment.
const EARLY_M: f64 = 0.5;

/// A cell's place among all: towards east and north.
pub(crate) type Cell = (i64, i64);

/// Which cells a level grid holds.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Grid {
    /// South-western cell.
    first: Cell,
    /// Cells to every side of the vehicle's.
    half: i64,
}

impl Grid {
    /// Cells along a side.
    pub(crate) fn side(self) -> usize {
        2 * self.half as usize + 1
    }

    fn cells(self) -> usize {
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

    /// The cell beside a point's, if there is one.
    fn beside(self, point: Point<World>, right: i64, up: i64) -> Option<usize> {
        let (x, y) = cell_of(point);
        let (column, row, side) = (x + right - self.first.0, y + up - self.first.1, self.side() as i64);
        ((0..side).contains(&column) && (0..side).contains(&row)).then(|| (row * side + column) as usize)
    }
}

/// Cost-to-go around the vehicle.
#[derive(Clone, Debug)]
pub(crate) struct Field {
    grid: Grid,
    levels: [Level; LEVELS],
    /// Those that are up to date, from the lowest on: the one at the height to keep, at least.
    known: Range<usize>,
    /// Price of a metre up or down.
    height_price: f64,
    /// Of every cell of every level, one level after the other: price of crossing it relative to a free one, infinite where
    /// closed, and length of the way to the goal from it, m.
    price: Vec<f32>,
    to_goal_m: Vec<f32>,
    queue: Buckets,
}

/// How the map is asked.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Ask {
    /// Height to keep, m.
    pub(crate) height_m: f64,
    /// γ.
    pub(crate) threshold: f32,
    /// What an unknown metre costs beyond a free one.
    pub(crate) unknown_price: f32,
    /// What a metre right beside something occupied costs beyond a free one.
    pub(crate) clearance_price: f32,
    /// What a metre up or down costs.
    pub(crate) height_price: f64,
}

impl Field {
    /// Grids that reach so far to every side of the vehicle, m.
    pub(crate) fn new(reach_m: f64) -> Self {
        let half = (reach_m / CELL_M).round().clamp(1.0, REMEMBERED as f64 / 2.0 - 1.0) as i64;
        let grid = Grid { first: (0, 0), half };
        let levels = [0; LEVELS].map(|_| Level::new(grid.cells()));
        let cells = LEVELS * grid.cells();
        Self {
            grid,
            levels,
            known: BELOW..BELOW + 1,
            height_price: 0.0,
            price: vec![1.0; cells],
            to_goal_m: vec![f32::INFINITY; cells],
            queue: Buckets::new(11 * cells),
        }
    }

    /// Asks the map anew around `at`.
    pub(crate) fn update(&mut self, view: &View, fence: &Fence, at: Point<World>, goal: Point<World>, ask: Ask) {
        let ((x, y), half) = (cell_of(at), self.grid.half);
        self.grid.first = (x - half, y - half);
        self.height_price = ask.height_price;
        let height_m = if ask.height_m.is_finite() { ask.height_m } else { at.z };
        for (number, level) in self.levels.iter_mut().enumerate() {
            level.move_to(height_m + (number as f64 - BELOW as f64) * RISE_M);
        }
        self.known = BELOW..BELOW + 1;
        let place = Place { at, fence };
        self.look(BELOW, view, place, ask);
        self.spread(goal);
        let straight_m = at.distance(goal);
        let seen_m = straight_m.min(half as f64 * CELL_M);
        let climbing_m = straight_m + f64::from(ask.unknown_price) * seen_m + 2.0 * RISE_M * ask.height_price;
        if self.to_goal_m(at) <= climbing_m && (at.z - height_m).abs() < 0.5 * RISE_M {
            return;
        }
        let is_within = |level: &Level| (fence.least_m[2]..=fence.most_m[2]).contains(&level.z_m);
        let below = self.levels[..BELOW].iter().rev().take_while(|level| is_within(level)).count();
        let above = self.levels[BELOW + 1..].iter().take_while(|level| is_within(level)).count();
        self.known = BELOW - below..BELOW + 1 + above;
        for number in self.known.clone().filter(|&number| number != BELOW) {
            self.look(number, view, place, ask);
        }
        self.spread(goal);
    }

    /// Asks the map about a level.
    fn look(&mut self, level: usize, view: &View, place: Place<'_>, ask: Ask) {
        let (cells, block) = (self.grid.cells(), if level == BELOW { 1 } else { COARSE });
        let price = &mut self.price[level * cells..][..cells];
        self.levels[level].update(self.grid, block, view, place, ask, price);
    }

    /// Fast marching (Sethian 1996) from the goal and the grids' rims inwards: distances as they are, not as a grid's
    /// eight directions make them. Up and down from grid to grid they add up.
    fn spread(&mut self, goal: Point<World>) {
        self.to_goal_m.fill(f32::INFINITY);
        self.queue.clear();
        let (goal_cell, side, cells) = (cell_of(goal), self.grid.side(), self.grid.cells());
        let goal_level = self.nearest_level(goal.z);
        for number in self.known.clone() {
            for index in 0..cells {
                let (column, row) = (index % side, index / side);
                let is_rim = column == 0 || row == 0 || column == side - 1 || row == side - 1;
                let is_goal = number == goal_level && self.grid.cell(index) == goal_cell;
                if is_goal || (is_rim && self.price[number * cells + index].is_finite()) {
                    // From the rim on it gets back to the height to keep.
                    let off_m = if is_goal { 0.0 } else { RISE_M * number.abs_diff(BELOW) as f64 };
                    let to_goal_m = self.grid.centre(index, goal.z).distance(goal) + self.height_price * off_m;
                    self.reach(number * cells + index, to_goal_m as f32);
                }
            }
        }
        let rise_m = (self.height_price * RISE_M) as f32;
        while let Some((index, so_far_m)) = self.queue.pop() {
            if so_far_m > self.to_goal_m[index] {
                continue;
            }
            for next in self.neighbours(index).into_iter().flatten() {
                // What is nearer to the goal already is not reached from here.
                if self.to_goal_m[next] > so_far_m {
                    let across_m = self.across(next);
                    self.reach(next, across_m);
                }
            }
            let level = index / cells;
            let down = (level > self.known.start).then(|| index - cells);
            let up = (level + 1 < self.known.end).then(|| index + cells);
            for next in [down, up].into_iter().flatten() {
                if self.price[next].is_finite() {
                    self.reach(next, so_far_m + rise_m);
                }
            }
        }
    }

    /// Cells beside a cell of the same grid: west, east, south, north.
    fn neighbours(&self, index: usize) -> [Option<usize>; 4] {
        let (side, within) = (self.grid.side(), index % self.grid.cells());
        let (column, row) = (within % side, within / side);
        [
            (column > 0).then(|| index - 1),
            (column + 1 < side).then(|| index + 1),
            (row > 0).then(|| index - side),
            (row + 1 < side).then(|| index + side),
        ]
    }

    /// Distance of a cell by its neighbours: the upwind solution of |grad d| = price.
    fn across(&self, index: usize) -> f32 {
        let at = |place: Option<usize>| place.map_or(f32::INFINITY, |place| self.to_goal_m[place]);
        let [west, east, south, north] = self.neighbours(index).map(at);
        let (west_east, south_north) = (west.min(east), south.min(north));
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
            self.queue.push(index, to_goal_m);
        }
    }

    /// Length of the way from a point to the goal, m, or more; infinite where the grids know none.
    pub(crate) fn to_goal_m(&self, point: Point<World>) -> f64 {
        self.levels_at(point.z).map(|level| self.by_level_m(level, point)).into_iter().fold(f64::INFINITY, f64::min)
    }

    /// The same by way of a level.
    fn by_level_m(&self, level: usize, point: Point<World>) -> f64 {
        let ((x, y), side) = (cell_of(point), self.grid.side());
        let mut least = f64::INFINITY;
        for (right, down) in (-1..=1).flat_map(|right| (-1..=1).map(move |down| (right, down))) {
            // What lies beyond the grid is reached straight from its rim.
            let inside = |value: i64| value.clamp(0, side as i64 - 1);
            let (column, row) = (inside(x + right - self.grid.first.0), inside(y + down - self.grid.first.1));
            let index = row as usize * side + column as usize;
            let to_goal_m = f64::from(self.to_goal_m[level * self.grid.cells() + index]);
            least = least.min(to_goal_m + self.grid.centre(index, point.z).distance(point));
        }
        least + self.height_price * (point.z - self.levels[level].z_m).abs()
    }

    /// The levels that a height lies between, or the same twice.
    fn levels_at(&self, z_m: f64) -> [usize; 2] {
        let above = self.known.clone().find(|&level| self.levels[level].z_m >= z_m).unwrap_or(self.known.end - 1);
        [if self.levels[above].z_m > z_m { above.saturating_sub(1).max(self.known.start) } else { above }, above]
    }

    fn nearest_level(&self, z_m: f64) -> usize {
        let off_m = |&level: &usize| (self.levels[level].z_m - z_m).abs();
        self.known.clone().min_by(|a, b| off_m(a).total_cmp(&off_m(b))).unwrap_or(BELOW)
    }

    /// The level by which the way from a point leads.
    fn level_of(&self, point: Point<World>) -> usize {
        let [below, above] = self.levels_at(point.z);
        let mut level = if self.by_level_m(below, point) <= self.by_level_m(above, point) { below } else { above };
        let Some(cell) = self.grid.beside(point, 0, 0) else { return level };
        let to_goal_m = |level: usize| f64::from(self.to_goal_m[level * self.grid.cells() + cell]);
        let rise_m = self.height_price * RISE_M - EARLY_M.min(0.4 * self.height_price * RISE_M);
        while level + 1 < self.known.end && to_goal_m(level + 1) + rise_m <= to_goal_m(level) {
            level += 1;
        }
        while level > self.known.start && to_goal_m(level - 1) + rise_m <= to_goal_m(level) {
            level -= 1;
        }
        level
    }

    /// Height to fly at from a point on, m.
    pub(crate) fn height_m(&self, point: Point<World>) -> f64 {
        self.levels[self.level_of(point)].z_m
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
        let price = |cell: usize| f64::from(self.price[self.nearest_level(place.z) * self.grid.cells() + cell]);
        self.grid.beside(place, 0, 0).map_or(1.0, price)
    }

    /// The way to the goal from a place, downhill, as far as the grids know it and `most_m` long at most.
    pub(crate) fn way(&self, from: Point<World>, most_m: f64, way: &mut Vec<Point<World>>) {
        way.clear();
        way.push(from);
        let mut at = from;
        for _ in 0..(most_m / CELL_M) as usize {
            let level = self.level_of(at);
            let Some(downhill) = self.downhill_on(level, at) else { break };
            let next = at + downhill * CELL_M;
            let off_m = self.levels[level].z_m - at.z;
            // Straight up, where what it is to lead over stands before it.
            if off_m < 0.5 * RISE_M || self.price_at(next).is_finite() {
                at = next;
            }
            at.z += off_m.clamp(-DESCENT * CELL_M, CLIMB * CELL_M);
            way.push(at);
        }
        smooth(way);
    }

    /// Level direction in which the way to the goal gets shorter fastest; `None` at its end, beyond the grid and where
    /// it knows no way.
    pub(crate) fn downhill(&self, point: Point<World>) -> Option<Vector<World>> {
        self.downhill_on(self.level_of(point), point)
    }

    fn downhill_on(&self, level: usize, point: Point<World>) -> Option<Vector<World>> {
        let at = |right: i64, up: i64| {
            let cell = self.grid.beside(point, right, up)?;
            let value = self.to_goal_m[level * self.grid.cells() + cell];
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

/// Takes out the corners that the grid makes: every place moves to the middle of itself and what lies beside it.
fn smooth(way: &mut [Point<World>]) {
    for _ in 0..SMOOTHINGS {
        for index in 1..way.len().max(1) - 1 {
            let between = way[index - 1].lerp(way[index + 1], 0.5);
            way[index] = way[index].lerp(between, 0.5);
        }
    }
}

fn cell_of(point: Point<World>) -> Cell {
    // No world is larger, and no sum of cells overflows.
    let cell = |value: f64| (value / CELL_M).floor().clamp(-1e12, 1e12) as i64;
    (cell(point.x), cell(point.y))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::{FENCE, RIG, home_only};
    use ipc_types::{Body, FlightTime, Pose, Rotation};

    const ASK: Ask = Ask { threshold: 0.9, unknown_price: 0.3, clearance_price: 0.0, height_m: 2.0, height_price: 0.5 };
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
        field.way(AT, 8.0, &mut way);
        let end = way.last().expect("a way");
        assert!((end.x - 8.0).abs() < 0.3 && end.y.abs() < 0.3 && (end.z - 2.0).abs() < 0.1, "{end:?}");
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
    fn hostile_points_are_far() {
        let mut field = Field::new(10.0);
        field.update(&home_only(200.0), &FENCE, AT, GOAL, ASK);
        for hostile in [f64::NAN, f64::INFINITY, -1e300] {
            assert!(!field.to_goal_m(Point::new(hostile, 0.0, 2.0)).is_finite() || hostile.is_finite());
            assert!(!field.to_goal_m(Point::new(0.0, 0.0, hostile)).is_nan());
            field.update(&home_only(200.0), &FENCE, Point::new(hostile, 1e300, hostile), GOAL, ASK);
            field.update(&home_only(200.0), &FENCE, AT, Point::new(hostile, hostile, hostile), ASK);
            field.update(&home_only(200.0), &FENCE, AT, GOAL, Ask { height_m: hostile, ..ASK });
        }
    }

    /// All is free but a slab across the way from 4 to 6 m, up to a height of 3 m, as far as the image reaches to either side.
    fn before_a_low_wall() -> View {
        let mut view = home_only(200.0);
        let value = |depth_m: f64| (RIG.disparity_px(depth_m) * 64.0) as u16;
        let (width, height) = (RIG.width_px as usize, RIG.height_px as usize);
        let cells = (0..width * height).flat_map(|pixel| {
            let up = (RIG.cy_px - (pixel / width) as f64) / RIG.focal_px;
            let (front_m, back_m) = if up * 4.0 < 1.0 { (4.0, 6.0) } else { (40.0, 40.0) };
            [value(0.3), value(front_m), value(back_m), 0]
        });
        let rotation = Rotation::<World, Body>::IDENTITY * Rotation::camera_mount(0.0);
        let pose = Pose { rotation, translation: Vector::new(0.0, 0.0, 2.0) };
        assert!(view.push(pose, FlightTime::from_nanos(0), cells.collect::<Vec<u16>>().into()));
        view
    }

    #[test]
    fn a_low_wall_is_passed_over_and_behind_it_the_way_comes_down_again() {
        let (mut field, mut way, view) = (Field::new(10.0), Vec::new(), before_a_low_wall());
        // No way leads around it.
        let fence = Fence { least_m: [-20.0, -2.5, 0.5], most_m: [50.0, 2.5, 6.0] };
        field.update(&view, &fence, AT, GOAL, ASK);
        let to_goal_m = field.to_goal_m(AT);
        assert!((40.9..44.0).contains(&to_goal_m), "{to_goal_m}");
        assert!(field.height_m(AT) > 2.9, "it rises at once: {}", field.height_m(AT));
        field.way(AT, 15.0, &mut way);
        assert!(way.iter().filter(|place| (4.2..5.8).contains(&place.x)).all(|place| place.z > 2.8), "{way:?}");
        assert!(way.iter().all(|place| place.y.abs() < 1.5), "{way:?}");
        field.update(&view, &fence, Point::new(7.5, 0.0, 4.0), GOAL, ASK);
        assert!(field.height_m(Point::new(7.5, 0.0, 4.0)) < 2.1, "behind it");
        // Where the fence ends below its top there is no way left.
        let low = Fence { most_m: [50.0, 2.5, 2.5], ..fence };
        field.update(&view, &low, AT, GOAL, ASK);
        assert!(field.to_goal_m(AT) > to_goal_m + 5.0, "{}", field.to_goal_m(AT));
    }
}
