//! Calibration files, raw cameras, rectification.

mod board;
mod lens;
mod middlebury;
mod rectifier;
mod solve;
mod stereo;
mod yaml;

pub use board::{BoardFinder, Pixel};
pub use lens::{Distortion, Lens};
pub use rectifier::Rectifier;
pub use solve::{Board, BoardView, Solution, calibrate, check};
pub use stereo::{Rectification, StereoCalibration};

use crate::pairs::{LARGEST_CALIBRATION, PairError, read_text, unusable};
use ipc_types::StereoRig;
use ipc_types::bounds::Bounds;
use std::path::{Path, PathBuf};
use yaml::Format;

/// What a calibration describes.
#[derive(Clone, Debug, PartialEq)]
pub enum Calibration {
    /// Images that are rectified already.
    Rectified(StereoRig),
    /// Raw images.
    Raw(Box<StereoCalibration>),
}

impl Calibration {
    /// Reads a calibration file or folder:
    ///
    /// * `.ron`: our [`StereoRig`] (rectified) or [`StereoCalibration`] (raw);
    /// * `.txt`: Middlebury's and ETH3D's calib.txt (rectified);
    /// * `.yaml`, `.yml`: ROS camera_info (`left.yaml`, with `right.yaml` beside it), Kalibr's camchain, EuRoC's
    ///   `cam0/sensor.yaml` (with `cam1` beside it), OpenCV (one file, or `intrinsics.yml` with `extrinsics.yml`);
    /// * a folder that has one of these under its usual name.
    ///
    /// `image_px` is the size of the images, where they are known; the calibration must be for that size.
    ///
    /// # Errors
    /// A file is missing or malformed, or describes no possible pair of cameras, or another image size.
    pub fn load(path: &Path, image_px: Option<(u32, u32)>) -> Result<Self, PairError> {
        let path = &inside(path)?;
        let text = read_text(path, LARGEST_CALIBRATION)?;
        let wrong = |problem: String| unusable(path, problem);
        let calibration = match path.extension().and_then(|extension| extension.to_str()) {
            Some("ron") => from_ron(&text).map_err(wrong)?,
            Some("yaml" | "yml") => Self::Raw(Box::new(from_yaml(path, &text, image_px)?)),
            _ => Self::Rectified(middlebury::middlebury(&text).map_err(wrong)?),
        };
        let mut bounds = Bounds::default();
        let size = match &calibration {
            Self::Rectified(rig) => {
                rig.check(&mut bounds);
                (rig.width_px, rig.height_px)
            }
            Self::Raw(raw) => {
                raw.check(&mut bounds);
                (raw.left.width_px, raw.left.height_px)
            }
        };
        let violations = bounds.into_violations();
        if !violations.is_empty() {
            return Err(wrong(violations.join("; ")));
        }
        match image_px {
            Some(image) if image != size => Err(wrong(format!(
                "is for images of {} x {} px, the pair has {} x {} px",
                size.0, size.1, image.0, image.1
            ))),
            _ => Ok(calibration),
        }
    }

    /// The rectified rig, and how raw images become it.
    ///
    /// # Errors
    /// The cameras have no common view.
    pub fn rectify(&self) -> Result<(StereoRig, Option<Rectifier>), String> {
        match self {
            Self::Rectified(rig) => Ok((*rig, None)),
            Self::Raw(raw) => {
                let rectification = raw.rectify()?;
                Ok((rectification.rig, Some(Rectifier::new(raw, &rectification))))
            }
        }
    }
}

/// The calibration file of a folder; a file is itself.
fn inside(path: &Path) -> Result<PathBuf, PairError> {
    if !path.is_dir() {
        return Ok(path.to_owned());
    }
    const NAMES: [&str; 11] = [
        "calibration.ron",
        "rig.ron",
        "cam0/sensor.yaml",
        "mav0/cam0/sensor.yaml",
        "camchain.yaml",
        "left.yaml",
        "intrinsics.yml",
        "stereo.yml",
        "stereo.yaml",
        "calib.txt",
        "calib.ron",
    ];
    let found = NAMES.iter().map(|name| path.join(name)).find(|file| file.is_file());
    found.ok_or_else(|| unusable(path, format!("has no calibration; looked for {}", NAMES.join(", "))))
}

fn from_ron(text: &str) -> Result<Calibration, String> {
    let raw = ron::from_str(text).map(|raw| Calibration::Raw(Box::new(raw)));
    raw.or_else(|raw| {
        ron::from_str(text).map(Calibration::Rectified).map_err(|rectified| {
            if text.contains("left:") { format!("raw pair: {raw}") } else { format!("rectified rig: {rectified}") }
        })
    })
}

fn from_yaml(path: &Path, text: &str, image_px: Option<(u32, u32)>) -> Result<StereoCalibration, PairError> {
    let wrong = |problem: String| unusable(path, problem);
    let companion = |other: PathBuf, why: &str| -> Result<String, PairError> {
        if other == *path || !other.is_file() {
            return Err(wrong(format!("{why}: expected {} beside it", other.display())));
        }
        read_text(&other, LARGEST_CALIBRATION)
    };
    match yaml::format(text).map_err(wrong)? {
        Format::Kalibr => yaml::kalibr(text).map_err(wrong),
        Format::Ros => {
            let name = path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
            let other = companion(path.with_file_name(name.replacen("left", "right", 1)), "is one camera of a pair")?;
            yaml::ros(text, &other).map_err(wrong)
        }
        Format::Euroc => {
            let rig = path.parent().and_then(Path::parent).unwrap_or(Path::new(".."));
            let other = companion(rig.join("cam1/sensor.yaml"), "is one camera of a pair")?;
            yaml::euroc(text, &other).map_err(wrong)
        }
        Format::OpenCv => {
            let extrinsics = path.with_file_name("extrinsics.yml");
            let intrinsics = path.with_file_name("intrinsics.yml");
            let other = [extrinsics, intrinsics].into_iter().find(|other| other != path && other.is_file());
            let other = other.map(|other| read_text(&other, LARGEST_CALIBRATION)).transpose()?;
            let files: Vec<&str> = [Some(text), other.as_deref()].into_iter().flatten().collect();
            yaml::open_cv(&files, image_px).map_err(wrong)
        }
    }
}
