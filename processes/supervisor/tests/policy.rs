//! The policy against random histories: whatever dies, hangs, ignores signals or cannot be started, in any order.

use ipc_types::{HostTime, ProcessId};
use proptest::prelude::*;
use std::collections::{HashMap, VecDeque};
use std::time::Duration;
use supervisor::{Action, Criticality, Event, Phase, Policy, Rule, Strategy as Restart};

const TICK: Duration = Duration::from_millis(10);
const MEMBERS: [ProcessId; 4] = [ProcessId::Recorder, ProcessId::Memory, ProcessId::Planner, ProcessId::Simulator];

fn rule(process: ProcessId) -> Rule {
    let (criticality, stops) = match process {
        ProcessId::Recorder => (Criticality::Spare, 1),
        ProcessId::Simulator => (Criticality::World, 0),
        _ => (Criticality::Flight, 0),
    };
    let strategy = if process == ProcessId::Memory { Restart::RestForOne } else { Restart::OneForOne };
    Rule {
        criticality,
        strategy,
        first_ms: 5,
        longest_ms: 200,
        window_s: 4.0,
        most: 6,
        start_up_s: 1.0,
        heartbeat_s: 0.25,
        output_s: 0.6,
        grace_s: 0.1,
        stops,
    }
}

/// What befalls a process at a moment.
#[derive(Clone, Copy, Debug)]
enum Fate {
    Dies,
    /// And so does every successor.
    AlwaysHangs,
    AlwaysSilent,
    Hangs,
    Halts,
    FallsSilent,
    IgnoresTerm,
    Recovers,
    CannotStart,
    MayStartAgain,
    SupervisorSleeps,
    /// A message of a former incarnation arrives late.
    Echo,
}

fn fates() -> impl Strategy<Value = Vec<(u16, u8, Fate)>> {
    let fate = prop_oneof![
        4 => Just(Fate::Dies),
        1 => Just(Fate::AlwaysHangs),
        1 => Just(Fate::AlwaysSilent),
        1 => Just(Fate::Hangs),
        1 => Just(Fate::Halts),
        1 => Just(Fate::FallsSilent),
        1 => Just(Fate::IgnoresTerm),
        2 => Just(Fate::Recovers),
        1 => Just(Fate::CannotStart),
        2 => Just(Fate::MayStartAgain),
        1 => Just(Fate::SupervisorSleeps),
        1 => Just(Fate::Echo),
    ];
    prop::collection::vec((0_u16..1000, 0_u8..4, fate), 0..60)
}

/// A process as the operating system has it.
#[derive(Clone, Debug, Default)]
struct Real {
    live: Option<u32>,
    hangs: bool,
    halts: bool,
    silent: bool,
    ignores_term: bool,
    dying: bool,
    cannot_start: bool,
    started: Vec<HostTime>,
    /// Whatever is started hangs, or is silent.
    always: (bool, bool),
}

/// An operating system, and the policy that rules it.
struct World {
    policy: Policy,
    now: HostTime,
    real: HashMap<ProcessId, Real>,
    told_to_kill: HashMap<ProcessId, HostTime>,
    ended: Option<(ProcessId, String)>,
}

impl World {
    fn new() -> Self {
        let now = HostTime::from_secs_f64(100.0);
        let policy = Policy::new(MEMBERS.map(|process| (process, rule(process))), now);
        let real = MEMBERS.into_iter().map(|process| (process, Real::default())).collect();
        let mut world = Self { policy, now, real, told_to_kill: HashMap::new(), ended: None };
        let actions = world.policy.begin(now);
        world.carry_out(actions);
        world
    }

