//! The account of a flight as text.

use std::fmt::Write;
use std::path::Path;
use supervisor::{LatencySummary, Losses, Outcome, Summary};

/// Which processes lost messages, and how many.
fn losses(summary: &Summary) -> String {
    if summary.losses.is_empty() {
        return "none".to_owned();
    }
    let of =
        |(name, losses): (&String, &Losses)| format!("{name} missed {}, refused {}", losses.missed, losses.dropped);
    summary.losses.iter().map(of).collect::<Vec<_>>().join("; ")
}

/// The flight report, as text.
pub fn report(summary: &Summary, folder: &Path) -> String {
    let outcome = match summary.outcome {
        Outcome::Arrived => "arrived",
        Outcome::Collided => "COLLIDED",
        Outcome::GaveUp => "gave up: no way was found",
        Outcome::TimedOut => "timed out",
        Outcome::Interrupted => "interrupted",
        Outcome::HandedBack => "handed back to the flight control unit: a process was given up",
        Outcome::ProcessLost => "ended by the loss of the world",
    };
    let clearance = summary.min_clearance_m.map_or("more than 5 m".to_owned(), |m| format!("{m:.2} m"));
    let mut text = String::new();
    // Writing to a string cannot fail.
    let mut line = |label: &str, value: String| {
        let _ = writeln!(text, "{label:<22} {value}");
    };
    line("outcome", format!("{outcome}, {:.2} m from the goal", summary.distance_to_goal_m));
    line("flight time", format!("{:.1} s", summary.flight_time_s));
    line(
        "path",
        format!(
            "{:.1} m flown, {:.1} m straight, {:.1} m beside it in the mean",
            summary.path_length_m, summary.straight_line_m, summary.mean_deviation_m
        ),
    );
    line("least clearance", clearance);
    line(
        "speed",
        format!(
            "cruise {:.1} m/s, on the way {:.1} m/s, mean {:.1} m/s, highest {:.1} m/s",
            summary.cruise_speed_mps, summary.way_speed_mps, summary.mean_speed_mps, summary.max_speed_mps
        ),
    );
    line("replans", summary.replans.to_string());
    if summary.shadow_setpoints > 0 {
        line("pilot", format!("{} setpoints recorded and not followed, while he flew", summary.shadow_setpoints));
    }
    line("stereo pairs", format!("{}, of which {} led to no map", summary.frames, summary.frames_without_map));
    line("lost messages", losses(summary));
    line("clock", format!("{:.3} flight seconds per second", summary.clock_ratio));
    let latency =
        |l: &LatencySummary| format!("p50 {:6.1} ms   p99 {:6.1} ms   max {:6.1} ms", l.p50_ms, l.p99_ms, l.max_ms);
    for stage in ["camera", "stereo-ingest", "expansion", "memory", "planner"] {
        if let Some(summary) = summary.stages.get(stage) {
            line(stage, latency(summary));
        }
    }
    line("exposure → command", latency(&summary.exposure_to_command));
    line("restarts", summary.restarts.to_string());
    went_wrong(summary, &mut line);
    if let Some(hash) = &summary.log_hash {
        line("message log hash", hash.clone());
    }
    line("run directory", folder.display().to_string());
    text
}

/// What went wrong, or was made to: a line for each.
fn went_wrong(summary: &Summary, line: &mut impl FnMut(&str, String)) {
    for process in summary.processes.iter().filter(|process| process.given_up.is_some()) {
        line("given up", format!("{}: {}", process.name, process.given_up.as_deref().unwrap_or_default()));
    }
    if summary.takeovers > 0 {
        line("takeovers", format!("{}; figures are of the time since the last one", summary.takeovers));
    }
    for step in &summary.degradation {
        let comma = if step.reason.is_empty() { "" } else { ", " };
        line("rung", format!("{:.1} s: {}{comma}{}", step.at_s, step.rung, step.reason));
    }
    for fault in &summary.faults {
        line("fault", format!("{:.1} s: {} of {}", fault.at_s, fault.fault, fault.victim));
    }
}
