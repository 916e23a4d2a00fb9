//! The graph's processes: carries out what the [`Policy`] asks for, and tells it what has happened.

use crate::child::{Look, Running, Usage, reap_group, wait_any};
use crate::policy::{Action, Event, Phase, Policy};
use crate::rule::{Criticality, Rule};
use ipc_types::messages::Health;
use ipc_types::wire::Stamp;
use ipc_types::{HostTime, ProcessId};
use runtime::host_now;
use runtime::ipc::Services;
use runtime::run_dir::RunDir;
use rustix::process::Signal;
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;
use std::time::Duration;

/// A process that has been silent for so long is looked at.
const LOOK_AFTER: Duration = Duration::from_millis(120);
/// Between two looks.
const LOOK_EVERY: Duration = Duration::from_millis(50);
/// What has not ended so long after it was killed never will.
const UNKILLABLE: Duration = Duration::from_secs(10);
/// A killed stray ends within this time.
const STRAY_ENDS: Duration = Duration::from_millis(100);
/// Between two samples of what a process uses.
const SAMPLE_EVERY: Duration = Duration::from_secs(1);

/// What to run for a process.
#[derive(Clone, Debug)]
pub struct ChildCommand {
    /// Which process.
    pub process: ProcessId,
    /// Program and arguments; `--incarnation N` is appended.
    pub arguments: Vec<String>,
    /// What it is worth, and how it is brought back.
    pub rule: Rule,
}

/// The signals that end a run, watched from before anything was made that would have to be cleaned up.
#[derive(Debug)]
pub struct SignalWatch(signal_hook::iterator::Signals);

impl SignalWatch {
    /// Starts watching SIGINT, SIGTERM and SIGHUP.
    ///
    /// # Errors
    /// The operating system refuses.
    pub fn begin() -> Result<Self, SupervisionError> {
        use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
        signal_hook::iterator::Signals::new([SIGINT, SIGTERM, SIGHUP]).map(Self).map_err(SupervisionError::Signals)
    }
}

/// Why supervision cannot begin.
#[derive(Debug, thiserror::Error)]
pub enum SupervisionError {
    /// The signals could not be watched.
    #[error("cannot watch signals: {0}")]
    Signals(std::io::Error),
}

/// A child as its supervisor leaves it on record, for a successor: whether it lives says its claim on the run.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Orphan {
    /// Which process.
    pub process: ProcessId,
    /// Which incarnation.
    pub incarnation: u32,
    /// Why it was given up, if it was.
    pub given_up: Option<String>,
    /// Its deaths that still count, host time, ns.
    pub deaths_ns: Vec<i64>,
}

/// A child as others may see it.
#[derive(Clone, Debug)]
pub struct ChildStatus {
    /// Which process.
    pub process: ProcessId,
    /// Its number, while it runs.
    pub pid: Option<u32>,
    /// What its loss means.
    pub criticality: Criticality,
    /// State.
    pub phase: Phase,
    /// Which incarnation, from 0.
    pub incarnation: u32,
    /// How often it was restarted under this supervisor.
    pub restarts: u32,
    /// When its last heartbeat arrived.
    pub beat_at: Option<HostTime>,
    /// Its last heartbeat.
    pub health: Option<Health>,
    /// What it uses of the machine.
    pub usage: Option<Usage>,
}

/// What the supervisor learned.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Happening {
    /// A child was started.
    Started(ProcessId, u32),
    /// A child died; it is being restarted after this wait.
    Died(ProcessId, String, Duration),
    /// A child has made its first output of a later instant than all before its predecessor's death, or for want of outputs its
    /// first heartbeat: so long after it.
    Recovered(ProcessId, Duration),
    /// A child does not do its work and is killed.
    Ended(ProcessId, String),
    /// A child is done without, for this reason.
    GaveUp(ProcessId, String),
    /// The world has died.
    RunEnded(ProcessId, String),
    /// SIGINT, SIGTERM or SIGHUP.
    Signal(i32),
}

struct Supervised {
    command: ChildCommand,
    running: Option<Running>,
    restarts: u32,
    died_at: Option<HostTime>,
    /// Validity of its newest output, whichever incarnation made it, ns.
    newest_ns: i64,
    beat_at: Option<HostTime>,
    started_at: Option<HostTime>,
    looked: HostTime,
    health: Option<Health>,
    sampled: HostTime,
    usage: Option<Usage>,
}

