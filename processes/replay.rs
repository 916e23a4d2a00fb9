//! `sparrowhawk replay`: a real stereo pair through the multi-process graph.

use crate::config::FlightConfig;
use crate::fly::command;
use crate::graph_config::Member;
use crate::run_files::{RunFiles, fresh_name};
use clap::Args;
use ipc_types::disparity::{NO_MATCH, encode, is_valid};
use ipc_types::messages::{ExpandedPlanes, Keyframe, UNKNOWN_FRONT};
use ipc_types::topics::{Disparity, Expanded, HealthReports, Keyframes, StereoFrames, Topic};
use ipc_types::wire::Header;
use ipc_types::{Body, Point, Pose, ProcessId, StereoRig, World};
use memory::{FreeSpace, Occupancy, View};
use runtime::ipc::{IpcPorts, Services};
use runtime::run_dir::RunDir;
use runtime::{Connect, Message, Ports};
use serde::Serialize;
use std::collections::BTreeMap;
use std::error::Error;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::{Duration, Instant};
use stereo_ingest::calibration::StereoCalibration;
use stereo_ingest::{Calibration, DisparityError, GroundTruth, StereoPair, save_disparity};
use supervisor::{ATTENTION, Happening, SignalWatch, Supervision};

/// Options of a replay.
#[derive(Clone, Debug, Args)]
pub(crate) struct ReplayArguments {
    /// Left image: PNG, JPEG, PGM/PPM or BMP; rectified, or raw with a raw calibration.
    left: PathBuf,
    /// Right image, of the same size.
    right: PathBuf,
    /// Calibration file or folder: a RON rig or Middlebury's calib.txt (rectified); ROS, Kalibr, EuRoC, OpenCV or RON (raw).
    #[arg(long, value_name = "FILE|FOLDER", conflicts_with_all = ["focal", "baseline"])]
    calib: Option<PathBuf>,
    /// Focal length, px, instead of a calibration file.
    #[arg(long, value_name = "PX", requires = "baseline")]
    focal: Option<f64>,
    /// Baseline, m.
    #[arg(long, value_name = "M", requires = "focal")]
    baseline: Option<f64>,
    /// Principal point, px: x,y. The image's centre if not given.
    #[arg(long, value_name = "X,Y", value_parser = parse_pair)]
    centre: Option<[f64; 2]>,
    /// Difference of the principal points' columns, px.
    #[arg(long, value_name = "PX", default_value_t = 0.0, allow_hyphen_values = true)]
    doffs: f64,
    /// Disparities searched: 16, 32, 64, 96, 128, 192 or 256.
    #[arg(long, value_name = "PX", default_value_t = 64)]
    max_disparity: u32,
    /// Mean horizontal difference that counts as texture, grey levels: above the camera's noise.
    #[arg(long, value_name = "GREY", default_value_t = 1.0)]
    least_texture: f32,
    /// Longest unmatched run that takes the nearer of its ends, px; a twelfth of the image's width if not given.
    #[arg(long, value_name = "PX")]
    hole: Option<u32>,
    /// True disparities: 16-bit PNG (px × 256) or PFM.
    #[arg(long, value_name = "FILE")]
    ground_truth: Option<PathBuf>,
    /// Image of the pixels to score (bright).
    #[arg(long, value_name = "FILE", requires = "ground_truth")]
    mask: Option<PathBuf>,
    /// Write PREFIX-disparity.*, PREFIX-front.*, PREFIX-back.*, and PREFIX-occupied.*: the first occupied point of each ray.
    #[arg(long, value_name = "PREFIX")]
    out: Option<PathBuf>,
    /// Kind of those files.
    #[arg(long, value_name = "KIND", default_value = "png", value_parser = ["png", "pfm"])]
    format: String,
    /// Write the summary to this file.
    #[arg(long, value_name = "FILE")]
    summary: Option<PathBuf>,
    /// Flight file whose vehicle parameters are used, apart from the rig.
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Name of the run.
    #[arg(long, value_name = "NAME")]
    run: Option<String>,
    /// Where run directories go.
    #[arg(long, value_name = "DIR", default_value = "runs")]
    run_dir: PathBuf,
}

