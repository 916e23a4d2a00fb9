//! What to do about what happens to processes: (state, event, now) → actions, and nothing else.
//!
//! Reads no clock, starts no process, waits for nobody: [`Supervision`](crate::Supervision) tells it what has happened and
//! carries out what it asks for, in order, and what follows from one action after the rest. Its promises, to which
//! `tests/policy.rs` holds it under random events:
//!
//! * never two live incarnations of a process: a successor is asked for only after the exit of its predecessor;
//! * a bounded rate of restarts, whatever dies how;
//! * every process ends up running or given up, with the reason;
//! * what is told to end and does not, is killed.
//!
//! A process is **hung** when its heart stops, or when the kernel has stopped it; it is **silent** when it beats but makes
//! nothing of an input that goes on, and refuses nothing. What hangs handles no signal and is killed; what is silent is
//! told to end first.

use crate::rule::{Criticality, Rule, Strategy};
use ipc_types::{HostTime, ProcessId};
use std::time::Duration;

/// Whoever asks less often than this was away, and judges no silence that it may have slept through.
const ABSENCE: Duration = Duration::from_millis(150);
/// A process that waits for the processor, rather than hangs, gets so many times its heartbeat's deadline.
const STARVED: u32 = 6;

/// What has happened.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Event {
    /// A former supervisor's child was found alive.
    Adopted {
        /// Which incarnation.
        incarnation: u32,
        /// Its deaths that still count.
        deaths: Vec<HostTime>,
    },
    /// A former supervisor's child is dead: the next one is a later incarnation.
    Left {
        /// Which it was.
        incarnation: u32,
        /// Its deaths that still count.
        deaths: Vec<HostTime>,
        /// Why it was given up, if it was.
        given_up: Option<String>,
    },
    /// It could not be started.
    NotStarted(String),
    /// A heartbeat.
    Beat(u32),
    /// It published what others wait for.
    Output(u32),
    /// It counted messages that it refused: so it is not silent.
    Refused(u32),
    /// It has ended, and was reaped.
    Exited(u32, String),
    /// The kernel says that it is stopped (SIGSTOP).
    Halted,
    /// The kernel says that it waits for the processor.
    Starved,
}

/// What is to be done.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Action {
    /// Start this incarnation.
    Start(ProcessId, u32),
    /// Ask it to end.
    Terminate(ProcessId),
    /// Kill it, for this reason.
    Kill(ProcessId, String),
    /// Say that it died so, and is to be restarted after a wait.
    Died(ProcessId, String, Duration),
    /// Go on without it.
    GaveUp(ProcessId, String),
    /// End the run.
    EndRun(ProcessId, String),
}

/// State of a process.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Phase {
    /// Never started, or not wanted any more.
    Stopped,
    /// Started, not heard of yet.
    Starting,
    /// Heard of.
    Running,
    /// Told to end, or killed; not reaped yet.
    Ending {
        /// Killed already.
        is_killed: bool,
    },
    /// Dead, to be restarted then.
    BackingOff(HostTime),
    /// Dead for good.
    GivenUp(String),
}

impl Phase {
    /// Whether an incarnation may be alive.
    pub fn is_live(&self) -> bool {
        matches!(self, Self::Starting | Self::Running | Self::Ending { .. })
    }
}

#[derive(Clone, Debug)]
struct Member {
    process: ProcessId,
    rule: Rule,
    phase: Phase,
    incarnation: u32,
    /// When the phase began.
    since: HostTime,
    /// When it was first heard.
    running_since: Option<HostTime>,
    /// For how long it had been doing its work when it was told to end.
    worked: Duration,
    deaths: Vec<HostTime>,
    /// The last heartbeat, or when its absence began to count.
    beat: HostTime,
    /// The last heartbeat, whatever excuses its absence.
    heard: HostTime,
    output: HostTime,
    /// Since when its input has been going on without a longer pause.
    fed_since: Option<HostTime>,
    fed: HostTime,
    /// Why it was told to end, for the account.
    why: Option<String>,
    /// It ends for another's sake: no death of its own, and back no earlier than this.
    anew_at: Option<HostTime>,
}

