//! The configuration of a flight: read from RON, checked whole, snapshotted for the children.
//!
//! No flight parameter has a silent default and no key is ignored. All violations are reported together, each with
//! its file, path, value and allowed range. The files that ship are compiled in, so that the executable flies alone.

use crate::graph_config::GraphConfig;
pub use crate::vehicle_config::VehicleConfig;
use ipc_types::bounds::Bounds;
use runtime::faults::Fault;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use simulator::{Piloted, Trouble, WorldConfig, WorldError};
use std::fs;
use std::path::{Path, PathBuf};
use stereo_ingest::calibration::Rectifier;
use supervisor::MissionConfig;

/// Why a configuration was refused.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    /// A file cannot be read.
    #[error("{path}: {source}")]
    Io {
        /// The file.
        path: String,
        /// Why.
        source: std::io::Error,
    },
    /// A file is not what it should be.
    #[error("{path}:{line}:{column}: {problem}")]
    Syntax {
        /// The file.
        path: String,
        /// Line, from 1.
        line: usize,
        /// Column, from 1.
        column: usize,
        /// What is wrong there.
        problem: String,
    },
    /// A world's OctoMap file is none.
    #[error(transparent)]
    World(#[from] WorldError),
    /// Values out of range, or that do not fit each other.
    #[error("configuration has {} impossible value(s):\n  {}", .0.len(), .0.join("\n  "))]
    Impossible(Vec<String>),
}

/// The top file: names the others.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct FlightFile {
    vehicle: String,
    world: String,
    graph: String,
    mission: MissionConfig,
}

/// Everything a flight depends on. The children read it from the run directory.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FlightConfig {
    /// The vehicle.
    pub vehicle: VehicleConfig,
    /// The world.
    pub world: WorldConfig,
    /// The graph.
    pub graph: GraphConfig,
    /// The mission.
    pub mission: MissionConfig,
    /// Seed of the world and of all noise.
    pub seed: u64,
    /// Whether the planner looks at the map.
    pub avoidance: bool,
    /// Whether images are recorded.
    pub record_images: bool,
    /// Whether the simulator models camera and matcher instead of rendering pairs.
    pub noise_camera: bool,
    /// What the simulated flight is troubled with.
    pub trouble: Trouble,
    /// When a pilot flies the simulated vehicle.
    pub pilot: Vec<Piloted>,
    /// What is made to go wrong.
    pub faults: Vec<Fault>,
}

/// The configuration files that ship, compiled in.
const SHIPPED: [(&str, &str); 31] = [
    ("default.ron", include_str!("../config/default.ron")),
    ("fast.ron", include_str!("../config/fast.ron")),
    ("forest_100.ron", include_str!("../config/forest_100.ron")),
    ("behind.ron", include_str!("../config/behind.ron")),
    ("corridor.ron", include_str!("../config/corridor.ron")),
    ("corner.ron", include_str!("../config/corner.ron")),
    ("cul_de_sac.ron", include_str!("../config/cul_de_sac.ron")),
    ("canopy.ron", include_str!("../config/canopy.ron")),
    ("hedge.ron", include_str!("../config/hedge.ron")),
    ("thesis_large.ron", include_str!("../config/thesis_large.ron")),
    ("thesis_small.ron", include_str!("../config/thesis_small.ron")),
    ("thicket.ron", include_str!("../config/thicket.ron")),
    ("vehicles/scout.ron", include_str!("../config/vehicles/scout.ron")),
    ("vehicles/swift.ron", include_str!("../config/vehicles/swift.ron")),
    ("vehicles/thesis_large.ron", include_str!("../config/vehicles/thesis_large.ron")),
    ("vehicles/thesis_small.ron", include_str!("../config/vehicles/thesis_small.ron")),
    ("vehicles/wren.ron", include_str!("../config/vehicles/wren.ron")),
    ("worlds/forest.ron", include_str!("../config/worlds/forest.ron")),
    ("worlds/long_forest.ron", include_str!("../config/worlds/long_forest.ron")),
    ("worlds/sparse_forest.ron", include_str!("../config/worlds/sparse_forest.ron")),
    ("worlds/thicket.ron", include_str!("../config/worlds/thicket.ron")),
    ("worlds/field.ron", include_str!("../config/worlds/field.ron")),
    ("worlds/wall.ron", include_str!("../config/worlds/wall.ron")),
    ("worlds/corridor.ron", include_str!("../config/worlds/corridor.ron")),
    ("worlds/corner.ron", include_str!("../config/worlds/corner.ron")),
    ("worlds/cul_de_sac.ron", include_str!("../config/worlds/cul_de_sac.ron")),
    ("worlds/canopy.ron", include_str!("../config/worlds/canopy.ron")),
    ("worlds/hedge.ron", include_str!("../config/worlds/hedge.ron")),
    ("graphs/droan.ron", include_str!("../config/graphs/droan.ron")),
    ("graphs/droan_640.ron", include_str!("../config/graphs/droan_640.ron")),
    ("faults/example.ron", include_str!("../config/faults/example.ron")),
];