    /// In order; what follows from an action comes after the rest.
    fn carry_out(&mut self, actions: Vec<Action>) {
        let mut actions = VecDeque::from(actions);
        while let Some(action) = actions.pop_front() {
            match action {
                Action::Start(process, incarnation) => {
                    let real = self.real.get_mut(&process).expect("a member");
                    assert_eq!(real.live, None, "two live incarnations of {process}");
                    real.started.push(self.now);
                    if real.cannot_start {
                        let why = "no memory".to_owned();
                        actions.extend(self.policy.happened(self.now, process, Event::NotStarted(why)));
                    } else {
                        let (started, always) = (std::mem::take(&mut real.started), real.always);
                        let ((hangs, silent), ignores_term) = (always, real.ignores_term);
                        *real = Real {
                            live: Some(incarnation),
                            started,
                            always,
                            hangs,
                            silent,
                            ignores_term,
                            ..Real::default()
                        };
                    }
                }
                Action::Terminate(process) => {
                    let real = self.real.get_mut(&process).expect("a member");
                    // What could not be started may be told to end before that is known.
                    assert!(real.live.is_some() || real.cannot_start, "{process} is not there to be told");
                    real.dying |= !real.ignores_term && !real.hangs && !real.halts;
                    self.told_to_kill.entry(process).or_insert(self.now);
                }
                Action::Kill(process, why) => {
                    let real = self.real.get_mut(&process).expect("a member");
                    assert!(real.live.is_some() && !why.is_empty(), "{process} is not there to be killed: {why}");
                    real.dying = true;
                }
                Action::Died(_, how, _) | Action::GaveUp(_, how) => assert!(!how.is_empty()),
                Action::EndRun(process, how) => self.ended = Some((process, how)),
            }
        }
    }

    fn befall(&mut self, process: ProcessId, fate: Fate) {
        let real = self.real.get_mut(&process).expect("a member");
        match fate {
            Fate::Dies => real.dying |= real.live.is_some() && process != ProcessId::Simulator,
            Fate::AlwaysHangs => real.always.0 = process != ProcessId::Simulator,
            Fate::AlwaysSilent => real.always.1 = true,
            Fate::Hangs => real.hangs = process != ProcessId::Simulator,
            Fate::Halts => real.halts = process != ProcessId::Simulator,
            Fate::FallsSilent => real.silent = true,
            Fate::IgnoresTerm => real.ignores_term = true,
            Fate::Recovers => {
                (real.hangs, real.halts, real.silent, real.always) = (false, false, false, (false, false));
            }
            Fate::CannotStart => real.cannot_start = true,
            Fate::MayStartAgain => real.cannot_start = false,
            Fate::SupervisorSleeps => self.now = self.now + Duration::from_secs(2),
            Fate::Echo => {
                let former = self.policy.incarnation(process).expect("a member").wrapping_sub(1);
                for event in [Event::Beat(former), Event::Output(former), Event::Exited(former, "long ago".to_owned())]
                {
                    let actions = self.policy.happened(self.now, process, event);
                    assert!(actions.is_empty(), "{actions:?} for what is long gone");
                }
            }
        }
    }

    /// Ten milliseconds of it.
    fn pass(&mut self) {
        self.now = self.now + TICK;
        for process in MEMBERS {
            let real = self.real.get_mut(&process).expect("a member");
            let Some(incarnation) = real.live else { continue };
            let mut events = Vec::new();
            if std::mem::take(&mut real.dying) {
                real.live = None;
                events.push(Event::Exited(incarnation, "was killed by signal 9".to_owned()));
            } else if real.halts {
                events.push(Event::Halted);
            } else if !real.hangs {
                events.push(Event::Beat(incarnation));
                if !real.silent {
                    events.push(Event::Output(incarnation));
                }
            }
            for event in events {
                let actions = self.policy.happened(self.now, process, event);
                self.carry_out(actions);
            }
        }
        let actions = self.policy.tick(self.now);
        self.carry_out(actions);
        self.check_rates();
    }

