//! What really happened, known to the simulator alone. Reports and tests read it; nothing that flies may.

use crate::wire::{Stamp, stamped, wire};

wire! {
    /// True state of the simulated vehicle.
    WorldTruth = "sparrowhawk/WorldTruth/1" {
        /// Origin.
        stamp: Stamp,
        /// Position of the body's origin, m.
        position_m: [f64; 3],
        /// Velocity, m/s.
        velocity_mps: [f64; 3],
        /// World from body, `[w, x, y, z]`.
        orientation: [f64; 4],
        /// Distance from the body's hull to the nearest obstacle, ground included, m.
        clearance_m: f64,
        /// Distance from the body's hull to the nearest obstacle other than the ground, m.
        obstacle_clearance_m: f64,
        /// 1 once the body has touched anything in flight.
        collided: u32,
        /// 1 while airborne.
        airborne: u32,
        /// Stereo pairs rendered so far.
        frames: u64,
        /// Flight seconds per host second since start.
        clock_ratio: f64,
    }
}
stamped!(WorldTruth);