/// The shipped file of a name that was asked for: `fast` is `fast.ron`.
fn shipped(folder: &str, name: &str) -> Option<String> {
    let file = format!("{folder}{name}.ron");
    (!name.contains('/') && SHIPPED.iter().any(|(shipped, _)| *shipped == file)).then_some(file)
}

/// Largest configuration file, bytes.
const LARGEST_FILE: u64 = 1 << 20;

/// Where files come from: a folder, or the shipped ones.
enum Source {
    Shipped,
    Folder(PathBuf),
}

impl Source {
    /// Label for messages, and text.
    fn read(&self, name: &str) -> Result<(String, String), ConfigError> {
        match self {
            Self::Shipped => match SHIPPED.iter().find(|(shipped, _)| *shipped == name) {
                Some((_, text)) => Ok((format!("config/{name}"), (*text).to_owned())),
                None => {
                    let source = std::io::Error::new(std::io::ErrorKind::NotFound, "not among the shipped files");
                    Err(ConfigError::Io { path: format!("config/{name}"), source })
                }
            },
            Self::Folder(folder) => {
                let path = folder.join(name);
                let label = path.display().to_string();
                read_text(&path).map(|text| (label, text))
            }
        }
    }
}

impl Source {
    /// The world that was asked for, else the flight's own: a shipped one, a RON file or an OctoMap file.
    fn world(&self, asked: Option<&str>, own: &str) -> Result<(String, WorldConfig), ConfigError> {
        let place = asked.unwrap_or(own);
        if Path::new(place).extension().is_some_and(|extension| extension == "bt") {
            return Ok((place.to_owned(), FlightConfig::load_world(Path::new(place))?));
        }
        let (label, text) = match (asked.and_then(|name| shipped("worlds/", name)), asked) {
            (Some(name), _) => Self::Shipped.read(&name)?,
            (None, Some(path)) => (path.to_owned(), read_text(Path::new(path))?),
            (None, None) => self.read(own)?,
        };
        let mut world: WorldConfig = parse(&label, &text)?;
        let folder = Path::new(&label).parent().unwrap_or(Path::new(""));
        // Absolute: the processes of a run may stand elsewhere.
        let whole = |file: PathBuf| std::path::absolute(folder.join(&file)).unwrap_or(file);
        world.octomap = world.octomap.map(whole);
        Ok((label, world))
    }
}

pub(crate) fn read_text(path: &Path) -> Result<String, ConfigError> {
    let io = |source| ConfigError::Io { path: path.display().to_string(), source };
    let size = fs::metadata(path).map_err(io)?.len();
    if size > LARGEST_FILE {
        let message = format!("has {size} bytes, a configuration may have {LARGEST_FILE}");
        return Err(io(std::io::Error::new(std::io::ErrorKind::FileTooLarge, message)));
    }
    fs::read_to_string(path).map_err(io)
}

pub(crate) fn parse<T: DeserializeOwned>(path: &str, text: &str) -> Result<T, ConfigError> {
    ron::from_str(text).map_err(|error| ConfigError::Syntax {
        path: path.to_owned(),
        line: error.span.start.line,
        column: error.span.start.col,
        problem: error.code.to_string(),
    })
}

