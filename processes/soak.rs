//! `sparrowhawk soak`: one flight for as long as is asked for, to and fro, with random faults; memory, descriptors and shared
//! memory of its processes over time, as a table and a plot.

use crate::fault_flight::{FaultFlight, Flown};
use crate::fault_plan::{FaultPlan, draw};
use crate::run_record::RunRecord;
use crate::say::tell;
use clap::Args;
use indicatif::{ProgressBar, ProgressStyle};
use plotters::prelude::*;
use runtime::run_dir::RunDir;
use serde::Serialize;
use std::error::Error;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};
use supervisor::{Outcome, Summary};

/// Options of a soak.
#[derive(Clone, Debug, Args)]
pub(crate) struct SoakArguments {
    /// How long.
    #[arg(long, value_name = "MIN", default_value_t = 30.0)]
    minutes: f64,
    /// Mean time between two faults, s.
    #[arg(long, value_name = "S", default_value_t = 3.0)]
    every: f64,
    /// What goes wrong.
    #[arg(long, value_name = "PLAN", value_enum, default_value = "mixed")]
    plan: FaultPlan,
    /// Seed of world, noise and faults.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Highest speed on the way, m/s.
    #[arg(long, value_name = "M/S", default_value_t = 4.0)]
    speed: f64,
    /// The samples (CSV), one a second.
    #[arg(long, value_name = "FILE", default_value = "soak.csv")]
    out: PathBuf,
    /// The plot (SVG).
    #[arg(long, value_name = "FILE", default_value = "soak.svg")]
    plot: PathBuf,
    /// Where fault files, logs and run directories go.
    #[arg(long, value_name = "DIR", default_value = "runs/soak")]
    folder: PathBuf,
}

/// Between two samples, s.
const INTERVAL_S: f64 = 1.0;
/// Both ends of the way to and fro in the default forest, m.
const ENDS_M: [&str; 2] = ["58,0,1.5", "8,0,1.5"];
/// Longest soak, minutes.
const LONGEST_MIN: f64 = 24.0 * 60.0;

/// The machine as the run uses it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
struct Sample {
    /// Since the soak began, s.
    at_s: f64,
    /// Resident memory of all processes, MiB.
    resident_mib: f64,
    /// Of the largest.
    largest_mib: f64,
    /// Open descriptors of all processes.
    descriptors: u64,
    /// Files of the run in shared memory.
    shared_files: u64,
    /// What they take, MiB.
    shared_mib: f64,
    /// Restarts so far, in this flight.
    restarts: u32,
}

