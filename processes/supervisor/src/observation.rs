//! What the ladder is told, gathered from what passes by.

use crate::ladder::Observed;
use crate::policy::Phase;
use crate::rule::Criticality;
use crate::supervision::ChildStatus;
use ipc_types::messages::{KeyframeSet, VehicleState};
use ipc_types::wire::Stamp;
use ipc_types::{FlightTime, ProcessId};
use std::collections::VecDeque;
use std::time::Duration;

/// Frames between these ages are counted: younger ones may still be on their way, s.
const COUNTED_S: (f64, f64) = (0.4, 1.6);
/// Fewer tell nothing.
const FEWEST: usize = 5;
/// Frames remembered.
const FRAMES: usize = 256;
/// A memory that came back with less than this share of the keyframes has lost them.
const KEPT_SHARE: f64 = 0.5;
/// A loss of keyframes counts for so long.
const LOST_FOR: Duration = Duration::from_secs(2);
/// At rest below this speed, m/s.
const AT_REST_MPS: f64 = 0.3;

/// See the module's documentation.
#[derive(Clone, Debug, Default)]
pub(crate) struct Observation {
    /// Exposures of the frames, oldest first, and whether a map with them was seen.
    frames: VecDeque<(i64, bool)>,
    map: Option<FlightTime>,
    /// Of the newest set: its memory's incarnation, its size, and what could not be stored.
    set: Option<(u32, usize, u64)>,
    lost_at: Option<FlightTime>,
    /// Flight processes that are away, and since when.
    away: Vec<(ProcessId, FlightTime)>,
    given_up: Option<ProcessId>,
}

impl Observation {
    /// The camera delivered a frame.
    pub(crate) fn frame(&mut self, stamp: &Stamp) {
        if self.frames.len() == FRAMES {
            self.frames.pop_front();
        }
        self.frames.push_back((stamp.valid_ns, false));
    }

    /// The memory published its map, with so many nodes.
    pub(crate) fn map(&mut self, now: FlightTime, set: &KeyframeSet, nodes: usize) {
        let valid_ns = set.stamp.valid_ns;
        self.frames.iter_mut().filter(|(exposure, _)| *exposure == valid_ns).for_each(|(_, seen)| *seen = true);
        self.map = Some(FlightTime::from_nanos(valid_ns));
        if let Some((incarnation, before, not_stored)) = self.set {
            let is_another = incarnation != set.stamp.incarnation;
            let came_back_poor = is_another && (nodes as f64) < KEPT_SHARE * before as f64;
            let could_not_store = !is_another && set.not_stored > not_stored;
            if came_back_poor || could_not_store {
                self.lost_at = Some(now);
            }
        }
        self.set = Some((set.stamp.incarnation, nodes, set.not_stored));
    }

    /// The processes as the supervisor has them.
    pub(crate) fn processes(&mut self, now: FlightTime, children: &[ChildStatus]) {
        let flying = || children.iter().filter(|child| child.criticality == Criticality::Flight);
        self.given_up = flying().find(|child| matches!(child.phase, Phase::GivenUp(_))).map(|child| child.process);
        // What has never been up yet is not missed.
        let is_away = |child: &&ChildStatus| {
            child.phase != Phase::Running && child.restarts + child.incarnation > 0
                || matches!(child.phase, Phase::BackingOff(_) | Phase::Ending { .. })
        };
        self.away.retain(|(process, _)| flying().filter(is_away).any(|child| child.process == *process));
        for child in flying().filter(is_away) {
            if self.away.iter().all(|(process, _)| *process != child.process) {
                self.away.push((child.process, now));
            }
        }
    }

    /// What is known now.
    pub(crate) fn observed(&self, now: FlightTime, state: Option<&VehicleState>) -> Observed {
        let counted = |exposure: i64| {
            let age_s = now.seconds_since(FlightTime::from_nanos(exposure));
            (COUNTED_S.0..COUNTED_S.1).contains(&age_s)
        };
        let counted: Vec<bool> = self.frames.iter().filter(|(at, _)| counted(*at)).map(|(_, seen)| *seen).collect();
        let seen = counted.iter().filter(|seen| **seen).count();
        let arriving = if counted.len() < FEWEST { 1.0 } else { seen as f64 / counted.len() as f64 };
        Observed {
            // Whoever has been away for longest.
            away: self.away.first().copied(),
            given_up: self.given_up,
            lost_keyframes: self.lost_at.is_some_and(|at| now.saturating_since(at) < LOST_FOR),
            arriving,
            map_age_s: self.map.map_or(0.0, |map| now.seconds_since(map)),
            airborne: state.is_some_and(|state| state.landed == 0),
            at_rest: state.is_none_or(|state| state.velocity().norm() < AT_REST_MPS),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ipc_types::messages::KeyframeSet;

    fn t(seconds: f64) -> FlightTime {
        FlightTime::from_secs_f64(seconds)
    }

    fn stamp(at_s: f64, incarnation: u32) -> Stamp {
        Stamp { sequence: 1, valid_ns: t(at_s).as_nanos(), published_ns: 0, incarnation, producer: 4 }
    }

    fn set(at_s: f64, incarnation: u32, not_stored: u64) -> KeyframeSet {
        let stamp = stamp(at_s, incarnation);
        KeyframeSet { stamp, without_pose: 0, late: 0, misfits: 0, not_stored, jumps: 0 }
    }

    #[test]
    fn images_that_lead_to_no_map_are_counted() {
        let mut observation = Observation::default();
        for tick in 0..100 {
            let at_s = 0.08 * f64::from(tick);
            observation.frame(&stamp(at_s, 0));
            if tick % 3 != 0 {
                observation.map(t(at_s), &set(at_s, 0, 0), 10);
            }
        }
        let seen = observation.observed(t(8.0), None);
        assert!((0.55..0.75).contains(&seen.arriving), "{seen:?}");
        assert!((seen.map_age_s - 0.16).abs() < 0.09 && !seen.lost_keyframes, "{seen:?}");
        assert_eq!(Observation::default().observed(t(8.0), None).arriving, 1.0, "without a camera nothing is missed");
    }

    #[test]
    fn keyframes_are_lost_when_one_is_not_stored_or_a_successor_has_few() {
        let lost = |sets: &[(u32, u64, usize)]| {
            let mut observation = Observation::default();
            sets.iter().for_each(|&(incarnation, not_stored, nodes)| {
                observation.map(t(1.0), &set(1.0, incarnation, not_stored), nodes)
            });
            [1.1, 5.0].map(|now| observation.observed(t(now), None).lost_keyframes)
        };
        assert_eq!(lost(&[(0, 0, 10), (0, 0, 11), (1, 0, 10)]), [false, false]);
        assert_eq!(lost(&[(0, 0, 10), (1, 0, 3)]), [true, false]);
        assert_eq!(lost(&[(0, 0, 10), (0, 1, 10)]), [true, false]);
    }
}
