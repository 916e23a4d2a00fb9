//! What a process leaves to its successor, so that it goes on where its predecessor died.
//!
//! Plain old data as messages are, and like them refused where the layout is another. None of it is trusted for what a topic
//! says: a successor takes it as a beginning, and the next message in its place.

use crate::messages::{Goal, Trajectory};
use crate::wire::wire;

wire! {
    /// Of the controller: what it tracked, and what it asked for last. Elements: the points of the trajectory.
    ControllerEstate = "sparrowhawk/ControllerEstate/1" {
        /// The trajectory being tracked; all zero before the first.
        trajectory: Trajectory,
        /// Flight time of the last command, ns; 0 before the first.
        commanded_ns: i64,
        /// The last command, m/s.
        command_mps: [f64; 3],
        /// The place that is held, m.
        hover_m: [f64; 3],
        /// Whether one is held.
        hovers: u64,
    }
}

wire! {
    /// Of the planner: its goal, what is flown and where it was stuck. Elements: [`EstatePlace`].
    PlannerEstate = "sparrowhawk/PlannerEstate/1" {
        /// The goal.
        goal: Goal,
        /// Flight time of the plan, ns.
        planned_ns: i64,
        /// Plans chosen anew so far.
        replans: u64,
        /// Views older than this are disregarded, ns.
        disregards_before_ns: i64,
        /// What is flown: 0 nothing, 1 a candidate of the library, 2 a manoeuvre.
        flown: u64,
        /// Which candidate.
        candidate: u64,
        /// First velocity of the manoeuvre, m/s.
        first_mps: [f64; 3],
        /// Then this one, m/s.
        then_mps: [f64; 3],
        /// After so long, s.
        switch_s: f64,
        /// Begun at this flight time, ns.
        begun_ns: i64,
        /// Whether the vehicle has taken off.
        airborne: u64,
    }
}

wire! {
    /// A place where the vehicle was stuck, or where it dwelt.
    EstatePlace = "sparrowhawk/EstatePlace/1" {
        /// Where, m.
        position_m: [f64; 3],
        /// How long it dwelt there, s; 0 where it was stuck.
        dwelt_s: f64,
    }
}