impl FlightConfig {
    /// Reads a flight file and the files it names, or shipped ones: `path` may be the name of such a flight, and is
    /// `default` if not given. Another world may be asked for: a file, or the name of a shipped one. Checks each file's values; [`FlightConfig::check`] checks how they fit.
    ///
    /// # Errors
    /// The first file that cannot be read or parsed; else all impossible values.
    pub fn load(path: Option<&Path>, world: Option<&str>) -> Result<Self, ConfigError> {
        let named = path.map_or(Some("default"), Path::to_str).and_then(|name| shipped("", name));
        let (source, top) = match (named, path.unwrap_or(Path::new(""))) {
            (Some(name), _) => (Source::Shipped, name),
            (None, path) => {
                let folder = path.parent().unwrap_or(Path::new("")).to_owned();
                (Source::Folder(folder), path.file_name().unwrap_or_default().to_string_lossy().into_owned())
            }
        };
        let (label, text) = source.read(&top)?;
        let file: FlightFile = parse(&label, &text)?;
        let (vehicle_path, text) = source.read(&file.vehicle)?;
        let vehicle: VehicleConfig = parse(&vehicle_path, &text)?;
        let (world_path, world) = source.world(world, &file.world)?;
        let (graph_path, text) = source.read(&file.graph)?;
        let graph = parse(&graph_path, &text)?;
        let config = Self {
            vehicle,
            world,
            graph,
            mission: file.mission,
            seed: 0,
            avoidance: true,
            record_images: false,
            noise_camera: false,
            trouble: Trouble::default(),
            pilot: Vec::new(),
            faults: Vec::new(),
        };
        let files = [label, vehicle_path, world_path, graph_path];
        config.check_values(&files)?;
        Ok(config)
    }

    /// Reads a flight as [`FlightConfig::load`] does, for the simulator, whose images are rectified pairs.
    ///
    /// # Errors
    /// As there; or the vehicle does not fly on pairs.
    pub fn load_for_simulator(path: Option<&Path>, world: Option<&str>) -> Result<Self, Box<dyn std::error::Error>> {
        let mut config = Self::load(path, world)?;
        (config.vehicle.calibration, config.vehicle.camera) = (None, None);
        match config.vehicle.source {
            stereo_ingest::Source::Stereo => Ok(config),
            source => Err(format!("vehicle.source is {source:?}, the simulator renders stereo pairs").into()),
        }
    }

    /// Reads an OctoMap file as a world.
    ///
    /// # Errors
    /// It is none.
    pub fn load_world(path: &Path) -> Result<WorldConfig, ConfigError> {
        let path =
            std::path::absolute(path).map_err(|source| ConfigError::Io { path: path.display().to_string(), source })?;
        Ok(WorldConfig::of_octomap(&path)?)
    }

    /// Reads a snapshot that [`FlightConfig::snapshot`] wrote.
    ///
    /// # Errors
    /// It cannot be read, or is not one.
    pub fn load_snapshot(path: &Path) -> Result<Self, ConfigError> {
        Self::parse_snapshot(&path.display().to_string(), &read_text(path)?)
    }

    /// A configuration from what [`FlightConfig::snapshot`] wrote; `name` says where it is from.
    ///
    /// # Errors
    /// It is none.
    pub fn parse_snapshot(name: &str, text: &str) -> Result<Self, ConfigError> {
        parse(name, text)
    }

    /// The whole configuration as RON.
    pub fn snapshot(&self) -> String {
        let pretty = ron::ser::PrettyConfig::new().compact_arrays(true);
        // Plain structures of numbers and texts always serialise.
        ron::ser::to_string_pretty(self, pretty).unwrap_or_else(|_| unreachable!("plain data"))
    }

    fn check_values(&self, [flight, vehicle, world, graph]: &[String; 4]) -> Result<(), ConfigError> {
        let mut bounds = Bounds::default();
        bounds.section(&format!("{vehicle}: "), |bounds| self.vehicle.check(bounds));
        bounds.section(&format!("{world}: "), |bounds| self.world.check(bounds));
        bounds.section(&format!("{graph}: "), |bounds| self.graph.check(bounds));
        bounds.section(&format!("{flight}: "), |bounds| bounds.section("mission", |bounds| self.mission.check(bounds)));
        impossible(bounds)
    }

