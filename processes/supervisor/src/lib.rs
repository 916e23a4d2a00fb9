//! Starts the process graph, watches it, and restarts what dies.
//!
//! * [`Policy`] decides when to restart, as a pure function of what happened and when.
//! * [`Supervision`] carries it out: spawns, reaps promptly (a thread waits on each child, nobody polls), cleans dead
//!   iceoryx2 nodes between reaping and restarting, kills what has stopped beating, and stops everything in order.
//! * [`Mission`] publishes the goal and watches how the flight goes; [`Summary`] is its account.
//!
//! The supervisor never blocks on a child: every wait has a deadline, and a child that ignores SIGTERM is killed.

mod mission;
mod policy;
mod summary;
mod supervision;

pub use mission::{ATTENTION, AtGoal, HomeConfig, Mission, MissionConfig, Outcome};
pub use policy::{Decision, Policy, RestartRule};
pub use summary::{LatencySummary, Losses, ProcessSummary, Summary};
pub use supervision::{ChildCommand, ChildState, ChildStatus, Happening, SignalWatch, Supervision, SupervisionError};
