//! How long a step takes, as measured from the ipc driver and written in the configuration.

use ipc_types::ProcessId;
use ipc_types::bounds::Bounds;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use serde::{Deserialize, Serialize};
use std::time::Duration;

/// Latency of one process' steps: `floor_ms` plus an exponential tail of mean `tail_ms`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StepLatency {
    /// Which process.
    pub process: ProcessId,
    /// Shortest time a step takes, ms.
    pub floor_ms: f64,
    /// Mean of what is added to it, ms.
    pub tail_ms: f64,
    /// Probability that a step's messages are lost.
    pub drop_probability: f64,
}

/// Latencies of the whole graph. A process that is not listed takes no time.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct LatencyModel(pub Vec<StepLatency>);

impl LatencyModel {
    /// Reports values out of range.
    pub fn check(&self, bounds: &mut Bounds) {
        for latency in &self.0 {
            let times = self.0.iter().filter(|other| other.process == latency.process).count();
            bounds.require(times == 1, latency.process.name(), "is listed more than once");
            bounds.section(latency.process.name(), |bounds| {
                bounds.range("floor_ms", latency.floor_ms, 0.0..=1000.0);
                bounds.range("tail_ms", latency.tail_ms, 0.0..=1000.0);
                bounds.range("drop_probability", latency.drop_probability, 0.0..=1.0);
            });
        }
    }

    pub(super) fn of(&self, process: ProcessId) -> StepLatency {
        let none = StepLatency { process, floor_ms: 0.0, tail_ms: 0.0, drop_probability: 0.0 };
        self.0.iter().find(|latency| latency.process == process).copied().unwrap_or(none)
    }
}

/// Draws latencies of one process.
#[derive(Debug)]
pub struct Latency {
    model: StepLatency,
    random: Pcg64Mcg,
}

impl Latency {
    pub(super) fn new(model: StepLatency, seed: u64) -> Self {
        Self { model, random: Pcg64Mcg::seed_from_u64(seed) }
    }

    pub(super) fn draw(&mut self) -> Duration {
        let tail = -(1.0 - self.random.random::<f64>()).ln() * self.model.tail_ms;
        Duration::from_secs_f64((self.model.floor_ms + tail.min(20.0 * self.model.tail_ms)) * 1e-3)
    }

    pub(super) fn drops(&mut self) -> bool {
        self.random.random_bool(self.model.drop_probability)
    }
}
