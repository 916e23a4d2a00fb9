//! What a flight shows while it flies: one line of progress and a table of processes. Quiet when not a terminal.

use indicatif::{MultiProgress, ProgressBar, ProgressDrawTarget, ProgressStyle};
use ipc_types::messages::{HealthLevel, PlanMode, Rung};
use ipc_types::{Point, Vector, World};
use std::time::{Duration, Instant};
use supervisor::{ChildStatus, Mission, Phase};

/// Redraws a second.
const REDRAWS_HZ: u8 = 5;

/// The live display.
#[derive(Debug)]
pub(crate) struct Display {
    progress: MultiProgress,
    flight: ProgressBar,
    processes: Vec<ProgressBar>,
    goal: Point<World>,
    drawn: Option<Instant>,
}

impl Display {
    pub(crate) fn new(goal: Point<World>) -> Self {
        let progress = MultiProgress::with_draw_target(ProgressDrawTarget::stderr_with_hz(REDRAWS_HZ));
        let flight = progress.add(line());
        Self { progress, flight, processes: Vec::new(), goal, drawn: None }
    }

    /// Shows how things are, no more often than is readable.
    pub(crate) fn show(&mut self, mission: &Mission, children: &[ChildStatus]) {
        let interval = Duration::from_secs_f64(1.0 / f64::from(REDRAWS_HZ));
        if self.progress.is_hidden() || self.drawn.is_some_and(|drawn| drawn.elapsed() < interval) {
            return;
        }
        self.drawn = Some(Instant::now());
        self.flight.set_message(self.flight_line(mission, children));
        while self.processes.len() < children.len() {
            self.processes.push(self.progress.add(line()));
        }
        for (bar, child) in self.processes.iter().zip(children) {
            bar.set_message(process_line(child));
        }
    }

    /// Removes the display.
    pub(crate) fn clear(&self) {
        // A terminal that went away needs no clearing.
        let _ = self.progress.clear();
    }

    fn flight_line(&self, mission: &Mission, children: &[ChildStatus]) -> String {
        let mode = mission.plan_mode();
        if mode == PlanMode::Waiting {
            return format!("not ready: {}", why_not_ready(children));
        }
        let Some(truth) = mission.truth() else {
            return "not ready: waiting for the simulator".to_owned();
        };
        let position = Point::<World>::from_array(truth.position_m);
        let speed = Vector::<World>::from_array(truth.velocity_mps).norm();
        let latency = mission.recorder().exposure_to_command();
        let rung = mission.rung();
        let rung = if rung.rung == Rung::Full { String::new() } else { format!("  {}: {}", rung.rung, rung.reason) };
        format!(
            "{:6.1} s  {mode:<11} {:5.1} m to goal  {speed:4.1} m/s  clearance {:4.2} m  exposure→command {:.0} ms  clock {:.2}{rung}",
            mission.now().as_secs_f64(),
            position.distance(self.goal),
            truth.clearance_m,
            latency.p50_ms,
            truth.clock_ratio,
        )
    }
}

fn line() -> ProgressBar {
    let bar = ProgressBar::no_length();
    // A constant template that parses.
    if let Ok(style) = ProgressStyle::with_template("{msg}") {
        bar.set_style(style);
    }
    bar
}

/// The first process that is not ready, and what it waits for.
pub(crate) fn why_not_ready(children: &[ChildStatus]) -> String {
    children.iter().find_map(complaint).unwrap_or_else(|| "waiting for the first plan".to_owned())
}

/// What is wrong with a process, or what it waits for.
pub(crate) fn complaint(child: &ChildStatus) -> Option<String> {
    match child.health {
        None => Some(format!("{} is starting", child.process)),
        Some(health) if health.level != HealthLevel::Ok as u32 => {
            Some(format!("{} is {}", child.process, health.note.to_string_lossy()))
        }
        Some(_) => None,
    }
}

fn process_line(child: &ChildStatus) -> String {
    let pid = child.pid.map_or("-".to_owned(), |pid| pid.to_string());
    let state = match child.phase {
        Phase::Starting => "starting",
        Phase::Running => "running",
        Phase::Ending { .. } => "ending",
        Phase::BackingOff(_) => "restarting",
        Phase::GivenUp(_) => "given up",
        Phase::Stopped => "stopped",
    };
    let health = child.health.map_or(String::new(), |health| {
        format!(
            "{:6.1} ms/step  {} missed  {} refused  {}",
            health.last_step_ns as f64 * 1e-6,
            health.missed,
            health.dropped,
            health.note.to_string_lossy()
        )
    });
    format!("  {:<14} pid {pid:<8} {state:<10} {} restarts  {health}", child.process.name(), child.restarts)
}
