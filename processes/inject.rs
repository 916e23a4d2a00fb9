//! The part of a flight's faults that is brought about from outside of its processes: signals, intruders, full memory. The
//! rest is brought about by the processes themselves, which are told by the run's configuration.

use crate::say::say;
use ipc_types::{HostTime, ProcessId, StereoRig};
use runtime::faults::{Fault, FaultKind};
use runtime::host_now;
use runtime::ipc::{Ballast, hold_messages};
use runtime::run_dir::RunDir;
use rustix::process::{Pid, Signal, kill_process};
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;
use std::process::{Child, Command, Stdio};
use std::time::Duration;
use supervisor::{ChildStatus, FaultSummary, Mission};

/// Flight time after a fault over which it is looked at whether the world has waited, s.
const CLOCK_S: f64 = 1.0;

/// A fault that came.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Injected {
    summary: FaultSummary,
    /// Host time that the world had lost by then, s.
    lost_s: f64,
}

/// Injects the faults of a flight as their time comes, and keeps account of them.
#[derive(Debug)]
pub(crate) struct Injector {
    run: RunDir,
    rig: StereoRig,
    /// Those to come, in order of time.
    due: VecDeque<Fault>,
    /// Those that came.
    injected: Vec<Injected>,
    /// What tries to join: command and process.
    intruder: Vec<String>,
    intruders: Vec<Child>,
    /// Whether this process is to be killed in the next round.
    is_last_round: bool,
    /// Shared memory that is held full until then.
    ballast: Option<(Ballast, HostTime)>,
}

impl Injector {
    /// For the faults that come after `from_s`; what came before is in `injected`. `intruder` is the command line of a process of the run.
    pub(crate) fn new(
        run: &RunDir,
        rig: &StereoRig,
        faults: &[Fault],
        from_s: f64,
        injected: Vec<Injected>,
        intruder: Vec<String>,
    ) -> Self {
        let mut due: Vec<_> = faults.iter().filter(|fault| fault.at_s > from_s).cloned().collect();
        due.sort_by(|a, b| a.at_s.total_cmp(&b.at_s));
        Self {
            run: run.clone(),
            rig: *rig,
            due: due.into(),
            injected,
            intruder,
            intruders: Vec::new(),
            is_last_round: false,
            ballast: None,
        }
    }

    /// Brings about what is due.
    pub(crate) fn inject(&mut self, mission: &Mission, children: &[ChildStatus]) {
        if self.is_last_round {
            signal(ProcessId::Supervisor, children, Signal::KILL);
        }
        // Without a truth it is not known yet what the world has lost.
        if mission.truth().is_none() {
            return;
        }
        let now_s = mission.now().as_secs_f64();
        let lost_s = lost_s(mission);
        for Injected { summary, lost_s: lost_before_s } in &mut self.injected {
            let passed_s = now_s - summary.at_s;
            if summary.clock_ratio.is_none() && passed_s >= CLOCK_S {
                summary.clock_ratio = Some(passed_s / (passed_s + lost_s - *lost_before_s));
            }
        }
        while let Some(fault) = self.due.pop_front_if(|fault| fault.at_s <= now_s) {
            tracing::warn!(flight_s = now_s, fault = %fault, "injected");
            let summary = FaultSummary {
                at_s: now_s,
                fault: fault.fault.name().to_owned(),
                victim: fault.fault.victim().to_owned(),
                clock_ratio: None,
            };
            // What could not be done was not injected.
            if self.bring_about(&fault, children) {
                self.injected.push(Injected { summary, lost_s });
            }
        }
        if self.ballast.as_ref().is_some_and(|(_, until)| *until <= host_now()) {
            self.ballast = None;
        }
        // Whoever was refused has ended; what has not been is seen by the account of the run.
        self.intruders.retain_mut(|child| !matches!(child.try_wait(), Ok(Some(_))));
    }

    /// Whether it was brought about.
    fn bring_about(&mut self, fault: &Fault, children: &[ChildStatus]) -> bool {
        match &fault.fault {
            // Not before it is on record.
            FaultKind::Kill { process: ProcessId::Supervisor } => {
                self.is_last_round = true;
                true
            }
            FaultKind::Kill { process } => signal(*process, children, Signal::KILL),
            FaultKind::Stop { process } => signal(*process, children, Signal::STOP),
            FaultKind::FillMemory { for_s } => match Ballast::fill() {
                Ok(ballast) => {
                    self.ballast = Some((ballast, host_now() + Duration::from_secs_f64(*for_s)));
                    true
                }
                Err(why) => {
                    say(format_args!("{fault}: {why}"));
                    false
                }
            },
            FaultKind::StallReader { topic, for_s } => {
                let (run, rig, topic) = (self.run.clone(), self.rig, topic.clone());
                let time = Duration::from_secs_f64(*for_s);
                // It ends by itself, and is nobody's to wait for.
                std::thread::spawn(move || {
                    if let Err(why) = hold_messages(&run, &rig, &topic, time) {
                        say(format_args!("cannot stall a reader of {topic}: {why}"));
                    }
                });
                true
            }
            FaultKind::OtherVersion => self.intrude(),
            // The processes and the simulator have it from the run's configuration.
            _ => true,
        }
    }

    /// Has a process of another version try to join.
    fn intrude(&mut self) -> bool {
        let Some((program, arguments)) = self.intruder.split_first() else { return false };
        let mut command = Command::new(program);
        command.args(arguments).args(["--incarnation", "999", "--schema-salt", "1"]);
        match command.stdin(Stdio::null()).stdout(Stdio::null()).spawn() {
            Ok(child) => {
                self.intruders.push(child);
                true
            }
            Err(why) => {
                say(format_args!("cannot start a process of another version: {why}"));
                false
            }
        }
    }

    /// Whether this process is about to be killed.
    pub(crate) fn is_last_round(&self) -> bool {
        self.is_last_round
    }

    /// The account, as a successor needs it.
    pub(crate) fn injected(&self) -> Vec<Injected> {
        self.injected.clone()
    }

    /// The account.
    pub(crate) fn summary(&self) -> Vec<FaultSummary> {
        self.injected.iter().map(|injected| injected.summary.clone()).collect()
    }
}

impl Drop for Injector {
    fn drop(&mut self) {
        for child in &mut self.intruders {
            // It may have ended in this moment.
            let _ = child.kill();
            let _ = child.wait();
        }
    }
}

/// Host time that the world has lost, s: by how much it has slowed flight time down.
fn lost_s(mission: &Mission) -> f64 {
    mission.truth().map_or(0.0, |truth| {
        let flight_s = truth.stamp.valid_ns as f64 * 1e-9;
        flight_s / truth.clock_ratio.max(1e-3) - flight_s
    })
}

/// Whether there was anyone to be signalled.
fn signal(process: ProcessId, children: &[ChildStatus], signal: Signal) -> bool {
    let number = match process {
        ProcessId::Supervisor => Some(std::process::id()),
        _ => children.iter().find(|child| child.process == process).and_then(|child| child.pid),
    };
    // What is just being restarted is not there to be harmed.
    let pid = number.and_then(|number| Pid::from_raw(number.cast_signed()));
    pid.is_some_and(|pid| kill_process(pid, signal).is_ok())
}
