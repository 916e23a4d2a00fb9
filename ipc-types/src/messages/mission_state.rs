//! How far the mission is, and who commands it.

use crate::wire::{Stamp, Text, stamped, wire};

wire! {
    /// The mission as it stands. Elements: the places it leads by, in order; the last is the goal.
    MissionState = "sparrowhawk/MissionState/1" {
        /// Origin.
        stamp: Stamp,
        /// Highest speed, as asked for, m/s: what the ladder leaves of it stands in `degradation`.
        speed_mps: f64,
        /// Places passed.
        passed: u32,
        /// 1 while it was told to hover.
        hovers: u32,
        /// Who commands; empty: nobody, it is flown as configured.
        commander: Text,
        /// What was last asked for, by whom, and what became of it.
        note: Text,
    }
}
stamped!(MissionState);
