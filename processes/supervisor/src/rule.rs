//! What a process of the graph is worth, and how it is brought back: its rule, from the graph's RON.

use ipc_types::bounds::Bounds;
use serde::{Deserialize, Serialize};
use std::time::Duration;

/// What the loss of a process means.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Criticality {
    /// The world itself: never restarted; its death ends the run.
    World,
    /// Nothing flies without it: lost for good, the vehicle brakes, hovers and is handed back to the flight control unit.
    Flight,
    /// The flight goes on without it.
    Spare,
}

/// Who starts anew when a process does.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Strategy {
    /// It alone.
    OneForOne,
    /// It, and all that were started after it: what they hold is worth nothing without what it held.
    RestForOne,
}

/// The rule of one process.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Rule {
    /// What its loss means.
    pub criticality: Criticality,
    /// Who starts anew with it.
    pub strategy: Strategy,
    /// Wait before the first restart, ms. Doubles with every death within `window_s`.
    pub first_ms: u64,
    /// Longest wait, ms.
    pub longest_ms: u64,
    /// Who has done its work for so long is well again: deaths before that do not count, s.
    pub window_s: f64,
    /// More deaths than this without working for a window in between, and the process is given up.
    pub most: u32,
    /// Longest time from its start to its first heartbeat, s.
    pub start_up_s: f64,
    /// Longest silence of its heartbeat, s.
    pub heartbeat_s: f64,
    /// Longest time without an output while its input goes on and it refuses nothing, s.
    pub output_s: f64,
    /// From being told to end until it is killed, s.
    pub grace_s: f64,
    /// When it is told to end at the end of a run: with the lowest first, and the next when those have ended.
    pub stops: u8,
}

impl Rule {
    /// Reports values out of range.
    pub fn check(&self, bounds: &mut Bounds) {
        bounds.range("first_ms", self.first_ms, 1..=10_000);
        bounds.range("longest_ms", self.longest_ms, self.first_ms..=60_000);
        bounds.range("window_s", self.window_s, 0.1..=3600.0);
        bounds.range("most", self.most, 0..=1000);
        bounds.range("start_up_s", self.start_up_s, 0.5..=120.0);
        bounds.range("heartbeat_s", self.heartbeat_s, 0.15..=60.0);
        bounds.range("output_s", self.output_s, 0.2..=3600.0);
        bounds.range("grace_s", self.grace_s, 0.0..=60.0);
        bounds.range("stops", self.stops, 0..=9);
    }

    /// Wait before the restart that follows so many deaths within the window.
    pub(crate) fn wait(&self, deaths: u32) -> Duration {
        let doubled = self.first_ms.saturating_mul(1 << deaths.saturating_sub(1).min(20));
        Duration::from_millis(doubled.min(self.longest_ms))
    }

    pub(crate) fn window(&self) -> Duration {
        Duration::from_secs_f64(self.window_s)
    }
}

#[cfg(test)]
pub(crate) const FLIGHT: Rule = Rule {
    criticality: Criticality::Flight,
    strategy: Strategy::OneForOne,
    first_ms: 10,
    longest_ms: 60,
    window_s: 10.0,
    most: 5,
    start_up_s: 2.0,
    heartbeat_s: 0.25,
    output_s: 1.0,
    grace_s: 0.2,
    stops: 0,
};

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn waits_double_up_to_the_cap() {
        let waits: Vec<_> = (1..7).map(|deaths| FLIGHT.wait(deaths).as_millis()).collect();
        assert_eq!(waits, [10, 20, 40, 60, 60, 60]);
    }
}
