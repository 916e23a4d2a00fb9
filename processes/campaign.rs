//! The table of a campaign: a row for every flight, in a file that grows while flying, and what groups of rows come to.

use crate::ablation::Part;
use serde::{Deserialize, Serialize};
use statrs::distribution::{Beta, ContinuousCDF};
use std::collections::{BTreeMap, HashMap};
use std::fs::{File, OpenOptions, TryLockError};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use supervisor::{LatencySummary, Outcome, Summary};

/// Confidence of the bounds.
const CONFIDENCE: f64 = 0.95;

/// What tells one flight of a campaign from another.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Case {
    /// Flight file; `default` for the shipped one.
    pub(crate) config: String,
    /// World: the name of a shipped one, or a file; `default` for the flight file's own.
    pub(crate) world: String,
    /// Highest speed asked for, m/s.
    pub(crate) cruise_mps: f64,
    /// Trees per square metre of the world.
    pub(crate) trees_per_m2: f64,
    /// Whether the planner looks at the map.
    pub(crate) avoidance: bool,
    /// The part that is done without.
    pub(crate) without: Option<Part>,
    /// Whether camera and matcher are modelled instead of rendered.
    pub(crate) noise_camera: bool,
    /// Seed of the world and of all noise.
    pub(crate) seed: u64,
}

impl Case {
    /// As a text that no other case has.
    pub(crate) fn key(&self) -> String {
        let Self { config, world, cruise_mps, trees_per_m2, avoidance, without, noise_camera, seed } = self;
        let without = without.map_or("", Part::name);
        format!("{config}\n{world}\n{cruise_mps}\n{trees_per_m2}\n{avoidance}\n{without}\n{noise_camera}\n{seed}")
    }
}

/// The table's columns: the fields of [`Row`], in order.
const COLUMNS: [&str; 28] = [
    "config",
    "world",
    "cruise_mps",
    "trees_per_m2",
    "avoidance",
    "without",
    "noise_camera",
    "seed",
    "outcome",
    "flight_time_s",
    "straight_line_m",
    "path_length_m",
    "mean_deviation_m",
    "distance_to_goal_m",
    "mean_speed_mps",
    "way_speed_mps",
    "max_speed_mps",
    "min_clearance_m",
    "replans",
    "plans",
    "planning_p50_ms",
    "planning_p99_ms",
    "planning_max_ms",
    "frames",
    "frames_without_map",
    "log_hash",
    "configuration",
    "version",
];

/// One flight.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Row {
    pub(crate) config: String,
    pub(crate) world: String,
    pub(crate) cruise_mps: f64,
    pub(crate) trees_per_m2: f64,
    pub(crate) avoidance: bool,
    pub(crate) without: Option<Part>,
    pub(crate) noise_camera: bool,
    pub(crate) seed: u64,
    pub(crate) outcome: Outcome,
    pub(crate) flight_time_s: f64,
    pub(crate) straight_line_m: f64,
    pub(crate) path_length_m: f64,
    /// Mean distance of the path from the straight line.
    pub(crate) mean_deviation_m: f64,
    pub(crate) distance_to_goal_m: f64,
    pub(crate) mean_speed_mps: f64,
    /// The same without taking off and settling at the goal.
    pub(crate) way_speed_mps: f64,
    pub(crate) max_speed_mps: f64,
    /// From the hull to an obstacle; empty when it never came within 5 m.
    pub(crate) min_clearance_m: Option<f64>,
    pub(crate) replans: u64,
    pub(crate) plans: u64,
    pub(crate) planning_p50_ms: f64,
    pub(crate) planning_p99_ms: f64,
    pub(crate) planning_max_ms: f64,
    pub(crate) frames: u64,
    pub(crate) frames_without_map: u64,
    pub(crate) log_hash: String,
    /// Hash of the whole configuration; the version that flew it, and its executable's hash.
    configuration: String,
    version: String,
}

