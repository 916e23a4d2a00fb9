//! Looking before leaping: a slow vehicle turns its camera to where it wants to go before it sets out.
//!
//! A sideways plan from rest begins where the camera does not look, so that it can neither be vouched for nor refused
//! by what is there. Two such plans, one on each side of an obstacle, would take turns for ever.

use crate::planner::Situation;
use ipc_types::frames::wrap_angle_rad;
use ipc_types::{FlightTime, Point, World};

/// A heading that differs by less counts as reached, rad.
const ALIGNED_RAD: f64 = 0.14;
/// Longest that a turn may take, s.
const TURN_S: f64 = 4.0;
/// What was looked at is forgotten after this long, s ...
const FORGET_S: f64 = 12.0;
/// ... or this far away, m.
const FORGET_M: f64 = 0.7;
/// Share of the camera's half view that counts as seen: towards the edge a body is not seen whole.
const SEEN_SHARE: f64 = 0.8;

#[derive(Clone, Copy, Debug)]
struct Look {
    heading_rad: f64,
    since: FlightTime,
    at: Point<World>,
}

/// Where the vehicle turns to look, and where it has looked from here.
#[derive(Clone, Debug, Default)]
pub(crate) struct Gaze {
    turn: Option<Look>,
    looked: Vec<Look>,
}

impl Gaze {
    /// Begins to turn.
    pub(crate) fn look(&mut self, heading_rad: f64, now: FlightTime, at: Point<World>) {
        self.looked.retain(|look| now.seconds_since(look.since) < FORGET_S && look.at.distance(at) < FORGET_M);
        self.turn = Some(Look { heading_rad, since: now, at });
    }

    /// The heading being turned to; `None` once it is reached, or was not within a reasonable time.
    pub(crate) fn turning(&mut self, now: FlightTime, yaw_rad: f64) -> Option<f64> {
        let turn = self.turn?;
        let is_aligned = wrap_angle_rad(turn.heading_rad - yaw_rad).abs() < ALIGNED_RAD;
        if is_aligned || now.seconds_since(turn.since) > TURN_S {
            self.turn = None;
            self.looked.push(Look { since: now, ..turn });
            return None;
        }
        Some(turn.heading_rad)
    }

    /// Whether a heading is out of the camera's view, and was not looked at from here.
    pub(crate) fn is_unseen(&self, heading_rad: f64, situation: &Situation, half_view_rad: f64) -> bool {
        let seen = SEEN_SHARE * half_view_rad;
        let covers = |other_rad: f64| wrap_angle_rad(other_rad - heading_rad).abs() < seen;
        let remembers = |look: &&Look| {
            situation.now.seconds_since(look.since) < FORGET_S && look.at.distance(situation.position) < FORGET_M
        };
        !covers(situation.yaw_rad) && !self.looked.iter().filter(remembers).any(|look| covers(look.heading_rad))
    }
}