/// The running graph.
pub struct Supervision {
    run: RunDir,
    policy: Policy,
    children: Vec<Supervised>,
    signals: SignalWatch,
    /// Groups of dead children, whose children may be left.
    groups: Vec<u32>,
    happenings: Vec<Happening>,
}

impl std::fmt::Debug for Supervision {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Supervision of {} processes", self.children.len())
    }
}

impl Supervision {
    /// Starts the graph, but for those that a former supervisor left and that still live. The run's services must exist.
    pub fn start(run: &RunDir, commands: Vec<ChildCommand>, signals: SignalWatch, orphans: &[Orphan]) -> Self {
        // What children fork and leave is reaped here; where that is not permitted, by whoever is.
        let _ = rustix::process::set_child_subreaper(Some(rustix::process::getpid()));
        let now = host_now();
        let policy = Policy::new(commands.iter().map(|command| (command.process, command.rule)), now);
        let children = commands.into_iter().map(Supervised::new).collect();
        let mut supervision =
            Self { run: run.clone(), policy, children, signals, groups: Vec::new(), happenings: Vec::new() };
        orphans.iter().for_each(|orphan| supervision.adopt(orphan, now));
        let actions = supervision.policy.begin(now);
        supervision.carry_out(actions);
        supervision
    }

    fn adopt(&mut self, orphan: &Orphan, now: HostTime) {
        let run = &self.run;
        let child = self.children.iter_mut().find(|child| child.command.process == orphan.process);
        let Some(child) = child else { return };
        let deaths = orphan.deaths_ns.iter().map(|&ns| HostTime::from_nanos(ns)).collect();
        // The record may be older than the last restart; who holds the process' claim lives.
        let living = run.living(orphan.process);
        // Asked again once it is watched: until then its number could have passed to another.
        let adopted = living.and_then(|(number, _)| Running::adopt(number));
        child.running = adopted.filter(|_| run.living(orphan.process) == living);
        let event = match (living, &child.running) {
            (Some((_, incarnation)), Some(_)) => Event::Adopted { incarnation, deaths },
            _ => {
                let last = run.last_claim(orphan.process).map_or(0, |(_, incarnation)| incarnation);
                let (incarnation, given_up) = (orphan.incarnation.max(last), orphan.given_up.clone());
                Event::Left { incarnation, deaths, given_up }
            }
        };
        self.tell(now, orphan.process, event);
    }

    /// What a successor of this supervisor needs to adopt the children.
    pub fn orphans(&self) -> Vec<Orphan> {
        let orphan = |child: &Supervised| {
            let process = child.command.process;
            Some(Orphan {
                process,
                given_up: match self.policy.phase(process) {
                    Some(Phase::GivenUp(why)) => Some(why.clone()),
                    _ => None,
                },
                incarnation: self.policy.incarnation(process)?,
                deaths_ns: self.policy.deaths(process).iter().map(|death| death.as_nanos()).collect(),
            })
        };
        self.children.iter().filter_map(orphan).collect()
    }

    /// The children.
    pub fn status(&self) -> Vec<ChildStatus> {
        let status = |child: &Supervised| ChildStatus {
            process: child.command.process,
            pid: child.running.as_ref().map(Running::number),
            criticality: child.command.rule.criticality,
            phase: self.policy.phase(child.command.process).cloned().unwrap_or(Phase::Stopped),
            incarnation: self.policy.incarnation(child.command.process).unwrap_or_default(),
            restarts: child.restarts,
            beat_at: child.beat_at,
            health: child.health,
            usage: child.usage,
        };
        self.children.iter().map(status).collect()
    }

    /// Notes a heartbeat. Those of former incarnations, still in the buffers, do not count.
    pub fn heard(&mut self, health: &Health) {
        let Some(process) = ProcessId::from_wire(health.stamp.producer) else { return };
        let (now, incarnation) = (host_now(), health.stamp.incarnation);
        if self.policy.incarnation(process) != Some(incarnation) {
            return;
        }
        if let Some(child) = self.children.iter_mut().find(|child| child.command.process == process) {
            let has_refused = child.health.is_some_and(|before| health.dropped > before.dropped);
            (child.beat_at, child.health) = (Some(now), Some(*health));
            if process == ProcessId::Recorder {
                self.happenings.extend(child.recovered(now));
            }
            if has_refused {
                self.tell(now, process, Event::Refused(incarnation));
            }
        }
        self.tell(now, process, Event::Beat(incarnation));
    }

