//! How a process is doing: its heartbeat.

use crate::wire::{Stamp, Text, stamped, wire};

wire! {
    /// Heartbeat and health of one process.
    Health = "sparrowhawk/Health/2" {
        /// Origin; `producer` is the process.
        stamp: Stamp,
        /// [`HealthLevel`].
        level: u32,
        /// Operating-system process number.
        pid: u32,
        /// Steps taken since start.
        steps: u64,
        /// Messages refused as malformed, late or unusable since start.
        dropped: u64,
        /// Messages that should have woken the process and that it never saw, since start.
        missed: u64,
        /// Host time of the last step that published, ns.
        last_step_ns: i64,
        /// Longest such step since start, ns.
        longest_step_ns: i64,
        /// What is wrong, or what is being waited for; empty when all is well.
        note: Text,
    }
}
stamped!(Health);

/// Grades of health.
#[derive(Clone, Copy, PartialEq, Eq, Debug, PartialOrd, Ord)]
#[repr(u32)]
pub enum HealthLevel {
    /// All is well.
    Ok = 0,
    /// Working, with less than it should have.
    Degraded = 1,
    /// Not doing its work.
    Faulted = 2,
}

impl HealthLevel {
    /// From the wire; an unknown number reads as [`HealthLevel::Faulted`].
    pub fn from_wire(number: u32) -> Self {
        match number {
            0 => Self::Ok,
            1 => Self::Degraded,
            _ => Self::Faulted,
        }
    }
}
