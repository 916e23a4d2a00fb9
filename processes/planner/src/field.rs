//! How far it is to the goal around what is known to stand in the way, and over it.
//!
//! A candidate is worth what remains to be flown from its end. The straight distance leads into every pocket; this
//! field is the length of the shortest way over level grids around the vehicle, from whose rims it goes on straight.
//! One grid lies at the height to keep. Only where its way is longer than a straight one through the unknown that climbs, or
//! the vehicle is at another height, the map is asked about those above and below, too: a way may change from one to the next
//! anywhere, at a price. The field prices candidates and admits none: that is [`crate::admission`]'s alone.

use crate::buckets::Buckets;
use crate::grid::{CELL_M, Grid, cell_of};
use crate::level::{Level, REMEMBERED, Survey};
use crate::rollout::Sample;
use ipc_types::limits::Fence;
use ipc_types::{Point, Vector, World};
use memory::View;
use std::cmp::Ordering;
use std::f64::consts::SQRT_2;
use std::ops::Range;

/// Grids at most, and how many of them below the one at the height to keep and above it: the closer they lie, the less far over
/// and under things they see.
const LEVELS: usize = 4;
const BELOW: usize = 1;
const ABOVE: usize = LEVELS - BELOW - 1;
/// A vehicle farther from the height to keep than this share of the grids' distance asks all of them.
const OFF: f64 = 0.4;
/// Those others are asked about once for so many cells along either side: 0.8 m, less than a margin is wide.
const COARSE: usize = 2;
/// Most entries of the queue, for every cell: it is reached by its neighbours and from above and below, some of them twice.
const PUSHES: usize = 11;
/// Most that a metre of a trajectory costs, relative to a free one: what is closed at the middle of a cell may be open beside it.
const CLOSED_PRICE: f64 = 12.0;
/// What is no farther from a trajectory's start costs nothing, m.
const OWN_M: f64 = 0.7;
/// Most places at which the way to the next sample is priced: what would need more is no flight.
const MOST_PIECES: f64 = 64.0;
/// So often a way is smoothed: over about a metre.
const SMOOTHINGS: usize = 8;
/// How steeply a way rises to another grid ...
const CLIMB: f64 = 1.0;
/// ... and sinks: flatter, so that the camera sees where it leads.
const DESCENT: f64 = 0.2;
/// A way changes to another grid where that costs no more than this beyond staying, m: rather early than at the last moment.
const EARLY_M: f64 = 0.5;

/// Cost-to-go around the vehicle.
#[derive(Clone, Debug)]
pub(crate) struct Field {
    grid: Grid,
    /// Distance of the levels from each other, m.
    rise_m: f64,
    levels: [Level; LEVELS],
    survey: Survey,
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
    /// Grids that reach so far to every side of the vehicle, so far above each other, m.
    pub(crate) fn new(reach_m: f64, rise_m: f64) -> Self {
        let grid = Grid::new((reach_m / CELL_M).round().clamp(1.0, REMEMBERED as f64 / 2.0 - 2.0) as i64);
        let cells = LEVELS * grid.cells();
        Self {
            grid,
            rise_m,
            levels: [0; LEVELS].map(|_| Level::new(rise_m)),
            survey: Survey::new(grid.cells()),
            known: BELOW..BELOW + 1,
            height_price: 0.0,
            price: vec![1.0; cells],
            to_goal_m: vec![f32::INFINITY; cells],
            queue: Buckets::new(PUSHES * cells),
        }
    }

