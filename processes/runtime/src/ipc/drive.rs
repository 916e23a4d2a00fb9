//! The loop of a process: sleep, step, heartbeat.

use super::{IpcError, IpcPorts};
use crate::ports::{Connect, Ports, Process, Report, host_now};
use crate::run_dir::RunDir;
use ipc_types::messages::HealthLevel;
use ipc_types::topics::HealthReports;
use ipc_types::wire::Text;
use ipc_types::{HostTime, StereoRig};
use signal_hook::consts::{SIGINT, SIGTERM};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// Heartbeats per second: one every so often.
const HEARTBEAT: Duration = Duration::from_millis(100);
/// Longest sleep, so that a signal or an orphaned process is noticed.
const LONGEST_SLEEP: Duration = Duration::from_millis(20);

/// How a process is to be driven.
#[derive(Clone, Copy, Debug)]
pub struct DriveOptions {
    /// Which restart of the process this is.
    pub incarnation: u32,
    /// The supervisor's process number.
    pub supervisor: u32,
    /// How long the process lives on after its supervisor has died.
    pub lease: Duration,
}

/// Heartbeat state.
struct Heart {
    last_beat: HostTime,
    steps: u64,
    last_step: Duration,
    longest_step: Duration,
    reported: Option<HealthLevel>,
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
    let makes_time = process.flight_time(host_now()).is_some();
    let mut ports = IpcPorts::open(run, P::ID, options.incarnation, rig, |ports| {
        process.connect(ports);
        ports.writes::<HealthReports>();
        if !makes_time {
            ports.follow_flight_clock();
        }
    })?;
    let _alive = run.join().map_err(|error| IpcError::new("join the run")(&error))?;
    let supervisor = rustix::process::Pid::from_raw(options.supervisor as i32);
    let mut orphaned_since = None;
    let mut heart = Heart {
        last_beat: HostTime::ZERO,
        steps: 0,
        last_step: Duration::ZERO,
        longest_step: Duration::ZERO,
        reported: None,
    };
    while !stop.load(Ordering::Relaxed) {
        if rustix::process::getppid() != supervisor {
            let since = *orphaned_since.get_or_insert_with(host_now);
            if host_now().saturating_since(since) > options.lease {
                break;
            }
        }
        let until_next = process.next_wake().map_or(LONGEST_SLEEP, |at| at.saturating_since(ports.now()));
        if until_next > Duration::ZERO {
            ports.sleep(until_next.min(LONGEST_SLEEP));
        }
        match process.flight_time(host_now()) {
            Some(own) => ports.set_own_time(own),
            None => ports.refresh(),
        }
        let started = host_now();
        let report = process.step(&mut ports);
        let ended = host_now();
        heart.steps += u64::from(report.worked);
        if report.worked {
            heart.last_step = ended.saturating_since(started);
            heart.longest_step = heart.longest_step.max(heart.last_step);
        }
        let changed = heart.reported != Some(report.level);
        if changed || ended.saturating_since(heart.last_beat) >= HEARTBEAT {
            heart.last_beat = ended;
            heart.reported = Some(report.level);
            process.housekeep();
            beat(&mut ports, &heart, &report);
        }
    }
    process.finish(&mut ports);
    Ok(())
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
