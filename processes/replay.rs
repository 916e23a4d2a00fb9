//! `sparrowhawk replay`: real images through the multi-process graph.

use crate::config::FlightConfig;
use crate::flight_run::command;
use crate::graph::map_model;
use crate::log_replay::{self, LogArguments, Told};
use crate::replay_input::{Input, InputArguments};
use crate::replay_report::{FrameFigures, print, summarise, write_images};
use crate::run_files::{RunFiles, fresh_name};
use crate::say::say;
use clap::Args;
use indicatif::{ProgressBar, ProgressStyle};
use ipc_types::disparity::is_valid;
use ipc_types::messages::{Health, Keyframe};
use ipc_types::topics::{DepthFrames, Disparity, Expanded, HealthReports, Keyframes, StereoFrames, Topic};
use ipc_types::wire::{Header, Stamp};
use ipc_types::{FlightTime, Point, ProcessId};
use memory::{FreeSpace, View};
use runtime::ipc::{IpcPorts, Services};
use runtime::run_dir::RunDir;
use runtime::{Connect, Message, Ports};
use std::collections::BTreeMap;
use std::error::Error;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::{Duration, Instant};
use stereo_ingest::{ALL_SHOWN, GroundTruth};
use supervisor::{ATTENTION, ChildCommand, Happening, SignalWatch, Supervision};

/// Options of a replay.
#[derive(Clone, Debug, Args)]
#[command(
    after_help = "Of images the vehicle stands still at the world's origin: of a sequence, the map holds the newest frame alone. Of a log (MCAP,
recorded with --record-images, or with the noise-model camera's images) it moves as it did; what the graph makes of it is
compared, topic by topic, with what was recorded.

Examples:
  sparrowhawk replay left.png right.png --calib calib.txt --out seen
  sparrowhawk replay V1_01_easy --calib V1_01_easy/mav0
  sparrowhawk replay rgbd_dataset/depth --source depth --unit 0.0002 --focal 525 --baseline 0.075 --sigma-px 0.06
  sparrowhawk replay runs/NAME/log.mcap --playback-rate fast
  sparrowhawk replay runs/NAME/log.mcap --from 12 --until 20 --config my/other.ron
  sparrowhawk replay --camera /dev/video0 --pixel-format mjpeg --calib calibration.ron --frames 300"
)]
pub(crate) struct ReplayArguments {
    #[command(flatten)]
    input: InputArguments,
    #[command(flatten)]
    log: LogArguments,
    /// Mean horizontal difference that counts as texture, grey levels: above the camera's noise.
    #[arg(long, value_name = "GREY", default_value_t = 1.0)]
    least_texture: f32,
    /// Longest unmatched run that takes the nearer of its ends, px; a twelfth of the image's width if not given.
    #[arg(long, value_name = "PX")]
    hole: Option<u32>,
    /// True disparities of the last frame: 16-bit PNG (px × 256) or PFM.
    #[arg(long, value_name = "FILE")]
    ground_truth: Option<PathBuf>,
    /// Image of the pixels to score (bright).
    #[arg(long, value_name = "FILE", requires = "ground_truth")]
    mask: Option<PathBuf>,
    /// Write PREFIX-disparity.*, PREFIX-front.*, PREFIX-back.*, and PREFIX-occupied.* of the last frame; the last one is the
    /// first occupied point of each ray.
    #[arg(long, value_name = "PREFIX")]
    out: Option<PathBuf>,
    /// Kind of those files.
    #[arg(long, value_name = "KIND", default_value = "png", value_parser = ["png", "pfm"])]
    format: String,
    /// Record images too.
    #[arg(long)]
    record_images: bool,
    /// Write the summary to this file.
    #[arg(long, value_name = "FILE")]
    summary: Option<PathBuf>,
    /// Flight file whose vehicle parameters are used; its rig too, where no calibration is given.
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Name of the run.
    #[arg(long, value_name = "NAME")]
    run: Option<String>,
    /// Where run directories go.
    #[arg(long, value_name = "DIR", default_value = "runs")]
    run_dir: PathBuf,
}

impl ReplayArguments {
    /// The first of the options that was given, if any, of those that are for images alone.
    fn given_for_images(&self) -> Option<&'static str> {
        let given = [
            (self.hole.is_some(), "--hole"),
            (self.ground_truth.is_some(), "--ground-truth"),
            (self.out.is_some(), "--out"),
        ];
        given.into_iter().find(|(is_given, _)| *is_given).map(|(_, name)| name).or(self.input.given_for_images())
    }
}

