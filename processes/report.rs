//! `sparrowhawk report`: a flight's log as one page that needs nothing else.

use crate::log_files::{attached_config, open_logs};
use crate::report_flight::{Doing, FlownFlight};
use crate::report_plots::{
    altitude, clearance, from_above, health, latencies, latency_figures, speed, time_to_collision,
};
use crate::run_files::CONFIG;
use crate::say::tell;
use clap::Args;
use ipc_types::rig::CameraMount;
use ipc_types::{Point, World};
use serde::Deserialize;
use std::error::Error;
use std::fmt::Write as _;
use std::path::PathBuf;
use std::process::ExitCode;

/// What to report on.
#[derive(Debug, Args)]
pub(crate) struct ReportArguments {
    /// The log (MCAP); of a recording in several files all of them, in their order.
    #[arg(required = true)]
    logs: Vec<PathBuf>,
    /// The page (HTML); beside the first log, `report.html`, if not given.
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
}

/// Reads the logs and writes the page.
pub(crate) fn report(arguments: &ReportArguments) -> Result<ExitCode, Box<dyn Error>> {
    let first = &arguments.logs[0];
    let at = |path: &PathBuf| {
        let path = path.display().to_string();
        move |error| format!("{path}: {error}")
    };
    let logs = open_logs(&arguments.logs)?;
    let attached = attached_config(&logs[0], first)?;
    let config: Flown = ron::from_str(&attached).map_err(|error| format!("{}: {CONFIG}: {error}", first.display()))?;
    let flight = FlownFlight::read(&logs, &config.vehicle.mount).map_err(at(first))?;
    let page = page(&config, &flight)?;
    let out = arguments.out.clone().unwrap_or_else(|| first.with_file_name("report.html"));
    std::fs::write(&out, page).map_err(|error| format!("{}: {error}", out.display()))?;
    tell!("{}: {} messages, {:.1} s", out.display(), flight.messages, flight.end_s());
    Ok(ExitCode::SUCCESS)
}

/// Of a flight's configuration only what the page needs: that of another version will do.
#[derive(Debug, Deserialize)]
struct Flown {
    seed: u64,
    vehicle: FlownVehicle,
}

#[derive(Debug, Deserialize)]
struct FlownVehicle {
    name: String,
    mount: CameraMount,
}

const STYLE: &str = "body{font:15px/1.5 system-ui,sans-serif;max-width:1000px;margin:2em auto;padding:0 1em;color:#222}\
    h1{font-size:1.5em}h2{font-size:1.15em;margin:1.6em 0 .3em}table{border-collapse:collapse;margin:.6em 0}\
    td,th{padding:.15em .9em .15em 0;text-align:left;vertical-align:top}th{font-weight:600}\
    svg{max-width:100%;height:auto}p{margin:.3em 0}.bad{color:#b00;font-weight:600}";

fn page(config: &Flown, flight: &FlownFlight) -> Result<String, Box<dyn Error>> {
    let mut page = String::new();
    let title = format!("Flight of {}", escape(&config.vehicle.name));
    write!(
        page,
        "<!doctype html><html lang=\"en\"><meta charset=\"utf-8\">\
         <meta name=\"viewport\" content=\"width=device-width\"><title>{title}</title><style>{STYLE}</style><h1>{title}</h1>"
    )?;
    figures(&mut page, config, flight)?;
    let plots = [
        (
            "From above",
            "Obstacles as seen by the cameras within 12 m, at the vehicle's height ± 1 m.",
            from_above(flight)?,
        ),
        ("Height", "", altitude(flight)?),
        ("Speed", "Allowed: what was asked for, scaled down where something did not work.", speed(flight)?),
        ("Clearance", "", clearance(flight)?),
        ("Time to collision", "With what is nearest, if the vehicle flew towards it.", time_to_collision(flight)?),
        (
            "Age of images",
            "When the map, the plan and the command that came of them were published.",
            latencies(flight)?,
        ),
        ("Health", "Green: well; orange: degraded; red: faulted. A black line: a successor begins.", health(flight)?),
    ];
    for (name, text, plot) in plots {
        write!(page, "<h2>{name}</h2><p>{text}</p>{plot}")?;
        if name == "Age of images" {
            latency_table(&mut page, flight)?;
        }
    }
    events(&mut page, flight)?;
    page.push_str("</html>\n");
    Ok(page)
}

