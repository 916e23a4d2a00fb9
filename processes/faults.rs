//! `sparrowhawk faults`: many flights with injected faults, over real processes and in real time; a table of what followed.

use crate::evaluate::parse_seeds;
use crate::fault_flight::{FaultFlight, Verdict};
use crate::fault_plan::{FaultPlan, draw};
use crate::fault_table::{FaultRow, NONE, markdown, rows};
use crate::run_files::VERSION;
use crate::say::tell;
use clap::Args;
use indicatif::{ProgressBar, ProgressStyle};
use std::collections::HashSet;
use std::error::Error;
use std::fs::{self, OpenOptions};
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Options of a fault campaign.
#[derive(Clone, Debug, Args)]
pub(crate) struct FaultsArguments {
    /// What goes wrong. Repeat, or separate by commas.
    #[arg(long, value_name = "PLAN", value_enum, value_delimiter = ',', default_value = "mixed")]
    plan: Vec<FaultPlan>,
    /// Seeds, first and last: of worlds, of noise and of faults. One flight for each, and each plan.
    #[arg(long, value_name = "FIRST..LAST", default_value = "1..5", value_parser = parse_seeds)]
    seeds: RangeInclusive<u64>,
    /// Mean time between two faults, s.
    #[arg(long, value_name = "S", default_value_t = 2.0)]
    every: f64,
    /// Flight: as for `fly`.
    #[arg(long, value_name = "NAME|FILE", default_value = "forest_100")]
    config: String,
    /// Highest speed on the way, m/s.
    #[arg(long, value_name = "M/S")]
    speed: Option<f64>,
    /// Model camera and matcher instead of rendering pairs: leaves more of the machine to the processes.
    #[arg(long)]
    noise_camera: bool,
    /// The table (CSV), a row for each fault. Flights that it holds already are not flown again.
    #[arg(long, value_name = "FILE", default_value = "faults.csv")]
    out: PathBuf,
    /// Write the table of fault × victim to this file (Markdown), besides printing it.
    #[arg(long, value_name = "FILE")]
    table: Option<PathBuf>,
    /// Where the flights' fault files, logs and run directories go.
    #[arg(long, value_name = "DIR", default_value = "runs/faults")]
    folder: PathBuf,
    /// Keep all run directories, not only those of flights that failed.
    #[arg(long)]
    keep: bool,
    /// Shrink the faults of a flight that failed to the shortest list that still fails.
    #[arg(long)]
    shrink: bool,
}

/// Longest flight for which faults are drawn, s.
const UNTIL_S: f64 = 400.0;

