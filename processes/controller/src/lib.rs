//! Trajectory tracking (DROAN, section 4.4.1, after Hoffmann, Waslander and Tomlin 2008).
//!
//! [`Tracker`] is the pure core. Along the track it matches the planned speed, which it feeds forward; it does not
//! catch up or slow down for the schedule. Across the track it closes the error. Speed is limited by curvature,
//! v ≤ √(a_max·r). Stale input means brake, then hold the place where braking ended. Altitude and geofence limits
//! hold whatever the trajectory says.
//!
//! It refuses to know the map: that the braking segment is free is the planner's promise, renewed with every
//! trajectory, which is why a trajectory goes stale.

mod process;
mod tracker;

pub use process::ControllerProcess;
pub use tracker::{Command, Reference, Tracker};

use ipc_types::bounds::Bounds;
use serde::{Deserialize, Serialize};

/// Gains, limits and deadlines.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// Velocity per cross-track error, 1/s.
    pub cross_track_gain_hz: f64,
    /// Time by which the planned velocity is fed forward, to make up for the flight control unit's lag, s.
    pub lead_s: f64,
    /// Largest acceleration across the track, for the curvature speed limit, m/s².
    pub curve_mps2: f64,
    /// Largest change of the commanded velocity, m/s².
    pub slew_mps2: f64,
    /// Deceleration when braking on stale input, m/s².
    pub braking_mps2: f64,
    /// Turn rate per heading error, 1/s.
    pub yaw_gain_hz: f64,
    /// Largest turn rate, degrees/s.
    pub yaw_rate_degps: f64,
    /// Setpoints per second.
    pub rate_hz: f64,
    /// A trajectory older than this is stale, s.
    pub trajectory_deadline_s: f64,
    /// A state older than this is stale, s.
    pub state_deadline_s: f64,
}

impl Config {
    /// Reports values out of range.
    pub fn check(&self, bounds: &mut Bounds) {
        bounds.range("cross_track_gain_hz", self.cross_track_gain_hz, 0.0..=5.0);
        bounds.range("lead_s", self.lead_s, 0.0..=1.0);
        bounds.range("curve_mps2", self.curve_mps2, 0.1..=30.0);
        bounds.range("slew_mps2", self.slew_mps2, 0.1..=50.0);
        bounds.range("braking_mps2", self.braking_mps2, 0.1..=30.0);
        bounds.range("yaw_gain_hz", self.yaw_gain_hz, 0.0..=10.0);
        bounds.range("yaw_rate_degps", self.yaw_rate_degps, 1.0..=360.0);
        bounds.range("rate_hz", self.rate_hz, 10.0..=500.0);
        bounds.range("trajectory_deadline_s", self.trajectory_deadline_s, 0.05..=2.0);
        bounds.range("state_deadline_s", self.state_deadline_s, 0.02..=1.0);
    }
}
