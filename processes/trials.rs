//! Trials: starts and goals from a table, each in the map that its row names.

use crate::config::FlightConfig;
use serde::Deserialize;
use simulator::Octomap;
use std::collections::HashSet;
use std::error::Error;
use std::path::{Path, PathBuf};
use supervisor::{HomeConfig, MissionConfig};

/// A row: number, map, start and goal, m. Both are free for a vehicle, as far as the table's maker knows.
#[derive(Clone, Debug, PartialEq, Deserialize)]
struct Row {
    trial: u64,
    map: String,
    start_m: [f64; 3],
    goal_m: [f64; 3],
}

/// A start and a goal in a map.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Trial {
    pub(crate) number: u64,
    pub(crate) map: PathBuf,
    start_m: [f64; 3],
    goal_m: [f64; 3],
}

/// Largest radius of the home cylinder around a trial's start, m.
const HOME_RADIUS_M: f64 = 2.0;
/// What is left free between it and what the map shows, m: as far as what was flown through unseen is open beside its rim.
const BESIDE_M: f64 = 0.2;
/// How far that cylinder reaches above the start, m.
const HOME_ABOVE_M: f64 = 0.5;
/// What is no higher above the floor is the floor's, m.
const FLOOR_M: f64 = 0.15;
/// Lowest height of trials, m.
const LOWEST_M: f64 = 0.4;

impl Trial {
    /// Reads a table (`trial,map,start x,y,z,goal x,y,z`, one header row). `{}` in `maps` stands for a row's map.
    pub(crate) fn read(table: &Path, maps: &str) -> Result<Vec<Self>, Box<dyn Error>> {
        let wrong = |error: csv::Error| format!("{}: {error}", table.display());
        let mut reader = csv::Reader::from_path(table).map_err(wrong)?;
        let (mut trials, mut seen) = (Vec::new(), HashSet::new());
        for row in reader.records() {
            let Row { trial, map, start_m, goal_m } = row.and_then(|row| row.deserialize(None)).map_err(wrong)?;
            if !start_m.iter().chain(&goal_m).all(|value| value.is_finite()) {
                return Err(format!("{}: trial {trial} has a coordinate that is not finite", table.display()).into());
            }
            if !seen.insert((trial, map.clone())) {
                return Err(format!("{}: trial {trial} of map {map} is there twice", table.display()).into());
            }
            trials.push(Self { number: trial, map: PathBuf::from(maps.replace("{}", &map)), start_m, goal_m });
        }
        Ok(trials)
    }

    /// A flight's configuration for this trial: from below its start, at the height of its start, inside its map.
    pub(crate) fn configure(&self, flight: &FlightConfig) -> Result<FlightConfig, Box<dyn Error>> {
        let map = Octomap::read(&self.map).map_err(|error| format!("{}: {error}", self.map.display()))?;
        let ([least, most], floor_m) = (map.bounds_m(), map.floor_m());
        let mut config = flight.clone();
        config.seed = self.number;
        let way = [self.goal_m[0] - self.start_m[0], self.goal_m[1] - self.start_m[1]];
        let height_m = self.start_m[2] - floor_m;
        config.mission = MissionConfig {
            start_m: [self.start_m[0], self.start_m[1]],
            start_heading_deg: way[1].atan2(way[0]).to_degrees(),
            goal_m: [self.goal_m[0], self.goal_m[1], self.goal_m[2] - floor_m],
            waypoints_m: Vec::new(),
            cruise_height_m: height_m,
            home: self.home(&map, floor_m)?,
            ..flight.mission.clone()
        };
        config.mission.fence.least_m = [least.x, least.y, LOWEST_M];
        config.mission.fence.most_m = [most.x, most.y, most.z - floor_m];
        config.check().map_err(|error| format!("trial {}: {error}", self.number))?;
        Ok(config)
    }

    /// A cylinder around the start that the map shows free from the floor on: who stands there sees that.
    fn home(&self, map: &Octomap, floor_m: f64) -> Result<HomeConfig, Box<dyn Error>> {
        let top_m = self.start_m[2] + HOME_ABOVE_M;
        let boxes = map.boxes().map_err(|error| format!("{}: {error}", self.map.display()))?;
        let beside = boxes.iter().filter(|[least, most]| most.z > floor_m + FLOOR_M && least.z < top_m);
        let away_m = beside.map(|[least, most]| {
            let [x, y] = [self.start_m[0], self.start_m[1]];
            (x - x.clamp(least.x, most.x)).hypot(y - y.clamp(least.y, most.y))
        });
        Ok(HomeConfig {
            radius_m: away_m.fold(HOME_RADIUS_M, |least_m, m| least_m.min(m - BESIDE_M)),
            height_m: top_m - floor_m,
        })
    }
}