fn parse_pair(text: &str) -> Result<[f64; 2], String> {
    let values: Result<Vec<f64>, _> = text.split(',').map(|value| value.trim().parse()).collect();
    let expected = || format!("is \"{text}\", expected two numbers x,y");
    values.map_err(|_| expected())?.try_into().map_err(|_| expected())
}

/// Name and operating-system number of a process.
type ProcessNumber = (String, Option<u32>);

/// Instant of publication, ns of flight time, and elements of a message.
type Product<E> = (i64, Vec<E>);

/// What a replay found.
#[derive(Debug, Serialize)]
struct ReplaySummary {
    width_px: u32,
    height_px: u32,
    valid_percent: f64,
    textureless_percent: f64,
    expanded_unknown_percent: f64,
    /// Points asked, all in view of the camera.
    occupancy_points: usize,
    free_percent: f64,
    occupied_percent: f64,
    unknown_percent: f64,
    keyframes: usize,
    stereo_ms: f64,
    expansion_ms: f64,
    memory_ms: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    disparity_error: Option<DisparityError>,
    pids: Vec<ProcessNumber>,
}

/// What the graph made of the pair.
#[derive(Default)]
struct Products {
    /// Published at, ns of flight time; disparity, planes, keyframes.
    frame_ns: i64,
    disparity: Option<Product<u16>>,
    expanded: Option<Product<u16>>,
    keyframes: Option<Product<Keyframe>>,
}

/// Longest wait for the graph to digest a pair.
const PATIENCE: Duration = Duration::from_secs(60);

pub(crate) fn replay(arguments: &ReplayArguments) -> Result<ExitCode, Box<dyn Error>> {
    let pair = StereoPair::load(&arguments.left, &arguments.right)?;
    let (rig, calibration) = arguments.rig(&pair)?;
    let mut config = FlightConfig::load(arguments.config.as_deref(), None)?;
    config.vehicle.rig = rig;
    config.vehicle.calibration = calibration;
    config.vehicle.stereo.max_disparity_px = arguments.max_disparity;
    config.vehicle.stereo.least_texture = arguments.least_texture;
    config.vehicle.expansion.hole_px = arguments.hole.unwrap_or((pair.width_px / 12).min(128));
    let truth = arguments.ground_truth.as_deref();
    let truth = truth.map(|path| GroundTruth::load(path, arguments.mask.as_deref(), pair.width_px, pair.height_px));
    let truth = truth.transpose()?;
    config.check_vehicle()?;
    let signals = SignalWatch::begin()?;
    let name = arguments.run.clone().unwrap_or_else(fresh_name);
    let run = RunDir::named(&name)?;
    let lock = run.take()?;
    let files = RunFiles::create(&arguments.run_dir, &name, &config, arguments.summary.as_deref())?;
    let (products, view, pids) = digest(arguments, &config, &run, files.folder(), signals)?;
    drop(lock);
    let summary = summarise(&config, &products, &view, truth.as_ref(), pids);
    if let Some(prefix) = &arguments.out {
        write_images(prefix, &arguments.format, &config, &products, &view)?;
    }
    print(&summary);
    files.write_summary(&summary)?;
    Ok(ExitCode::SUCCESS)
}

impl ReplayArguments {
    /// The rectified rig, and the raw cameras that become it, if they are raw.
    fn rig(&self, pair: &StereoPair) -> Result<(StereoRig, Option<StereoCalibration>), Box<dyn Error>> {
        if let Some(path) = &self.calib {
            return match Calibration::load(path, Some((pair.width_px, pair.height_px)))? {
                Calibration::Rectified(rig) => Ok((rig, None)),
                Calibration::Raw(raw) => Ok((raw.rectify()?.rig, Some(*raw))),
            };
        }
        let (Some(focal_px), Some(baseline_m)) = (self.focal, self.baseline) else {
            return Err("no calibration: give --calib FILE, or --focal PX and --baseline M".into());
        };
        let [cx_px, cy_px] = self.centre.unwrap_or([f64::from(pair.width_px) / 2.0, f64::from(pair.height_px) / 2.0]);
        let (width_px, height_px) = (pair.width_px, pair.height_px);
        Ok((StereoRig { width_px, height_px, focal_px, cx_px, cy_px, baseline_m, doffs_px: self.doffs }, None))
    }
}

