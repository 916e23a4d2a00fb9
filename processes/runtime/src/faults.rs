//! Faults to inject into a flight: what may be written in a fault file.
//!
//! Who brings them about: the supervisor's injector (signals, intruders, full memory), the processes themselves (what goes on
//! inside: hanging, crashing, being slow; what becomes of their messages), the simulator (sensors and clock). All of them are
//! told by the same list, in the run's configuration.

use ipc_types::ProcessId;
use ipc_types::bounds::Bounds;
use ipc_types::topics::{TOPICS, TopicInfo};
use serde::{Deserialize, Serialize};
use std::fmt;

/// A fault and when it comes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Fault {
    /// Flight time, s.
    pub at_s: f64,
    /// What happens.
    pub fault: FaultKind,
}

/// What may happen.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum FaultKind {
    /// SIGKILL.
    Kill {
        /// Which; also `supervisor`.
        process: ProcessId,
    },
    /// SIGSTOP.
    Stop {
        /// Which.
        process: ProcessId,
    },
    /// It panics whenever it runs.
    CrashLoop {
        /// Which.
        process: ProcessId,
        /// For so long, s.
        for_s: f64,
    },
    /// It runs in a circle for ever: no heartbeat, no output, all of a processor.
    Hang {
        /// Which.
        process: ProcessId,
    },
    /// It beats, and does nothing else any more.
    Silence {
        /// Which.
        process: ProcessId,
    },
    /// Every step takes longer, by computing.
    Slow {
        /// Which.
        process: ProcessId,
        /// For so long, s.
        for_s: f64,
        /// By so much, ms.
        by_ms: f64,
    },
    /// It cannot open any file.
    Descriptors {
        /// Which.
        process: ProcessId,
        /// For so long, s.
        for_s: f64,
    },
    /// Messages are lost.
    Lose {
        /// Of this topic.
        topic: String,
        /// For so long, s.
        for_s: f64,
        /// Share of them, 0..1.
        share: f64,
    },
    /// Messages come late.
    Delay {
        /// Of this topic.
        topic: String,
        /// For so long, s.
        for_s: f64,
        /// By so much, ms.
        by_ms: f64,
    },
    /// Messages come twice.
    Duplicate {
        /// Of this topic.
        topic: String,
        /// For so long, s.
        for_s: f64,
        /// Share of them, 0..1.
        share: f64,
    },
    /// Messages have wrong bytes.
    Corrupt {
        /// Of this topic.
        topic: String,
        /// For so long, s.
        for_s: f64,
        /// Share of them, 0..1.
        share: f64,
    },
    /// The camera delivers the same images, with new times.
    FreezeCamera {
        /// For so long, s.
        for_s: f64,
    },
    /// The camera delivers grey.
    BlankCamera {
        /// For so long, s.
        for_s: f64,
    },
    /// The camera is noisy.
    Noise {
        /// For so long, s.
        for_s: f64,
        /// Standard deviation, grey levels.
        grey: f64,
    },
    /// The position estimate jumps, to the left of the world's x axis.
    Jump {
        /// By so much, m.
        by_m: f64,
    },
    /// One reading of the flight clock is wrong.
    StepClock {
        /// By so much, s.
        by_s: f64,
    },
    /// The disk is full: what the recorder writes is refused.
    FillDisk {
        /// For so long, s.
        for_s: f64,
    },
    /// `/dev/shm` is full.
    FillMemory {
        /// For so long, s.
        for_s: f64,
    },
    /// A reader takes messages and never lets go of them.
    StallReader {
        /// Of this topic.
        topic: String,
        /// For so long, s.
        for_s: f64,
    },
    /// A process that was built with other messages tries to join.
    OtherVersion,
}

/// Longest that a fault may last, s.
const LONGEST_S: f64 = 3600.0;

impl FaultKind {
    /// The process that is concerned, if it is one.
    pub fn process(&self) -> Option<ProcessId> {
        match self {
            Self::Kill { process }
            | Self::Stop { process }
            | Self::CrashLoop { process, .. }
            | Self::Hang { process }
            | Self::Silence { process }
            | Self::Slow { process, .. }
            | Self::Descriptors { process, .. } => Some(*process),
            Self::FillDisk { .. } => Some(ProcessId::Recorder),
            _ => None,
        }
    }

    /// The topic that is concerned, if it is one.
    pub fn topic(&self) -> Option<&str> {
        match self {
            Self::Lose { topic, .. }
            | Self::Delay { topic, .. }
            | Self::Duplicate { topic, .. }
            | Self::Corrupt { topic, .. }
            | Self::StallReader { topic, .. } => Some(topic),
            _ => None,
        }
    }

    /// How long it lasts, s; 0 for what happens at once.
    pub fn for_s(&self) -> f64 {
        match self {
            Self::CrashLoop { for_s, .. }
            | Self::Slow { for_s, .. }
            | Self::Descriptors { for_s, .. }
            | Self::Lose { for_s, .. }
            | Self::Delay { for_s, .. }
            | Self::Duplicate { for_s, .. }
            | Self::Corrupt { for_s, .. }
            | Self::FreezeCamera { for_s }
            | Self::BlankCamera { for_s }
            | Self::Noise { for_s, .. }
            | Self::FillDisk { for_s }
            | Self::FillMemory { for_s }
            | Self::StallReader { for_s, .. } => *for_s,
            _ => 0.0,
        }
    }