    fn check_rates(&self) {
        for (process, real) in &self.real {
            let rule = rule(*process);
            let recent = |at: &&HostTime| self.now.saturating_since(**at) < Duration::from_secs_f64(rule.window_s);
            // Deaths of others with which it starts anew do not count as its own.
            let own = if *process == ProcessId::Memory || *process == ProcessId::Recorder { 1 } else { 2 };
            let starts = real.started.iter().filter(recent).count();
            assert!(starts <= own * (rule.most as usize + 1), "{process} was started {starts} times in a window");
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 400, failure_persistence: None, ..ProptestConfig::default() })]

    /// Never two live incarnations, a bounded rate, no signal to the dead (all asserted inside), and in the end every process
    /// runs or was given up with the reason; then, told to stop, all end, however they resist.
    #[test]
    fn every_history_ends_well(fates in fates()) {
        let mut world = World::new();
        let mut fates: Vec<_> = fates;
        fates.sort_by_key(|(tick, ..)| *tick);
        let mut fates = fates.into_iter().peekable();
        for tick in 0..1000 {
            while let Some((_, which, fate)) = fates.next_if(|(at, ..)| *at <= tick) {
                world.befall(MEMBERS[usize::from(which)], fate);
            }
            world.pass();
        }
        prop_assert_eq!(&world.ended, &None, "the world did not die");
        // What hangs from its start is noticed after a second, and that seven times over.
        for _ in 0..1500 {
            world.pass();
        }
        for process in MEMBERS {
            let real = &world.real[&process];
            match world.policy.phase(process).expect("a member") {
                Phase::Running => prop_assert!(real.live.is_some() && !real.hangs && !real.halts, "{} {:?}", process, real),
                Phase::GivenUp(reason) => prop_assert!(reason.contains("died") && real.live.is_none()),
                // What cannot be started is being tried at its longest wait, until it is given up.
                Phase::BackingOff(_) | Phase::Starting => prop_assert!(real.cannot_start, "{} {:?}", process, real),
                phase => prop_assert!(false, "{} {:?}", process, phase),
            }
        }
        for process in MEMBERS {
            world.real.get_mut(&process).expect("a member").ignores_term = true;
        }
        let actions = world.policy.stop(world.now);
        world.carry_out(actions);
        for _ in 0..100 {
            world.pass();
        }
        prop_assert!(world.policy.is_over() && world.real.values().all(|real| real.live.is_none()));
    }
}

#[test]
fn a_crash_loop_backs_off_and_is_given_up_with_the_reason() {
    let mut world = World::new();
    let mut waits = Vec::new();
    for _ in 0..600 {
        world.real.get_mut(&ProcessId::Planner).expect("a member").dying = true;
        if let Phase::BackingOff(until) = world.policy.phase(ProcessId::Planner).expect("a member") {
            waits.push(until.saturating_since(world.now));
        }
        world.pass();
    }
    let Some(Phase::GivenUp(reason)) = world.policy.phase(ProcessId::Planner) else { panic!("it goes on") };
    assert!(reason.contains("signal 9") && reason.contains("7 times"), "{reason}");
    assert!(waits.iter().max().expect("waits") >= &Duration::from_millis(140), "{waits:?}");
}

/// Neither what never comes up nor what is silent from the start goes on for ever, however long it takes to notice.
#[test]
fn what_takes_as_long_to_fail_as_it_would_to_be_well_is_given_up() {
    let now = HostTime::from_secs_f64(100.0);
    let slow = Rule { start_up_s: 10.0, output_s: 6.0, window_s: 5.0, most: 2, ..rule(ProcessId::Planner) };
    for beats in [false, true] {
        let mut policy = Policy::new([(ProcessId::Memory, rule(ProcessId::Memory)), (ProcessId::Planner, slow)], now);
        let mut actions = policy.begin(now);
        let (mut tick, mut given_up) = (0, false);
        while !given_up && tick < 20_000 {
            tick += 1;
            let at = now + TICK * tick;
            for (process, is_silent) in [(ProcessId::Memory, false), (ProcessId::Planner, true)] {
                let incarnation = policy.incarnation(process).expect("a member");
                if beats || !is_silent {
                    policy.happened(at, process, Event::Beat(incarnation));
                }
                if !is_silent {
                    policy.happened(at, process, Event::Output(incarnation));
                }
            }
            actions.extend(policy.tick(at));
            for action in std::mem::take(&mut actions) {
                if let Action::Kill(process, _) | Action::Terminate(process) = action {
                    let incarnation = policy.incarnation(process).expect("a member");
                    actions.extend(policy.happened(at, process, Event::Exited(incarnation, "ended".to_owned())));
                }
            }
            given_up = matches!(policy.phase(ProcessId::Planner), Some(Phase::GivenUp(_)));
        }
        assert!(given_up, "beats: {beats}: it goes on for ever");
    }
}

#[test]
fn what_hangs_is_killed_in_time_and_what_is_silent_is_told_first() {
    for (fate, least_ms, most_ms) in [(Fate::Halts, 0, 40), (Fate::Hangs, 240, 290), (Fate::FallsSilent, 590, 900)] {
        let mut world = World::new();
        (0..100).for_each(|_| world.pass());
        let began = world.now;
        world.befall(ProcessId::Planner, fate);
        while world.policy.incarnation(ProcessId::Planner) == Some(0) {
            world.pass();
            assert!(world.now.saturating_since(began) < Duration::from_secs(3), "{fate:?} goes unnoticed");
        }
        let after_ms = world.now.saturating_since(began).as_millis();
        assert!((least_ms..=most_ms).contains(&after_ms), "{fate:?}: replaced after {after_ms} ms");
        let was_told = world.told_to_kill.contains_key(&ProcessId::Planner);
        assert_eq!(was_told, matches!(fate, Fate::FallsSilent), "{fate:?}");
    }
}