    /// Checks values, wherever they came from, and how vehicle and mission fit each other.
    ///
    /// # Errors
    /// All impossible values.
    pub fn check(&self) -> Result<(), ConfigError> {
        let mut bounds = Bounds::default();
        bounds.section("vehicle", |bounds| self.vehicle.check(bounds));
        bounds.section("world", |bounds| self.world.check(bounds));
        bounds.section("graph", |bounds| self.graph.check(bounds));
        bounds.section("mission", |bounds| self.mission.check(bounds));
        bounds.section("trouble", |bounds| self.trouble.check(bounds));
        bounds.section("pilot", |bounds| self.pilot.iter().for_each(|piloted| piloted.check(bounds)));
        crate::fault_file::check(&self.faults, &mut bounds);
        self.check_stopping(&mut bounds);
        self.check_places(&mut bounds);
        self.check_home(&mut bounds);
        self.check_deadlines(&mut bounds);
        impossible(bounds)
    }

    /// Checks the vehicle alone: what a replay needs.
    ///
    /// # Errors
    /// All impossible values.
    pub fn check_vehicle(&self) -> Result<(), ConfigError> {
        let mut bounds = Bounds::default();
        bounds.section("vehicle", |bounds| self.vehicle.check(bounds));
        impossible(bounds)
    }

    /// How raw images become the rig's, where they are raw; checked by [`Self::check_vehicle`].
    pub fn rectifier(&self) -> Option<Rectifier> {
        let raw = self.vehicle.calibration.as_ref()?;
        raw.rectify().ok().map(|rectification| Rectifier::new(raw, &rectification))
    }

    /// Free-space evidence with a swept radius below what the slowest plan commits to: else the vehicle could creep,
    /// plan by plan, into what it has not seen. Its home is where the body's centre may be for the body to stay inside the
    /// cylinder that the operator declares free.
    pub fn free_space(&self) -> memory::FreeSpaceRule {
        let (flown, home, body) = (self.vehicle.memory.free_space, self.mission.home, &self.vehicle.expansion);
        let least_m = self.vehicle.planner.least_commitment_m(self.mission.cruise_speed_mps);
        let swept_radius_m = flown.swept_radius_m.min(0.9 * least_m);
        let radius_m = (home.radius_m - f64::from(body.body_radius_m)).max(0.0);
        let height_m = (home.height_m - f64::from(body.body_half_height_m)).max(0.0);
        memory::FreeSpaceConfig { swept_radius_m, ..flown }.with_home(radius_m, height_m)
    }

    /// Range at which the noise is still small against the vehicle: σ_z = z²·σ/(f·b) + σ_m = radius, m.
    pub fn sensing_range_m(&self) -> f64 {
        let vehicle = &self.vehicle;
        let radius_m = f64::from(vehicle.expansion.radius_m);
        let (sigma_px, sigma_m) = (f64::from(vehicle.noise.sigma_px), f64::from(vehicle.noise.sigma_m));
        let range_m = ((radius_m - sigma_m).max(0.0) * vehicle.rig.focal_baseline_px_m() / sigma_px).sqrt();
        match vehicle.source {
            stereo_ingest::Source::Depth { farthest_m, .. } => range_m.min(farthest_m),
            _ => range_m,
        }
    }

    /// Speed from which the vehicle can just stop, without delay, within what its sensor is good for: √(2·a·R), m/s.
    pub fn braking_limit_mps(&self) -> f64 {
        (2.0 * self.vehicle.planner.braking_mps2 * self.sensing_range_m()).sqrt()
    }

    fn check_stopping(&self, bounds: &mut Bounds) {
        let (vehicle, speed_mps) = (&self.vehicle, self.mission.cruise_speed_mps);
        let stopping_m = vehicle.planner.stopping_distance_m(speed_mps) + f64::from(vehicle.expansion.radius_m);
        let range_m = self.sensing_range_m();
        bounds.require(
            stopping_m < range_m,
            "mission.cruise_speed_mps",
            format_args!(
                "is {speed_mps} m/s: stopping takes {stopping_m:.1} m, but the sensor is good for {range_m:.1} m"
            ),
        );
        let radius_m = f64::from(vehicle.expansion.radius_m);
        bounds.require(
            radius_m < range_m,
            "vehicle.expansion.radius_m",
            format_args!("is {radius_m}, must be less than the {range_m:.2} m that the sensor is good for"),
        );
        // Level acceleration at the candidates' limit against drag at cruise speed.
        let pull_mps2 = vehicle.planner.acceleration_mps2 + vehicle.simulator.vehicle.drag_hz * speed_mps;
        let tilt_deg = (pull_mps2 / 9.806_65).atan().to_degrees();
        let margin_deg = vehicle.rig.half_view_up_rad().to_degrees() + vehicle.mount.pitch_up_deg - tilt_deg;
        let least_deg = vehicle.planner.least_view_up_deg;
        bounds.require(
            margin_deg >= least_deg,
            "vehicle.mount.pitch_up_deg",
            format_args!(
                "is {}: tilted by {tilt_deg:.0} degrees the camera sees {margin_deg:.0} degrees above the flight path, planner.least_view_up_deg is {least_deg}",
                vehicle.mount.pitch_up_deg
            ),
        );
    }