/// Runs the graph until it has made everything of the pair.
fn digest(
    arguments: &ReplayArguments,
    config: &FlightConfig,
    run: &RunDir,
    folder: &Path,
    signals: SignalWatch,
) -> Result<(Products, View, Vec<ProcessNumber>), Box<dyn Error>> {
    let services = Services::create(run)?;
    let mut ports = IpcPorts::open(run, ProcessId::Supervisor, 0, &config.vehicle.rig, |ports| {
        ports.reads::<StereoFrames>();
        ports.reads::<Disparity>();
        ports.reads::<Expanded>();
        ports.reads::<Keyframes>();
        ports.reads::<HealthReports>();
    })?;
    // The player takes the place of world and vehicle, for which nothing is planned.
    let flies =
        |member: &&Member| matches!(member.process, ProcessId::Simulator | ProcessId::Planner | ProcessId::Controller);
    let digesting = config.graph.processes.iter().filter(|member| !flies(member)).copied();
    let player = Member { process: ProcessId::Player, restarts: false, is_essential: true };
    let commands: std::io::Result<Vec<_>> =
        digesting.chain([player]).map(|member| command(config, run, folder, member)).collect();
    let mut commands = commands?;
    if let Some(player) = commands.last_mut() {
        let files = [("--left", &arguments.left), ("--right", &arguments.right)];
        player.arguments.extend(files.iter().flat_map(|(flag, path)| [(*flag).to_owned(), path.display().to_string()]));
    }
    let mut supervision = Supervision::start(commands, signals)?;
    let (started, mut gathered) = (Instant::now(), Gathered::new());
    let (products, view) = loop {
        if let Some(complete) = gathered.complete() {
            // The images lie in the run's shared memory, which goes when the graph stops: ask before. A newer showing
            // may have taken the keyframe's place already; then it is its turn.
            let view = complete.view(config, &mut ports);
            if view.keyframes() > 0 {
                break (complete, view);
            }
        }
        match supervision.attend(&services, ATTENTION) {
            Happening::Signal(_) => return Err("interrupted".into()),
            Happening::RunEnded(process, how) => return Err(format!("{process} {how}").into()),
            Happening::Died(process, how) => eprintln!("sparrowhawk: {process} {how}: restarting it"),
            Happening::GivenUp(process, how) => eprintln!("sparrowhawk: {process} {how}: going on without it"),
            Happening::Nothing => {}
        }
        gathered.take(&mut ports);
        while let Some(health) = ports.receive::<HealthReports>() {
            supervision.heard(health.header());
        }
        supervision.kill_silent();
        if started.elapsed() > PATIENCE {
            return Err(format!("the graph did not digest the pair within {} s", PATIENCE.as_secs()).into());
        }
    };
    let pids = supervision.stop().iter().map(|child| (child.process.name().to_owned(), child.pid)).collect();
    Ok((products, view, pids))
}

/// Products by exposure: stages are at work on different ones at a time.
struct Gathered(BTreeMap<i64, Products>);

impl Gathered {
    fn new() -> Self {
        Self(BTreeMap::new())
    }

    /// The products of an exposure that has passed all stages.
    fn complete(&mut self) -> Option<Products> {
        let is_complete = |p: &Products| p.disparity.is_some() && p.expanded.is_some() && p.keyframes.is_some();
        let exposure = *self.0.iter().find(|(_, products)| is_complete(products))?.0;
        self.0.remove(&exposure)
    }

    fn take(&mut self, ports: &mut IpcPorts) {
        while let Some(frame) = ports.receive::<StereoFrames>() {
            let stamp = *frame.header().stamp();
            self.0.entry(stamp.valid_ns).or_default().frame_ns = stamp.published_ns;
        }
        while let Some((exposure, product)) = next::<Disparity>(ports) {
            self.0.entry(exposure).or_default().disparity = Some(product);
        }
        while let Some((exposure, product)) = next::<Expanded>(ports) {
            self.0.entry(exposure).or_default().expanded = Some(product);
        }
        while let Some((exposure, product)) = next::<Keyframes>(ports) {
            self.0.entry(exposure).or_default().keyframes = Some(product);
        }
        // The pair is shown again and again; what is old will not be completed any more.
        while self.0.len() > MOST_AT_WORK {
            self.0.pop_first();
        }
    }
}

