//! `sparrowhawk expand`: one disparity image to configuration space, on files.

use crate::picture::save_disparity_picture;
use crate::replay_report::save_layers;
use crate::say::tell;
use clap::{Args, ValueEnum};
use expansion::{BackgroundRule, Config, Expander, Reach};
use ipc_types::StereoRig;
use ipc_types::bounds::Bounds;
use ipc_types::disparity::{NO_MATCH, decode, encode, is_valid};
use ipc_types::messages::{ExpandedCells, Layers, Seen};
use ipc_types::noise::NoiseModel;
use std::error::Error;
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Instant;
use stereo_ingest::{Calibration, load_disparity};

/// Options of the command.
#[derive(Clone, Debug, Args)]
pub(crate) struct ExpandArguments {
    /// Disparity image: PFM (px, infinite = unmatched) or 16-bit PNG (px × 256, 0 = unmatched, as KITTI).
    disparity: PathBuf,
    /// The rectified camera: a rig (RON), or a calibration as `stereo --calib` takes it.
    #[arg(long, value_name = "FILE")]
    rig: PathBuf,
    /// Radius by which obstacles are inflated: vehicle plus tracking error, m.
    #[arg(long, value_name = "M")]
    radius: f32,
    /// The same upwards and downwards, m; the radius if not given.
    #[arg(long, value_name = "M")]
    half_height: Option<f32>,
    /// Radius of the body that must have been measured around free space, m; half of the radius, 0.05 at least, if not given.
    #[arg(long, value_name = "M")]
    body_radius: Option<f32>,
    /// Front and back of the nearest group of surfaces, or of the next one behind it, too.
    #[arg(long, value_enum, default_value_t = LayerCount::Two)]
    layers: LayerCount,
    /// Pixels to add on every side of the image, even.
    #[arg(long, value_name = "PX", default_value_t = 0)]
    margin: u32,
    /// Standard deviation of disparity, px. Surfaces are padded by three of them near, by one far.
    #[arg(long, value_name = "PX", default_value_t = 0.5)]
    sigma: f32,
    /// Longest stray unmatched run that takes the nearer of its two ends, px.
    #[arg(long, value_name = "PX", default_value_t = 0)]
    hole: u32,
    /// Threads; the result does not depend on them.
    #[arg(long, default_value_t = 1)]
    threads: u32,
    /// Expand this many times, to tell the time.
    #[arg(long, value_name = "N", default_value_t = 1)]
    repeat: u32,
    /// Write PREFIX-front.pfm, -back.pfm, with four layers also -front2.pfm, -back2.pfm, and each in colours as .png.
    #[arg(long, value_name = "PREFIX")]
    out_prefix: PathBuf,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum LayerCount {
    #[value(name = "2")]
    Two,
    #[value(name = "4")]
    Four,
}

pub(crate) fn expand(arguments: &ExpandArguments) -> Result<ExitCode, Box<dyn Error>> {
    let (rig, _) = Calibration::load(&arguments.rig, None)?.rectify()?;
    let (config, noise) = (arguments.config(), arguments.noise());
    let mut bounds = Bounds::default();
    rig.check(&mut bounds);
    config.check(&mut bounds);
    noise.check(&mut bounds, &rig);
    let violations = bounds.into_violations();
    if !violations.is_empty() {
        return Err(violations.join("\n").into());
    }
    let measured = load_disparity(&arguments.disparity, rig.width_px, rig.height_px)?;
    let disparity: Vec<u16> = measured.iter().map(|measured| measured.map_or(NO_MATCH, encode)).collect();
    let most_px = disparity.iter().filter_map(|&pixel| decode(pixel)).fold(1.0, f32::max);
    let mut expander = Expander::new(rig, &noise, Reach::Matched { most_px }, config);
    let layout = expander.layout();
    let mut elements = vec![0; layout.elements()];
    let mut times = Vec::new();
    for _ in 0..arguments.repeat.max(1) {
        let begun = Instant::now();
        expander.step(&disparity, &mut elements)?;
        times.push(begun.elapsed().as_secs_f64() * 1e3);
    }
    times.sort_by(f64::total_cmp);
    let cells = ExpandedCells::split(&elements, layout).ok_or("the expanded image is not of its size")?;
    let unmatched = disparity.iter().filter(|&&pixel| !is_valid(pixel)).count();
    let percent = |part: usize| 100.0 * part as f64 / rig.pixels() as f64;
    tell!("image                  {} x {} px, {:.1} % unmatched", rig.width_px, rig.height_px, percent(unmatched));
    tell!("rig                    focal length {:.2} px, baseline {:.4} m", rig.focal_px, rig.baseline_m);
    tell!("expanded               {} x {} px, {} layers", layout.width_px, layout.height_px, layout.layers.count());
    tell!(
        "expanded in            {:.2} ms on {} thread(s); least {:.2} ms",
        times[times.len() / 2],
        arguments.threads,
        times[0]
    );
    report(&rig, &cells, layout.cell_of(0, 0), layout.width_px as usize);
    for path in save_layers(&arguments.out_prefix, "pfm", layout, &cells)? {
        let layer = load_disparity(&path, layout.width_px, layout.height_px)?;
        let layer: Vec<u16> = layer.iter().map(|value| value.map_or(NO_MATCH, encode)).collect();
        save_disparity_picture(&path.with_extension("png"), layout.width_px, layout.height_px, &layer)?;
        tell!("written                {}", path.display());
    }
    Ok(ExitCode::SUCCESS)
}

/// How much of the camera's view is free, at some depths.
fn report(rig: &StereoRig, cells: &ExpandedCells<'_>, first: usize, stride: usize) {
    for depth_m in [1.0, 2.0, 5.0, 10.0, 20.0, 50.0] {
        let d = (rig.disparity_px(depth_m) * f64::from(ipc_types::disparity::SCALE)) as f32;
        let mut counts = [0_usize; 3];
        for row in 0..rig.height_px as usize {
            for column in 0..rig.width_px as usize {
                counts[match cells.at(first + row * stride + column, d) {
                    Seen::Free | Seen::FarBackground => 0,
                    Seen::Occupied => 1,
                    Seen::Unmeasured | Seen::Occluded => 2,
                }] += 1;
            }
        }
        let [free, occupied, unknown] = counts.map(|count| 100.0 * count as f64 / rig.pixels() as f64);
        tell!("at {depth_m:>4} m              {free:5.1} % free, {occupied:5.1} % occupied, {unknown:5.1} % unknown");
    }
}

impl ExpandArguments {
    fn config(&self) -> Config {
        let half_height_m = self.half_height.unwrap_or(self.radius);
        let body_radius_m = self.body_radius.unwrap_or((0.5 * self.radius).max(0.05));
        Config {
            half_height_m,
            layers: if self.layers == LayerCount::Two { Layers::Two } else { Layers::Four },
            margin_px: self.margin,
            threads: self.threads,
            body_radius_m,
            body_half_height_m: body_radius_m.min(half_height_m),
            hole_px: self.hole,
            patch_px: 0,
            background: BackgroundRule { limit_m: 0.0, share: 0.0, textureless_share: 1.0 },
            ..Config::for_sphere(self.radius)
        }
    }

    /// Near is where the ramp from one to three sigmas can end without the far end of the interval turning back.
    fn noise(&self) -> NoiseModel {
        let (near_px, far_px) = (20.0 * self.sigma, 8.0 * self.sigma);
        NoiseModel { sigma_px: self.sigma, sigma_m: 0.0, lambda_near: 3.0, lambda_far: 1.0, near_px, far_px }
    }
}