    /// Asks the map anew around `at`.
    pub(crate) fn update(&mut self, view: &View, fence: &Fence, at: Point<World>, goal: Point<World>, ask: Ask) {
        self.grid.move_to(at);
        self.height_price = ask.height_price;
        // The vehicle's own height lies between the lowest and the highest level.
        let rise_m = self.rise_m;
        let height_m = ask.height_m.max(at.z - ABOVE as f64 * rise_m).min(at.z + BELOW as f64 * rise_m);
        for (number, level) in self.levels.iter_mut().enumerate() {
            level.move_to(height_m + (number as f64 - BELOW as f64) * rise_m);
        }
        // What is asked about once is so until there is less reason for it.
        let rises = if self.known.len() > 1 { 1.0 } else { 2.0 };
        self.known = BELOW..BELOW + 1;
        self.look(BELOW, view, fence, at, ask);
        self.spread(goal, ask);
        let straight_m = at.distance(goal);
        let seen_m = straight_m.min(self.grid.reach_m());
        let climbing_m = straight_m + f64::from(ask.unknown_price) * seen_m + rises * rise_m * ask.height_price;
        if self.to_goal_m(at) <= climbing_m && (at.z - height_m).abs() < OFF * rise_m {
            return;
        }
        let is_within = |level: &Level| (fence.least_m[2]..=fence.most_m[2]).contains(&level.z_m);
        let below = self.levels[..BELOW].iter().rev().take_while(|level| is_within(level)).count();
        let above = self.levels[BELOW + 1..].iter().take_while(|level| is_within(level)).count();
        self.known = BELOW - below..BELOW + 1 + above;
        for number in self.known.clone().filter(|&number| number != BELOW) {
            self.look(number, view, fence, at, ask);
        }
        self.spread(goal, ask);
    }

    /// Asks the map about a level.
    fn look(&mut self, level: usize, view: &View, fence: &Fence, at: Point<World>, ask: Ask) {
        let (cells, block) = (self.grid.cells(), if level == BELOW { 1 } else { COARSE });
        let Self { grid, levels, survey, price, .. } = self;
        let price = &mut price[level * cells..][..cells];
        let is_asked = survey.ask(*grid, block, levels[level].z_m, view, ask.threshold);
        for (index, price) in price.iter_mut().enumerate() {
            let centre = grid.centre(index, levels[level].z_m);
            *price = if is_asked && fence.contains(centre) && !grid.is_border(index) {
                levels[level].price_of(grid.cell(index), survey.seen(index), centre.distance(at), ask.unknown_price)
            } else {
                f32::INFINITY
            };
        }
        survey.keep_off(grid.side(), ask.clearance_price, price);
    }

    /// Fast marching (Sethian 1996) from the goal and the grids' rims inwards: distances as they are, not as a grid's
    /// eight directions make them. Up and down from grid to grid they add up.
    fn spread(&mut self, goal: Point<World>, ask: Ask) {
        self.to_goal_m.fill(f32::INFINITY);
        let cells = self.grid.cells();
        // Nothing of a square lies farther from its middle than its diagonal.
        let least_m = self.grid.centre(cells / 2, goal.z).distance(goal) - SQRT_2 * (self.grid.reach_m() + CELL_M);
        let dearest = f64::from(Level::dearest(ask.unknown_price, ask.clearance_price));
        self.queue.begin(least_m.max(0.0) as f32, (2.0 * self.grid.side() as f64 * CELL_M * dearest) as f32);
        self.begin_spreading(goal);
        let (rise_m, bottom, top) =
            ((self.height_price * self.rise_m) as f32, self.known.start * cells, self.known.end * cells);
        while let Some((index, so_far_m)) = self.queue.pop() {
            if so_far_m > self.to_goal_m[index] {
                continue;
            }
            for next in self.grid.neighbours(index) {
                // What is nearer to the goal already is not reached from here.
                if self.to_goal_m[next] > so_far_m && self.price[next].is_finite() {
                    let across_m = self.across(next);
                    self.reach(next, across_m);
                }
            }
            let down = (index >= bottom + cells).then(|| index - cells);
            let up = (index + cells < top).then(|| index + cells);
            for next in [down, up].into_iter().flatten() {
                if self.price[next].is_finite() {
                    self.reach(next, so_far_m + rise_m);
                }
            }
        }
    }