    /// Its name, as a fault file has it.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Kill { .. } => "kill",
            Self::Stop { .. } => "stop",
            Self::CrashLoop { .. } => "crash_loop",
            Self::Hang { .. } => "hang",
            Self::Silence { .. } => "silence",
            Self::Slow { .. } => "slow",
            Self::Descriptors { .. } => "descriptors",
            Self::Lose { .. } => "lose",
            Self::Delay { .. } => "delay",
            Self::Duplicate { .. } => "duplicate",
            Self::Corrupt { .. } => "corrupt",
            Self::FreezeCamera { .. } => "freeze_camera",
            Self::BlankCamera { .. } => "blank_camera",
            Self::Noise { .. } => "noise",
            Self::Jump { .. } => "jump",
            Self::StepClock { .. } => "step_clock",
            Self::FillDisk { .. } => "fill_disk",
            Self::FillMemory { .. } => "fill_memory",
            Self::StallReader { .. } => "stall_reader",
            Self::OtherVersion => "other_version",
        }
    }

    /// What it befalls: a process, a topic, or the name of neither.
    pub fn victim(&self) -> &str {
        self.process().map(ProcessId::name).or(self.topic()).unwrap_or("vehicle")
    }
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} of {} at {:.2} s", self.fault.name(), self.fault.victim(), self.at_s)?;
        if self.fault.for_s() > 0.0 { write!(f, " for {:.2} s", self.fault.for_s()) } else { Ok(()) }
    }
}

impl Fault {
    /// Whether it is going on.
    pub fn is_on(&self, now_s: f64) -> bool {
        (self.at_s..self.at_s + self.fault.for_s()).contains(&now_s)
    }

    /// Reports values out of range, processes and topics that there are not, and what cannot be done to them.
    pub fn check(&self, bounds: &mut Bounds) {
        bounds.range("at_s", self.at_s, 0.0..=36_000.0);
        bounds.section(self.fault.name(), |bounds| {
            bounds.range("for_s", self.fault.for_s(), 0.0..=LONGEST_S);
            match &self.fault {
                FaultKind::Lose { share, .. }
                | FaultKind::Duplicate { share, .. }
                | FaultKind::Corrupt { share, .. } => bounds.range("share", *share, 0.0..=1.0),
                FaultKind::Slow { by_ms, .. } | FaultKind::Delay { by_ms, .. } => {
                    bounds.range("by_ms", *by_ms, 0.0..=10_000.0);
                }
                FaultKind::Noise { grey, .. } => bounds.range("grey", *grey, 0.0..=255.0),
                FaultKind::Jump { by_m } => bounds.range("by_m", *by_m, -100.0..=100.0),
                FaultKind::StepClock { by_s } => bounds.range("by_s", *by_s, -3600.0..=3600.0),
                _ => {}
            }
            if let Some(topic) = self.fault.topic() {
                let known = TOPICS.iter().map(|info: &TopicInfo| info.name).collect::<Vec<_>>();
                let message = format!("is \"{topic}\", expected one of {}", known.join(", "));
                bounds.require(known.contains(&topic), "topic", message);
            }
            if let Some(process) = self.fault.process() {
                let is_world = process == ProcessId::Simulator;
                bounds.require(!is_world, "process", "is simulator, which is the world: its death ends the run");
                let from_outside = matches!(self.fault, FaultKind::Kill { .. });
                let is_supervisor = process == ProcessId::Supervisor;
                bounds.require(!is_supervisor || from_outside, "process", "is supervisor, which can only be killed");
                let is_flown = !matches!(process, ProcessId::Player | ProcessId::Camera);
                bounds.require(is_flown, "process", format_args!("is {process}, which no simulated flight has"));
            }
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn complaints(at_s: f64, fault: FaultKind) -> Vec<String> {
        let mut bounds = Bounds::default();
        Fault { at_s, fault }.check(&mut bounds);
        bounds.into_violations()
    }

    #[test]
    fn what_cannot_be_is_said() {
        assert!(complaints(1.0, FaultKind::Kill { process: ProcessId::Supervisor }).is_empty());
        let impossible = [
            (f64::NAN, FaultKind::OtherVersion, "at_s"),
            (1.0, FaultKind::Kill { process: ProcessId::Simulator }, "world"),
            (1.0, FaultKind::Hang { process: ProcessId::Supervisor }, "only be killed"),
            (1.0, FaultKind::Stop { process: ProcessId::Camera }, "no simulated flight"),
            (1.0, FaultKind::Lose { topic: "plan".to_owned(), for_s: 1.0, share: 0.5 }, "expected one of"),
            (1.0, FaultKind::Lose { topic: "goal".to_owned(), for_s: -1.0, share: 0.5 }, "for_s is -1"),
            (1.0, FaultKind::Corrupt { topic: "goal".to_owned(), for_s: 1.0, share: f64::NAN }, "share is NaN"),
        ];
        for (at_s, fault, expected) in impossible {
            let found = complaints(at_s, fault.clone());
            assert!(found.len() == 1 && found[0].contains(expected), "{fault:?}: {found:?}");
        }
    }

    #[test]
    fn a_fault_is_on_from_when_it_comes_for_as_long_as_it_lasts() {
        let fault = Fault { at_s: 2.0, fault: FaultKind::FreezeCamera { for_s: 1.5 } };
        assert_eq!([1.9, 2.0, 3.4, 3.6].map(|now| fault.is_on(now)), [false, true, true, false]);
        assert_eq!(fault.to_string(), "freeze_camera of vehicle at 2.00 s for 1.50 s");
    }
}
