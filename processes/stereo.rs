//! `sparrowhawk stereo`: one pair of images to disparity, on files.

use crate::picture::save_disparity_picture;
use crate::say::{say, tell};
use clap::{Args, ValueEnum};
use ipc_types::StereoRig;
use ipc_types::bounds::Bounds;
use ipc_types::disparity::{MASKED, is_valid};
use serde::Serialize;
use std::error::Error;
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Instant;
use stereo_ingest::calibration::Rectifier;
use stereo_ingest::{
    Calibration, Config, DisparityError, GroundTruth, Matcher, Method, PairCheck, PairFault, StereoPair, save_disparity,
};

/// Options of the command.
#[derive(Clone, Debug, Args)]
pub(crate) struct StereoArguments {
    /// Left image: PNG (8 or 16 bits), JPEG, PGM/PPM or BMP; colour is converted.
    left: PathBuf,
    /// Right image, of the same size.
    right: PathBuf,
    /// Calibration file or folder. Raw images (ROS camera_info, Kalibr camchain, EuRoC sensor.yaml, OpenCV stereo YAML,
    /// our RON) are rectified first; for Middlebury's calib.txt and a RON rig they are rectified already. Without it, too.
    #[arg(long, value_name = "FILE|FOLDER")]
    calib: Option<PathBuf>,
    /// Disparities searched: 16, 32, 64, 96, 128, 192 or 256. Nearer things are unmatched or wrong.
    #[arg(long, value_name = "PX", default_value_t = 64)]
    max_disparity: u32,
    /// How to match: semi-global on census, or plain blocks on gradients (cheaper, and blind to weak texture).
    #[arg(long, value_enum, default_value_t = MethodName::SemiGlobal)]
    method: MethodName,
    /// Threads; the result does not depend on them.
    #[arg(long, default_value_t = 1)]
    threads: u32,
    /// Mean horizontal difference that counts as texture, grey levels: weaker areas are unmatched. 0 keeps all.
    #[arg(long, value_name = "GREY", default_value_t = 0.2)]
    least_texture: f32,
    /// How much worse than the best the second-best match must be, percent.
    #[arg(long, value_name = "PERCENT", default_value_t = 0)]
    uniqueness: u32,
    /// Write the disparity: 16-bit PNG (px × 256, 0 = unmatched, as KITTI) or PFM (px, infinite = unmatched).
    #[arg(long, value_name = "FILE.png|FILE.pfm")]
    out: Option<PathBuf>,
    /// Write it in colours: from blue (far) to red (near), black where unmatched.
    #[arg(long, value_name = "FILE.png")]
    preview: Option<PathBuf>,
    /// True disparities of the left image: 16-bit PNG (px × 256) or PFM. Prints how far off the found ones are.
    #[arg(long, value_name = "FILE")]
    ground_truth: Option<PathBuf>,
    /// Image of the pixels to score (bright): those not occluded, say.
    #[arg(long, value_name = "FILE", requires = "ground_truth")]
    mask: Option<PathBuf>,
    /// Match images that look swapped, too.
    #[arg(long)]
    force: bool,
    /// Match this many times, to tell the time.
    #[arg(long, value_name = "N", default_value_t = 1)]
    repeat: u32,
    /// Write the figures to this file (JSON).
    #[arg(long, value_name = "FILE")]
    summary: Option<PathBuf>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum MethodName {
    SemiGlobal,
    Block,
}

/// What was found.
#[derive(Debug, Serialize)]
struct StereoSummary {
    width_px: u32,
    height_px: u32,
    max_disparity_px: u32,
    threads: u32,
    valid_percent: f64,
    textureless_percent: f64,
    /// Median and least over the repetitions; rectification apart.
    match_ms: f64,
    least_match_ms: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    rectify_ms: Option<f64>,
    /// What is wrong with the pair, if anything.
    #[serde(skip_serializing_if = "Option::is_none")]
    fault: Option<&'static str>,
    /// Of all pixels with a truth (or of those in the mask), and of those that the right camera sees.
    #[serde(skip_serializing_if = "Option::is_none")]
    error: Option<DisparityError>,
    #[serde(skip_serializing_if = "Option::is_none")]
    error_not_occluded: Option<DisparityError>,
}

/// Times that a pair is looked at for what is wrong with it; other places each time.
const LOOKS: usize = 100;

pub(crate) fn stereo(arguments: &StereoArguments) -> Result<ExitCode, Box<dyn Error>> {
    let mut pair = StereoPair::load(&arguments.left, &arguments.right)?;
    let size = (pair.width_px, pair.height_px);
    let calibration = arguments.calib.as_deref().map(|path| Calibration::load(path, Some(size))).transpose()?;
    let (rig, rectifier) = match &calibration {
        Some(calibration) => calibration.rectify()?,
        None => {
            say(format_args!("no calibration given: the images are taken as rectified"));
            (unknown_rig(size), None)
        }
    };
    let config = arguments.config();
    let mut bounds = Bounds::default();
    config.check(&mut bounds, &rig);
    let violations = bounds.into_violations();
    if !violations.is_empty() {
        return Err(violations.join("\n").into());
    }
    let truth = arguments.ground_truth.as_deref();
    let truth = truth.map(|path| GroundTruth::load(path, arguments.mask.as_deref(), size.0, size.1)).transpose()?;
    let rectify_ms = rectifier.as_ref().map(|rectifier| rectify(rectifier, &mut pair));
    let fault = (0..LOOKS).fold(None, {
        let mut check = PairCheck::new(&rig, config.max_disparity_px);
        let (left, right) = pair.pixels.split_at(rig.pixels());
        move |_, _| check.step(left, right)
    });
    match fault {
        Some(PairFault::Swapped) if !arguments.force => {
            let (left, right) = (arguments.left.display(), arguments.right.display());
            let problem = PairFault::Swapped.note();
            return Err(format!("{left}, {right}: {problem}; to match them nevertheless, give --force").into());
        }
        Some(fault) => say(format_args!("WARNING: {}", fault.note())),
        None => {}
    }
    let mut matcher = Matcher::new(&rig, config);
    let mut disparity = vec![0; rig.pixels()];
    let (left, right) = pair.pixels.split_at(rig.pixels());
    let mut times = Vec::new();
    let mut found = matcher.step(left, right, &mut disparity)?;
    for _ in 0..arguments.repeat.max(1) {
        let begun = Instant::now();
        found = matcher.step(left, right, &mut disparity)?;
        times.push(begun.elapsed().as_secs_f64() * 1e3);
    }
    times.sort_by(f64::total_cmp);
    if let Some(rectifier) = &rectifier {
        rectifier.outside().iter().for_each(|&pixel| disparity[pixel as usize] = MASKED);
    }
    let percent = |part: usize| 100.0 * part as f64 / rig.pixels() as f64;
    let summary = StereoSummary {
        width_px: rig.width_px,
        height_px: rig.height_px,
        max_disparity_px: config.max_disparity_px,
        threads: config.threads,
        valid_percent: percent(disparity.iter().filter(|&&pixel| is_valid(pixel)).count()),
        textureless_percent: percent(found.textureless),
        match_ms: times[times.len() / 2],
        least_match_ms: times[0],
        rectify_ms,
        fault: fault.map(PairFault::note),
        error: truth.as_ref().map(|truth| truth.score(&disparity)),
        error_not_occluded: truth.as_ref().map(|truth| truth.not_occluded(rig.width_px).score(&disparity)),
    };
    print(&summary, calibration.is_some().then_some(&rig));
    if let Some(path) = &arguments.out {
        save_disparity(path, rig.width_px, rig.height_px, &disparity)?;
    }
    if let Some(path) = &arguments.preview {
        save_disparity_picture(path, rig.width_px, rig.height_px, &disparity)?;
    }
    if let Some(path) = &arguments.summary {
        std::fs::write(path, serde_json::to_string_pretty(&summary)?)
            .map_err(|error| format!("{}: {error}", path.display()))?;
    }
    Ok(ExitCode::SUCCESS)
}

impl StereoArguments {
    fn config(&self) -> Config {
        let dense = Config::dense(self.max_disparity);
        Config {
            threads: self.threads,
            method: if self.method == MethodName::Block { Method::Block { window_px: 9 } } else { dense.method },
            least_texture: self.least_texture,
            uniqueness_percent: self.uniqueness,
            ..dense
        }
    }
}

/// Stands in where only disparities are asked for, which do not depend on it.
fn unknown_rig((width_px, height_px): (u32, u32)) -> StereoRig {
    let (cx_px, cy_px) = (f64::from(width_px) / 2.0, f64::from(height_px) / 2.0);
    StereoRig { width_px, height_px, focal_px: f64::from(width_px), cx_px, cy_px, baseline_m: 0.1, doffs_px: 0.0 }
}

/// Rectifies both images in place; how long that took, ms.
fn rectify(rectifier: &Rectifier, pair: &mut StereoPair) -> f64 {
    let raw = pair.pixels.clone();
    let half = raw.len() / 2;
    let begun = Instant::now();
    for (camera, (raw, out)) in raw.chunks(half).zip(pair.pixels.chunks_mut(half)).enumerate() {
        rectifier.remap(camera, raw, out);
    }
    begun.elapsed().as_secs_f64() * 1e3
}

fn print(summary: &StereoSummary, rig: Option<&StereoRig>) {
    tell!(
        "image                  {} x {} px, {} disparities",
        summary.width_px,
        summary.height_px,
        summary.max_disparity_px
    );
    if let Some(rig) = rig {
        tell!("rig                    focal length {:.2} px, baseline {:.4} m", rig.focal_px, rig.baseline_m);
    }
    if let Some(rectify_ms) = summary.rectify_ms {
        tell!("rectified in           {rectify_ms:.2} ms, both images, one thread");
    }
    tell!(
        "matched in             {:.2} ms on {} thread(s); least {:.2} ms",
        summary.match_ms,
        summary.threads,
        summary.least_match_ms
    );
    tell!("matched                {:.1} %, textureless {:.1} %", summary.valid_percent, summary.textureless_percent);
    for (name, error) in [("scored", &summary.error), ("not occluded", &summary.error_not_occluded)] {
        let Some(error) = error else { continue };
        let [bad1, bad2, bad3] = error.bad_percent;
        let [all1, all2, all3] = error.bad_or_unmatched_percent;
        tell!(
            "{name:<22} {} px, {:.1} % matched, mean error {:.3} px",
            error.scored,
            error.density_percent,
            error.mean_error_px
        );
        tell!("  of the matched       {bad1:.2} % off by more than 1 px, {bad2:.2} % by 2, {bad3:.2} % by 3");
        tell!("  unmatched as bad     {all1:.2} %, {all2:.2} %, {all3:.2} %");
    }
}
