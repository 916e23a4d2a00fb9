//! Starts the process graph, watches it, restarts what dies, and says what may still be flown.
//!
//! * [`Policy`] decides what to do about what happens to processes, as a pure function of (state, event, now).
//! * [`Supervision`] carries it out: starts, reaps promptly (by pidfd, nobody polls numbers), cleans dead iceoryx2 nodes
//!   between reaping and restarting, looks at what does not beat, and ends everything in order. It adopts what a dead
//!   supervisor has left.
//! * [`Ladder`] decides how far the flight is to be scaled down for what does not work: also a pure function.
//! * [`Mission`] publishes goal and rung and watches how the flight goes; [`Summary`] is its account.
//!
//! The supervisor never blocks on a child: every wait has a deadline, and a child that ignores SIGTERM is killed.

mod child;
mod ladder;
mod mission;
mod mission_config;
mod observation;
mod orders;
mod policy;
mod rule;
mod summary;
mod supervision;

pub use child::Usage;
pub use ladder::{Ladder, LadderConfig, Observed, Step};
pub use mission::{ATTENTION, Mission, Outcome, Progress};
pub use mission_config::{AtGoal, HomeConfig, MissionConfig};
pub use orders::{Directive, LinkConfig, LinkLoss, Orders, Verdict};
pub use policy::{Action, Event, Phase, Policy};
pub use rule::{Criticality, Rule, Strategy};
pub use summary::{DeathSummary, FaultSummary, LatencySummary, Losses, ProcessSummary, RungSummary, Summary};
pub use supervision::{ChildCommand, ChildStatus, Happening, Orphan, SignalWatch, Supervision, SupervisionError};