    /// Notes that a process published what others wait for.
    pub fn saw_output(&mut self, stamp: &Stamp) {
        let Some(process) = ProcessId::from_wire(stamp.producer) else { return };
        let now = host_now();
        if self.policy.incarnation(process) == Some(stamp.incarnation)
            && let Some(child) = self.children.iter_mut().find(|child| child.command.process == process)
        {
            // What a predecessor had made already, published again, is no recovery.
            if stamp.valid_ns > child.newest_ns {
                child.newest_ns = stamp.valid_ns;
                self.happenings.extend(child.recovered(now));
            }
        }
        self.tell(now, process, Event::Output(stamp.incarnation));
    }

    /// Waits at most `patience` for a child to end, and does what is due; what has happened since the last call.
    /// Deadlines are judged by what was heard before, so that is to be reported first.
    pub fn attend(&mut self, services: &Services, patience: Duration) -> Vec<Happening> {
        wait_any(self.children.iter().filter_map(|child| child.running.as_ref()), patience);
        self.reap(services);
        self.look();
        let actions = self.policy.tick(host_now());
        self.carry_out(actions);
        let signals: Vec<_> = self.signals.0.pending().map(Happening::Signal).collect();
        self.happenings.extend(signals);
        std::mem::take(&mut self.happenings)
    }

    fn reap(&mut self, services: &Services) {
        let mut ended = Vec::new();
        for child in &mut self.children {
            let how = child.running.as_mut().and_then(Running::reap);
            if let Some((how, running)) = how.and_then(|how| Some((how, child.running.take()?))) {
                self.groups.push(running.number());
                // Who dies again before it has made anything has been away since the first time.
                child.died_at.get_or_insert(host_now());
                child.beat_at = None;
                ended.push((child.command.process, how));
            }
        }
        self.groups.retain(|&group| reap_group(group));
        if !ended.is_empty() {
            // Between reaping and restarting, so that the successor finds its places free.
            services.clean_dead_nodes();
        }
        for (process, how) in ended {
            let incarnation = self.policy.incarnation(process).unwrap_or_default();
            self.tell(host_now(), process, Event::Exited(incarnation, how));
        }
    }

    /// Asks the kernel about those that do not beat, and now and then what all of them use.
    fn look(&mut self) {
        let (now, mut seen) = (host_now(), Vec::new());
        for child in &mut self.children {
            let elapsed = now.saturating_since(child.sampled);
            if let Some(running) = child.running.as_mut().filter(|_| elapsed > SAMPLE_EVERY) {
                (child.sampled, child.usage) = (now, running.usage(elapsed));
            }
            let process = child.command.process;
            let is_quiet = now.saturating_since(child.beat_at.max(child.started_at).unwrap_or(now)) > LOOK_AFTER;
            let elapsed = now.saturating_since(child.looked);
            if let Some(running) = child.running.as_mut().filter(|_| is_quiet && elapsed > LOOK_EVERY) {
                child.looked = now;
                if self.run.is_dying(process) {
                    // It needs a moment to write down why.
                    seen.push((process, Event::Starved));
                    continue;
                }
                match running.look(elapsed) {
                    Look::Halted => seen.push((process, Event::Halted)),
                    // What it did before it fell quiet says nothing: the first look only begins to count.
                    Look::Starved if elapsed < LOOK_AFTER => seen.push((process, Event::Starved)),
                    Look::Starved | Look::Awake => {}
                }
            }
        }
        seen.into_iter().for_each(|(process, event)| self.tell(now, process, event));
    }

    fn tell(&mut self, now: HostTime, process: ProcessId, event: Event) {
        let actions = self.policy.happened(now, process, event);
        self.carry_out(actions);
    }

