//! What a replay found: figures of all frames, the map of the last one, and its images.

use crate::config::FlightConfig;
use crate::replay::{ProcessNumber, Products};
use crate::say::tell;
use ipc_types::disparity::{NO_MATCH, encode, is_valid};
use ipc_types::messages::{ExpandedCells, ExpandedLayout, UNKNOWN_FRONT};
use ipc_types::{Body, Point, Pose, World};
use memory::{Occupancy, View};
use serde::Serialize;
use std::error::Error;
use std::path::{Path, PathBuf};
use stereo_ingest::{DisparityError, GroundTruth, Sequence, save_disparity};

/// Figures of all frames of a replay.
#[derive(Clone, Debug, Default)]
pub(crate) struct FrameFigures {
    /// Frames that the files make; a camera has no such number.
    pub(crate) in_sequence: Option<usize>,
    /// Images without a counterpart in the other camera.
    pub(crate) unpaired: usize,
    /// Frames that could not be read, or that a camera lost.
    pub(crate) left_out: u64,
    pub(crate) shown: u64,
    /// Disparity images made of them.
    pub(crate) disparity_images: u64,
    pub(crate) first_exposure_ns: Option<i64>,
    pub(crate) duration_s: f64,
    pub(crate) valid_percent: Vec<f64>,
    pub(crate) stereo_ms: Vec<f64>,
    /// Between the images of a pair, at most.
    pub(crate) apart_ns: i64,
    /// What camera and stereo-ingest complained of.
    pub(crate) notes: Vec<String>,
}

impl FrameFigures {
    pub(crate) fn of_sequence(sequence: &Sequence) -> Self {
        Self {
            in_sequence: Some(sequence.frames.len()),
            unpaired: sequence.unpaired,
            first_exposure_ns: sequence.first_ns,
            duration_s: sequence.duration_s(),
            apart_ns: sequence.apart_ns,
            ..Self::default()
        }
    }

    /// Remembers a complaint, once.
    pub(crate) fn note(&mut self, note: String) {
        if !self.notes.contains(&note) {
            self.notes.push(note);
        }
    }
}

/// Least, median and largest value.
#[derive(Clone, Copy, Debug, Serialize)]
struct Spread {
    least: f64,
    median: f64,
    most: f64,
}

impl Spread {
    /// Of no values there is none.
    fn of(mut values: Vec<f64>) -> Option<Self> {
        values.sort_by(f64::total_cmp);
        let (least, most) = (*values.first()?, *values.last()?);
        Some(Self { least, median: values[values.len() / 2], most })
    }
}

/// Frames of a replay.
#[derive(Debug, Serialize)]
struct FramesSummary {
    #[serde(skip_serializing_if = "Option::is_none")]
    in_sequence: Option<usize>,
    unpaired: usize,
    left_out: u64,
    shown: u64,
    disparity_images: u64,
    /// Time of the first exposure as the files give it, ns.
    #[serde(skip_serializing_if = "Option::is_none")]
    first_exposure_ns: Option<i64>,
    duration_s: f64,
    /// Between the images of a pair, at most, ms.
    apart_ms: f64,
    valid_percent: Option<Spread>,
    stereo_ms: Option<Spread>,
    notes: Vec<String>,
}