/// Exposures in the pipeline at a time, at most: one in each stage, and spares.
const MOST_AT_WORK: usize = 64;

/// Exposure, publication and elements of the next message.
fn next<T: Topic>(ports: &mut IpcPorts) -> Option<(i64, Product<T::Element>)> {
    let message = ports.receive::<T>()?;
    let stamp = message.header().stamp();
    Some((stamp.valid_ns, (stamp.published_ns, message.elements().to_vec())))
}

impl Products {
    /// The map as a planner would see it.
    fn view(&self, config: &FlightConfig, ports: &mut IpcPorts) -> View {
        let vehicle = &config.vehicle;
        let nowhere = FreeSpace::new(vehicle.memory.free_space, Point::new(0.0, 0.0, -1e6));
        let mut view = View::new(vehicle.rig, vehicle.noise, nowhere);
        for keyframe in self.keyframes.iter().flat_map(|(_, keyframes)| keyframes) {
            if let (Some(pose), Some(image)) = (keyframe.world_from_camera(), ports.images().get(keyframe.image_id)) {
                view.push(pose, image);
            }
        }
        view
    }
}

/// Depths at which occupancy is asked: 0.5 m to 12 m, each a tenth farther than the one before.
fn depths_m() -> impl Iterator<Item = f64> {
    std::iter::successors(Some(0.5), |depth_m| Some(depth_m * 1.1)).take_while(|&depth_m| depth_m <= 12.0)
}

/// The point on a pixel's ray at a depth. The vehicle stands at the world's origin and looks along its x axis.
fn in_view(config: &FlightConfig, column: f64, row: f64, depth_m: f64) -> Point<World> {
    let rig = config.vehicle.rig;
    let world_from_camera = Pose::<World, Body>::IDENTITY * config.vehicle.mount.body_from_camera();
    world_from_camera * rig.back_project(column, row, rig.disparity_px(depth_m))
}

/// Points on every eighth pixel's ray: free, occupied, unknown.
fn occupancy_in_view(config: &FlightConfig, view: &View) -> [usize; 3] {
    let rig = config.vehicle.rig;
    let mut counts = [0; 3];
    for row in (0..rig.height_px).step_by(8) {
        for column in (0..rig.width_px).step_by(8) {
            for depth_m in depths_m() {
                let place = in_view(config, f64::from(column), f64::from(row), depth_m);
                counts[match view.occupancy(place, config.vehicle.planner.gamma_low) {
                    Occupancy::Free => 0,
                    Occupancy::Occupied => 1,
                    Occupancy::Unknown(_) => 2,
                }] += 1;
            }
        }
    }
    counts
}

fn summarise(
    config: &FlightConfig,
    products: &Products,
    view: &View,
    truth: Option<&GroundTruth>,
    pids: Vec<ProcessNumber>,
) -> ReplaySummary {
    let rig = config.vehicle.rig;
    let empty = (0, Vec::new());
    let (disparity_ns, disparity) = products.disparity.as_ref().unwrap_or(&empty);
    let (expanded_ns, planes) = products.expanded.as_ref().unwrap_or(&empty);
    let (keyframes_ns, keyframes) = products.keyframes.as_ref().map_or((0, 0), |(ns, list)| (*ns, list.len()));
    let percent = |part: usize, whole: usize| 100.0 * part as f64 / whole.max(1) as f64;
    let count = |code: fn(&u16) -> bool| disparity.iter().filter(|pixel| code(pixel)).count();
    let unknown = ExpandedPlanes::split(planes, rig.pixels())
        .map_or(0, |planes| planes.front.iter().filter(|&&front| front == UNKNOWN_FRONT).count());
    let counts = occupancy_in_view(config, view);
    let points = counts.iter().sum();
    let ms = |from: i64, to: i64| (to - from) as f64 * 1e-6;
    ReplaySummary {
        width_px: rig.width_px,
        height_px: rig.height_px,
        valid_percent: percent(count(|&pixel| is_valid(pixel)), rig.pixels()),
        textureless_percent: percent(count(|&pixel| pixel == ipc_types::disparity::TEXTURELESS), rig.pixels()),
        expanded_unknown_percent: percent(unknown, rig.pixels()),
        occupancy_points: points,
        free_percent: percent(counts[0], points),
        occupied_percent: percent(counts[1], points),
        unknown_percent: percent(counts[2], points),
        keyframes,
        stereo_ms: ms(products.frame_ns, *disparity_ns),
        expansion_ms: ms(*disparity_ns, *expanded_ns),
        memory_ms: ms(*expanded_ns, keyframes_ns),
        disparity_error: truth.map(|truth| truth.score(disparity)),
        pids,
    }
}

