//! Where to go, and what to do there.

use crate::wire::{Stamp, stamped, wire};

wire! {
    /// What the vehicle is to do next.
    Goal = "sparrowhawk/Goal/2" {
        /// Origin.
        stamp: Stamp,
        /// World position to fly to, m.
        position_m: [f64; 3],
        /// Highest speed on the way, m/s.
        cruise_speed_mps: f64,
        /// [`Task`].
        task: u32,
        /// Always zero.
        reserved: u32,
    }
}
stamped!(Goal);

/// What to do about a goal.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[repr(u32)]
pub enum Task {
    /// Fly there, and hover.
    Hover = 0,
    /// Fly there, and land: whoever asks for it declares the column below the goal free, as for take-off.
    Land = 1,
    /// Stay: hover where the vehicle can stop, or on the ground.
    Stay = 2,
}

impl Task {
    /// From the wire; an unknown number reads as [`Task::Stay`], the safe one.
    pub fn from_wire(number: u32) -> Self {
        match number {
            0 => Self::Hover,
            1 => Self::Land,
            _ => Self::Stay,
        }
    }
}
