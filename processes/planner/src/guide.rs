//! The way to the goal: a path around all that is known, in three dimensions, kept from one plan to the next.
//!
//! A new path must be shorter than the one being flown by the hysteresis; the one being flown is asked about with
//! γ_high, new ones with γ_low, so that flicker changes nothing. The guide prices candidates and leads some, it
//! admits none.

use crate::Config;
use crate::map_space::{MapSpace, Questions, ROOM_M};
use crate::rollout::STEP_S;
use crate::route::{self, BitStar, Limits, Space, Timed, Timing};
use ipc_types::limits::Fence;
use ipc_types::{Point, World};
use memory::View;

/// Price of a metre off the path, relative to one along it.
const OFF_PATH: f64 = 2.0;
/// Segments asked about to pull a new path taut.
const SHORTEN_SEGMENTS: u32 = 150;
/// So much of the path is timed, m: more than any candidate flies.
const TIMED_M: f64 = 40.0;
/// A vehicle farther off the path than this has left it, m.
const LEFT_M: f64 = 3.0;

/// Paths keep this far inside the fence, m.
const FENCE_M: f64 = 0.3;

/// Ends no farther apart are the same, m.
const SAME_M: f64 = 0.05;
/// Room that the path being flown needs, relative to a new one.
const KEPT_ROOM: f64 = 0.5;
/// Effort without a path, relative to that with one.
const WITHOUT: u32 = 4;

/// A path to the goal.
#[derive(Clone, Debug)]
pub(crate) struct Guide {
    segments: u32,
    hysteresis_m: f64,
    search: BitStar,
    questions: Questions,
    /// From the vehicle to the goal; empty without one.
    path: Vec<Point<World>>,
    spare: Vec<Point<World>>,
    timing: Timing,
}

impl Guide {
    pub(crate) fn new(config: &Config, fence: Fence) -> Self {
        let most = config.route.search.places as usize + 2;
        Self {
            segments: config.route.segments,
            hysteresis_m: config.hysteresis_m,
            search: BitStar::new(config.route.search, inset(fence)),
            questions: Questions::new(),
            path: Vec::with_capacity(most),
            spare: Vec::with_capacity(most),
            timing: Timing::default(),
        }
    }

    /// Forgets the path: the goal has changed.
    pub(crate) fn reset(&mut self) {
        self.path.clear();
    }

    /// Searches anew from `from`, and keeps the better path.
    pub(crate) fn update(&mut self, view: &View, from: Point<World>, goal: Point<World>, config: &Config) {
        if self.segments == 0 {
            return;
        }
        self.cut_to(from);
        let (threshold, room_m) = (config.gamma_high, KEPT_ROOM * ROOM_M);
        let mut space = MapSpace { view, threshold, room_m, start: from, questions: &mut self.questions };
        // A vehicle inside a margin leaves it by the first leg.
        let leaving = usize::from(!space.is_free(from));
        let mut legs = self.path.windows(2).skip(leaving);
        let is_free = self.path.len() > 1 && legs.all(|leg| space.is_way_free(leg[0], leg[1]));
        (space.threshold, space.room_m) = (config.gamma_low, ROOM_M);
        // What was blocked of the old path may still be good for something.
        if self.search.begin(&mut space, from, goal, &self.path).is_err() {
            self.path.clear();
            return;
        }
        let is_whole = is_free && self.path.last().is_some_and(|end| end.distance(self.search.goal()) < SAME_M);
        let kept_m = if is_whole { route::length_m(&self.path) - self.hysteresis_m } else { f64::INFINITY };
        // Without a path it searches harder.
        let effort = if is_whole { 1 } else { WITHOUT };
        self.search.improve(&mut space, self.segments.saturating_mul(effort));
        if self.search.length_m() < kept_m || !is_whole {
            self.path.clear();
            self.path.extend_from_slice(self.search.path());
        }
        route::shorten(&mut self.path, &mut self.spare, &mut space, SHORTEN_SEGMENTS);
    }

    /// The path, from the vehicle to the goal; empty without one.
    pub(crate) fn path(&self) -> &[Point<World>] {
        &self.path
    }

    /// Times the path for a vehicle that flies along it at `start_mps`.
    pub(crate) fn time(&mut self, start_mps: f64, limits: &Limits) {
        self.timing.time(&self.path, TIMED_M, start_mps, limits, STEP_S);
    }

    /// The timed path, as far as candidates may need it.
    pub(crate) fn timed(&self) -> &[Timed] {
        self.timing.timed()
    }

    /// Length of the way from a point to the goal by the path, m; infinite without one.
    pub(crate) fn to_goal_m(&self, point: Point<World>) -> f64 {
        self.nearest(point).map_or(f64::INFINITY, |(leg, foot, off_m)| {
            let next = self.path[leg + 1];
            OFF_PATH * off_m + foot.distance(next) + route::length_m(&self.path[leg + 1..])
        })
    }

