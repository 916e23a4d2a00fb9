//! `sparrowhawk evaluate`: many flights in lockstep on all cores, a row each.
//!
//! Flights differ in configuration, world, speed and seed. A campaign that was interrupted, or is to be
//! widened, goes on where it was: what the table holds already is not flown again.

use crate::ablation::Part;
use crate::campaign::{Case, MadeBy, Row, Table, digest};
use crate::campaign_plot;
use crate::config::FlightConfig;
use crate::graph::Flight;
use crate::run_files::VERSION;
use crate::say::{say, tell};
use crate::svg;
use crate::trials::Trial;
use crate::troubles::TroubleArguments;
use clap::Args;
use indicatif::{ProgressBar, ProgressStyle};
use std::collections::HashSet;
use std::error::Error;
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use supervisor::Outcome;
use xxhash_rust::xxh3::xxh3_64;

/// Most flights of a campaign.
const MOST_FLIGHTS: usize = 1_000_000;

/// Options of a campaign. Every combination of configuration, world, speed and seed is flown.
#[derive(Clone, Debug, Args)]
pub(crate) struct EvaluateArguments {
    /// Flights to compare: default, fast, forest_100, behind, corridor, corner, cul_de_sac, canopy, hedge, thesis_large, thesis_small, thicket, or files (RON); default if not given. Repeat, or separate by commas.
    #[arg(long, value_name = "NAME|FILE", value_delimiter = ',')]
    config: Vec<PathBuf>,
    /// Worlds: forest, long_forest, sparse_forest, field, wall, corridor, corner, cul_de_sac, canopy, hedge, thicket, or RON files; each flight file's own if not given. Repeat, or separate by commas.
    #[arg(long, value_name = "NAME|FILE", value_delimiter = ',')]
    world: Vec<String>,
    /// Highest speeds, m/s; each flight file's own if not given. Repeat, or separate by commas.
    #[arg(long, value_name = "M/S", value_delimiter = ',')]
    speed: Vec<f64>,
    /// Densities of the forest, trees per m²; each world's own if not given. Repeat, or separate by commas.
    #[arg(long, value_name = "PER_M2", value_delimiter = ',', conflicts_with = "trials")]
    trees: Vec<f64>,
    /// Seeds, first and last: 1..100 are a hundred. Of worlds and of all noise.
    #[arg(long, value_name = "FIRST..LAST", default_value = "1..10", value_parser = parse_seeds)]
    seeds: RangeInclusive<u64>,
    /// Trials (CSV: trial, map, start x, y, z, goal x, y, z) instead of worlds; those whose numbers are among the seeds.
    #[arg(long, value_name = "FILE", requires = "maps", conflicts_with = "world")]
    trials: Option<PathBuf>,
    /// Their maps (OctoMap .bt), with {} for what the table calls a map.
    #[arg(long, value_name = "PATTERN", requires = "trials")]
    maps: Option<String>,
    /// Fly without looking: shows what avoidance is worth.
    #[arg(long)]
    no_avoidance: bool,
    /// Fly without a part, too: shows what it is worth. Repeat, or separate by commas.
    #[arg(long, value_name = "PART", value_delimiter = ',')]
    without: Vec<Part>,
    /// Draw the share that arrives against speed, or density where speeds do not differ (SVG).
    #[arg(long, value_name = "FILE.svg")]
    plot: Option<PathBuf>,
    /// Model what the stereo camera and its matcher get wrong instead of rendering and matching pairs: faster.
    #[arg(long)]
    noise_camera: bool,
    #[command(flatten)]
    trouble: TroubleArguments,
    /// The table (CSV). Flights that it holds already are not flown again.
    #[arg(long, value_name = "FILE", default_value = "campaign.csv")]
    out: PathBuf,
    /// Flights at a time; as many as the machine has cores if not given.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=1024))]
    jobs: Option<u64>,
}

pub(crate) fn parse_seeds(text: &str) -> Result<RangeInclusive<u64>, String> {
    let expected = || format!("is \"{text}\", expected FIRST..LAST or one number, the last no less than the first");
    let number = |text: &str| text.trim().trim_start_matches('=').parse::<u64>().map_err(|_| expected());
    let (first, last) = text.split_once("..").unwrap_or((text, text));
    let seeds = number(first)?..=number(last)?;
    if seeds.is_empty() { Err(expected()) } else { Ok(seeds) }
}

/// What of a configuration a campaign varies; none: as it is.
#[derive(Clone, Copy, Debug)]
struct Varied {
    speed: Option<f64>,
    trees: Option<f64>,
    without: Option<Part>,
}

/// A flight to be flown: a combination with a seed.
struct Todo {
    case: Case,
    made_by: MadeBy,
    config: FlightConfig,
}

impl Todo {
    fn new(case: Case, config: FlightConfig, version: &str) -> Self {
        let configuration = format!("{:016x}", xxh3_64(config.snapshot().as_bytes()));
        Self { case, made_by: MadeBy { configuration, version: version.to_owned() }, config }
    }
}