/// Disparity of the first occupied point on every pixel's ray, asked as in [`occupancy_in_view`]; 0 where there is none.
fn first_occupied(config: &FlightConfig, view: &View) -> Vec<u16> {
    let rig = config.vehicle.rig;
    let first = |index: usize| {
        let (row, column) = (index / rig.width_px as usize, index % rig.width_px as usize);
        let is_occupied = |depth_m: &f64| {
            let place = in_view(config, column as f64, row as f64, *depth_m);
            view.occupancy(place, config.vehicle.planner.gamma_low) == Occupancy::Occupied
        };
        depths_m().find(is_occupied).map_or(NO_MATCH, |depth_m| encode(rig.disparity_px(depth_m) as f32))
    };
    (0..rig.pixels()).map(first).collect()
}

fn write_images(
    prefix: &Path,
    kind: &str,
    config: &FlightConfig,
    products: &Products,
    view: &View,
) -> Result<(), Box<dyn Error>> {
    let rig = config.vehicle.rig;
    let file = |name: &str| PathBuf::from(format!("{}-{name}.{kind}", prefix.display()));
    if let Some((_, disparity)) = &products.disparity {
        save_disparity(&file("disparity"), rig.width_px, rig.height_px, disparity)?;
    }
    if let Some((_, elements)) = &products.expanded
        && let Some(planes) = ExpandedPlanes::split(elements, rig.pixels())
    {
        // Unknown pixels hold the largest value, which in a file would read as nearest.
        let known = |plane: &[u16]| -> Vec<u16> {
            plane.iter().map(|&value| if value == UNKNOWN_FRONT { 0 } else { value }).collect()
        };
        save_disparity(&file("front"), rig.width_px, rig.height_px, &known(planes.front))?;
        save_disparity(&file("back"), rig.width_px, rig.height_px, &known(planes.back))?;
    }
    save_disparity(&file("occupied"), rig.width_px, rig.height_px, &first_occupied(config, view))?;
    Ok(())
}

fn print(summary: &ReplaySummary) {
    println!("image                  {} x {} px", summary.width_px, summary.height_px);
    println!(
        "disparity              {:.1} % matched, {:.1} % textureless, {:.1} ms",
        summary.valid_percent, summary.textureless_percent, summary.stereo_ms
    );
    println!(
        "expanded               {:.1} % unknown, {:.1} ms",
        summary.expanded_unknown_percent, summary.expansion_ms
    );
    println!(
        "occupancy              {:.1} % free, {:.1} % occupied, {:.1} % unknown of {} points in view, 0.5 to 12 m deep; {} keyframe(s), {:.1} ms",
        summary.free_percent,
        summary.occupied_percent,
        summary.unknown_percent,
        summary.occupancy_points,
        summary.keyframes,
        summary.memory_ms
    );
    if let Some(error) = &summary.disparity_error {
        println!(
            "against ground truth   density {:.1} %, off by more than 1/2/3 px {:.2}/{:.2}/{:.2} %, mean error {:.2} px over {} px",
            error.density_percent,
            error.bad_percent[0],
            error.bad_percent[1],
            error.bad_percent[2],
            error.mean_error_px,
            error.scored
        );
        let [one, two, three] = error.bad_or_unmatched_percent;
        println!("unmatched as bad       {one:.2}/{two:.2}/{three:.2} %");
    }
}