fn figures(page: &mut String, config: &Flown, flight: &FlownFlight) -> std::fmt::Result {
    let flown = if flight.truth.is_empty() { &flight.track } else { &flight.truth };
    let length_m: f64 = flown.windows(2).map(|pair| distance(pair[0].position_m, pair[1].position_m)).sum();
    let fastest = flown.iter().map(|moment| moment.speed_mps).fold(0.0, f64::max);
    let nearest = flight.clearance.iter().map(|near| near.distance_m).reduce(f64::min);
    let to_goal = flown.last().zip(flight.goals.last()).map(|(last, goal)| distance(last.position_m, goal.position_m));
    let metres = |value: Option<f64>| value.map_or_else(|| "unknown".to_owned(), |value| format!("{value:.2} m"));
    let last = |history: &Vec<Doing>| history.iter().map(|doing| u64::from(doing.incarnation)).max();
    let restarts: u64 = flight.health.values().filter_map(last).sum();
    let collision = match flight.collided_s {
        Some(at_s) => format!("<span class=\"bad\">at {at_s:.1} s</span>"),
        None => "none".to_owned(),
    };
    let rows = [
        ("Seed", config.seed.to_string()),
        ("Duration", format!("{:.1} s", flight.end_s())),
        ("Length of the path", format!("{length_m:.1} m")),
        ("Fastest", format!("{fastest:.1} m/s")),
        ("Least clearance", metres(nearest)),
        ("Collision", collision),
        ("Left to the goal at the end", metres(to_goal)),
        ("Plans chosen anew", flight.replans.to_string()),
        ("Processes restarted", restarts.to_string()),
        ("Messages", flight.messages.to_string()),
        ("Could not be read", unread(flight)),
    ];
    page.push_str("<table>");
    rows.iter().try_for_each(|(name, value)| write!(page, "<tr><th>{name}</th><td>{value}</td></tr>"))?;
    page.push_str("</table>");
    Ok(())
}

/// What of the log is not in this page.
fn unread(flight: &FlownFlight) -> String {
    let damaged: Vec<_> = flight.damage.iter().filter(|damage| !damage.is_none()).map(ToString::to_string).collect();
    match (damaged.is_empty(), flight.no_messages) {
        (true, 0) => "nothing".to_owned(),
        (true, count) => format!("<span class=\"bad\">{count} messages</span>"),
        (false, count) => format!("<span class=\"bad\">{count} messages; {}</span>", damaged.join("; ")),
    }
}

fn latency_table(page: &mut String, flight: &FlownFlight) -> std::fmt::Result {
    page.push_str("<table><tr><th>from exposure to</th><th>median</th><th>99 %</th><th>longest</th></tr>");
    for (name, [median, p99, longest]) in latency_figures(flight) {
        write!(page, "<tr><td>{name}</td><td>{median:.1} ms</td><td>{p99:.1} ms</td><td>{longest:.1} ms</td></tr>")?;
    }
    page.push_str("</table>");
    Ok(())
}

/// What happened, line by line.
fn events(page: &mut String, flight: &FlownFlight) -> std::fmt::Result {
    let mut lines: Vec<(f64, String)> = Vec::new();
    for (process, history) in &flight.health {
        for pair in history.windows(2) {
            let (before, after) = (&pair[0], &pair[1]);
            let text = match before.incarnation != after.incarnation {
                true => format!("{process}: successor {} begins", after.incarnation),
                false => format!("{process}: {:?}: {}", after.level, after.note),
            };
            lines.push((after.from_s, text));
        }
    }
    for pair in flight.rungs.windows(2) {
        let on = &pair[1];
        lines.push((on.from_s, format!("{}, {:.0} % of the speed: {}", on.rung, 100.0 * on.speed_share, on.reason)));
    }
    lines.sort_by(|a, b| a.0.total_cmp(&b.0));
    page.push_str("<h2>What happened</h2><table>");
    for (at_s, text) in lines {
        write!(page, "<tr><td>{at_s:.1} s</td><td>{}</td></tr>", escape(&text))?;
    }
    page.push_str("</table>");
    Ok(())
}

fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    Point::<World>::from_array(a).distance(Point::from_array(b))
}

/// Text in a page: a log may come from anywhere.
fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}