#[test]
fn what_waits_for_the_processor_gets_more_time_but_not_for_ever() {
    let mut world = World::new();
    (0..50).for_each(|_| world.pass());
    world.befall(ProcessId::Planner, Fate::Hangs);
    let began = world.now;
    while world.policy.incarnation(ProcessId::Planner) == Some(0) {
        let actions = world.policy.happened(world.now, ProcessId::Planner, Event::Starved);
        assert!(actions.is_empty());
        world.pass();
    }
    let after_ms = world.now.saturating_since(began).as_millis();
    assert!((1400..2000).contains(&after_ms), "{after_ms} ms");
}

#[test]
fn what_is_not_fed_or_refuses_its_input_is_not_silent() {
    let mut world = World::new();
    (0..100).for_each(|_| world.pass());
    // The planner is fed and makes nothing of it, but counts what it refuses.
    world.befall(ProcessId::Planner, Fate::FallsSilent);
    for _ in 0..400 {
        world.pass();
        let incarnation = world.policy.incarnation(ProcessId::Planner).expect("a member");
        world.policy.happened(world.now, ProcessId::Planner, Event::Refused(incarnation));
    }
    assert_eq!(world.policy.incarnation(ProcessId::Planner), Some(0), "it refuses");
    // The memory, which nobody feeds here, falls silent, too: so the planner is not fed any more, and needs not refuse.
    world.befall(ProcessId::Memory, Fate::FallsSilent);
    (0..100).for_each(|_| world.pass());
    assert_eq!(world.policy.incarnation(ProcessId::Planner), Some(0), "it is not fed");
}

#[test]
fn the_adopted_are_not_started_and_their_deaths_still_count() {
    let now = HostTime::from_secs_f64(50.0);
    let mut policy = Policy::new(MEMBERS.map(|process| (process, rule(process))), now);
    let deaths = vec![now; 6];
    let later = now + Duration::from_secs(60);
    let mut well = policy.clone();
    well.happened(later, ProcessId::Planner, Event::Adopted { incarnation: 6, deaths: deaths.clone() });
    let actions = well.happened(later, ProcessId::Planner, Event::Exited(6, "ended".to_owned()));
    assert!(matches!(&actions[..], [Action::Died(..)]), "what was lived down does not count: {actions:?}");
    policy.happened(now, ProcessId::Planner, Event::Adopted { incarnation: 6, deaths });
    let started = policy.begin(now);
    assert_eq!(started.len(), 3, "{started:?}");
    assert_eq!(policy.incarnation(ProcessId::Planner), Some(6));
    let mut other = Policy::new(MEMBERS.map(|process| (process, rule(process))), now);
    other.happened(now, ProcessId::Memory, Event::Left { incarnation: 3, deaths: Vec::new(), given_up: None });
    assert!(
        other.begin(now).contains(&Action::Start(ProcessId::Memory, 4)),
        "the dead are followed by a later incarnation"
    );
    let actions = policy.happened(now, ProcessId::Planner, Event::Exited(6, "ended".to_owned()));
    assert!(matches!(&actions[..], [Action::GaveUp(ProcessId::Planner, _)]), "{actions:?}");
}

#[test]
fn the_death_of_the_world_ends_the_run_and_stopping_follows_the_order() {
    let mut world = World::new();
    (0..10).for_each(|_| world.pass());
    world.real.get_mut(&ProcessId::Simulator).expect("a member").dying = true;
    (0..5).for_each(|_| world.pass());
    assert_eq!(world.ended.as_ref().map(|(process, _)| *process), Some(ProcessId::Simulator));
    let actions = world.policy.stop(world.now);
    assert!(!actions.contains(&Action::Terminate(ProcessId::Recorder)), "the recorder ends last: {actions:?}");
    world.carry_out(actions);
    (0..20).for_each(|_| world.pass());
    assert!(world.policy.is_over());
}
