//! The table of a campaign: a row for every flight, in a file that grows while flying, and what groups of rows come to.

use serde::{Deserialize, Serialize};
use statrs::distribution::{Beta, ContinuousCDF};
use std::collections::BTreeMap;
use std::error::Error;
use std::fmt::Write as _;
use std::fs::{File, OpenOptions};
use std::io;
use std::path::{Path, PathBuf};
use supervisor::{LatencySummary, Outcome, Summary};

/// Confidence of the bounds.
const CONFIDENCE: f64 = 0.95;

/// What tells one flight of a campaign from another.
#[derive(Clone, Debug, PartialEq, PartialOrd, Serialize, Deserialize)]
pub(crate) struct Case {
    /// Flight file; `default` for the shipped one.
    pub(crate) config: String,
    /// World: the name of a shipped one, or a file; `default` for the flight file's own.
    pub(crate) world: String,
    /// Highest speed asked for, m/s.
    pub(crate) cruise_mps: f64,
    /// Whether the planner looks at the map.
    pub(crate) avoidance: bool,
    /// Seed of the world and of all noise.
    pub(crate) seed: u64,
}

/// One flight.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Row {
    pub(crate) config: String,
    pub(crate) world: String,
    pub(crate) cruise_mps: f64,
    pub(crate) avoidance: bool,
    pub(crate) seed: u64,
    pub(crate) outcome: Outcome,
    flight_time_s: f64,
    straight_line_m: f64,
    path_length_m: f64,
    distance_to_goal_m: f64,
    mean_speed_mps: f64,
    max_speed_mps: f64,
    /// From the hull to an obstacle; empty when it never came within 5 m.
    min_clearance_m: Option<f64>,
    replans: u64,
    plans: u64,
    planning_p50_ms: f64,
    planning_p99_ms: f64,
    planning_max_ms: f64,
    frames: u64,
    frames_without_map: u64,
    log_hash: String,
    /// Hash of the whole configuration, and the version that flew it.
    configuration: String,
    version: String,
}