/// Name and operating-system number of a process.
pub(crate) type ProcessNumber = (String, Option<u32>);

/// Instant of publication, ns of flight time, and elements of a message.
pub(crate) type Product<E> = (i64, Vec<E>);

/// What the graph made of a frame.
#[derive(Default)]
pub(crate) struct Products {
    /// Published at, ns of flight time; disparity, planes, keyframes.
    pub(crate) frame_ns: i64,
    pub(crate) disparity: Option<Product<u16>>,
    pub(crate) expanded: Option<Product<u16>>,
    pub(crate) keyframes: Option<Product<Keyframe>>,
}

/// Longest wait for the graph to make something of a frame.
const PATIENCE: Duration = Duration::from_secs(60);

pub(crate) fn replay(arguments: &ReplayArguments) -> Result<ExitCode, Box<dyn Error>> {
    if let Some(logs) = arguments.input.logs()? {
        if let Some(name) = arguments.given_for_images() {
            return Err(format!("{name} is for images; a log has its own").into());
        }
        let ReplayArguments { config, record_images, run, run_dir, summary, .. } = arguments;
        let (config, run, summary) = (config.as_deref(), run.as_deref(), summary.as_deref());
        let told = Told { config, record_images: *record_images, run, run_dir, summary };
        return log_replay::replay(logs, &arguments.log, told);
    }
    if let Some(name) = arguments.log.given() {
        return Err(format!("{name} is for logs (MCAP), and these are images").into());
    }
    let mut config = FlightConfig::load(arguments.config.as_deref(), None)?;
    let input = arguments.input.apply(&mut config, arguments.config.is_some())?;
    let (width_px, height_px) = (config.vehicle.rig.width_px, config.vehicle.rig.height_px);
    config.record_images = arguments.record_images;
    config.vehicle.stereo.least_texture = arguments.least_texture;
    config.vehicle.expansion.hole_px = arguments.hole.unwrap_or((width_px / 12).min(128));
    let truth = arguments.ground_truth.as_deref();
    let truth =
        truth.map(|path| GroundTruth::load(path, arguments.mask.as_deref(), width_px, height_px)).transpose()?;
    config.check_vehicle()?;
    let signals = SignalWatch::begin()?;
    let name = arguments.run.clone().unwrap_or_else(fresh_name);
    let run = RunDir::named(&name)?;
    let lock = run.take()?;
    let files = RunFiles::create(&arguments.run_dir, &name, &config, arguments.summary.as_deref())?;
    let commands = commands(&config, &run, files.folder(), &input, arguments.input.rate_hz())?;
    let digested = digest(&config, &run, &input, commands, signals)?;
    drop(lock);
    let Digested { products, view, figures, pids } = digested;
    let summary = summarise(&config, &products, &view, truth.as_ref(), figures, pids);
    if let Some(prefix) = &arguments.out {
        write_images(prefix, &arguments.format, &config, &products, &view)?;
    }
    print(&summary);
    files.write_summary(&summary)?;
    Ok(ExitCode::SUCCESS)
}

/// The graph without world and vehicle, for which a player stands; and the camera, if there is one.
fn commands(
    config: &FlightConfig,
    run: &RunDir,
    folder: &Path,
    input: &Input,
    rate_hz: f64,
) -> std::io::Result<Vec<ChildCommand>> {
    // A camera that is unplugged is opened again; one that cannot be opened at all ends the run.
    let player = config.graph.in_place_of_the_world(ProcessId::Player);
    let camera = config.graph.in_place_of_the_world(ProcessId::Camera).filter(|_| matches!(input, Input::Camera(_)));
    let members = config.graph.digesting().chain(player).chain(camera);
    let mut commands: Vec<_> = members.map(|member| command(run, folder, &member)).collect::<std::io::Result<_>>()?;
    for command in commands.iter_mut().filter(|command| command.process == ProcessId::Player) {
        command.arguments.extend(["--rate".to_owned(), rate_hz.to_string()]);
        if let Input::Files(paths, _) = input {
            let shown = paths.iter().flat_map(|path| ["--play".to_owned(), path.display().to_string()]);
            command.arguments.extend(shown);
        }
    }
    Ok(commands)
}

/// What the graph made of the input.
struct Digested {
    /// Of the last frame.
    products: Products,
    view: View,
    /// Of all frames.
    figures: FrameFigures,
    pids: Vec<ProcessNumber>,
}

