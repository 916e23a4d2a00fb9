//! Where to go.

use crate::wire::{Stamp, stamped, wire};

wire! {
    /// The goal of the mission.
    Goal = "sparrowhawk/Goal/1" {
        /// Origin.
        stamp: Stamp,
        /// World position to hover at, m.
        position_m: [f64; 3],
        /// Highest speed on the way, m/s.
        cruise_speed_mps: f64,
    }
}
stamped!(Goal);