impl EvaluateArguments {
    /// All combinations that were asked for, once each.
    fn templates(&self) -> Result<Vec<(Case, FlightConfig)>, Box<dyn Error>> {
        let mut templates: Vec<(Case, FlightConfig)> = Vec::new();
        for path in optional(self.config.iter().map(PathBuf::as_path)) {
            for world in optional(self.world.iter().map(String::as_str)) {
                for speed in optional(self.speed.iter().copied()) {
                    for trees in optional(self.trees.iter().copied()) {
                        for without in std::iter::once(None).chain(self.without.iter().copied().map(Some)) {
                            let (case, config) = self.template(path, world, Varied { speed, trees, without })?;
                            if templates.iter().all(|(other, _)| *other != case) {
                                templates.push((case, config));
                            }
                        }
                    }
                }
            }
        }
        let seeds = self.seeds.end() - self.seeds.start();
        if (seeds as f64 + 1.0) * templates.len() as f64 > MOST_FLIGHTS as f64 {
            return Err(format!("--seeds: more than {MOST_FLIGHTS} flights were asked for").into());
        }
        Ok(templates)
    }

    /// All flights, seed by seed, so that comparisons grow evenly.
    fn flights(&self, version: &str) -> Result<Vec<Todo>, Box<dyn Error>> {
        let templates = self.templates()?;
        if let (Some(trials), Some(maps)) = (&self.trials, &self.maps) {
            return self.trials(&templates, &Trial::read(trials, maps)?, version);
        }
        let with_seed = |seed: u64, (case, template): &(Case, FlightConfig)| {
            Todo::new(Case { seed, ..case.clone() }, FlightConfig { seed, ..template.clone() }, version)
        };
        let of_seed = |seed: u64| templates.iter().map(move |template| with_seed(seed, template));
        Ok(self.seeds.clone().flat_map(of_seed).collect())
    }

    /// The trials whose numbers are among the seeds.
    fn trials(
        &self,
        templates: &[(Case, FlightConfig)],
        trials: &[Trial],
        version: &str,
    ) -> Result<Vec<Todo>, Box<dyn Error>> {
        let mut todo = Vec::new();
        for trial in trials.iter().filter(|trial| self.seeds.contains(&trial.number)) {
            let world = FlightConfig::load_world(&trial.map)?;
            for (case, template) in templates {
                let flight = FlightConfig { world: world.clone(), ..template.clone() };
                let case = Case { world: trial.map.display().to_string(), seed: trial.number, ..case.clone() };
                let mut flight = Todo::new(case, trial.configure(&flight)?, version);
                // A configuration names the map; another one of that name is another campaign.
                flight.made_by.configuration.push_str(&format!("-{:016x}", xxh3_64(&std::fs::read(&trial.map)?)));
                todo.push(flight);
            }
        }
        let left_out = trials.iter().filter(|trial| !self.seeds.contains(&trial.number)).count();
        if left_out > 0 {
            say(format_args!("{left_out} of {} trials have numbers outside --seeds", trials.len()));
        }
        if todo.is_empty() {
            return Err(
                format!("--trials: none of {} has a number among --seeds {:?}", trials.len(), self.seeds).into()
            );
        }
        Ok(todo)
    }

    /// A combination, of no seed yet.
    fn template(
        &self,
        path: Option<&Path>,
        world: Option<&str>,
        Varied { speed, trees, without }: Varied,
    ) -> Result<(Case, FlightConfig), Box<dyn Error>> {
        let mut config = FlightConfig::load_for_simulator(path, world)?;
        config.avoidance = !self.no_avoidance;
        config.noise_camera = self.noise_camera;
        config.trouble = self.trouble.trouble();
        config.mission.cruise_speed_mps = speed.unwrap_or(config.mission.cruise_speed_mps);
        config.world.forest.trees_per_m2 = trees.unwrap_or(config.world.forest.trees_per_m2);
        if let Some(part) = without {
            part.remove(&mut config);
        }
        config.check()?;
        let name = |path: &Path| path.display().to_string();
        let case = Case {
            config: path.map_or("default".to_owned(), name),
            world: world.unwrap_or("default").to_owned(),
            cruise_mps: config.mission.cruise_speed_mps,
            trees_per_m2: config.world.forest.trees_per_m2,
            avoidance: config.avoidance,
            without,
            noise_camera: config.noise_camera,
            seed: 0,
        };
        Ok((case, config))
    }
}

/// What was given, or one that was not.
fn optional<T>(given: impl Iterator<Item = T>) -> Vec<Option<T>> {
    let given: Vec<Option<T>> = given.map(Some).collect();
    if given.is_empty() { vec![None] } else { given }
}

