//! Where to fly next (DROAN, chapter 4).
//!
//! [`Planner`] is the pure core. At every new map it rolls out a library of manoeuvres from where the vehicle will be when
//! the plan takes effect, prices them by what remains to the goal, refines the cheapest, and publishes the first one in the
//! order of prices that the map admits. Every candidate ends at rest. Admissible means: as far as the vehicle can get before
//! the next plan or the controller's deadline, and along the straight stop from every instant of that, everything is known
//! free (but for a short way out of a margin the vehicle is in). What lies beyond is priced, not asked.
//!
//! New plans are checked with γ_low, the plan being flown with γ_high, so that flicker causes no replan. Without an
//! admissible plan the vehicle stops as the map says is best, looks around, backs out along the path flown, and finally
//! gives up and hovers.
//!
//! Effort is bounded by the number of candidates and samples, never by time.

mod admission;
mod buckets;
mod choice;
mod deliberation;
mod draft;
mod emergency;
mod estate;
mod field;
#[cfg(test)]
mod fixtures;
mod gaze;
mod grid;
mod guide;
mod level;
mod library;
mod map_space;
mod planner;
#[cfg(test)]
mod planner_tests;
mod pricing;
mod process;
mod rollout;
pub mod route;
mod situation;
mod stuck;

pub use admission::Tally;
pub use library::LibraryConfig;
pub use planner::{Plan, Planner, TakeOff};
pub use process::PlannerProcess;
pub use situation::Situation;

use crate::route::{Limits, SearchConfig};
use ipc_types::bounds::Bounds;
use serde::{Deserialize, Serialize};

/// Parameters of the planner.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// Threshold for new plans (strict).
    pub gamma_low: f32,
    /// Threshold for the plan being flown (lenient).
    pub gamma_high: f32,
    /// The manoeuvres to choose from.
    pub library: LibraryConfig,
    /// Length of a candidate before it brakes, s.
    pub horizon_s: f64,
    /// Time for which a plan must be safe: replanning interval, latency and the controller's deadline, s.
    pub commit_s: f64,
    /// Time until a plan takes effect, s.
    pub lead_s: f64,
    /// A state older than this is stale: brake, s.
    pub state_deadline_s: f64,
    /// A map whose newest image is older than this is stale: brake, s.
    pub image_deadline_s: f64,
    /// Spacing of occupancy checks, m.
    pub sample_m: f64,
    /// Acceleration of the candidates, m/s².
    pub acceleration_mps2: f64,
    /// Acceleration of the candidates across their velocity, m/s².
    pub lateral_mps2: f64,
    /// Deceleration of the candidates, m/s².
    pub braking_mps2: f64,
    /// Change of acceleration along a timed path, m/s³.
    pub jerk_mps3: f64,
    /// Deceleration of a stop for want of an admissible plan, m/s².
    pub hard_braking_mps2: f64,
    /// How far from a candidate's start an occupied stretch may reach that leads out of a margin the vehicle is in, m.
    pub escape_m: f64,
    /// How far above the flight path the camera must see while the vehicle speeds up at its cruise speed, degrees.
    pub least_view_up_deg: f64,
    /// Speed of take-off, m/s.
    pub take_off_mps: f64,
    /// Turn rate of the planned heading, degrees/s.
    pub yaw_rate_degps: f64,
    /// Whether the camera looks where the vehicle flies, and around before it does; else always towards the goal.
    pub gaze_follows_flight: bool,
    /// Price of a metre of the candidate that is unknown, m.
    pub unknown_price: f64,
    /// Price of a metre right beside something occupied, m.
    pub clearance_price: f64,
    /// Weight of the distance that is lost by turning, at a candidate's end, towards the way that remains.
    pub turning_price: f64,
    /// Price of a metre up or down from the height to keep, m.
    pub height_price: f64,
    /// How much cheaper a new plan must be than the one being flown, m.
    pub hysteresis_m: f64,
    /// Price of turning the camera to where it does not look before setting out there, m; the n-th look from a place costs
    /// n² times as much.
    pub look_price_m: f64,
    /// Price of stepping back to look at what is too near, m; the n-th look from a place costs n² times as much.
    pub step_back_price_m: f64,
    /// What is unknown and nearer than this no look from here makes known, m: the body does not fit into the view, or
    /// stereo does not match.
    pub blind_m: f64,
    /// Time without an admissible plan before looking around, s.
    pub patience_s: f64,
    /// Distance to back out before trying again, m.
    pub back_out_m: f64,
    /// Rounds of looking around and backing out before giving up.
    pub attempts: u32,
    /// How far the grid of the cost-to-go reaches to every side, m.
    pub field_reach_m: f64,
    /// How far its levels lie above each other, m: a way that is open over less height than this may lie between two. There is one
    /// below the height to keep and two are above it, so that what lies closer reaches less far over and under things.
    pub field_rise_m: f64,
    /// Threads that price candidates, 1..64; plans do not depend on it.
    pub threads: u32,
    /// The search for a way to the goal.
    pub route: RouteConfig,
}