    /// From the goal, and from the rims, from which it goes on straight and back at the height to keep.
    fn begin_spreading(&mut self, goal: Point<World>) {
        let (grid, cells) = (self.grid, self.grid.cells());
        let from_m = |cell: usize| grid.centre(cell, goal.z).distance(goal);
        for level in self.known.clone() {
            let back_m = self.height_price * self.rise_m * level.abs_diff(BELOW) as f64;
            for cell in grid.rim() {
                if self.price[level * cells + cell].is_finite() {
                    self.reach(level * cells + cell, (from_m(cell) + back_m) as f32);
                }
            }
        }
        if let Some(cell) = grid.at(goal) {
            self.reach(self.nearest_level(goal.z) * cells + cell, from_m(cell) as f32);
        }
    }

    /// Distance of a cell by its neighbours: the upwind solution of |grad d| = price.
    fn across(&self, index: usize) -> f32 {
        let [west, east, south, north] = self.grid.neighbours(index).map(|place| self.to_goal_m[place]);
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
        let [below, above] = self.levels_at(point.z);
        let above_m = if above == below { f64::INFINITY } else { self.by_level_m(above, point) };
        // What is no number is infinitely far.
        f64::INFINITY.min(self.by_level_m(below, point)).min(above_m)
    }

    /// The same by way of a level.
    fn by_level_m(&self, level: usize, point: Point<World>) -> f64 {
        let (cell, mut least) = (cell_of(point), f64::INFINITY);
        for (east, north) in (-1..=1).flat_map(|east| (-1..=1).map(move |north| (east, north))) {
            // What lies beyond the grid is reached straight from its rim.
            let index = self.grid.nearest(cell, east, north);
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
        if self.known.len() == 1 {
            return self.known.start;
        }
        let off_m = |&level: &usize| (self.levels[level].z_m - z_m).abs();
        self.known.clone().min_by(|a, b| off_m(a).total_cmp(&off_m(b))).unwrap_or(BELOW)
    }

    /// The level by which the way from a point leads.
    fn level_of(&self, point: Point<World>) -> usize {
        if self.known.len() == 1 {
            return BELOW;
        }
        let [below, above] = self.levels_at(point.z);
        let mut level = match self.by_level_m(below, point).total_cmp(&self.by_level_m(above, point)) {
            Ordering::Less => below,
            Ordering::Greater => above,
            Ordering::Equal => self.nearest_level(point.z),
        };
        let Some(cell) = self.grid.at(point) else { return level };
        let to_goal_m = |level: usize| f64::from(self.to_goal_m[level * self.grid.cells() + cell]);
        let rise_m = self.height_price * self.rise_m - EARLY_M.min(0.4 * self.height_price * self.rise_m);
        while level + 1 < self.known.end && to_goal_m(level + 1) + rise_m < to_goal_m(level) {
            level += 1;
        }
        while level > self.known.start && to_goal_m(level - 1) + rise_m < to_goal_m(level) {
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
            let step = pair[1].position - pair[0].position;
            let length_m = step.norm();
            let pieces = (length_m / CELL_M).ceil().clamp(1.0, MOST_PIECES);
            let (piece, piece_m) = (step * (1.0 / pieces), length_m / pieces);
            let mut place = pair[0].position;
            for _ in 0..pieces as usize {
                place += piece;
                let away = place - start;
                if away.dot(away) > OWN_M * OWN_M {
                    cost_m += (self.price_at(place).min(CLOSED_PRICE) - 1.0) * piece_m;
                }
            }
        }
        cost_m
    }

    /// Price of a metre at a place, relative to a free one; beyond the grid nothing is known to stand.
    fn price_at(&self, place: Point<World>) -> f64 {
        let price = |cell: usize| f64::from(self.price[self.nearest_level(place.z) * self.grid.cells() + cell]);
        self.grid.at(place).map_or(1.0, price)
    }

    /// The way to the goal from a place, downhill, as far as the grids know it and about `most_m` long at most.
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
            if off_m < 0.5 * self.rise_m || self.price_at(next).is_finite() {
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
        let around = cell_of(point);
        let at = |east: i64, north: i64| {
            let cell = self.grid.beside(around, east, north)?;
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

#[cfg(test)]
#[path = "field_tests.rs"]
mod tests;