/// The version with the executable's hash: changes that were never committed are another version, too.
fn version() -> Result<String, Box<dyn Error>> {
    let executable = std::env::current_exe()?;
    let bytes = std::fs::read(&executable).map_err(|error| format!("{}: {error}", executable.display()))?;
    Ok(format!("{VERSION} {:016x}", xxh3_64(&bytes)))
}

/// Flies a campaign; the exit code says whether all of it was flown.
pub(crate) fn evaluate(arguments: &EvaluateArguments) -> Result<ExitCode, Box<dyn Error>> {
    arguments.plot.as_deref().map_or(Ok(()), svg::check_name)?;
    let mut todo = arguments.flights(&version()?)?;
    let limits = todo.iter().map(|flight| flight.config.braking_limit_mps());
    let braking_limit_mps = limits.fold(f64::INFINITY, f64::min);
    let cases: HashSet<String> = todo.iter().map(|flight| flight.case.key()).collect();
    let mut table = Table::open(&arguments.out)?;
    if table.torn_bytes > 0 {
        say(format_args!("{}: cut off an unfinished row", arguments.out.display()));
    }
    for flight in std::mem::take(&mut todo) {
        if !table.has(&flight.case, &flight.made_by)? {
            todo.push(flight);
        }
    }
    let stop = Arc::new(AtomicBool::new(false));
    crate::cli::stop_on_signals(&stop)?;
    let cores = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    let jobs = arguments.jobs.map_or(cores, |jobs| jobs as usize).min(todo.len().max(1));
    let bar = progress(cases.len(), cases.len() - todo.len());
    fly_all(&todo, jobs, &stop, &mut table, &bar)?;
    bar.finish_and_clear();
    let rows: Vec<&Row> = table.rows.iter().filter(|row| cases.contains(&row.case().key())).collect();
    tell!("{}", digest(&rows).trim_end());
    tell!("table                  {}", arguments.out.display());
    if let Some(path) = &arguments.plot
        && !rows.is_empty()
    {
        campaign_plot::plot(path, &rows, braking_limit_mps)?;
        tell!("plot                   {}", path.display());
    }
    if rows.len() < cases.len() {
        say(format_args!("{} of {} flights flown; the same command goes on", rows.len(), cases.len()));
        return Ok(ExitCode::FAILURE);
    }
    Ok(ExitCode::SUCCESS)
}

fn progress(all: usize, done: usize) -> ProgressBar {
    let bar = ProgressBar::new(all as u64).with_position(done as u64);
    // A constant template that parses.
    if let Ok(style) = ProgressStyle::with_template("{bar:30} {pos} of {len} flights  {elapsed} {msg}") {
        bar.set_style(style);
    }
    bar.reset_eta();
    bar.tick();
    bar
}

/// Flies what is to be flown; stops when told, without the flights that are then in the air.
fn fly_all(
    todo: &[Todo],
    jobs: usize,
    stop: &AtomicBool,
    table: &mut Table,
    bar: &ProgressBar,
) -> Result<(), Box<dyn Error>> {
    let next = Mutex::new(todo.iter());
    let already = table.rows.len();
    let table = Mutex::new((table, None));
    std::thread::scope(|scope| {
        for _ in 0..jobs {
            scope.spawn(|| {
                while !stop.load(Ordering::Relaxed) {
                    let Some(flight) = next.lock().unwrap_or_else(PoisonError::into_inner).next() else { return };
                    let flown = fly_one(flight, stop);
                    let (table, failed) = &mut *table.lock().unwrap_or_else(PoisonError::into_inner);
                    let added = match flown {
                        Ok(None) => return,
                        Ok(Some(row)) => table.add(row).map_err(|error| error.to_string()),
                        Err(error) => Err(error.to_string()),
                    };
                    if let Err(error) = added {
                        // Nothing more can be flown, or kept.
                        *failed = Some(error);
                        stop.store(true, Ordering::Relaxed);
                    }
                    bar.set_message(state(&table.rows[already..]));
                    bar.inc(1);
                }
            });
        }
    });
    let (_, failed) = table.into_inner().unwrap_or_else(PoisonError::into_inner);
    failed.map_or(Ok(()), |error| Err(error.into()))
}

fn state(rows: &[Row]) -> String {
    let count = |outcome| rows.iter().filter(|row| row.outcome == outcome).count();
    format!("now: {} arrived, {} collided", count(Outcome::Arrived), count(Outcome::Collided))
}

/// A flight, unless it was interrupted.
fn fly_one(todo: &Todo, stop: &AtomicBool) -> Result<Option<Row>, Box<dyn Error>> {
    let mut flight = Flight::new(&todo.config, None)?;
    let summary = flight.fly(|_| !stop.load(Ordering::Relaxed));
    let planning = flight.planning_times();
    let is_whole = summary.outcome != Outcome::Interrupted;
    Ok(is_whole.then(|| Row::new(&todo.case, &todo.made_by, &summary, planning)))
}