/// The policy of a run.
#[derive(Clone, Debug)]
pub struct Policy {
    members: Vec<Member>,
    asked: HostTime,
    is_stopping: bool,
}

/// Whose output a process lives on.
fn feeder(process: ProcessId) -> Option<ProcessId> {
    match process {
        ProcessId::StereoIngest => Some(ProcessId::Simulator),
        ProcessId::Expansion => Some(ProcessId::StereoIngest),
        ProcessId::Memory => Some(ProcessId::Expansion),
        ProcessId::Planner => Some(ProcessId::Memory),
        ProcessId::Controller => Some(ProcessId::Planner),
        _ => None,
    }
}

impl Policy {
    /// For processes in order of start.
    pub fn new(members: impl IntoIterator<Item = (ProcessId, Rule)>, now: HostTime) -> Self {
        let member = |(process, rule)| Member {
            process,
            rule,
            phase: Phase::Stopped,
            incarnation: 0,
            since: now,
            running_since: None,
            worked: Duration::ZERO,
            deaths: Vec::new(),
            beat: now,
            heard: now,
            output: now,
            fed_since: None,
            fed: now,
            why: None,
            anew_at: None,
        };
        Self { members: members.into_iter().map(member).collect(), asked: now, is_stopping: false }
    }

    /// State of a process; `None` if it is none of the run's.
    pub fn phase(&self, process: ProcessId) -> Option<&Phase> {
        self.member(process).map(|member| &member.phase)
    }

    /// Its current or last incarnation.
    pub fn incarnation(&self, process: ProcessId) -> Option<u32> {
        self.member(process).map(|member| member.incarnation)
    }

    /// Deaths that still count.
    pub fn deaths(&self, process: ProcessId) -> &[HostTime] {
        self.member(process).map_or(&[], |member| &member.deaths)
    }

    /// Whether nothing lives any more.
    pub fn is_over(&self) -> bool {
        !self.members.iter().any(|member| member.phase.is_live())
    }

    fn member(&self, process: ProcessId) -> Option<&Member> {
        self.members.iter().find(|member| member.process == process)
    }

    /// Starts all that does not live.
    pub fn begin(&mut self, now: HostTime) -> Vec<Action> {
        let mut actions = Vec::new();
        for member in self.members.iter_mut().filter(|member| member.phase == Phase::Stopped) {
            member.start(now, &mut actions);
        }
        actions
    }

    /// Ends the run: the lowest in the order of ending first.
    pub fn stop(&mut self, now: HostTime) -> Vec<Action> {
        self.is_stopping = true;
        for member in self.members.iter_mut().filter(|member| !member.phase.is_live()) {
            if matches!(member.phase, Phase::BackingOff(_)) {
                member.phase = Phase::Stopped;
            }
        }
        let mut actions = Vec::new();
        self.stop_next(now, &mut actions);
        actions
    }

    fn stop_next(&mut self, now: HostTime, actions: &mut Vec<Action>) {
        let next = self.members.iter().filter(|member| member.phase.is_live()).map(|member| member.rule.stops).min();
        let told = |member: &&mut Member| next == Some(member.rule.stops);
        for member in self.members.iter_mut().filter(told) {
            member.end(now, actions);
        }
    }

