//! The loop of a process: sleep, step, heartbeat.

use super::injection::Injection;
use super::lease::Lease;
use super::{IpcError, IpcPorts};
use crate::faults::Fault;
use crate::ports::{Connect, Ports, Process, Report, host_now};
use crate::run_dir::RunDir;
use ipc_types::messages::HealthLevel;
use ipc_types::topics::HealthReports;
use ipc_types::wire::Text;
use ipc_types::{FlightTime, HostTime, StereoRig};
use signal_hook::consts::{SIGINT, SIGTERM};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// Heartbeats per second: one every so often.
const HEARTBEAT: Duration = Duration::from_millis(50);
/// Changes of health are logged no more often.
const LOG_INTERVAL: Duration = Duration::from_millis(100);
/// Longest sleep, so that a signal or an orphaned process is noticed.
const LONGEST_SLEEP: Duration = Duration::from_millis(20);

/// How a process is to be driven.
#[derive(Clone, Debug)]
pub struct DriveOptions {
    /// Which restart of the process this is.
    pub incarnation: u32,
    /// The supervisor's process number.
    pub supervisor: u32,
    /// How long the process lives on after its supervisor has died.
    pub lease: Duration,
    /// What is to go wrong in this run.
    pub faults: Vec<Fault>,
    /// Makes its messages others than they are: for showing that such a process is refused. 0 for what flies.
    pub schema_salt: u64,
}

/// Heartbeat state.
struct Heart {
    last_beat: HostTime,
    steps: u64,
    last_step: Duration,
    longest_step: Duration,
    reported: Option<HealthLevel>,
    last_report: Report,
    logged: HostTime,
    /// Changes of health since then.
    unlogged: u64,
}

/// Drives a process until SIGTERM or SIGINT, or until its supervisor has been dead for the lease.
///
/// # Errors
/// The run's services cannot be opened.
pub fn drive<P: Process>(mut process: P, run: &RunDir, rig: &StereoRig, options: DriveOptions) -> Result<(), IpcError> {
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [SIGINT, SIGTERM] {
        signal_hook::flag::register(signal, Arc::clone(&stop))
            .map_err(|error| IpcError::new("watch signals")(&error))?;
    }
    let mut lease = Lease::new(run, options.supervisor, options.lease);
    let _member = run
        .join(P::ID, options.incarnation)
        .map_err(|error| IpcError::new(format!("join the run: {error}"))(&error))?;
    // In this order: a successor sees the claim, or this process sees the successor.
    if lease.is_replaced() {
        return Err(IpcError::new("join the run")(&"the supervisor that started this process was replaced meanwhile"));
    }
    let makes_time = process.flight_time(host_now()).is_some();
    let mut ports = IpcPorts::open_salted(run, P::ID, options.incarnation, rig, options.schema_salt, |ports| {
        process.connect(ports);
        ports.writes::<HealthReports>();
        if !makes_time {
            ports.follow_flight_clock();
        }
    })?;
    run.forget_dying(P::ID);
    ports.keep_black_box(run);
    ports.inject(Injection::new(&options.faults, P::ID, options.incarnation));
    let mut heart = Heart::new();
    tracing::info!(pid = std::process::id(), "up");
    while !stop.load(Ordering::Relaxed) {
        if lease.is_over() {
            tracing::warn!(
                flight_s = ports.now().as_secs_f64(),
                "the supervisor is dead, and nobody has taken over: ending"
            );
            break;
        }
        let until_next = process.next_wake().map_or(LONGEST_SLEEP, |at| ports.host_until(at));
        if until_next > Duration::ZERO {
            ports.sleep(until_next.min(LONGEST_SLEEP));
        }
        match process.flight_time(host_now()) {
            Some(own) => ports.set_own_time(own),
            None => ports.refresh(),
        }
        let started = host_now();
        let report = match ports.may_step() {
            true => process.step(&mut ports),
            false => heart.last_report,
        };
        if heart.stepped(ports.now(), &report, started) {
            beat(&mut ports, &heart, &report);
            process.housekeep();
        }
    }
    process.finish(&mut ports);
    tracing::info!(flight_s = ports.now().as_secs_f64(), "ended");
    Ok(())
}

impl Heart {
    fn new() -> Self {
        Self {
            last_beat: HostTime::ZERO,
            steps: 0,
            last_step: Duration::ZERO,
            longest_step: Duration::ZERO,
            reported: None,
            last_report: Report::waiting("starting"),
            logged: HostTime::ZERO,
            unlogged: 0,
        }
    }

    /// Notes a step; whether it is to beat now.
    fn stepped(&mut self, now: FlightTime, report: &Report, started: HostTime) -> bool {
        let ended = host_now();
        self.last_report = *report;
        self.steps += u64::from(report.worked);
        if report.worked {
            self.last_step = ended.saturating_since(started);
            self.longest_step = self.longest_step.max(self.last_step);
        }
        let changed = self.reported != Some(report.level);
        if changed {
            self.log(now, report, ended);
        }
        let beats = changed || ended.saturating_since(self.last_beat) >= HEARTBEAT;
        if beats {
            (self.last_beat, self.reported) = (ended, Some(report.level));
        }
        beats
    }

    /// A change of health, in the run's log: but for those that follow too fast, which are counted.
    fn log(&mut self, now: FlightTime, report: &Report, at: HostTime) {
        if at.saturating_since(self.logged) < LOG_INTERVAL {
            self.unlogged += 1;
            return;
        }
        self.logged = at;
        let (flight_s, unlogged) = (now.as_secs_f64(), std::mem::take(&mut self.unlogged));
        let (note, dropped) = (report.note, report.dropped);
        match report.level {
            HealthLevel::Ok => tracing::info!(flight_s, unlogged, "well"),
            HealthLevel::Degraded => tracing::info!(flight_s, note, unlogged, "degraded"),
            HealthLevel::Faulted => tracing::warn!(flight_s, note, dropped, unlogged, "faulted"),
        }
    }
}

fn beat(ports: &mut IpcPorts, heart: &Heart, report: &Report) {
    let (now, failures, missed) = (ports.now(), ports.failures(), ports.missed());
    ports.publish::<HealthReports>(now, 0, |health, _| {
        health.level = report.level as u32;
        health.pid = std::process::id();
        health.steps = heart.steps;
        health.dropped = report.dropped + failures;
        health.missed = missed;
        health.last_step_ns = heart.last_step.as_nanos() as i64;
        health.longest_step_ns = heart.longest_step.as_nanos() as i64;
        health.note = Text::from(report.note);
    });
    ports.serve_late_subscribers();
}
