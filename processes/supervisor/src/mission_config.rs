//! Where to fly, and within what.

use ipc_types::bounds::Bounds;
use ipc_types::limits::Fence;
use ipc_types::{Point, World};
use serde::{Deserialize, Serialize};

/// A cylinder around the take-off place, declared free: no image sees what is beside a vehicle on the ground.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HomeConfig {
    /// Its radius, m. Take-off may drift so far.
    pub radius_m: f64,
    /// Its height above the take-off place, m.
    pub height_m: f64,
}

/// What ends a mission.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum AtGoal {
    /// Hovering.
    Hover,
    /// Landing: whoever asks for it declares the column below the goal free.
    Land,
}

/// Where to fly.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MissionConfig {
    /// Take-off place (x, y), m.
    pub start_m: [f64; 2],
    /// Heading at take-off, degrees from east.
    pub start_heading_deg: f64,
    /// Places to pass on the way, within 2.5 m (x, y, z), m.
    pub waypoints_m: Vec<[f64; 3]>,
    /// Where to hover at last (x, y, z), m.
    pub goal_m: [f64; 3],
    /// Whether to hover or to land there.
    pub at_goal: AtGoal,
    /// Highest speed on the way, m/s.
    pub cruise_speed_mps: f64,
    /// Height to fly at above the take-off place, m.
    pub cruise_height_m: f64,
    /// The cylinder around the take-off place that the operator declares free.
    pub home: HomeConfig,
    /// Geofence and altitude limits.
    pub fence: Fence,
    /// The flight has failed when it takes longer, s.
    pub time_limit_s: f64,
}

impl MissionConfig {
    /// Reports values out of range.
    pub fn check(&self, bounds: &mut Bounds) {
        self.start_m.iter().for_each(|&value| bounds.range("start_m", value, -1e5..=1e5));
        self.waypoints_m.iter().flatten().for_each(|&value| bounds.range("waypoints_m", value, -1e5..=1e5));
        self.goal_m.iter().for_each(|&value| bounds.range("goal_m", value, -1e5..=1e5));
        bounds.range("start_heading_deg", self.start_heading_deg, -360.0..=360.0);
        bounds.range("cruise_speed_mps", self.cruise_speed_mps, 0.2..=20.0);
        bounds.range("cruise_height_m", self.cruise_height_m, 0.5..=100.0);
        bounds.section("home", |bounds| {
            bounds.range("radius_m", self.home.radius_m, 0.3..=20.0);
            bounds.range("height_m", self.home.height_m, 0.0..=100.0);
            bounds.require(
                self.home.height_m >= self.cruise_height_m,
                "height_m",
                format_args!(
                    "is {}, must be at least cruise_height_m = {}: take-off climbs there",
                    self.home.height_m, self.cruise_height_m
                ),
            );
        });
        let heights = self.fence.least_m[2]..self.fence.most_m[2];
        bounds.require(
            heights.contains(&self.cruise_height_m),
            "cruise_height_m",
            format_args!("is {}, must be within the fence's heights, {heights:?} m", self.cruise_height_m),
        );
        bounds.range("time_limit_s", self.time_limit_s, 1.0..=36_000.0);
        bounds.section("fence", |bounds| self.fence.check(bounds));
        let places = self.waypoints_m.iter().map(|place| ("waypoints_m", place)).chain([("goal_m", &self.goal_m)]);
        for (name, place) in places {
            bounds.require(
                self.fence.contains(Point::from_array(*place)),
                name,
                format_args!("is {place:?}, must lie inside the fence {:?}", self.fence),
            );
        }
    }

    /// Take-off place, at ground level zero.
    pub fn start(&self) -> Point<World> {
        Point::new(self.start_m[0], self.start_m[1], 0.0)
    }

    /// Places that the way leads to, in order: the waypoints, then the goal.
    pub fn places(&self) -> impl Iterator<Item = Point<World>> {
        self.waypoints_m.iter().chain([&self.goal_m]).map(|&place| Point::from_array(place))
    }

    /// Distance of a place from the straight line that leads by the waypoints to the goal, seen from above, m.
    pub(crate) fn deviation_m(&self, place: Point<World>) -> f64 {
        let (mut from, mut nearest_m) = (self.start(), f64::INFINITY);
        for to in self.places() {
            let (way, off) = (to - from, place - from);
            let share = (off.x * way.x + off.y * way.y) / way.horizontal_norm().powi(2).max(1e-12);
            nearest_m = nearest_m.min((off - way * share.clamp(0.0, 1.0)).horizontal_norm());
            from = to;
        }
        nearest_m
    }

    /// Length of that line, m.
    pub(crate) fn straight_line_m(&self) -> f64 {
        let mut from = self.start();
        self.places().map(|to| std::mem::replace(&mut from, to).distance(to)).sum()
    }

    /// Distance of a place from the goal, m; from the column below it, where that is to be landed on.
    pub(crate) fn to_goal_m(&self, place: Point<World>) -> f64 {
        let off = self.goal() - place;
        if self.at_goal == AtGoal::Land { off.horizontal_norm() } else { off.norm() }
    }

    /// The goal.
    pub fn goal(&self) -> Point<World> {
        Point::from_array(self.goal_m)
    }
}