impl Row {
    pub(crate) fn new(case: &Case, made_by: &MadeBy, summary: &Summary, planning: LatencySummary) -> Self {
        let Case { config, world, cruise_mps, trees_per_m2, avoidance, without, noise_camera, seed } = case.clone();
        Self {
            config,
            world,
            cruise_mps,
            trees_per_m2,
            avoidance,
            without,
            noise_camera,
            seed,
            outcome: summary.outcome,
            flight_time_s: summary.flight_time_s,
            straight_line_m: summary.straight_line_m,
            path_length_m: summary.path_length_m,
            mean_deviation_m: summary.mean_deviation_m,
            distance_to_goal_m: summary.distance_to_goal_m,
            mean_speed_mps: summary.mean_speed_mps,
            way_speed_mps: summary.way_speed_mps,
            max_speed_mps: summary.max_speed_mps,
            min_clearance_m: summary.min_clearance_m,
            replans: summary.replans,
            plans: planning.count,
            planning_p50_ms: planning.p50_ms,
            planning_p99_ms: planning.p99_ms,
            planning_max_ms: planning.max_ms,
            frames: summary.frames,
            frames_without_map: summary.frames_without_map,
            log_hash: summary.log_hash.clone().unwrap_or_default(),
            configuration: made_by.configuration.clone(),
            version: made_by.version.clone(),
        }
    }

    /// What flew: the configuration, and without what.
    pub(crate) fn flight(&self) -> String {
        let blind = if self.avoidance { "" } else { " (blind)" };
        let without = self.without.map_or(String::new(), |part| format!(" without {}", part.name()));
        format!("{}{blind}{without}", self.config)
    }

    pub(crate) fn case(&self) -> Case {
        let Self { config, world, cruise_mps, trees_per_m2, avoidance, without, noise_camera, seed, .. } = self.clone();
        Case { config, world, cruise_mps, trees_per_m2, avoidance, without, noise_camera, seed }
    }
}

/// What a row was made by.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct MadeBy {
    pub(crate) configuration: String,
    pub(crate) version: String,
}

/// A table that cannot be gone on with.
#[derive(Debug, thiserror::Error)]
pub(crate) enum TableError {
    #[error("{path}: {source}")]
    Io { path: String, source: io::Error },
    #[error("{path}: {source}")]
    Csv { path: String, source: csv::Error },
    #[error("{path}: is not the table of a campaign: its columns are {found}")]
    Foreign { path: String, found: String },
    #[error("{path}: another campaign is writing it")]
    Busy { path: String },
    #[error("{path}: {case} was flown by {found}, this would be {expected}: choose another --out, or remove the file")]
    Another { path: String, case: String, found: String, expected: String },
}

/// The growing file, locked while it is open.
#[derive(Debug)]
pub(crate) struct Table {
    path: PathBuf,
    file: File,
    /// Bytes of whole rows.
    length: u64,
    pub(crate) rows: Vec<Row>,
    /// Which row a case is in.
    places: HashMap<String, usize>,
    /// Bytes of a row that a killed campaign did not finish.
    pub(crate) torn_bytes: u64,
}

impl Table {
    /// Opens a table, which may hold flights already. A last row that was not written whole is cut off. A file that is no
    /// table of a campaign is left as it was.
    pub(crate) fn open(path: &Path) -> Result<Self, TableError> {
        let name = || path.display().to_string();
        let io = |source| TableError::Io { path: name(), source };
        let file = OpenOptions::new().create(true).read(true).append(true).open(path).map_err(io)?;
        file.try_lock().map_err(|error| match error {
            TryLockError::WouldBlock => TableError::Busy { path: name() },
            TryLockError::Error(source) => io(source),
        })?;
        let text = std::fs::read(path).map_err(io)?;
        let header = COLUMNS.join(",") + "\n";
        let whole = text.iter().rposition(|&byte| byte == b'\n').map_or(0, |last| last + 1);
        // Whoever was killed while writing the header has left the beginning of it.
        if !text[..whole].starts_with(header.as_bytes()) && !header.as_bytes().starts_with(&text) {
            let found = String::from_utf8_lossy(text.split(|&byte| byte == b'\n').next().unwrap_or_default())
                .chars()
                .take(200)
                .collect();
            return Err(TableError::Foreign { path: name(), found });
        }
        let rows: Result<Vec<Row>, _> = csv::Reader::from_reader(&text[..whole]).deserialize().collect();
        let rows = rows.map_err(|source| TableError::Csv { path: name(), source })?;
        file.set_len(whole as u64).map_err(io)?;
        let places = rows.iter().enumerate().map(|(place, row)| (row.case().key(), place)).collect();
        let torn_bytes = (text.len() - whole) as u64;
        let mut table = Self { path: path.to_owned(), file, length: whole as u64, rows, places, torn_bytes };
        if whole == 0 {
            table.append(header.as_bytes()).map_err(io)?;
        }
        Ok(table)
    }

