//! Spawning, reaping, restarting and stopping children.

use crate::policy::{Decision, Policy, RestartRule};
use ipc_types::messages::Health;
use ipc_types::{HostTime, ProcessId};
use runtime::host_now;
use runtime::ipc::Services;
use rustix::process::{Pid, Signal, kill_process};
use std::os::unix::process::{CommandExt, ExitStatusExt};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::time::Duration;

/// Time between SIGTERM and SIGKILL.
const GRACE: Duration = Duration::from_secs(3);
/// The supervisor judges no silence that it may itself have slept through.
const LONGEST_ABSENCE: Duration = Duration::from_millis(500);
/// Silence after which the world counts as dead, s.
const WORLD_DEADLINE_S: f64 = 5.0;
/// Grace before a first heartbeat is missed: starting up takes longer than beating.
const START_UP: Duration = Duration::from_secs(10);

/// What to run for a process.
#[derive(Clone, Debug)]
pub struct ChildCommand {
    /// Which process.
    pub process: ProcessId,
    /// Program and arguments; `--incarnation N` is appended.
    pub arguments: Vec<String>,
    /// How to restart it; `None` when its death ends the run.
    pub restart: Option<RestartRule>,
    /// Whether the run ends when it is given up. A flight goes on without its recorder.
    pub is_essential: bool,
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

/// Why the graph could not be started.
#[derive(Debug, thiserror::Error)]
pub enum SupervisionError {
    /// A process could not be spawned.
    #[error("cannot start {process}: {source}")]
    Spawn {
        /// Which.
        process: ProcessId,
        /// Why.
        source: std::io::Error,
    },
    /// The signals could not be watched.
    #[error("cannot watch signals: {0}")]
    Signals(std::io::Error),
}

/// State of a child.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ChildState {
    /// Running.
    Running,
    /// Dead, to be restarted.
    BackingOff,
    /// Dead for good.
    GivenUp,
    /// Ended when told to.
    Stopped,
}

/// A child as others may see it.
#[derive(Clone, Copy, Debug)]
pub struct ChildStatus {
    /// Which process.
    pub process: ProcessId,
    /// Its number, while it runs.
    pub pid: Option<u32>,
    /// State.
    pub state: ChildState,
    /// How often it was restarted.
    pub restarts: u32,
    /// Longest time from a death to the first heartbeat of the successor, s.
    pub longest_recovery_s: Option<f64>,
    /// Its last heartbeat.
    pub health: Option<Health>,
}

/// What the supervisor learned.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Happening {
    /// A child died; it is being restarted or was given up.
    Died(ProcessId, String),
    /// A child died too often and is done without.
    GivenUp(ProcessId, String),
    /// A process whose death ends the run has died, or one was given up.
    RunEnded(ProcessId, String),
    /// SIGINT, SIGTERM or SIGHUP.
    Signal(i32),
    /// Nothing, for a while.
    Nothing,
}

enum Event {
    Exited { process: ProcessId, incarnation: u32, at: HostTime, status: std::io::Result<ExitStatus> },
    Signal(i32),
}

struct Supervised {
    command: ChildCommand,
    policy: Option<Policy>,
    status: ChildStatus,
    incarnation: u32,
    restart_at: Option<HostTime>,
    died_at: Option<HostTime>,
    last_beat: HostTime,
    beaten: bool,
}

/// The running graph.
pub struct Supervision {
    children: Vec<Supervised>,
    sender: Sender<Event>,
    events: Receiver<Event>,
    stopping: bool,
    /// When silence was last looked for.
    attended: HostTime,
}

impl std::fmt::Debug for Supervision {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Supervision of {} processes", self.children.len())
    }
}

impl Supervision {
    /// Spawns the graph. The run's services must exist.
    ///
    /// # Errors
    /// A process cannot be spawned; those that were are stopped again.
    pub fn start(commands: Vec<ChildCommand>, signals: SignalWatch) -> Result<Self, SupervisionError> {
        let (sender, events) = channel();
        let SignalWatch(mut signals) = signals;
        let to_supervisor = sender.clone();
        std::thread::spawn(move || {
            for signal in signals.forever() {
                if to_supervisor.send(Event::Signal(signal)).is_err() {
                    return; // The run is over.
                }
            }
        });
        let attended = host_now();
        let mut supervision = Self { children: Vec::new(), sender, events, stopping: false, attended };
        for command in commands {
            supervision.children.push(Supervised::new(command));
            let last = supervision.children.len() - 1;
            if let Err(source) = supervision.spawn(last) {
                let process = supervision.children[last].command.process;
                supervision.stop();
                return Err(SupervisionError::Spawn { process, source });
            }
        }
        Ok(supervision)
    }

