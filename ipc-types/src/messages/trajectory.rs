//! What the vehicle is to fly next.

use crate::wire::{Stamp, stamped, wire};

wire! {
    /// A trajectory that ends at rest. Elements: [`TrajectoryPoint`]s in order of time, the first at `stamp.valid_ns`.
    Trajectory = "sparrowhawk/Trajectory/2" {
        /// Origin.
        stamp: Stamp,
        /// Exposure of the newest image the plan rests on, ns; 0 when none was needed.
        image_valid_ns: i64,
        /// Counts plans that were chosen anew rather than continued.
        replans: u64,
        /// [`PlanMode`].
        mode: u32,
        /// Candidates evaluated.
        candidates: u32,
        /// Candidates found admissible.
        admissible: u32,
        /// Candidates refused because they touch something occupied.
        occupied: u32,
        /// Candidates refused because what they commit to is not known free.
        unknown: u32,
        /// Candidates refused because they leave the fence.
        outside: u32,
        /// Planning latency allowed for: the trajectory starts this long after the newest state, s.
        lead_s: f64,
    }
}
stamped!(Trajectory);

wire! {
    /// One sample of a trajectory.
    TrajectoryPoint = "sparrowhawk/TrajectoryPoint/1" {
        /// Seconds after the trajectory's start.
        t_s: f64,
        /// World position, m.
        position_m: [f64; 3],
        /// World velocity, m/s.
        velocity_mps: [f64; 3],
        /// Heading of the body's x axis about the world's z axis, rad.
        yaw_rad: f64,
    }
}

/// What the planner is doing.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[repr(u32)]
pub enum PlanMode {
    /// Not yet ready to fly.
    Waiting = 0,
    /// Climbing inside the home cylinder.
    TakeOff = 1,
    /// On the way to the goal.
    Cruise = 2,
    /// At the goal.
    Arrived = 3,
    /// Stopping or stopped because no way ahead is known to be free.
    Hold = 4,
    /// Turning on the spot to see more.
    LookAround = 5,
    /// Flying back along the path flown, or stepping back to see more.
    BackOut = 6,
    /// Hovering for good: no way was found.
    GivenUp = 7,
    /// Descending at the goal.
    Land = 8,
    /// On the ground, at the end of a landing.
    Landed = 9,
}

impl PlanMode {
    /// From the wire; an unknown number reads as [`PlanMode::Hold`], the safe one.
    pub fn from_wire(number: u32) -> Self {
        match number {
            0 => Self::Waiting,
            1 => Self::TakeOff,
            2 => Self::Cruise,
            3 => Self::Arrived,
            5 => Self::LookAround,
            6 => Self::BackOut,
            7 => Self::GivenUp,
            8 => Self::Land,
            9 => Self::Landed,
            _ => Self::Hold,
        }
    }
}

impl std::fmt::Display for PlanMode {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.pad(match self {
            Self::Waiting => "waiting",
            Self::TakeOff => "take-off",
            Self::Cruise => "cruise",
            Self::Arrived => "arrived",
            Self::Hold => "hold",
            Self::LookAround => "look around",
            Self::BackOut => "back out",
            Self::GivenUp => "given up",
            Self::Land => "land",
            Self::Landed => "landed",
        })
    }
}