    /// Whether a flight is in the table.
    ///
    /// # Errors
    /// It is, but flown with another configuration or by another version.
    pub(crate) fn has(&self, case: &Case, made_by: &MadeBy) -> Result<bool, TableError> {
        let Some(row) = self.places.get(&case.key()).map(|&place| &self.rows[place]) else { return Ok(false) };
        let found = MadeBy { configuration: row.configuration.clone(), version: row.version.clone() };
        if found == *made_by {
            return Ok(true);
        }
        let name = |by: &MadeBy| format!("version {} with configuration {}", by.version, by.configuration);
        Err(TableError::Another {
            path: self.path.display().to_string(),
            case: format!("seed {} of {} in {}", case.seed, case.config, case.world),
            found: name(&found),
            expected: name(made_by),
        })
    }

    /// Adds a flight; it is in the file when this returns.
    pub(crate) fn add(&mut self, row: Row) -> Result<(), TableError> {
        let csv = |source| TableError::Csv { path: self.path.display().to_string(), source };
        let mut writer = csv::WriterBuilder::new().has_headers(false).from_writer(Vec::new());
        writer.serialize(&row).map_err(csv)?;
        let text = writer.into_inner().map_err(|error| csv(error.into_error().into()))?;
        self.append(&text).map_err(|source| TableError::Io { path: self.path.display().to_string(), source })?;
        self.places.insert(row.case().key(), self.rows.len());
        self.rows.push(row);
        Ok(())
    }

    /// Writes all of it, or nothing.
    fn append(&mut self, text: &[u8]) -> io::Result<()> {
        self.file.write_all(text).inspect_err(|_| {
            // On a full disk a piece may be there. If it cannot be cut off either, the next to open the table does.
            let _ = self.file.set_len(self.length);
        })?;
        self.length += text.len() as u64;
        Ok(())
    }
}

/// Upper bound of a share of which `found` of `of` were seen (Clopper and Pearson, one-sided).
pub(crate) fn upper_bound(found: usize, of: usize) -> f64 {
    if found >= of {
        return 1.0;
    }
    // Both parameters are positive.
    Beta::new(found as f64 + 1.0, (of - found) as f64).map_or(1.0, |beta| beta.inverse_cdf(CONFIDENCE))
}

/// What a share of which `found` of `of` were seen may be, from below and from above (Clopper and Pearson, 95 %).
pub(crate) fn success_bounds(found: usize, of: usize) -> [f64; 2] {
    [1.0 - upper_bound(of - found, of), upper_bound(found, of)]
}

/// Value below which a share of the values lies; 0 of none.
fn quantile(mut values: Vec<f64>, share: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    let place = (share * values.len().saturating_sub(1) as f64).round() as usize;
    values.get(place).copied().unwrap_or_default()
}

/// Headings of the digest.
const HEADINGS: [&str; 16] = [
    "flight",
    "world",
    "m/s",
    "trees/m2",
    "flights",
    "arrived",
    "collided",
    "stuck",
    "time s",
    "mean m/s",
    "way m/s",
    "path/straight",
    "beside m",
    "clearance m",
    "planning ms",
    "replans",
];
const NOTES: &str =
    "collided: in brackets the most that it may be, with 95 % confidence. stuck: gave up or out of time.
time, speeds, path: medians of those that arrived; way: without taking off and settling at the goal. beside: how far from the
straight line they flew in the mean, median.
clearance: least, median. planning: medians of the flights' medians and 99th percentiles, and the longest of all, with all
cores flying. replans: median.
";