    /// The children.
    pub fn status(&self) -> Vec<ChildStatus> {
        self.children.iter().map(|child| child.status).collect()
    }

    /// Notes a heartbeat. Those of former incarnations, still in the buffers, do not count.
    pub fn heard(&mut self, health: &Health) {
        let process = ProcessId::from_wire(health.stamp.producer);
        let child = self.children.iter_mut().find(|child| Some(child.command.process) == process);
        let Some(child) = child.filter(|child| child.incarnation == health.stamp.incarnation) else {
            return;
        };
        child.last_beat = host_now();
        child.status.health = Some(*health);
        if !std::mem::replace(&mut child.beaten, true)
            && let Some(died_at) = child.died_at.take()
        {
            let recovery_s = child.last_beat.seconds_since(died_at);
            let longest = child.status.longest_recovery_s.get_or_insert(recovery_s);
            *longest = longest.max(recovery_s);
        }
    }

    /// Waits at most `patience` for something to happen, and does what it calls for.
    pub fn attend(&mut self, services: &Services, patience: Duration) -> Happening {
        let until_restart = self.children.iter().filter_map(|child| child.restart_at).min();
        let patience = until_restart.map_or(patience, |at| at.saturating_since(host_now()).min(patience));
        let happening = match self.events.recv_timeout(patience) {
            Ok(Event::Exited { process, incarnation, at, status }) => {
                self.exited(services, (process, incarnation), at, &status)
            }
            Ok(Event::Signal(signal)) => Happening::Signal(signal),
            Err(RecvTimeoutError::Timeout | RecvTimeoutError::Disconnected) => Happening::Nothing,
        };
        if !self.stopping {
            self.restart_due();
        }
        happening
    }

    fn exited(
        &mut self,
        services: &Services,
        (process, incarnation): (ProcessId, u32),
        at: HostTime,
        status: &std::io::Result<ExitStatus>,
    ) -> Happening {
        let how = describe(status);
        // Between reaping and restarting, so that the successor finds its places free.
        services.clean_dead_nodes();
        let Some(child) = self.children.iter_mut().find(|child| child.command.process == process) else {
            return Happening::Nothing;
        };
        if child.incarnation != incarnation {
            return Happening::Nothing;
        }
        child.status.pid = None;
        child.died_at = Some(at);
        if self.stopping {
            child.status.state = ChildState::Stopped;
            return Happening::Nothing;
        }
        match child.policy.as_mut().map(|policy| policy.died(host_now())) {
            Some(Decision::RestartAt(at)) => {
                child.restart_at = Some(at);
                child.status.state = ChildState::BackingOff;
                Happening::Died(process, how)
            }
            Some(Decision::GiveUp) => {
                child.status.state = ChildState::GivenUp;
                let how = format!("{how}, too often");
                let is_essential = child.command.is_essential;
                if is_essential { Happening::RunEnded(process, how) } else { Happening::GivenUp(process, how) }
            }
            None => {
                child.status.state = ChildState::GivenUp;
                Happening::RunEnded(process, how)
            }
        }
    }

    fn restart_due(&mut self) {
        let now = host_now();
        for index in 0..self.children.len() {
            if self.children[index].restart_at.is_some_and(|at| at <= now) {
                let child = &mut self.children[index];
                child.restart_at = None;
                child.incarnation += 1;
                child.status.restarts += 1;
                if self.spawn(index).is_err() {
                    // Out of processes or memory: try again after the longest wait.
                    let child = &mut self.children[index];
                    let wait = child.command.restart.map_or(1000, |rule| rule.longest_ms);
                    child.restart_at = Some(now + Duration::from_millis(wait));
                }
            }
        }
    }

