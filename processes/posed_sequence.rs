//! Depth images with their poses, from files: 7-Scenes and what is laid out like it.
//!
//! A frame is `NAME.depth.png` (16 bits) beside `NAME.pose.txt`, four rows of camera-to-world. Frames without either, and
//! poses that are none (lost tracking is written as NaN or infinity), are left out and counted.

use ipc_types::{Camera, Pose, Rotation, StereoRig, Vector, World};
use std::error::Error;
use std::fs;
use std::path::{Path, PathBuf};
use stereo_ingest::{DepthImage, Source, ValueTable};

/// Ending of a depth image's name.
const DEPTH: &str = ".depth.png";
/// Rows of camera coordinates (x right, y down, z forward) in a world whose z is up.
const UPRIGHT: [[f64; 3]; 3] = [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]];

/// One frame.
#[derive(Clone, Debug)]
pub struct PosedFrame {
    /// The image.
    pub path: PathBuf,
    /// Where it was taken. The files' world is that of a camera (y down); ours is upright.
    pub world_from_camera: Pose<World, Camera>,
}

impl PosedFrame {
    /// The image as disparity.
    ///
    /// # Errors
    /// The file cannot be read, or is not of the rig's size.
    pub fn disparity(&self, rig: &StereoRig, table: &ValueTable) -> Result<Vec<u16>, Box<dyn Error>> {
        let image = DepthImage::load(&self.path)?;
        if (image.width_px, image.height_px) != (rig.width_px, rig.height_px) {
            let found = format!("{} x {} px", image.width_px, image.height_px);
            let expected = format!("{} x {} px", rig.width_px, rig.height_px);
            return Err(format!("{}: is {found}, expected the rig's {expected}", self.path.display()).into());
        }
        let mut disparity = vec![0; rig.pixels()];
        table.convert(&image.values, &mut disparity);
        Ok(disparity)
    }
}

/// All frames of a folder in the order of their names, and how many were left out.
///
/// # Errors
/// The folder cannot be read or holds no frame.
pub fn posed_frames(folder: &Path) -> Result<(Vec<PosedFrame>, usize), Box<dyn Error>> {
    let entries = fs::read_dir(folder).map_err(|error| format!("{}: {error}", folder.display()))?;
    let mut images: Vec<PathBuf> = entries
        .flatten()
        .map(|entry| entry.path())
        .filter(|path| path.file_name().is_some_and(|name| name.to_string_lossy().ends_with(DEPTH)))
        .collect();
    images.sort();
    let found = images.len();
    let frames: Vec<PosedFrame> = images
        .into_iter()
        .filter_map(|path| {
            let name = path.to_string_lossy().into_owned();
            let pose = fs::read_to_string(name.replace(DEPTH, ".pose.txt")).ok()?;
            Some(PosedFrame { world_from_camera: pose_of(&pose)?, path })
        })
        .collect();
    if frames.is_empty() {
        return Err(format!(
            "{}: no frames; expected NAME{DEPTH} beside NAME.pose.txt (four rows of camera-to-world)",
            folder.display()
        )
        .into());
    }
    let left_out = found - frames.len();
    Ok((frames, left_out))
}

/// A depth sensor whose values are in `unit_m`.
pub fn depth_table(
    rig: &StereoRig,
    unit_m: f64,
    nearest_m: f64,
    farthest_m: f64,
) -> Result<ValueTable, Box<dyn Error>> {
    let source = Source::Depth { unit_m, nearest_m, farthest_m };
    ValueTable::new(rig, &source).ok_or_else(|| "a depth source needs a table".into())
}

fn pose_of(text: &str) -> Option<Pose<World, Camera>> {
    let numbers: Vec<f64> = text.split_whitespace().map(|word| word.parse().ok()).collect::<Option<_>>()?;
    let rows: &[f64; 16] = numbers.as_slice().try_into().ok()?;
    let turned = |row: usize, column: usize| (0..3).map(|i| UPRIGHT[row][i] * rows[4 * i + column]).sum::<f64>();
    let rotation = Rotation::from_matrix([0, 1, 2].map(|row| [0, 1, 2].map(|column| turned(row, column))))?;
    let translation = Vector::from_array([0, 1, 2].map(|row| turned(row, 3)));
    translation.is_finite().then_some(Pose { rotation, translation })
}