/// What a replay found.
#[derive(Debug, Serialize)]
pub(crate) struct ReplaySummary {
    width_px: u32,
    height_px: u32,
    /// By which expanded images are larger on every side.
    margin_px: u32,
    frames: FramesSummary,
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

pub(crate) fn summarise(
    config: &FlightConfig,
    products: &Products,
    view: &View,
    truth: Option<&GroundTruth>,
    figures: FrameFigures,
    pids: Vec<ProcessNumber>,
) -> ReplaySummary {
    let rig = config.vehicle.rig;
    let empty = (0, Vec::new());
    let (disparity_ns, disparity) = products.disparity.as_ref().unwrap_or(&empty);
    let (expanded_ns, elements) = products.expanded.as_ref().unwrap_or(&empty);
    let (keyframes_ns, keyframes) = products.keyframes.as_ref().map_or((0, 0), |(ns, list)| (*ns, list.len()));
    let percent = |part: usize, whole: usize| 100.0 * part as f64 / whole.max(1) as f64;
    let count = |code: fn(&u16) -> bool| disparity.iter().filter(|pixel| code(pixel)).count();
    let layout = config.vehicle.expansion.layout(&rig);
    let camera_cells = || (0..rig.height_px).flat_map(|row| (0..rig.width_px).map(move |column| (column, row)));
    let unknown = ExpandedCells::split(elements, layout).map_or(0, |cells| {
        let is_unknown = |(column, row)| cells.nearest[layout.cell_of(column, row)][1] == UNKNOWN_FRONT;
        camera_cells().filter(|&at| is_unknown(at)).count()
    });
    let counts = occupancy_in_view(config, view);
    let points = counts.iter().sum();
    let ms = |from: i64, to: i64| (to - from) as f64 * 1e-6;
    let frames = FramesSummary {
        in_sequence: figures.in_sequence,
        unpaired: figures.unpaired,
        left_out: figures.left_out,
        shown: figures.shown,
        disparity_images: figures.disparity_images,
        first_exposure_ns: figures.first_exposure_ns,
        duration_s: figures.duration_s,
        apart_ms: figures.apart_ns as f64 * 1e-6,
        valid_percent: Spread::of(figures.valid_percent),
        stereo_ms: Spread::of(figures.stereo_ms),
        notes: figures.notes,
    };
    ReplaySummary {
        width_px: rig.width_px,
        height_px: rig.height_px,
        margin_px: layout.margin_px,
        frames,
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

/// Writes every layer as a file of disparities, margins included. Unknown cells hold the largest value, which in a file
/// would read as nearest: they are written as unmatched.
pub(crate) fn save_layers(
    prefix: &Path,
    kind: &str,
    layout: ExpandedLayout,
    cells: &ExpandedCells<'_>,
) -> Result<Vec<PathBuf>, Box<dyn Error>> {
    let known = |value: u16| if value == UNKNOWN_FRONT { NO_MATCH } else { value };
    let nearest = |part: usize| cells.nearest.iter().map(|cell| known(cell[part])).collect::<Vec<u16>>();
    let next = |part: usize| cells.next.iter().map(|cell| known(cell[part])).collect::<Vec<u16>>();
    let mut layers = vec![("front", nearest(1)), ("back", nearest(2))];
    if !cells.next.is_empty() {
        layers.extend([("front2", next(0)), ("back2", next(1))]);
    }
    let mut files = Vec::new();
    for (name, layer) in layers {
        let path = PathBuf::from(format!("{}-{name}.{kind}", prefix.display()));
        save_disparity(&path, layout.width_px, layout.height_px, &layer)?;
        files.push(path);
    }
    Ok(files)
}

pub(crate) fn write_images(
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
        && let Some(cells) = ExpandedCells::split(elements, config.vehicle.expansion.layout(&rig))
    {
        save_layers(prefix, kind, config.vehicle.expansion.layout(&rig), &cells)?;
    }
    save_disparity(&file("occupied"), rig.width_px, rig.height_px, &first_occupied(config, view))?;
    Ok(())
}

pub(crate) fn print(summary: &ReplaySummary) {
    tell!("image                  {} x {} px", summary.width_px, summary.height_px);
    print_frames(&summary.frames);
    tell!(
        "disparity              {:.1} % matched, {:.1} % textureless, {:.1} ms",
        summary.valid_percent,
        summary.textureless_percent,
        summary.stereo_ms
    );
    tell!("expanded               {:.1} % unknown, {:.1} ms", summary.expanded_unknown_percent, summary.expansion_ms);
    tell!(
        "occupancy              {:.1} % free, {:.1} % occupied, {:.1} % unknown of {} points in view, 0.5 to 12 m deep; {} keyframe(s), {:.1} ms",
        summary.free_percent,
        summary.occupied_percent,
        summary.unknown_percent,
        summary.occupancy_points,
        summary.keyframes,
        summary.memory_ms
    );
    if let Some(error) = &summary.disparity_error {
        tell!(
            "against ground truth   density {:.1} %, off by more than 1/2/3 px {:.2}/{:.2}/{:.2} %, mean error {:.2} px over {} px",
            error.density_percent,
            error.bad_percent[0],
            error.bad_percent[1],
            error.bad_percent[2],
            error.mean_error_px,
            error.scored
        );
        let [one, two, three] = error.bad_or_unmatched_percent;
        tell!("unmatched as bad       {one:.2}/{two:.2}/{three:.2} %");
    }
}

/// Says of a sequence or a camera how many frames there were, and how they differ.
fn print_frames(frames: &FramesSummary) {
    for note in &frames.notes {
        tell!("note                   {note}");
    }
    let lost = frames.unpaired as u64 + frames.left_out;
    if frames.shown <= 1 && lost == 0 {
        return;
    }
    let of = frames.in_sequence.map_or(String::new(), |count| format!(" of {count}"));
    tell!(
        "frames                 {}{of} shown, {} disparity images; {} images without a counterpart, {} frames left out",
        frames.shown,
        frames.disparity_images,
        frames.unpaired,
        frames.left_out
    );
    if let Some(first_ns) = frames.first_exposure_ns {
        tell!(
            "exposures              from {first_ns} ns on, over {:.3} s; pairs up to {:.3} ms apart",
            frames.duration_s,
            frames.apart_ms
        );
    } else if frames.in_sequence.is_some() {
        tell!("exposures              not told by the files: an even rate is assumed, over {:.3} s", frames.duration_s);
    }
    if let Some(Spread { least, median, most }) = frames.valid_percent {
        tell!("matched                {median:.1} % of the pixels ({least:.1} to {most:.1})");
    }
    if let Some(Spread { least, median, most }) = frames.stereo_ms {
        tell!("stereo-ingest          {median:.1} ms ({least:.1} to {most:.1})");
    }
}
