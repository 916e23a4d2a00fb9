//! What the planner plans from.

use crate::Config;
use ipc_types::messages::Task;
use ipc_types::{FlightTime, Point, Vector, World};

/// What the planner plans from.
#[derive(Clone, Copy, Debug)]
pub struct Situation {
    /// Flight time.
    pub now: FlightTime,
    /// When the state below was valid.
    pub state_valid: FlightTime,
    /// Position of the body, m.
    pub position: Point<World>,
    /// Its velocity, m/s.
    pub velocity: Vector<World>,
    /// Heading, rad.
    pub yaw_rad: f64,
    /// Where to go.
    pub goal: Point<World>,
    /// Highest speed on the way, m/s.
    pub cruise_mps: f64,
    /// What to do there.
    pub task: Task,
    /// Whether a pilot flies: plans are made, but not followed.
    pub piloted: bool,
    /// Whether the vehicle stands on the ground.
    pub landed: bool,
    /// Exposure of the newest image in the map.
    pub image_valid: FlightTime,
}

impl Situation {
    /// Heading towards the goal, rad; the vehicle's own close by.
    pub(crate) fn goal_heading_rad(&self) -> f64 {
        let offset = self.goal - self.position;
        if offset.horizontal_norm() < 0.5 { self.yaw_rad } else { offset.y.atan2(offset.x) }
    }

    /// Whether state or map are too old to plan from, or from a time that is yet to come.
    pub(crate) fn is_stale(&self, config: &Config) -> bool {
        let is_fresh = |valid, deadline_s| (-0.1..=deadline_s).contains(&self.now.seconds_since(valid));
        !is_fresh(self.state_valid, config.state_deadline_s) || !is_fresh(self.image_valid, config.image_deadline_s)
    }
}