impl Row {
    pub(crate) fn new(case: &Case, made_by: &MadeBy, summary: &Summary, planning: LatencySummary) -> Self {
        let Case { config, world, cruise_mps, avoidance, seed } = case.clone();
        Self {
            config,
            world,
            cruise_mps,
            avoidance,
            seed,
            outcome: summary.outcome,
            flight_time_s: summary.flight_time_s,
            straight_line_m: summary.straight_line_m,
            path_length_m: summary.path_length_m,
            distance_to_goal_m: summary.distance_to_goal_m,
            mean_speed_mps: summary.mean_speed_mps,
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

    pub(crate) fn case(&self) -> Case {
        let Self { config, world, cruise_mps, avoidance, seed, .. } = self.clone();
        Case { config, world, cruise_mps, avoidance, seed }
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
    #[error("{path}: {case} was flown by {found}, this would be {expected}: choose another --out, or remove the file")]
    Another { path: String, case: String, found: String, expected: String },
}

/// The growing file.
#[derive(Debug)]
pub(crate) struct Table {
    path: PathBuf,
    writer: csv::Writer<File>,
    pub(crate) rows: Vec<Row>,
    /// Bytes of a row that a killed campaign did not finish.
    pub(crate) torn_bytes: u64,
}

impl Table {
    /// Opens a table, which may hold flights already. A last row that was not written whole is cut off.
    pub(crate) fn open(path: &Path) -> Result<Self, TableError> {
        let io = |source| TableError::Io { path: path.display().to_string(), source };
        let csv = |source| TableError::Csv { path: path.display().to_string(), source };
        let file = OpenOptions::new().create(true).read(true).append(true).open(path).map_err(io)?;
        let text = std::fs::read(path).map_err(io)?;
        let whole = text.iter().rposition(|&byte| byte == b'\n').map_or(0, |last| last + 1);
        file.set_len(whole as u64).map_err(io)?;
        let rows: Result<Vec<Row>, _> = csv::Reader::from_reader(&text[..whole]).deserialize().collect();
        let writer = csv::WriterBuilder::new().has_headers(whole == 0).from_writer(file);
        let torn_bytes = (text.len() - whole) as u64;
        Ok(Self { path: path.to_owned(), writer, rows: rows.map_err(csv)?, torn_bytes })
    }

    /// Whether a flight is in the table.
    ///
    /// # Errors
    /// It is, but flown with another configuration or by another version.
    pub(crate) fn has(&self, case: &Case, made_by: &MadeBy) -> Result<bool, TableError> {
        let Some(row) = self.rows.iter().find(|row| row.case() == *case) else { return Ok(false) };
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
    pub(crate) fn add(&mut self, row: Row) -> Result<(), Box<dyn Error>> {
        self.writer.serialize(&row)?;
        self.writer.flush()?;
        self.rows.push(row);
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

/// Value below which a share of the values lies; 0 of none.
fn quantile(mut values: Vec<f64>, share: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    let place = (share * values.len().saturating_sub(1) as f64).round() as usize;
    values.get(place).copied().unwrap_or_default()
}

/// What the rows come to: a line for every configuration, world and speed.
pub(crate) fn digest(rows: &[Row]) -> String {
    let mut groups: BTreeMap<(String, String, String, bool), Vec<&Row>> = BTreeMap::new();
    for row in rows {
        let speed = format!("{:6.2}", row.cruise_mps);
        groups.entry((row.config.clone(), row.world.clone(), speed, row.avoidance)).or_default().push(row);
    }
    let mut text = String::from(
        "config     world       m/s  flights  arrived  collided (at most)  stuck  mean m/s  path/straight  clearance m     \
         planning ms          replans\n",
    );
    for ((config, world, speed, avoidance), rows) in groups {
        let count = |is: fn(Outcome) -> bool| rows.iter().filter(|row| is(row.outcome)).count();
        let arrived = count(|outcome| outcome == Outcome::Arrived);
        let collided = count(|outcome| outcome == Outcome::Collided);
        let stuck = rows.len() - arrived - collided;
        let percent = |part: usize| 100.0 * part as f64 / rows.len() as f64;
        let of_arrived = |value: fn(&Row) -> f64| {
            rows.iter().filter(|row| row.outcome == Outcome::Arrived).map(|row| value(row)).collect::<Vec<_>>()
        };
        let all = |value: fn(&Row) -> f64| rows.iter().map(|row| value(row)).collect::<Vec<_>>();
        let clearances = all(|row| row.min_clearance_m.unwrap_or(5.0));
        let blind = if avoidance { "" } else { " (no avoidance)" };
        // Writing to a string cannot fail.
        let _ = writeln!(
            text,
            "{config:<10} {world:<9} {speed}  {:>7}  {:>5.1} %  {collided:>4} ({:>5.1} %)     {stuck:>5}  {:>8.1}  {:>13.2}  {:>4.2}, p50 \
             {:>4.2}  p50 {:>4.1} p99 {:>5.1} max {:>5.1}  {:>5.0}{blind}",
            rows.len(),
            percent(arrived),
            100.0 * upper_bound(collided, rows.len()),
            quantile(of_arrived(|row| row.mean_speed_mps), 0.5),
            quantile(of_arrived(|row| row.path_length_m / row.straight_line_m), 0.5),
            quantile(clearances.clone(), 0.0),
            quantile(clearances, 0.5),
            quantile(all(|row| row.planning_p50_ms), 0.5),
            quantile(all(|row| row.planning_p99_ms), 0.5),
            quantile(all(|row| row.planning_max_ms), 1.0),
            quantile(all(|row| row.replans as f64), 0.5),
        );
    }
    text
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

    #[test]
    fn quantiles_are_values() {
        assert_eq!(quantile(vec![3.0, 1.0, 2.0], 0.5), 2.0);
        assert_eq!(quantile(vec![3.0, 1.0, 2.0], 1.0), 3.0);
        assert_eq!(quantile(Vec::new(), 0.5), 0.0);
    }
}
