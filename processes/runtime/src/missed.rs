//! Counts the messages that a process should have been woken for and never saw.

use ipc_types::ProcessId;
use ipc_types::topics::TopicInfo;
use ipc_types::wire::Stamp;
use std::collections::HashMap;

/// Gaps in the sequences of received messages. A message that gave way to a newer one in a full buffer, or was lost on
/// the way, leaves a gap. Only topics that wake the process count: of the others it wants the latest alone.
#[derive(Debug, Default)]
pub(crate) struct Missed {
    last: HashMap<&'static str, Stamp>,
    count: u64,
}

impl Missed {
    pub(crate) fn count(&self) -> u64 {
        self.count
    }

    /// Notes a message that `process` received.
    pub(crate) fn received(&mut self, topic: &TopicInfo, process: ProcessId, stamp: &Stamp) {
        let wakes = topic.consumers.iter().any(|consumer| consumer.process == process && consumer.wakes);
        if !wakes {
            return;
        }
        // A topic may have several producers, and a restarted one counts anew: gaps between them are not known.
        let before = self.last.insert(topic.name, *stamp);
        let same = before.filter(|last| (last.producer, last.incarnation) == (stamp.producer, stamp.incarnation));
        self.count += same.map_or(0, |last| stamp.sequence.saturating_sub(last.sequence.saturating_add(1)));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ipc_types::topics::{Disparity, State, Topic};

    fn stamp(incarnation: u32, sequence: u64) -> Stamp {
        Stamp { sequence, valid_ns: 0, published_ns: 0, incarnation, producer: 2 }
    }

    #[test]
    fn gaps_count_once_and_restarts_do_not() {
        let mut missed = Missed::default();
        for (incarnation, sequence) in [(0, 5), (0, 6), (0, 9), (0, 9), (0, 8), (1, 1), (1, 2), (1, u64::MAX)] {
            missed.received(&Disparity::INFO, ProcessId::Expansion, &stamp(incarnation, sequence));
        }
        assert_eq!(missed.count(), 2 + (u64::MAX - 3));
    }

    #[test]
    fn topics_of_which_only_the_latest_counts_are_left_out() {
        let mut missed = Missed::default();
        for sequence in [1, 9] {
            missed.received(&State::INFO, ProcessId::Planner, &stamp(0, sequence));
        }
        assert_eq!(missed.count(), 0);
    }
}