/// Flies the campaign. The exit code says whether no flight failed.
pub(crate) fn faults(arguments: &FaultsArguments) -> Result<ExitCode, Box<dyn Error>> {
    if !(0.1..=600.0).contains(&arguments.every) {
        return Err(format!("--every: is {}, allowed is 0.1 to 600 s", arguments.every).into());
    }
    let mut table = read(&arguments.out)?;
    let flown: HashSet<(String, u64)> = table.iter().map(|row| (row.plan.clone(), row.seed)).collect();
    let cases = arguments.plan.iter().flat_map(|&plan| arguments.seeds.clone().map(move |seed| (plan, seed)));
    let cases: Vec<_> = cases.filter(|(plan, seed)| !flown.contains(&(plan.name(), *seed))).collect();
    let stop = Arc::new(AtomicBool::new(false));
    crate::cli::stop_on_signals(&stop)?;
    let bar = ProgressBar::new(cases.len() as u64);
    // The template is ours and known to be good; the default one would do.
    if let Ok(style) = ProgressStyle::with_template("{bar:40} {pos}/{len} flights, {eta} left   {msg}") {
        bar.set_style(style);
    }
    let mut failed = 0;
    for (plan, seed) in cases {
        if stop.load(Ordering::Relaxed) {
            break;
        }
        bar.set_message(format!("{} {seed}; {failed} failed", plan.name()));
        let verdict = fly(arguments, plan, seed, &mut table, &bar)?;
        failed += usize::from(verdict == Verdict::Failed);
        bar.inc(1);
    }
    bar.finish_and_clear();
    let text = markdown(&table);
    tell!("{}", format!("{text}{}", account(&table)).trim_end());
    if let Some(path) = &arguments.table {
        fs::write(path, &text).map_err(|error| format!("{}: {error}", path.display()))?;
    }
    let is_sound = !table.iter().any(|row| row.verdict == Verdict::Failed || row.leaked > 0)
        && table.iter().any(|row| matches!(row.verdict, Verdict::Arrived | Verdict::Hovered));
    Ok(if is_sound { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

fn fly(
    arguments: &FaultsArguments,
    plan: FaultPlan,
    seed: u64,
    table: &mut Vec<FaultRow>,
    bar: &ProgressBar,
) -> Result<Verdict, Box<dyn Error>> {
    let mut options = vec!["--config".to_owned(), arguments.config.clone(), "--seed".to_owned(), seed.to_string()];
    options.extend(arguments.speed.into_iter().flat_map(|speed| ["--speed".to_owned(), speed.to_string()]));
    if arguments.noise_camera {
        options.push("--noise-camera".to_owned());
    }
    // The campaign's own number: two campaigns at a time are two sets of runs. Run names are short.
    let name = format!("{}-{seed}-{}", plan.name().replace('_', "-").get(..5).unwrap_or("fault"), std::process::id());
    let flight = FaultFlight { options, folder: arguments.folder.clone(), name };
    let drawn = draw(plan, seed, arguments.every, UNTIL_S);
    let flown = flight.fly(&drawn, || true)?;
    let rows = rows(&plan.name(), seed, &flown, VERSION);
    append(&arguments.out, &rows)?;
    table.extend(rows);
    let came = flown.summary.as_ref().map_or(drawn.len(), |summary| summary.faults.len());
    let outcome = flown.summary.as_ref().map(|summary| summary.outcome);
    if flown.verdict == Verdict::Failed {
        bar.println(format!("{} {seed}: {:?} after {came} faults: {}", plan.name(), outcome, flight.name));
        if arguments.shrink {
            let tell = |left| bar.set_message(format!("shrinking: {left} faults left"));
            let shortest = flight.shrink(&drawn[..came.min(drawn.len())], tell)?;
            bar.println(format!(
                "  still fails: {}",
                shortest.iter().map(ToString::to_string).collect::<Vec<_>>().join("; ")
            ));
        }
    } else if !arguments.keep {
        // What was recorded of a flight that went well is of no further use.
        let _ = fs::remove_dir_all(arguments.folder.join(&flight.name));
    }
    Ok(flown.verdict)
}

/// How many faults and flights, and what was left behind.
fn account(table: &[FaultRow]) -> String {
    let flights: HashSet<_> = table.iter().map(|row| (&row.plan, row.seed)).collect();
    let of = |verdict| {
        let of: HashSet<_> =
            table.iter().filter(|row| row.verdict == verdict).map(|row| (&row.plan, row.seed)).collect();
        of.len()
    };
    let takeovers = table.iter().filter(|row| row.takeovers > 0);
    let taken: HashSet<_> = takeovers.clone().map(|row| (&row.plan, row.seed)).collect();
    let restarted: HashSet<_> = takeovers.filter(|row| row.restarts > 0).map(|row| (&row.plan, row.seed)).collect();
    let leaked: usize = table.iter().filter(|row| row.leaked > 0).map(|row| row.leaked).max().unwrap_or_default();
    format!(
        "\n{} faults in {} flights: {} arrived, {} hovered, {} late, {} failed, {} void; most files and processes left behind by one: {leaked}; \
         {} were taken over, in {} of which a process was restarted\n",
        table.iter().filter(|row| row.fault != NONE).count(),
        flights.len(),
        of(Verdict::Arrived),
        of(Verdict::Hovered),
        of(Verdict::Late),
        of(Verdict::Failed),
        of(Verdict::Void),
        taken.len(),
        restarted.len(),
    )
}

fn read(path: &Path) -> Result<Vec<FaultRow>, Box<dyn Error>> {
    if !path.exists() {
        return Ok(Vec::new());
    }
    let of_file = |error: csv::Error| format!("{}: {error}", path.display());
    let rows: Result<Vec<FaultRow>, _> = csv::Reader::from_path(path).map_err(of_file)?.into_deserialize().collect();
    let rows = rows.map_err(of_file)?;
    match rows.iter().find(|row| row.version != VERSION) {
        Some(other) => Err(format!(
            "{}: holds flights of version {}, this is {VERSION}: choose another --out",
            path.display(),
            other.version
        )
        .into()),
        None => Ok(rows),
    }
}

fn append(path: &Path, rows: &[FaultRow]) -> Result<(), Box<dyn Error>> {
    let is_new = !path.exists();
    let file =
        OpenOptions::new().create(true).append(true).open(path).map_err(|e| format!("{}: {e}", path.display()))?;
    let mut writer = csv::WriterBuilder::new().has_headers(is_new).from_writer(file);
    rows.iter().try_for_each(|row| writer.serialize(row))?;
    writer.flush()?;
    Ok(())
}
