//! The command to the flight control unit.

use crate::wire::{Stamp, stamped, wire};

wire! {
    /// Velocity and yaw-rate setpoint. The flight control unit brakes by itself when setpoints stop.
    Setpoint = "sparrowhawk/Setpoint/1" {
        /// Origin.
        stamp: Stamp,
        /// World velocity, m/s.
        velocity_mps: [f64; 3],
        /// Turn rate about the world's z axis, rad/s.
        yaw_rate_radps: f64,
        /// Exposure of the newest image behind the trajectory being tracked, ns; 0 when none.
        image_valid_ns: i64,
        /// [`SetpointMode`].
        mode: u32,
        /// Always zero.
        reserved: u32,
    }
}
stamped!(Setpoint);

/// Why the setpoint is what it is.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[repr(u32)]
pub enum SetpointMode {
    /// On the ground: waiting for a trajectory, or landed.
    Idle = 0,
    /// Tracking a fresh trajectory.
    Track = 1,
    /// Slowing down because an input is stale.
    Brake = 2,
    /// Holding the position where braking ended.
    Hover = 3,
    /// What it would ask for while a pilot flies: to be recorded, not followed.
    Shadow = 4,
}

impl SetpointMode {
    /// From the wire; an unknown number reads as [`SetpointMode::Brake`].
    pub fn from_wire(number: u32) -> Self {
        match number {
            0 => Self::Idle,
            1 => Self::Track,
            3 => Self::Hover,
            4 => Self::Shadow,
            _ => Self::Brake,
        }
    }
}
