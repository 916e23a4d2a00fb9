//! Faults that a process brings upon itself, because its run's configuration says so: it crashes, hangs, falls silent, is
//! slow, or runs out of descriptors; its messages are lost, late, doubled or damaged.

use crate::faults::{Fault, FaultKind};
use crate::ports::host_now;
use ipc_types::topics::TopicInfo;
use ipc_types::{FlightTime, ProcessId};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

/// The faults of one process.
#[derive(Debug)]
pub(super) struct Injection {
    faults: Vec<Fault>,
    process: ProcessId,
    /// Flight time of the first step: what came before happened to a predecessor.
    first_s: Option<f64>,
    random: Pcg64Mcg,
    limited: Option<(Resource, Rlimit)>,
}

/// What becomes of a message.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Fate {
    pub(super) is_lost: bool,
    pub(super) is_doubled: bool,
    pub(super) is_damaged: bool,
    pub(super) late_by: Duration,
}

impl Injection {
    pub(super) fn new(faults: &[Fault], process: ProcessId, incarnation: u32) -> Self {
        let seed = (process as u64) << 32 | u64::from(incarnation);
        Self { faults: faults.to_vec(), process, first_s: None, random: Pcg64Mcg::seed_from_u64(seed), limited: None }
    }

    /// Whether there is nothing to inject: the usual flight.
    pub(super) fn is_none(&self) -> bool {
        self.faults.is_empty()
    }

    /// Before a step; whether the step may be taken.
    pub(super) fn may_step(&mut self, now: FlightTime) -> bool {
        if self.is_none() || now == FlightTime::ZERO {
            return true;
        }
        let now_s = now.as_secs_f64();
        let first_s = *self.first_s.get_or_insert(now_s);
        let (mut may_step, mut limit) = (true, None);
        for fault in self.faults.iter().filter(|fault| fault.fault.process() == Some(self.process)) {
            let has_come = first_s < fault.at_s && fault.at_s <= now_s;
            match fault.fault {
                // Asked for: without such a fault in the run's configuration this is never reached.
                FaultKind::CrashLoop { .. } if fault.is_on(now_s) => panic!("injected: {fault}"),
                FaultKind::Hang { .. } if has_come => loop {
                    std::hint::spin_loop();
                },
                FaultKind::Silence { .. } if has_come => may_step = false,
                FaultKind::Slow { by_ms, .. } if fault.is_on(now_s) => spin(Duration::from_secs_f64(by_ms * 1e-3)),
                FaultKind::Descriptors { .. } if fault.is_on(now_s) => limit = Some(Resource::Nofile),
                FaultKind::FillDisk { .. } if fault.is_on(now_s) => limit = Some(Resource::Fsize),
                _ => {}
            }
        }
        self.limit(limit);
        may_step
    }

    /// Takes all that is left of a resource away, or gives it back.
    fn limit(&mut self, wanted: Option<Resource>) {
        match (wanted, self.limited.take()) {
            (Some(resource), None) => {
                let limit = getrlimit(resource);
                // Its default is to end the process; a disk that is full does not.
                let _ = signal_hook::flag::register(signal_hook::consts::SIGXFSZ, Arc::new(AtomicBool::new(false)));
                // None: neither more descriptors than are open, nor a longer file. A limit that cannot be set leaves all as it was.
                if setrlimit(resource, Rlimit { current: Some(0), ..limit }).is_ok() {
                    self.limited = Some((resource, limit));
                }
            }
            (None, Some((resource, limit))) => drop(setrlimit(resource, limit)),
            (_, limited) => self.limited = limited,
        }
    }

    /// What becomes of a message of a topic that is published now.
    pub(super) fn fate(&mut self, topic: &TopicInfo, now: FlightTime) -> Fate {
        let (mut fate, now_s) = (Fate::default(), now.as_secs_f64());
        for fault in self.faults.iter().filter(|fault| fault.fault.topic() == Some(topic.name) && fault.is_on(now_s)) {
            let mut happens = |share: f64| self.random.random::<f64>() < share;
            match fault.fault {
                FaultKind::Lose { share, .. } => fate.is_lost |= happens(share),
                FaultKind::Duplicate { share, .. } => fate.is_doubled |= happens(share),
                FaultKind::Corrupt { share, .. } => fate.is_damaged |= happens(share),
                FaultKind::Delay { by_ms, .. } => fate.late_by = Duration::from_secs_f64(by_ms * 1e-3),
                _ => {}
            }
        }
        fate
    }

    /// Damages some of the bytes.
    pub(super) fn damage(&mut self, bytes: &mut [u8]) {
        if bytes.is_empty() {
            return;
        }
        for _ in 0..1 + bytes.len() / 64 {
            let at = self.random.random_range(0..bytes.len());
            bytes[at] = self.random.random();
        }
    }
}

fn spin(time: Duration) {
    let until = host_now() + time;
    while host_now() < until {
        std::hint::spin_loop();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ipc_types::topics::{Goals, Plan, Topic};

    fn t(seconds: f64) -> FlightTime {
        FlightTime::from_secs_f64(seconds)
    }

    #[test]
    fn messages_meet_the_fate_of_their_topic_while_it_lasts() {
        let topic = || Plan::INFO.name.to_owned();
        let faults = [
            Fault { at_s: 1.0, fault: FaultKind::Lose { topic: topic(), for_s: 1.0, share: 0.5 } },
            Fault { at_s: 3.0, fault: FaultKind::Delay { topic: topic(), for_s: 1.0, by_ms: 30.0 } },
        ];
        let mut injection = Injection::new(&faults, ProcessId::Planner, 0);
        let lost = |injection: &mut Injection, topic: &TopicInfo, at_s: f64| {
            (0..1000).filter(|_| injection.fate(topic, t(at_s)).is_lost).count()
        };
        assert!((400..600).contains(&lost(&mut injection, &Plan::INFO, 1.5)));
        assert_eq!(lost(&mut injection, &Goals::INFO, 1.5) + lost(&mut injection, &Plan::INFO, 2.5), 0);
        assert_eq!(injection.fate(&Plan::INFO, t(3.5)).late_by, Duration::from_millis(30));
    }

    #[test]
    fn a_successor_does_not_suffer_what_befell_its_predecessor() {
        let faults = [Fault { at_s: 2.0, fault: FaultKind::Silence { process: ProcessId::Memory } }];
        let mut first = Injection::new(&faults, ProcessId::Memory, 0);
        assert!(first.may_step(t(1.0)) && !first.may_step(t(2.5)) && !first.may_step(t(9.0)));
        let mut second = Injection::new(&faults, ProcessId::Memory, 1);
        assert!(second.may_step(t(2.6)) && second.may_step(t(9.0)));
        let mut other = Injection::new(&faults, ProcessId::Planner, 0);
        assert!(other.may_step(t(1.0)) && other.may_step(t(3.0)));
    }
}
