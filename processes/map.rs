//! `sparrowhawk map`: depth images with poses to a voxel grid, on files.

use crate::posed_sequence::{depth_table, posed_frames};
use crate::say::tell;
use crate::voxels::VoxelGrid;
use clap::Args;
use expansion::{Config, Expander, Reach};
use indicatif::{ProgressBar, ProgressStyle};
use ipc_types::bounds::Bounds;
use ipc_types::messages::Layers;
use ipc_types::noise::NoiseModel;
use ipc_types::{FlightTime, Point, StereoRig, World};
use memory::{DisparityGraph, FreeSpace, FreeSpaceConfig, GraphRule, Inference, MapModel, Node, View};
use runtime::images::ImageStore;
use std::error::Error;
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Instant;
use stereo_ingest::Calibration;

/// Options of the command.
#[derive(Clone, Debug, Args)]
pub(crate) struct MapArguments {
    /// Folder of NAME.depth.png (16 bits) beside NAME.pose.txt (four rows of camera-to-world), as 7-Scenes has it.
    folder: PathBuf,
    /// The camera: a rig (RON) or a calibration. Of a depth camera the baseline only sets how finely depth is told apart.
    #[arg(long, value_name = "FILE")]
    rig: PathBuf,
    /// Radius by which obstacles are inflated, m.
    #[arg(long, value_name = "M", default_value_t = 0.3)]
    radius: f32,
    /// What a pixel's value counts, m.
    #[arg(long, value_name = "M", default_value_t = 0.001)]
    unit: f64,
    /// Farther values are not believed, m.
    #[arg(long, value_name = "M", default_value_t = 6.0)]
    farthest: f64,
    /// Standard deviation of disparity, px.
    #[arg(long, value_name = "PX", default_value_t = 0.1)]
    sigma: f32,
    /// Keyframes kept (N_graph), and the displacement (m) and angle (degrees) between them.
    #[arg(long, value_name = "N", default_value_t = 10)]
    keyframes: usize,
    /// Displacement between keyframes, m.
    #[arg(long, value_name = "M", default_value_t = 0.2)]
    spacing: f64,
    /// Angle between keyframes, degrees.
    #[arg(long, value_name = "DEG", default_value_t = 15.0)]
    turn: f64,
    /// Size of the grid: east, north, up, m.
    #[arg(long, value_name = "M", num_args = 3, default_values_t = [100.0, 100.0, 20.0])]
    size: Vec<f64>,
    /// Side of a voxel, m.
    #[arg(long, value_name = "M", default_value_t = 0.5)]
    voxel: f64,
    /// Occupied from this score on (γ).
    #[arg(long, default_value_t = 0.9)]
    gamma: f32,
    /// Weigh votes by log-odds with this prior, rather than by confidence.
    #[arg(long, value_name = "PRIOR")]
    log_odds: Option<f32>,
    /// Write PREFIX-top.png, PREFIX-oblique.png and PREFIX.ply, the occupied voxels.
    #[arg(long, value_name = "PREFIX")]
    out_prefix: PathBuf,
}

/// Time between frames; 7-Scenes was recorded at 30 Hz.
const FRAME_S: f64 = 1.0 / 30.0;

pub(crate) fn map(arguments: &MapArguments) -> Result<ExitCode, Box<dyn Error>> {
    let (rig, _) = Calibration::load(&arguments.rig, None)?.rectify()?;
    let (view, mean) = arguments.build(rig)?;
    let begun = Instant::now();
    let size_m = [arguments.size[0], arguments.size[1], arguments.size[2]];
    let grid = VoxelGrid::ask(&view, mean, size_m, arguments.voxel, arguments.gamma)?;
    let asked_ms = begun.elapsed().as_secs_f64() * 1e3;
    let [free, occupied, unknown] = grid.tally();
    let total = free + occupied + unknown;
    tell!("keyframes              {}", view.keyframes());
    tell!("voxels                 {total} of {} m, asked in {asked_ms:.1} ms", arguments.voxel);
    tell!("                       {free} free, {occupied} occupied, {unknown} unknown");
    let file = |ending: &str| PathBuf::from(format!("{}{ending}", arguments.out_prefix.display()));
    let (top, oblique, points) = (file("-top.png"), file("-oblique.png"), file(".ply"));
    grid.save_top(&top)?;
    grid.save_oblique(&oblique)?;
    grid.save_points(&points)?;
    tell!("written                {}, {}, {}", top.display(), oblique.display(), points.display());
    Ok(ExitCode::SUCCESS)
}