/// Runs the graph until it has made everything of the last frame.
fn digest(
    config: &FlightConfig,
    run: &RunDir,
    input: &Input,
    commands: Vec<ChildCommand>,
    signals: SignalWatch,
) -> Result<Digested, Box<dyn Error>> {
    run.name_supervisor(std::process::id())?;
    let services = Services::hold(run)?;
    let mut ports = IpcPorts::open(run, ProcessId::Supervisor, 0, &config.vehicle.rig, |ports| {
        ports.reads::<StereoFrames>();
        ports.reads::<DepthFrames>();
        ports.reads::<Disparity>();
        ports.reads::<Expanded>();
        ports.reads::<Keyframes>();
        ports.reads::<HealthReports>();
    })?;
    let mut supervision = Supervision::start(run, commands, signals, &[]);
    let mut gathered = Gathered::new(input);
    let (mut progress, mut is_interrupted) = (Instant::now(), false);
    let (products, view) = loop {
        if let Some(complete) = gathered.complete(is_interrupted) {
            // The images lie in the run's shared memory, which goes when the graph stops: ask before. A newer showing
            // may have taken the keyframe's place already; then it is its turn.
            let view = complete.view(config, &mut ports);
            if view.keyframes() > 0 {
                break (complete, view);
            }
        }
        for happening in supervision.attend(&services, ATTENTION) {
            match happening {
                // There may be something to tell already.
                Happening::Signal(_) if gathered.figures.disparity_images > 0 && !is_interrupted => {
                    is_interrupted = true
                }
                Happening::Signal(_) => return Err("interrupted".into()),
                Happening::RunEnded(process, how) => return Err(format!("{process} {how}").into()),
                Happening::Died(process, how, _) => say(format_args!("{process} {how}: restarting it")),
                Happening::GaveUp(ProcessId::Recorder, how) => say(format_args!("recorder {how}: going on without")),
                Happening::GaveUp(process, how) => return Err(format!("{process} {how}: given up").into()),
                Happening::Started(..) | Happening::Ended(..) | Happening::Recovered(..) => {}
            }
        }
        // Before the frames: who says that all have been shown has shown them before.
        let reports: Vec<Health> =
            std::iter::from_fn(|| ports.receive::<HealthReports>().map(|report| *report.header())).collect();
        if gathered.take(&mut ports) {
            progress = Instant::now();
        }
        for health in &reports {
            supervision.heard(health);
            gathered.hear(health)?;
        }
        if progress.elapsed() > PATIENCE + gathered.longest_gap {
            let waiting: Vec<String> = supervision.status().iter().filter_map(crate::display::complaint).collect();
            let why = waiting.join("; ");
            return Err(format!("the graph made nothing of the frames for {} s: {why}", PATIENCE.as_secs()).into());
        }
    };
    let pids = supervision.stop(&services).iter().map(|child| (child.process.name().to_owned(), child.pid)).collect();
    Ok(Digested { products, view, figures: gathered.into_figures(), pids })
}

/// Products by exposure: stages are at work on different ones at a time.
struct Gathered {
    products: BTreeMap<i64, Products>,
    figures: FrameFigures,
    /// Frames asked of a camera.
    wanted: Option<u64>,
    /// Exposure of the last frame, once all have been shown.
    last_ns: Option<i64>,
    newest_ns: i64,
    /// Between two frames of a sequence.
    longest_gap: Duration,
    bar: ProgressBar,
}

/// Exposures in the pipeline at a time, at most: one in each stage, and spares.
const MOST_AT_WORK: usize = 8;

impl Gathered {
    fn new(input: &Input) -> Self {
        let (wanted, figures, longest_gap) = match input {
            Input::Files(_, sequence) => (None, FrameFigures::of_sequence(sequence), sequence.longest_gap()),
            Input::Camera(frames) => (Some(*frames), FrameFigures::default(), Duration::ZERO),
        };
        let length = wanted.or(figures.in_sequence.map(|frames| frames as u64)).unwrap_or_default();
        let bar = if length > 1 { ProgressBar::new(length) } else { ProgressBar::hidden() };
        // The template is ours and known to be good; the default one would do.
        if let Ok(style) = ProgressStyle::with_template("{bar:40} {pos}/{len} frames, {per_sec}, {eta} left") {
            bar.set_style(style);
        }
        Self { products: BTreeMap::new(), figures, wanted, last_ns: None, newest_ns: i64::MIN, longest_gap, bar }
    }