    fn carry_out(&mut self, actions: Vec<Action>) {
        let mut actions = VecDeque::from(actions);
        while let Some(action) = actions.pop_front() {
            match action {
                Action::Start(process, incarnation) => {
                    if let Err(why) = self.start_child(process, incarnation) {
                        actions.extend(self.policy.happened(host_now(), process, Event::NotStarted(why.to_string())));
                    }
                }
                Action::Terminate(process) => self.signal(process, Signal::TERM),
                Action::Kill(process, why) => {
                    self.signal(process, Signal::KILL);
                    self.happenings.push(Happening::Ended(process, why));
                }
                Action::Died(process, how, wait) => self.happenings.push(Happening::Died(process, how, wait)),
                Action::GaveUp(process, why) => self.happenings.push(Happening::GaveUp(process, why)),
                Action::EndRun(process, how) => self.happenings.push(Happening::RunEnded(process, how)),
            }
        }
    }

    fn start_child(&mut self, process: ProcessId, incarnation: u32) -> std::io::Result<()> {
        let Some(child) = self.children.iter_mut().find(|child| child.command.process == process) else {
            return Ok(());
        };
        // One that nobody knew of, for its supervisor died as it was started. Two must not fly.
        if let Some(stray) = self.run.living(process).and_then(|(number, _)| Running::adopt(number)) {
            stray.signal(Signal::KILL);
            wait_any([&stray], STRAY_ENDS);
        }
        let mut arguments = child.command.arguments.clone();
        arguments.extend(["--incarnation".to_owned(), incarnation.to_string()]);
        child.restarts += u32::from(incarnation > 0);
        (child.health, child.beat_at, child.usage) = (None, None, None);
        child.started_at = Some(host_now());
        // Out of processes, memory or descriptors: a death like any other, to be tried again after a wait.
        child.running = Some(Running::start(&arguments).inspect_err(|_| {
            let _ = child.died_at.get_or_insert(host_now());
        })?);
        self.happenings.push(Happening::Started(process, incarnation));
        Ok(())
    }

    fn signal(&self, process: ProcessId, signal: Signal) {
        let child = self.children.iter().find(|child| child.command.process == process);
        if let Some(running) = child.and_then(|child| child.running.as_ref()) {
            running.signal(signal);
            if signal == Signal::TERM {
                // A stopped process handles no signal until it continues.
                running.signal(Signal::CONT);
            }
        }
    }

    /// Ends everything in the order of the rules. A second signal meanwhile kills what is left at once.
    /// Returns the status of the children before.
    pub fn stop(&mut self, services: &Services) -> Vec<ChildStatus> {
        let last_seen = self.status();
        let began = host_now();
        let actions = self.policy.stop(began);
        self.carry_out(actions);
        // What was killed and still does not end hangs in the kernel; nobody waits for that.
        let longest = self.children.iter().map(|child| Duration::from_secs_f64(child.command.rule.grace_s));
        let longest = longest.sum::<Duration>() + UNKILLABLE;
        while !self.policy.is_over() && host_now().saturating_since(began) < longest {
            let happened = self.attend(services, Duration::from_millis(20));
            if happened.iter().any(|happening| matches!(happening, Happening::Signal(_))) {
                let running = self.children.iter().filter_map(|child| child.running.as_ref());
                running.for_each(|running| running.signal(Signal::KILL));
            }
        }
        last_seen
    }
}

impl Drop for Supervision {
    fn drop(&mut self) {
        // Nobody lives on after whoever was to watch it, whatever it was that ended the watch.
        for running in self.children.iter_mut().filter_map(|child| child.running.as_mut()) {
            running.signal(Signal::KILL);
            wait_any([&*running], Duration::from_secs(1));
            let _ = running.reap();
        }
    }
}

impl Supervised {
    fn new(command: ChildCommand) -> Self {
        Self {
            command,
            running: None,
            restarts: 0,
            died_at: None,
            newest_ns: i64::MIN,
            beat_at: None,
            started_at: None,
            looked: HostTime::ZERO,
            health: None,
            sampled: HostTime::ZERO,
            usage: None,
        }
    }

    /// That it has made something new, if its predecessor had died.
    fn recovered(&mut self, now: HostTime) -> Option<Happening> {
        let died_at = self.died_at.take()?;
        Some(Happening::Recovered(self.command.process, now.saturating_since(died_at)))
    }
}