    /// The leg, place and distance of the path's nearest point.
    fn nearest(&self, point: Point<World>) -> Option<(usize, Point<World>, f64)> {
        let feet = self.path.windows(2).enumerate().map(|(index, leg)| {
            let way = leg[1] - leg[0];
            let share = ((point - leg[0]).dot(way) / way.dot(way).max(1e-12)).clamp(0.0, 1.0);
            let foot = leg[0].lerp(leg[1], share);
            (index, foot, foot.distance(point))
        });
        feet.min_by(|a, b| a.2.total_cmp(&b.2))
    }

    /// Leaves out what was flown: the path begins at the vehicle.
    fn cut_to(&mut self, from: Point<World>) {
        match self.nearest(from) {
            Some((leg, _, off_m)) if off_m < LEFT_M => {
                self.path.drain(..leg);
                self.path[0] = from;
            }
            _ => self.path.clear(),
        }
    }
}

/// A fence within the fence: what leads along its very border cannot be flown.
fn inset(fence: Fence) -> Fence {
    let by_m = [0, 1, 2].map(|axis| FENCE_M.min(0.1 * (fence.most_m[axis] - fence.least_m[axis])));
    Fence {
        least_m: [0, 1, 2].map(|axis| fence.least_m[axis] + by_m[axis]),
        most_m: [0, 1, 2].map(|axis| fence.most_m[axis] - by_m[axis]),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::{FENCE, RIG, before, config, home_only};

    const GOAL: Point<World> = Point::new(60.0, 0.0, 2.0);
    const FROM: Point<World> = Point::new(0.0, 0.0, 2.0);

    /// All is free but a slab across the way, whose margin begins at 3 m and fills all of the image's columns but the
    /// outermost; its upper edge, if any, is at row `top`.
    fn before_a_slab(top: usize) -> View {
        before(|column, row| {
            let is_slab = row >= top && (4..RIG.width_px as usize - 2).contains(&column);
            if is_slab { [3.0, 4.0] } else { [30.0, 30.0] }
        })
    }

    fn guide(view: &View) -> Guide {
        let mut guide = Guide::new(&config(), FENCE);
        guide.update(view, FROM, GOAL, &config());
        guide
    }

    #[test]
    fn it_leads_straight_where_all_is_free_and_around_or_over_what_is_not() {
        assert_eq!(guide(&home_only(200.0)).path, [FROM, GOAL]);
        let around = guide(&before_a_slab(0));
        let widest = around.path.iter().map(|place| place.y.abs()).fold(0.0, f64::max);
        assert!(widest > 1.5 && route::length_m(&around.path) < 63.0, "{:?}", around.path);
        let over = guide(&before_a_slab(10));
        let highest = over.path.iter().map(|place| place.z).fold(0.0, f64::max);
        assert!(highest > 2.1 && route::length_m(&over.path) < 60.5, "{:?}", over.path);
    }

    #[test]
    fn the_price_falls_along_the_path_and_rises_off_it() {
        let mut guide = guide(&home_only(200.0));
        let price = |x: f64, y: f64| guide.to_goal_m(Point::new(x, y, 2.0));
        assert!((price(10.0, 0.0) - 50.0).abs() < 1e-9 && (price(10.0, 1.5) - 53.0).abs() < 1e-9);
        assert!((price(70.0, 0.0) - 20.0).abs() < 1e-9, "beyond the goal");
        guide.reset();
        assert!(guide.to_goal_m(FROM).is_infinite());
    }

    #[test]
    fn the_path_is_kept_while_it_is_free_and_as_good() {
        let view = before_a_slab(0);
        let mut guide = guide(&view);
        let side = |guide: &Guide| {
            guide.path.iter().map(|place| place.y).fold(0.0, |a: f64, b| if b.abs() > a.abs() { b } else { a })
        };
        let first = side(&guide);
        for step in 0..10 {
            // The vehicle is pushed to the other side of the path, a little.
            let at = Point::new(0.2 * f64::from(step), -first.signum() * 0.02 * f64::from(step), 2.0);
            guide.update(&view, at, GOAL, &config());
            assert_eq!((guide.path[0], side(&guide).signum()), (at, first.signum()));
        }
        for hostile in [f64::NAN, f64::INFINITY, 1e9, -1e300] {
            guide.update(&view, FROM, GOAL, &config());
            assert!(!guide.path.is_empty());
            guide.update(&view, Point::new(hostile, 0.0, 2.0), GOAL, &config());
            assert!(guide.path.is_empty(), "{hostile}");
        }
    }
}