    /// Kills children that have stopped beating: alive, but hung or stopped. To be called after every heartbeat that
    /// has arrived was [`heard`](Self::heard). When the supervisor itself was away, the children get their time anew.
    pub fn kill_silent(&mut self) {
        let now = host_now();
        let was_away = now.saturating_since(self.attended) > LONGEST_ABSENCE;
        self.attended = now;
        for child in self.children.iter_mut().filter(|child| child.status.state == ChildState::Running) {
            if was_away {
                child.last_beat = now;
            }
            let rule_s = child.command.restart.map_or(WORLD_DEADLINE_S, |rule| rule.heartbeat_deadline_s);
            let deadline = if child.beaten { Duration::from_secs_f64(rule_s) } else { START_UP };
            if now.saturating_since(child.last_beat) > deadline {
                // Its exit arrives as an event, like any other death.
                signal(child.status.pid, Signal::KILL);
                child.last_beat = now;
            }
        }
    }

    fn spawn(&mut self, index: usize) -> std::io::Result<()> {
        let child = &mut self.children[index];
        let (program, arguments) = child.command.arguments.split_first().ok_or(std::io::ErrorKind::InvalidInput)?;
        let incarnation = child.incarnation;
        let spawned = Command::new(program)
            .args(arguments)
            .arg("--incarnation")
            .arg(incarnation.to_string())
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            // A group of its own: Ctrl-C reaches the supervisor alone, which stops the others in order.
            .process_group(0)
            .spawn()?;
        child.status.pid = Some(spawned.id());
        child.status.state = ChildState::Running;
        child.status.health = None;
        (child.last_beat, child.beaten) = (host_now(), false);
        wait_for(spawned, child.command.process, incarnation, self.sender.clone());
        Ok(())
    }

    /// Stops everything: SIGTERM, SIGKILL to what is left after a grace; the recorder last, so that it has it all.
    /// Returns the status of the children before.
    pub fn stop(&mut self) -> Vec<ChildStatus> {
        self.stopping = true;
        let last_seen = self.status();
        self.stop_those(|process| process != ProcessId::Recorder);
        self.stop_those(|_| true);
        last_seen
    }

    fn stop_those(&mut self, which: impl Fn(ProcessId) -> bool) {
        for child in self.children.iter_mut().filter(|child| which(child.command.process)) {
            child.restart_at = None;
            signal(child.status.pid, Signal::TERM);
            // A stopped process handles no signal until it continues.
            signal(child.status.pid, Signal::CONT);
        }
        let (started, mut killed) = (host_now(), false);
        while self.children.iter().any(|child| which(child.command.process) && child.status.pid.is_some()) {
            if let Ok(Event::Exited { process, incarnation, .. }) = self.events.recv_timeout(Duration::from_millis(50))
            {
                let child = self.children.iter_mut().find(|child| child.command.process == process);
                if let Some(child) = child.filter(|child| child.incarnation == incarnation) {
                    child.status.pid = None;
                    child.status.state = ChildState::Stopped;
                }
            }
            if !killed && host_now().saturating_since(started) > GRACE {
                killed = true;
                let stubborn = self.children.iter().filter(|child| which(child.command.process));
                stubborn.for_each(|child| signal(child.status.pid, Signal::KILL));
            }
        }
    }
}

impl Drop for Supervision {
    fn drop(&mut self) {
        self.stop();
    }
}

impl Supervised {
    fn new(command: ChildCommand) -> Self {
        Self {
            status: ChildStatus {
                process: command.process,
                pid: None,
                state: ChildState::Stopped,
                restarts: 0,
                longest_recovery_s: None,
                health: None,
            },
            policy: command.restart.map(Policy::new),
            command,
            incarnation: 0,
            restart_at: None,
            died_at: None,
            last_beat: host_now(),
            beaten: false,
        }
    }
}

/// A thread that does nothing but wait for one child: prompt, and it blocks nobody.
fn wait_for(mut child: Child, process: ProcessId, incarnation: u32, sender: Sender<Event>) {
    std::thread::spawn(move || {
        let status = child.wait();
        let at = host_now();
        // Nobody listens any more when the run is over.
        let _ = sender.send(Event::Exited { process, incarnation, at, status });
    });
}

fn signal(pid: Option<u32>, signal: Signal) {
    if let Some(pid) = pid.and_then(|pid| Pid::from_raw(pid as i32)) {
        // It may have died in this moment; its exit is on the way then.
        let _ = kill_process(pid, signal);
    }
}

fn describe(status: &std::io::Result<ExitStatus>) -> String {
    match status {
        Ok(status) => match (status.code(), status.signal()) {
            (Some(code), _) => format!("exited with status {code}"),
            (None, Some(signal)) => format!("was killed by signal {signal}"),
            (None, None) => "ended".to_owned(),
        },
        Err(error) => format!("could not be waited for: {error}"),
    }
}