    /// Take-off place against fence.
    fn check_places(&self, bounds: &mut Bounds) {
        let (fence, start) = (self.mission.fence, self.mission.start_m);
        let is_inside = |axis: usize, place: f64| (fence.least_m[axis]..=fence.most_m[axis]).contains(&place);
        bounds.require(
            is_inside(0, start[0]) && is_inside(1, start[1]),
            "mission.start_m",
            format_args!("is {start:?}, must be inside the fence"),
        );
    }

    /// The cylinder that is declared free must hold the body, up to where take-off ends.
    fn check_home(&self, bounds: &mut Bounds) {
        let (home, body) = (self.mission.home, &self.vehicle.expansion);
        bounds.require(
            home.radius_m > f64::from(body.body_radius_m),
            "mission.home.radius_m",
            format_args!("is {}, must exceed the body's radius, {} m", home.radius_m, body.body_radius_m),
        );
        let top_m = self.mission.cruise_height_m + f64::from(body.body_half_height_m);
        bounds.require(
            home.height_m >= top_m,
            "mission.home.height_m",
            format_args!("is {}, must hold the body at cruise_height_m, up to {top_m:.2} m", home.height_m),
        );
    }

    /// What counts as stale against how often and how late it comes.
    fn check_deadlines(&self, bounds: &mut Bounds) {
        let camera = self.vehicle.simulator.camera;
        let oldest_s = 1.0 / camera.rate_hz + camera.latency_ms * 1e-3;
        let deadline_s = self.vehicle.planner.image_deadline_s;
        bounds.require(
            deadline_s > oldest_s,
            "vehicle.planner.image_deadline_s",
            format_args!("is {deadline_s}, must exceed the camera's interval and latency, {oldest_s:.3} s"),
        );
    }
}

pub(crate) fn impossible(bounds: Bounds) -> Result<(), ConfigError> {
    // A section that names a file ends in a colon; the path goes on after it.
    let violations: Vec<_> = bounds.into_violations().into_iter().map(|text| text.replacen(": .", ": ", 1)).collect();
    if violations.is_empty() { Ok(()) } else { Err(ConfigError::Impossible(violations)) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_ships_is_possible() {
        for flight in [None, Some("default"), Some("fast")] {
            for world in [None, Some("forest"), Some("long_forest"), Some("field"), Some("wall")] {
                let config = FlightConfig::load(flight.map(Path::new), world).expect("loads");
                config.check().expect("fits");
                let snapshot = config.snapshot();
                assert_eq!(parse::<FlightConfig>("snapshot", &snapshot).expect("reads back"), config);
            }
        }
        let top = std::fs::read_dir(concat!(env!("CARGO_MANIFEST_DIR"), "/config")).expect("there").flatten();
        // A file counts as one, a folder as what is in it.
        let files = top.map(|entry| std::fs::read_dir(entry.path()).map_or(1, Iterator::count));
        assert_eq!(files.sum::<usize>(), SHIPPED.len(), "every file of config/ is compiled in");
    }

    #[test]
    fn violations_are_reported_together() {
        let mut config = FlightConfig::load(None, None).expect("loads");
        config.vehicle.noise.sigma_px = f32::NAN;
        config.mission.cruise_speed_mps = 19.0;
        config.vehicle.mount.pitch_up_deg = -30.0;
        let Err(ConfigError::Impossible(violations)) = config.check() else { panic!("accepted") };
        assert!(violations.iter().any(|v| v.starts_with("vehicle.noise.sigma_px is NaN")), "{violations:?}");
        assert!(violations.len() >= 3, "{violations:?}");
    }
}