/// Flies to and fro. The exit code says whether nothing was touched and nothing grew.
pub(crate) fn soak(arguments: &SoakArguments) -> Result<ExitCode, Box<dyn Error>> {
    crate::svg::check_name(&arguments.plot)?;
    if !(0.1..=LONGEST_MIN).contains(&arguments.minutes) {
        return Err(format!("--minutes: is {}, allowed is 0.1 to {LONGEST_MIN}", arguments.minutes).into());
    }
    let stop = Arc::new(AtomicBool::new(false));
    crate::cli::stop_on_signals(&stop)?;
    let length = Duration::from_secs_f64(60.0 * arguments.minutes);
    let bar = ProgressBar::new(length.as_secs());
    // The template is ours and known to be good; the default one would do.
    if let Ok(style) = ProgressStyle::with_template("{bar:40} {elapsed} of {len} s   {msg}") {
        bar.set_style(style);
    }
    let (began, mut samples, mut flights) = (Instant::now(), Vec::<Sample>::new(), Vec::new());
    let is_over = || began.elapsed() >= length || stop.load(Ordering::Relaxed);
    while !is_over() {
        let number = flights.len() as u64;
        let flight = flight(arguments, number);
        let run = RunDir::named(&flight.name)?;
        let faults = draw(arguments.plan, arguments.seed + number, arguments.every, length.as_secs_f64());
        flights.push(flight.fly(&faults, || {
            let at_s = began.elapsed().as_secs_f64();
            let is_due = samples.last().is_none_or(|last| at_s - last.at_s >= INTERVAL_S);
            if let Some(sample) = is_due.then(|| RunRecord::read(&run).ok()).flatten().map(|r| sample(&r, &run, at_s)) {
                bar.set_position(at_s as u64);
                bar.set_message(format!("{:.0} MiB, {} descriptors", sample.resident_mib, sample.descriptors));
                samples.push(sample);
            }
            !is_over()
        })?);
    }
    bar.finish_and_clear();
    let mut writer = csv::Writer::from_path(&arguments.out).map_err(|e| format!("{}: {e}", arguments.out.display()))?;
    samples.iter().try_for_each(|sample| writer.serialize(sample))?;
    writer.flush()?;
    plot(&arguments.plot, &samples)?;
    let is_sound = report(&samples, &flights);
    Ok(if is_sound { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

/// A flight to and fro: the next one follows if it ends before its time.
fn flight(soak: &SoakArguments, number: u64) -> FaultFlight {
    let legs = (20.0 * soak.minutes).ceil() as usize + 2;
    let mut options: Vec<String> =
        (0..legs).flat_map(|leg| ["--waypoint", ENDS_M[leg % 2]]).map(str::to_owned).collect();
    let limit_s = (60.0 * soak.minutes + 60.0).to_string();
    let (seed, speed) = ((soak.seed + number).to_string(), soak.speed.to_string());
    options.extend(["--time-limit", &limit_s, "--seed", &seed, "--speed", &speed].map(str::to_owned));
    let name = format!("soak-{}-{number}", std::process::id());
    FaultFlight { options, folder: soak.folder.clone(), name }
}

fn sample(record: &RunRecord, run: &RunDir, at_s: f64) -> Sample {
    let usages = || record.processes.iter().filter_map(|process| process.usage);
    let mib = |bytes: u64| bytes as f64 / f64::from(1 << 20);
    let (shared_files, shared_bytes) = run.footprint();
    Sample {
        at_s,
        resident_mib: mib(usages().map(|usage| usage.resident_bytes).sum()),
        largest_mib: mib(usages().map(|usage| usage.resident_bytes).max().unwrap_or_default()),
        descriptors: usages().map(|usage| usage.descriptors).sum(),
        shared_files,
        shared_mib: mib(shared_bytes),
        restarts: record.processes.iter().map(|process| process.restarts).sum(),
    }
}

/// What is drawn: a name, and a value of each sample.
type Series = (&'static str, fn(&Sample) -> f64);

/// What is to stay as it is.
const FLAT: [Series; 4] = [
    ("resident memory, MiB", |sample| sample.resident_mib),
    ("open descriptors", |sample| sample.descriptors as f64),
    ("files in shared memory", |sample| sample.shared_files as f64),
    ("shared memory, MiB", |sample| sample.shared_mib),
];
/// Growth from the second quarter to the last that counts as none, for each; the first quarter is warming up.
const GROWTH: f64 = 0.1;

fn median(samples: &[Sample], of: fn(&Sample) -> f64) -> f64 {
    let mut values: Vec<f64> = samples.iter().map(of).collect();
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or_default()
}

/// Says what it came to; whether nothing was touched and nothing grew.
fn report(samples: &[Sample], flights: &[Flown]) -> bool {
    let told = || flights.iter().filter_map(|flight| flight.summary.as_ref());
    let faults: usize = told().map(|flight| flight.faults.len()).sum();
    let deaths: usize = told().map(|flight| flight.deaths.len()).sum();
    let collisions = told().filter(|flight| flight.outcome == Outcome::Collided).count();
    let is_lost = |flight: &&Summary| matches!(flight.outcome, Outcome::ProcessLost | Outcome::HandedBack);
    // Without an account nobody knows what became of it.
    let lost = told().filter(is_lost).count() + flights.len() - told().count();
    let path_m: f64 = told().map(|flight| flight.path_length_m).sum();
    let lasted_s = samples.last().map_or(0.0, |sample| sample.at_s);
    tell!(
        "{lasted_s:.0} s in {} flight(s), {path_m:.0} m, {faults} faults, {deaths} deaths, {collisions} collision(s), {lost} lost",
        flights.len()
    );
    let quarter = samples.len() / 4;
    let mut is_flat = true;
    for (name, of) in FLAT {
        let (early, late) = (median(&samples[quarter..2 * quarter], of), median(&samples[3 * quarter..], of));
        let most = samples.iter().map(of).fold(0.0, f64::max);
        tell!("{name:<24} {early:8.1} in the second quarter, {late:8.1} in the last, {most:8.1} at most");
        is_flat &= late <= early * (1.0 + GROWTH) + 1.0;
    }
    is_flat && collisions + lost == 0
}

/// Every series as a share of its own largest value, over time.
fn plot(path: &Path, samples: &[Sample]) -> Result<(), Box<dyn Error>> {
    const COLOURS: [RGBColor; 4] =
        [RGBColor(31, 119, 180), RGBColor(214, 39, 40), RGBColor(44, 160, 44), RGBColor(148, 103, 189)];
    let minutes = samples.last().map_or(1.0, |sample| sample.at_s / 60.0).max(1e-3);
    let area = SVGBackend::new(path, (860, 720)).into_drawing_area();
    area.fill(&WHITE)?;
    for ((panel, (name, of)), colour) in area.split_evenly((FLAT.len(), 1)).iter().zip(FLAT).zip(COLOURS) {
        let most = samples.iter().map(of).fold(0.0, f64::max).max(1e-3);
        let mut chart = ChartBuilder::on(panel)
            .caption(name, ("sans-serif", 16))
            .margin(8)
            .x_label_area_size(28)
            .y_label_area_size(56)
            .build_cartesian_2d(0.0..minutes, 0.0..1.1 * most)?;
        chart.configure_mesh().x_desc("minutes").y_labels(5).draw()?;
        chart.draw_series(LineSeries::new(samples.iter().map(|s| (s.at_s / 60.0, of(s))), colour.stroke_width(2)))?;
    }
    area.present().map_err(|error| format!("{}: {error}", path.display()).into())
}
