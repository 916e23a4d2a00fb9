//! Random faults by seed: what a campaign throws at a flight.

use clap::ValueEnum;
use ipc_types::ProcessId;
use rand::seq::IndexedRandom;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use runtime::faults::{Fault, FaultKind};

/// Kinds of campaign.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, ValueEnum)]
#[value(rename_all = "snake_case")]
pub(crate) enum FaultPlan {
    /// SIGKILL of random processes.
    Kills,
    /// SIGSTOP of random processes.
    Stops,
    /// Endless loops in random processes.
    Hangs,
    /// Processes that beat, and do nothing else.
    Silences,
    /// One process that panics until it is given up.
    CrashLoops,
    /// One kill of the supervisor, which a new one takes over from.
    Supervisor,
    /// Processes that take longer.
    Slowness,
    /// Lost, late, doubled and damaged messages.
    Messages,
    /// A frozen, blank or noisy camera, a jumping estimate, a wrong clock.
    Sensors,
    /// A full disk, no descriptors, a stalled reader, a process of another version.
    Machine,
    /// All of these, but for crash loops.
    Mixed,
}

impl FaultPlan {
    /// Name, as on the command line.
    pub(crate) fn name(self) -> String {
        self.to_possible_value().map_or(String::new(), |value| value.get_name().to_owned())
    }
}

/// Processes that may be harmed.
pub(crate) const VICTIMS: [ProcessId; 6] = [
    ProcessId::StereoIngest,
    ProcessId::Expansion,
    ProcessId::Memory,
    ProcessId::Planner,
    ProcessId::Controller,
    ProcessId::Recorder,
];
/// Those without which nothing flies.
const FLYING: usize = 5;
/// Topics whose messages may be harmed.
const TOPICS: [&str; 10] = [
    "flight_clock",
    "vehicle_state",
    "stereo_frame",
    "disparity_image",
    "expanded_image",
    "keyframe_set",
    "flown_path",
    "goal",
    "trajectory",
    "setpoint",
];
/// No fault before the vehicle is in the air, s.
const FIRST_S: f64 = 4.0;

/// The faults of a flight, drawn by a seed: one every `every_s` or so, until `until_s`.
pub(crate) fn draw(plan: FaultPlan, seed: u64, every_s: f64, until_s: f64) -> Vec<Fault> {
    let mut random = Pcg64Mcg::seed_from_u64(seed ^ (plan as u64) << 48);
    let once = matches!(plan, FaultPlan::CrashLoops | FaultPlan::Supervisor);
    let mut at_s = FIRST_S + if once { random.random_range(0.0..10.0) } else { 0.0 };
    let mut faults = Vec::new();
    while at_s < until_s {
        faults.push(Fault { at_s, fault: one(plan, &mut random) });
        if once {
            break;
        }
        at_s += every_s * random.random_range(0.5..1.5);
    }
    faults
}

fn one(plan: FaultPlan, random: &mut Pcg64Mcg) -> FaultKind {
    // The lists are constants, and not empty.
    let process = *VICTIMS.choose(random).unwrap_or(&ProcessId::Planner);
    let flying = *VICTIMS[..FLYING].choose(random).unwrap_or(&ProcessId::Planner);
    let topic = (*TOPICS.choose(random).unwrap_or(&"trajectory")).to_owned();
    let for_s = random.random_range(0.5..2.0);
    match plan {
        FaultPlan::Kills => FaultKind::Kill { process },
        FaultPlan::Stops => FaultKind::Stop { process },
        FaultPlan::Hangs => FaultKind::Hang { process: flying },
        FaultPlan::Silences => FaultKind::Silence { process: flying },
        FaultPlan::CrashLoops => FaultKind::CrashLoop { process: flying, for_s: 600.0 },
        FaultPlan::Supervisor => FaultKind::Kill { process: ProcessId::Supervisor },
        FaultPlan::Slowness => FaultKind::Slow { process: flying, for_s, by_ms: random.random_range(10.0..150.0) },
        FaultPlan::Messages => message(topic, for_s, random),
        FaultPlan::Sensors => match random.random_range(0..5) {
            0 => FaultKind::FreezeCamera { for_s },
            1 => FaultKind::BlankCamera { for_s },
            2 => FaultKind::Noise { for_s, grey: random.random_range(5.0..60.0) },
            3 => FaultKind::Jump { by_m: random.random_range(-1.0..1.0) },
            _ => FaultKind::StepClock { by_s: random.random_range(-1.0..1.0) },
        },
        FaultPlan::Machine => match random.random_range(0..4) {
            0 => FaultKind::FillDisk { for_s },
            1 => FaultKind::Descriptors { process: flying, for_s },
            2 => FaultKind::StallReader { topic, for_s },
            _ => FaultKind::OtherVersion,
        },
        FaultPlan::Mixed => {
            let plans = [
                FaultPlan::Kills,
                FaultPlan::Kills,
                FaultPlan::Stops,
                FaultPlan::Hangs,
                FaultPlan::Silences,
                FaultPlan::Slowness,
                FaultPlan::Messages,
                FaultPlan::Messages,
                FaultPlan::Sensors,
                FaultPlan::Machine,
            ];
            one(*plans.choose(random).unwrap_or(&FaultPlan::Kills), random)
        }
    }
}

fn message(topic: String, for_s: f64, random: &mut Pcg64Mcg) -> FaultKind {
    let share = random.random_range(0.1..0.6);
    match random.random_range(0..4) {
        0 => FaultKind::Lose { topic, for_s, share },
        1 => FaultKind::Delay { topic, for_s, by_ms: random.random_range(5.0..150.0) },
        2 => FaultKind::Duplicate { topic, for_s, share },
        _ => FaultKind::Corrupt { topic, for_s, share: 0.3 * share },
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ipc_types::bounds::Bounds;

    #[test]
    fn plans_are_possible_repeat_by_seed_and_hit_everyone() {
        for plan in FaultPlan::value_variants() {
            let faults = draw(*plan, 7, 1.0, 300.0);
            assert_eq!(faults, draw(*plan, 7, 1.0, 300.0));
            assert_ne!(faults, draw(*plan, 8, 1.0, 300.0));
            let mut bounds = Bounds::default();
            crate::fault_file::check(&faults, &mut bounds);
            assert_eq!(bounds.into_violations(), Vec::<String>::new(), "{plan:?}");
        }
        let kills = draw(FaultPlan::Kills, 7, 1.0, 300.0);
        assert!(VICTIMS.iter().all(|victim| kills.iter().any(|fault| fault.fault.process() == Some(*victim))));
        assert!((200..400).contains(&kills.len()));
    }
}