    /// Something happened to a process.
    pub fn happened(&mut self, now: HostTime, process: ProcessId, event: Event) -> Vec<Action> {
        let mut actions = Vec::new();
        let Some(index) = self.members.iter().position(|member| member.process == process) else { return actions };
        let member = &mut self.members[index];
        let is_current = |incarnation: u32| member.incarnation == incarnation && member.phase.is_live();
        match event {
            Event::Adopted { incarnation, deaths } if !member.phase.is_live() => {
                // Since when it has lived is not on record; what lies further back than a window it has lived down.
                let recent = |death: &HostTime| now.saturating_since(*death) < member.rule.window();
                (member.incarnation, member.deaths) = (incarnation, deaths.into_iter().filter(recent).collect());
                member.running_since = Some(now);
                member.enter(Phase::Running, now);
            }
            Event::Left { incarnation, deaths, given_up } if !member.phase.is_live() => {
                (member.incarnation, member.deaths) = (incarnation + 1, deaths);
                if let Some(why) = given_up {
                    member.enter(Phase::GivenUp(why), now);
                }
            }
            Event::Beat(incarnation) if is_current(incarnation) => {
                (member.beat, member.heard) = (now, now);
                if member.phase == Phase::Starting {
                    member.running_since = Some(now);
                    member.enter(Phase::Running, now);
                }
            }
            Event::Output(incarnation) if is_current(incarnation) => {
                member.output = now;
                self.feed(process, now);
            }
            Event::Refused(incarnation) if is_current(incarnation) => member.output = now,
            Event::Halted if matches!(member.phase, Phase::Starting | Phase::Running) => {
                member.kill(now, "was stopped by a signal".to_owned(), &mut actions);
            }
            Event::Starved if matches!(member.phase, Phase::Running) => {
                let most = Duration::from_secs_f64(member.rule.heartbeat_s) * STARVED;
                if now.saturating_since(member.heard) < most {
                    (member.beat, member.output) = (now, now);
                }
            }
            // It may have been told to end before it could not be started.
            Event::NotStarted(why) if matches!(member.phase, Phase::Starting | Phase::Ending { .. }) => {
                self.exited(index, now, format!("could not be started: {why}"), &mut actions);
            }
            Event::Exited(incarnation, how) if is_current(incarnation) => {
                let how = member.why.take().unwrap_or(how);
                self.exited(index, now, how, &mut actions);
            }
            // Of a former incarnation, or what it was waiting for has come to nothing.
            _ => {}
        }
        actions
    }

    /// What a process made is there for whoever lives on it.
    fn feed(&mut self, process: ProcessId, now: HostTime) {
        for member in self.members.iter_mut().filter(|member| feeder(member.process) == Some(process)) {
            let pause = Duration::from_secs_f64(member.rule.output_s / 2.0);
            let goes_on = member.fed_since.is_some() && now.saturating_since(member.fed) < pause;
            (member.fed, member.fed_since) = (now, if goes_on { member.fed_since } else { Some(now) });
        }
    }

    /// Time passes: deadlines are looked at. To be called often, after all that has arrived was reported.
    pub fn tick(&mut self, now: HostTime) -> Vec<Action> {
        let mut actions = Vec::new();
        let was_away = now.saturating_since(std::mem::replace(&mut self.asked, now)) > ABSENCE;
        for member in &mut self.members {
            if was_away {
                (member.beat, member.heard, member.output, member.fed_since) = (now, now, now, None);
                member.since = if member.phase == Phase::Starting { now } else { member.since };
            }
            member.look(now, &mut actions);
        }
        actions
    }