/// What the rows come to: a line for every configuration, world and speed.
pub(crate) fn digest(rows: &[&Row]) -> String {
    let mut groups: BTreeMap<_, Vec<&Row>> = BTreeMap::new();
    for &row in rows {
        // Positive floats order as their bits do.
        let numbers = [row.cruise_mps, row.trees_per_m2].map(f64::to_bits);
        let key = (&row.config, &row.world, numbers, row.avoidance, row.without);
        groups.entry(key).or_default().push(row);
    }
    let lines: Vec<[String; HEADINGS.len()]> = groups.values().map(|rows| line(rows)).collect();
    let headings = HEADINGS.map(str::to_owned);
    let all: Vec<&[String; HEADINGS.len()]> = std::iter::once(&headings).chain(&lines).collect();
    let wide = |column: usize| all.iter().map(|line| line[column].chars().count()).max().unwrap_or_default();
    let mut text = String::new();
    for line in &all {
        let cells = line.iter().enumerate().map(|(column, cell)| format!("{cell:<width$}", width = wide(column)));
        text += cells.collect::<Vec<_>>().join("  ").trim_end();
        text.push('\n');
    }
    text + NOTES
}

/// The digest of flights that differ in their seeds alone.
fn line(rows: &[&Row]) -> [String; HEADINGS.len()] {
    let count = |is: fn(Outcome) -> bool| rows.iter().filter(|row| is(row.outcome)).count();
    let arrived = count(|outcome| outcome == Outcome::Arrived);
    let collided = count(|outcome| outcome == Outcome::Collided);
    let all = |value: fn(&Row) -> f64| rows.iter().map(|row| value(row)).collect::<Vec<_>>();
    let median_of_arrived = |value: fn(&Row) -> f64| {
        let of = rows.iter().filter(|row| row.outcome == Outcome::Arrived).map(|row| value(row));
        if arrived == 0 { "-".to_owned() } else { format!("{:.2}", quantile(of.collect(), 0.5)) }
    };
    let clearances = all(|row| row.min_clearance_m.unwrap_or(f64::INFINITY));
    let clearance = |share: f64| match quantile(clearances.clone(), share) {
        least if least.is_finite() => format!("{least:.2}"),
        _ => "> 5".to_owned(),
    };
    let Some(first) = rows.first() else { return Default::default() };
    [
        first.flight(),
        first.world.clone(),
        format!("{}", first.cruise_mps),
        format!("{}", first.trees_per_m2),
        format!("{}", rows.len()),
        format!("{:.1} %", 100.0 * arrived as f64 / rows.len() as f64),
        format!("{collided} ({:.1} %)", 100.0 * upper_bound(collided, rows.len())),
        format!("{}", rows.len() - arrived - collided),
        median_of_arrived(|row| row.flight_time_s),
        median_of_arrived(|row| row.mean_speed_mps),
        median_of_arrived(|row| row.way_speed_mps),
        median_of_arrived(|row| row.path_length_m / row.straight_line_m),
        median_of_arrived(|row| row.mean_deviation_m),
        format!("{}, {}", clearance(0.0), clearance(0.5)),
        format!(
            "{:.1}, {:.1}, {:.1}",
            quantile(all(|row| row.planning_p50_ms), 0.5),
            quantile(all(|row| row.planning_p99_ms), 0.5),
            quantile(all(|row| row.planning_max_ms), 1.0)
        ),
        format!("{}", quantile(all(|row| row.replans as f64), 0.5)),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bounds_are_those_of_clopper_and_pearson() {
        // 0 of n: 1 − 0.05^(1/n). 2 of 20: 28.3 % in tables.
        assert!((upper_bound(0, 300) - (1.0 - 0.05_f64.powf(1.0 / 300.0))).abs() < 1e-6);
        assert!((upper_bound(2, 20) - 0.283).abs() < 0.001, "{}", upper_bound(2, 20));
        assert_eq!(upper_bound(3, 3), 1.0);
        assert_eq!(upper_bound(0, 0), 1.0);
    }

    fn row(seed: u64, outcome: Outcome) -> Row {
        Row {
            config: "default".to_owned(),
            world: "a, world".to_owned(),
            cruise_mps: 0.1 + 0.2,
            trees_per_m2: 0.05,
            avoidance: true,
            without: (seed > 1).then_some(Part::Gaze),
            noise_camera: false,
            seed,
            outcome,
            flight_time_s: 20.0,
            straight_line_m: 65.0,
            path_length_m: 78.0,
            mean_deviation_m: 1.4,
            distance_to_goal_m: 0.1,
            mean_speed_mps: 2.5,
            way_speed_mps: 2.9,
            max_speed_mps: 4.0,
            min_clearance_m: (seed > 1).then_some(0.5),
            replans: 3,
            plans: 200,
            planning_p50_ms: 1.0,
            planning_p99_ms: 5.0,
            planning_max_ms: 9.0,
            frames: 250,
            frames_without_map: 1,
            log_hash: "abc".to_owned(),
            configuration: "0123".to_owned(),
            version: "0.1.0 (x)".to_owned(),
        }
    }

    #[test]
    fn a_table_is_read_back_whole_and_by_one_campaign_at_a_time() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("t.csv");
        let by = MadeBy { configuration: "0123".to_owned(), version: "0.1.0 (x)".to_owned() };
        let rows = [row(1, Outcome::Arrived), row(2, Outcome::Collided)];
        {
            let mut table = Table::open(&path).expect("a new one");
            assert!(matches!(Table::open(&path), Err(TableError::Busy { .. })));
            rows.iter().for_each(|row| table.add(row.clone()).expect("written"));
        }
        // The header is that of the fields, and whatever is torn, all that was whole is there.
        let text = std::fs::read(&path).expect("there");
        let mut writer = csv::Writer::from_writer(Vec::new());
        writer.serialize(&rows[0]).expect("serialises");
        let one = writer.into_inner().expect("written");
        assert!(text.starts_with(&one));
        for torn in 0..text.len() {
            std::fs::write(&path, &text[..torn]).expect("written");
            let table = Table::open(&path).expect("still a table");
            assert!(rows.starts_with(&table.rows), "{torn}");
            assert_eq!(table.rows.len(), usize::from(torn >= one.len()), "{torn}");
            assert!(!table.has(&rows[1].case(), &by).expect("the same"), "{torn}");
        }
        for foreign in ["my only line", "a,b\n1,2", "config,world\n"] {
            std::fs::write(&path, foreign).expect("written");
            assert!(matches!(Table::open(&path), Err(TableError::Foreign { .. })), "{foreign}");
            assert_eq!(std::fs::read_to_string(&path).expect("there"), foreign, "left as it was");
        }
    }

    #[test]
    fn the_digest_counts_by_group_and_lines_up() {
        let rows = [Outcome::Arrived, Outcome::Collided, Outcome::TimedOut]
            .map(|outcome| Row { without: None, ..row(if outcome == Outcome::Arrived { 1 } else { 2 }, outcome) });
        let other = Row { world: "elsewhere".to_owned(), ..row(1, Outcome::GaveUp) };
        let text = digest(&[&rows[0], &rows[1], &rows[2], &other]);
        let lines: Vec<&str> = text.lines().collect();
        let column = |name: &str| lines[0].find(name).expect("a heading");
        assert!(lines[1][column("arrived")..].starts_with("33.3 %"), "{text}");
        assert!(lines[1][column("collided")..].starts_with("1 (86.5 %)"), "{text}");
        assert!(lines[1][column("stuck")..].starts_with('1'), "{text}");
        assert!(lines[1][column("clearance")..].starts_with("0.50, 0.50"), "{text}");
        assert!(lines[2][column("mean m/s")..].starts_with('-'), "{text}");
        assert!(lines[2][column("clearance")..].starts_with("> 5, > 5"), "{text}");
    }

    #[test]
    fn quantiles_are_values() {
        assert_eq!(quantile(vec![3.0, 1.0, 2.0], 0.5), 2.0);
        assert_eq!(quantile(vec![3.0, 1.0, 2.0], 1.0), 3.0);
        assert_eq!(quantile(Vec::new(), 0.5), 0.0);
    }
}