impl MapArguments {
    /// The map after all frames, and the mean place that they were taken from.
    fn build(&self, rig: StereoRig) -> Result<(View, Point<World>), Box<dyn Error>> {
        let body_m = (0.5 * self.radius).max(0.05);
        let config = Config {
            layers: Layers::Four,
            body_radius_m: body_m,
            body_half_height_m: body_m,
            hole_px: 4,
            patch_px: 0,
            ..Config::for_sphere(self.radius)
        };
        let (near_px, far_px) = (20.0 * self.sigma, 8.0 * self.sigma);
        let noise =
            NoiseModel { sigma_px: self.sigma, sigma_m: 0.0, lambda_near: 3.0, lambda_far: 1.0, near_px, far_px };
        let rule = GraphRule { keyframes: self.keyframes, spacing_m: self.spacing, spacing_deg: self.turn };
        let free_space = FreeSpaceConfig { swept_radius_m: 0.0, background_parallax_m: 0.5 };
        let inference = self.log_odds.map_or(Inference::Confidence, |prior| Inference::LogOdds { prior });
        let memory = memory::Config { graph: rule, free_space, inference, forget_s: 1.0 };
        let mut bounds = Bounds::default();
        bounds.section("rig", |bounds| rig.check(bounds));
        bounds.section("noise", |bounds| noise.check(bounds, &rig));
        bounds.section("expansion", |bounds| config.check(bounds));
        bounds.section("memory", |bounds| memory.check(bounds));
        let violations = bounds.into_violations();
        if !violations.is_empty() {
            return Err(violations.join("\n").into());
        }
        let (frames, left_out) = posed_frames(&self.folder)?;
        tell!("frames                 {}, {left_out} without a pose", frames.len());
        let table = depth_table(&rig, self.unit, 0.2, self.farthest)?;
        let mut expander = Expander::new(rig, &noise, Reach::Ranged { nearest_m: 0.2 }, config);
        let layout = expander.layout();
        let mut graph = DisparityGraph::new(rule, memory.forget_s);
        let (mut images, mut elements) = (ImageStore::in_memory(), vec![0; layout.elements()]);
        let style =
            ProgressStyle::with_template("{bar:40} {pos} of {len} frames").unwrap_or(ProgressStyle::default_bar());
        let progress = ProgressBar::new(frames.len() as u64).with_style(style);
        let mut mean = [0.0; 3];
        for (number, frame) in frames.iter().enumerate() {
            expander.step(&frame.disparity(&rig, &table)?, &mut elements)?;
            let image_id = number as u64;
            images.put(image_id, &elements)?;
            let exposure = FlightTime::from_secs_f64(number as f64 * FRAME_S);
            let node = Node { image_id, exposure, world_from_camera: frame.world_from_camera };
            graph.insert(node, |id| images.remove(id));
            let at = frame.world_from_camera.origin().to_array();
            mean.iter_mut().zip(at).for_each(|(mean, at)| *mean += at / frames.len() as f64);
            progress.inc(1);
        }
        progress.finish_and_clear();
        let model = MapModel { rig, noise, layout, radius_m: self.radius, inference, forget_s: memory.forget_s };
        let mut view = View::new(model, FreeSpace::new(free_space.with_home(0.0, 0.0), Point::new(0.0, 0.0, -1e6)));
        for node in graph.nodes() {
            let image = images.get(node.image_id).ok_or("a keyframe's image is missing")?;
            view.push(node.world_from_camera, node.exposure, image);
        }
        Ok((view, Point::from_array(mean)))
    }
}