    /// The products of the last frame, once it has passed all stages; of the newest one if there is no more to wait for.
    fn complete(&mut self, is_interrupted: bool) -> Option<Products> {
        let from_ns = if is_interrupted { i64::MIN } else { self.last_ns? };
        let is_complete = |p: &Products| p.disparity.is_some() && p.expanded.is_some() && p.keyframes.is_some();
        let found = self.products.iter().rev().find(|(at, products)| **at >= from_ns && is_complete(products));
        let exposure = *found?.0;
        self.products.remove(&exposure)
    }

    /// Takes what has arrived; whether a frame was matched.
    fn take(&mut self, ports: &mut IpcPorts) -> bool {
        while let Some(frame) = ports.receive::<StereoFrames>() {
            self.take_frame(frame.header().stamp());
        }
        while let Some(frame) = ports.receive::<DepthFrames>() {
            self.take_frame(frame.header().stamp());
        }
        let mut is_matched = false;
        while let Some(message) = ports.receive::<Disparity>() {
            let (stamp, pixels) = (*message.header().stamp(), message.elements());
            let products = self.products.entry(stamp.valid_ns).or_default();
            if self.last_ns.is_none_or(|last_ns| stamp.valid_ns <= last_ns) {
                let valid = pixels.iter().filter(|&&pixel| is_valid(pixel)).count();
                self.figures.disparity_images = self.figures.disparity_images.max(stamp.sequence);
                self.figures.valid_percent.push(100.0 * valid as f64 / pixels.len().max(1) as f64);
                if products.frame_ns > 0 {
                    self.figures.stereo_ms.push((stamp.published_ns - products.frame_ns) as f64 * 1e-6);
                }
                is_matched = true;
            }
            products.disparity = Some((stamp.published_ns, pixels.to_vec()));
        }
        while let Some((exposure, product)) = next::<Expanded>(ports) {
            self.products.entry(exposure).or_default().expanded = Some(product);
        }
        while let Some((exposure, product)) = next::<Keyframes>(ports) {
            self.products.entry(exposure).or_default().keyframes = Some(product);
        }
        while self.products.len() > MOST_AT_WORK {
            self.products.pop_first();
        }
        is_matched
    }

    fn take_frame(&mut self, stamp: &Stamp) {
        self.products.entry(stamp.valid_ns).or_default().frame_ns = stamp.published_ns;
        self.newest_ns = self.newest_ns.max(stamp.valid_ns);
        if self.last_ns.is_none() {
            self.figures.shown = self.figures.shown.max(stamp.sequence);
            self.bar.set_position(self.figures.shown);
            self.last_ns = self.wanted.filter(|&wanted| self.figures.shown >= wanted).map(|_| stamp.valid_ns);
        }
    }

    fn hear(&mut self, health: &Health) -> Result<(), Box<dyn Error>> {
        match ProcessId::from_wire(health.stamp.producer) {
            Some(ProcessId::Player) => {
                if self.wanted.is_none() {
                    self.figures.left_out = health.dropped.saturating_sub(self.figures.unpaired as u64);
                }
                if self.last_ns.is_none() && health.note.to_string_lossy() == ALL_SHOWN {
                    if self.figures.shown == 0 {
                        return Err("no frame of the sequence could be shown".into());
                    }
                    self.last_ns = Some(self.newest_ns);
                }
            }
            Some(ProcessId::Camera) => self.figures.left_out = health.dropped,
            _ => {}
        }
        let process = ProcessId::from_wire(health.stamp.producer);
        let is_source = matches!(process, Some(ProcessId::Camera | ProcessId::StereoIngest));
        // Before its first work a process only waits.
        if let Some(process) = process.filter(|_| is_source && health.level > 0 && health.steps > 0) {
            self.figures.note(format!("{process}: {}", health.note.to_string_lossy()));
        }
        Ok(())
    }

    fn into_figures(self) -> FrameFigures {
        self.bar.finish_and_clear();
        self.figures
    }
}

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
        let nowhere = FreeSpace::new(vehicle.memory.free_space.with_home(0.0, 0.0), Point::new(0.0, 0.0, -1e6));
        let mut view = View::new(map_model(vehicle), nowhere);
        for keyframe in self.keyframes.iter().flat_map(|(_, keyframes)| keyframes) {
            if let (Some(pose), Some(image)) = (keyframe.world_from_camera(), ports.images().get(keyframe.image_id)) {
                view.push(pose, FlightTime::from_nanos(keyframe.exposure_ns), image);
            }
        }
        view
    }
}
