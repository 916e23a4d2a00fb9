//! When to restart: capped exponential back-off, and an end to it.

use ipc_types::HostTime;
use ipc_types::bounds::Bounds;
use serde::{Deserialize, Serialize};
use std::time::Duration;

/// How one process is to be restarted.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RestartRule {
    /// Wait before the first restart, ms. Doubles with every death within `window_s`.
    pub first_ms: u64,
    /// Longest wait, ms.
    pub longest_ms: u64,
    /// Deaths within this time count together, s.
    pub window_s: f64,
    /// More deaths than this within the window and the process is given up.
    pub most: u32,
    /// A process whose heartbeat is older than this is killed, s.
    pub heartbeat_deadline_s: f64,
}

impl RestartRule {
    /// Reports values out of range.
    pub fn check(&self, bounds: &mut Bounds) {
        bounds.range("first_ms", self.first_ms, 0..=10_000);
        bounds.range("longest_ms", self.longest_ms, self.first_ms..=60_000);
        bounds.range("window_s", self.window_s, 0.1..=3600.0);
        bounds.range("most", self.most, 0..=10_000);
        bounds.range("heartbeat_deadline_s", self.heartbeat_deadline_s, 0.3..=60.0);
    }
}

/// What to do about a death.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Decision {
    /// Restart no earlier than this.
    RestartAt(HostTime),
    /// Too many deaths.
    GiveUp,
}

/// The deaths of one process.
#[derive(Clone, Debug)]
pub struct Policy {
    rule: RestartRule,
    deaths: Vec<HostTime>,
}

impl Policy {
    /// No deaths yet.
    pub fn new(rule: RestartRule) -> Self {
        Self { rule, deaths: Vec::new() }
    }

    /// The process died at `now`.
    pub fn died(&mut self, now: HostTime) -> Decision {
        let window = Duration::from_secs_f64(self.rule.window_s);
        self.deaths.retain(|death| now.saturating_since(*death) < window);
        self.deaths.push(now);
        let count = self.deaths.len() as u32;
        if count > self.rule.most {
            return Decision::GiveUp;
        }
        let doubled = self.rule.first_ms.saturating_mul(1 << (count - 1).min(20));
        Decision::RestartAt(now + Duration::from_millis(doubled.min(self.rule.longest_ms)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const RULE: RestartRule =
        RestartRule { first_ms: 10, longest_ms: 60, window_s: 10.0, most: 5, heartbeat_deadline_s: 1.0 };

    #[test]
    fn backs_off_up_to_the_cap_then_gives_up() {
        let mut policy = Policy::new(RULE);
        let now = HostTime::from_secs_f64(1.0);
        let waits: Vec<_> = (0..6)
            .map(|_| match policy.died(now) {
                Decision::RestartAt(at) => Some(at.saturating_since(now).as_millis()),
                Decision::GiveUp => None,
            })
            .collect();
        assert_eq!(waits, [Some(10), Some(20), Some(40), Some(60), Some(60), None]);
    }

    #[test]
    fn old_deaths_are_forgiven() {
        let mut policy = Policy::new(RULE);
        for second in 0..100 {
            let now = HostTime::from_secs_f64(f64::from(second) * 11.0);
            assert_eq!(policy.died(now), Decision::RestartAt(now + Duration::from_millis(10)));
        }
    }
}