    fn exited(&mut self, index: usize, now: HostTime, how: String, actions: &mut Vec<Action>) {
        let member = &mut self.members[index];
        let (process, rule) = (member.process, member.rule);
        if self.is_stopping {
            member.enter(Phase::Stopped, now);
            return self.stop_next(now, actions);
        }
        if rule.criticality == Criticality::World {
            member.enter(Phase::GivenUp(how.clone()), now);
            return actions.push(Action::EndRun(process, how));
        }
        if let Some(at) = member.anew_at.take() {
            return member.enter(Phase::BackingOff(at.max(now)), now);
        }
        // Whoever has done its work for a whole window is well again, and begins to count anew.
        if member.phase == Phase::Running {
            member.worked = member.working_until(now);
        }
        if member.worked >= rule.window() {
            member.deaths.clear();
        }
        member.deaths.push(now);
        let deaths = member.deaths.len() as u32;
        if deaths > rule.most {
            let reason = format!("{how}; it died {deaths} times without working for {} s in between", rule.window_s);
            member.enter(Phase::GivenUp(reason.clone()), now);
            return actions.push(Action::GaveUp(process, reason));
        }
        let recent = member.deaths.iter().filter(|&&death| now.saturating_since(death) < rule.window()).count() as u32;
        let wait = rule.wait(recent);
        member.enter(Phase::BackingOff(now + wait), now);
        actions.push(Action::Died(process, how, wait));
        if rule.strategy == Strategy::RestForOne {
            for later in &mut self.members[index + 1..] {
                if later.rule.criticality != Criticality::World
                    && matches!(later.phase, Phase::Starting | Phase::Running)
                {
                    later.anew_at = Some(now + wait);
                    later.end(now, actions);
                }
            }
        }
    }
}

impl Member {
    fn enter(&mut self, phase: Phase, now: HostTime) {
        self.phase = phase;
        (self.since, self.beat, self.heard, self.output, self.fed_since) = (now, now, now, now, None);
    }

    fn start(&mut self, now: HostTime, actions: &mut Vec<Action>) {
        (self.why, self.anew_at) = (None, None);
        self.enter(Phase::Starting, now);
        (self.running_since, self.worked) = (None, Duration::ZERO);
        actions.push(Action::Start(self.process, self.incarnation));
    }

    /// For how long it has been doing its work until then.
    fn working_until(&self, until: HostTime) -> Duration {
        self.running_since.map_or(Duration::ZERO, |since| until.saturating_since(since))
    }

    /// Told to end, if it lives and was not told yet.
    fn end(&mut self, now: HostTime, actions: &mut Vec<Action>) {
        if matches!(self.phase, Phase::Starting | Phase::Running) {
            // To its last output, if it has fallen silent.
            self.worked = self.working_until(self.output);
            self.enter(Phase::Ending { is_killed: false }, now);
            actions.push(Action::Terminate(self.process));
        }
    }

    fn kill(&mut self, now: HostTime, why: String, actions: &mut Vec<Action>) {
        self.why.get_or_insert_with(|| why.clone());
        if self.phase == Phase::Running {
            self.worked = self.working_until(self.heard);
        }
        self.enter(Phase::Ending { is_killed: true }, now);
        actions.push(Action::Kill(self.process, why));
    }

    /// Looks at its deadlines.
    fn look(&mut self, now: HostTime, actions: &mut Vec<Action>) {
        let (rule, seconds) = (self.rule, Duration::from_secs_f64);
        match self.phase {
            Phase::Starting if now.saturating_since(self.since) > seconds(rule.start_up_s) => {
                self.kill(now, format!("was not up within {} s", rule.start_up_s), actions);
            }
            Phase::Running if now.saturating_since(self.beat) > seconds(rule.heartbeat_s) => {
                self.kill(now, format!("has not beaten for {} s", rule.heartbeat_s), actions);
            }
            Phase::Running if self.is_silent(now) => {
                self.why = Some(format!("made nothing of its input for {} s", rule.output_s));
                self.end(now, actions);
            }
            Phase::Ending { is_killed: false } if now.saturating_since(self.since) > seconds(rule.grace_s) => {
                self.kill(now, format!("did not end within {} s", rule.grace_s), actions);
            }
            Phase::BackingOff(until) if until <= now => {
                self.incarnation += 1;
                self.start(now, actions);
            }
            _ => {}
        }
    }

    fn is_silent(&self, now: HostTime) -> bool {
        let limit = Duration::from_secs_f64(self.rule.output_s);
        let is_fed = self.fed_since.is_some_and(|since| now.saturating_since(since) > limit)
            && now.saturating_since(self.fed) < limit / 2;
        is_fed && now.saturating_since(self.output) > limit
    }
}
