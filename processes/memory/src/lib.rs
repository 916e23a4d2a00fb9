//! Occupancy from expanded disparity images.
//!
//! * [`DisparityGraph`] keeps the keyframes (DROAN, Algorithm 2).
//! * [`View`] answers what a planner asks: free, occupied, or unknown and why (eqs 3.9–3.12, Table 3.1). It is a
//!   library type: the memory process decides what is in it, the planner asks it where its pixels lie.
//! * [`FreeSpace`] holds the evidence of free space that no image gives: where the vehicle has been, and the home
//!   cylinder that the operator declares.
//!
//! Unknown is never free. The order of keyframes does not change any answer.

mod along;
mod batch;
mod evidence;
mod frozen;
mod graph;
mod inference;
mod lanes;
mod process;
mod record;
mod simd;
mod view;
mod votes;

pub use along::{Demand, FINEST_M, Hit, TimedHit};
pub use batch::{LengthsDiffer, Points, Scratch};
pub use evidence::{FreeSpace, FreeSpaceConfig, FreeSpaceRule};
pub use graph::{DisparityGraph, GraphRule, Node, Place};
pub use inference::{Inference, probability_mass};
pub use process::MemoryProcess;
pub use view::{MapModel, Occupancy, Score, Unknown, View};

use ipc_types::bounds::Bounds;
use serde::{Deserialize, Serialize};

/// Parameters of the memory.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// Which frames become keyframes.
    pub graph: GraphRule,
    /// Free space beside measured surfaces.
    pub free_space: FreeSpaceConfig,
    /// How votes are weighed.
    pub inference: Inference,
    /// How long something must be seen free again to be forgotten, s.
    pub forget_s: f64,
}

impl Config {
    /// Reports values out of range.
    pub fn check(&self, bounds: &mut Bounds) {
        bounds.section("graph", |bounds| self.graph.check(bounds));
        bounds.section("free_space", |bounds| self.free_space.check(bounds));
        bounds.section("inference", |bounds| self.inference.check(bounds));
        bounds.range("forget_s", self.forget_s, 0.1..=3600.0);
    }
}