/// The search for a way to the goal, at every plan.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RouteConfig {
    /// Segments asked about per plan; 0 does without.
    pub segments: u32,
    /// How BIT* goes about it.
    pub search: SearchConfig,
}

impl Config {
    /// Reports values out of range.
    pub fn check(&self, bounds: &mut Bounds) {
        bounds.range("gamma_low", self.gamma_low, 0.0..=100.0);
        bounds.range("gamma_high", self.gamma_high, self.gamma_low.max(0.0)..=100.0);
        bounds.section("library", |bounds| {
            bounds.range("size", self.library.size, 20..=2000);
            bounds.range("turn_deg", self.library.turn_deg, 10.0..=180.0);
            bounds.range("climb_deg", self.library.climb_deg, 0.0..=60.0);
            bounds.range("slowest_share", self.library.slowest_share, 0.05..=1.0);
        });
        bounds.range("horizon_s", self.horizon_s, 0.3..=6.0);
        bounds.range("commit_s", self.commit_s, 0.05..=2.0);
        bounds.range("lead_s", self.lead_s, 0.0..=0.5);
        bounds.range("state_deadline_s", self.state_deadline_s, 0.02..=1.0);
        bounds.range("image_deadline_s", self.image_deadline_s, 0.05..=3.0);
        bounds.range("sample_m", self.sample_m, 0.02..=1.0);
        bounds.range("acceleration_mps2", self.acceleration_mps2, 0.2..=20.0);
        bounds.range("lateral_mps2", self.lateral_mps2, 0.2..=20.0);
        bounds.range("braking_mps2", self.braking_mps2, 0.2..=20.0);
        bounds.range("jerk_mps3", self.jerk_mps3, 1.0..=1000.0);
        bounds.range("hard_braking_mps2", self.hard_braking_mps2, self.braking_mps2.max(0.2)..=20.0);
        bounds.range("escape_m", self.escape_m, 0.0..=2.0);
        bounds.range("least_view_up_deg", self.least_view_up_deg, -60.0..=60.0);
        bounds.range("take_off_mps", self.take_off_mps, 0.1..=5.0);
        bounds.range("yaw_rate_degps", self.yaw_rate_degps, 1.0..=360.0);
        bounds.range("unknown_price", self.unknown_price, 0.0..=100.0);
        bounds.range("clearance_price", self.clearance_price, 0.0..=100.0);
        bounds.range("turning_price", self.turning_price, 0.0..=10.0);
        bounds.range("height_price", self.height_price, 0.0..=100.0);
        bounds.range("hysteresis_m", self.hysteresis_m, 0.0..=10.0);
        bounds.range("look_price_m", self.look_price_m, 0.0..=100.0);
        bounds.range("step_back_price_m", self.step_back_price_m, 0.0..=100.0);
        bounds.range("blind_m", self.blind_m, 0.0..=10.0);
        bounds.range("patience_s", self.patience_s, 0.1..=30.0);
        bounds.range("back_out_m", self.back_out_m, 0.5..=50.0);
        bounds.range("attempts", self.attempts, 0..=100);
        bounds.range("field_reach_m", self.field_reach_m, 2.0..=30.0);
        bounds.range("field_rise_m", self.field_rise_m, 0.3..=2.0);
        bounds.range("threads", self.threads, 1..=64);
        bounds.section("route", |bounds| {
            bounds.range("segments", self.route.segments, 0..=100_000);
            bounds.section("search", |bounds| self.route.search.check(bounds));
        });
    }

    /// What a path is timed within, at a speed.
    fn limits(&self, speed_mps: f64) -> Limits {
        Limits {
            speed_mps,
            acceleration_mps2: self.acceleration_mps2,
            braking_mps2: self.braking_mps2,
            lateral_mps2: self.lateral_mps2,
            jerk_mps3: self.jerk_mps3,
        }
    }

    /// Distance that the slowest candidate commits to from rest, braking included, m.
    pub fn least_commitment_m(&self, cruise_mps: f64) -> f64 {
        let slowest = self.library.slowest_share * cruise_mps;
        let accelerating_s = (slowest / self.acceleration_mps2).min(self.commit_s);
        let speed = accelerating_s * self.acceleration_mps2;
        let going_m = speed * (self.commit_s - accelerating_s / 2.0);
        going_m + speed * speed / (2.0 * self.braking_mps2)
    }

    /// Distance covered from `speed_mps` until at rest, latency included, m.
    pub fn stopping_distance_m(&self, speed_mps: f64) -> f64 {
        speed_mps * (self.commit_s + self.lead_s) + speed_mps * speed_mps / (2.0 * self.braking_mps2)
    }
}
