//! What a replay plays: image files, a sequence of them, or a live camera; and the geometry that goes with it.

use crate::config::FlightConfig;
use crate::numbers::parse_numbers;
use clap::{Args, ValueEnum};
use ipc_types::StereoRig;
use ipc_types::noise::NoiseModel;
use std::error::Error;
use std::path::PathBuf;
use stereo_ingest::calibration::StereoCalibration;
use stereo_ingest::{Calibration, CameraConfig, Content, PixelFormat, Sequence, SequenceFrame, Source};

/// Frames per second of files that do not say when they were exposed.
pub(crate) const DEFAULT_RATE_HZ: f64 = 10.0;

/// Where images come from, and what they mean.
#[derive(Clone, Debug, Args)]
pub(crate) struct InputArguments {
    /// Left and right image; or a folder of pairs (EuRoC, KITTI, left… and right…), or one for each camera; or, with --source
    /// depth or disparity, one 16-bit image or a folder of them. PNG, JPEG, PGM/PPM or BMP. Or a flight's log (MCAP), or its parts
    /// in their order.
    #[arg(value_name = "IMAGES|LOG", num_args = 1.., required_unless_present = "camera")]
    images: Vec<PathBuf>,
    /// A live camera instead: the V4L2 device that delivers both images side by side (or depth), or left and right device.
    /// A file of raw frames is played like a camera.
    #[arg(long, value_name = "DEVICE", num_args = 1..=2, conflicts_with = "images")]
    camera: Vec<PathBuf>,
    /// What the images are; the vehicle's source if not given.
    #[arg(long, value_enum)]
    source: Option<SourceName>,
    /// What a unit of a 16-bit image is worth: m of depth (0.001 if not given), px of disparity (1/256).
    #[arg(long, value_name = "M|PX", requires = "source")]
    unit: Option<f64>,
    /// Least depth that the sensor measures, m.
    #[arg(long, value_name = "M", default_value_t = 0.3, requires = "source")]
    nearest: f64,
    /// Largest depth that is believed, m.
    #[arg(long, value_name = "M", default_value_t = 10.0, requires = "source")]
    farthest: f64,
    /// Frames per second: asked of a camera (30 if not given), assumed of files that do not say when they were exposed (10).
    #[arg(long, value_name = "HZ", value_parser = parse_rate)]
    rate: Option<f64>,
    /// Pixels of the camera: grey, y10, y12, y16, yuyv, uyvy, nv12, mjpeg or z16; yuyv if not given, z16 for depth.
    #[arg(long, value_name = "FORMAT", value_parser = parse_format)]
    pixel_format: Option<PixelFormat>,
    /// From the middle of the exposure to the driver's time stamp, ms; the vehicle's if not given.
    #[arg(long, value_name = "MS", allow_hyphen_values = true)]
    stamp_delay_ms: Option<f64>,
    /// Stop after so many frames of a camera.
    #[arg(long, value_name = "N", default_value_t = 100, value_parser = clap::value_parser!(u64).range(1..))]
    frames: u64,
    /// Disparities searched: 16, 32, 64, 96, 128, 192 or 256; 64 if not given. With --source disparity: the largest that the
    /// sensor finds.
    #[arg(long, value_name = "PX")]
    max_disparity: Option<u32>,
    /// Calibration file or folder: a RON rig or Middlebury's calib.txt (rectified); ROS, Kalibr, EuRoC, OpenCV or RON (raw).
    #[arg(long, value_name = "FILE|FOLDER", conflicts_with_all = ["focal", "baseline"])]
    calib: Option<PathBuf>,
    /// Focal length, px, instead of a calibration file.
    #[arg(long, value_name = "PX", requires = "baseline")]
    focal: Option<f64>,
    /// Baseline, m. For depth, any that tells it finely enough: depth is kept as focal·baseline/depth, to 1/64 px.
    #[arg(long, value_name = "M", requires = "focal")]
    baseline: Option<f64>,
    /// Principal point, px: x,y. The image's centre if not given.
    #[arg(long, value_name = "X,Y", value_parser = parse_numbers::<2>)]
    centre: Option<[f64; 2]>,
    /// Difference of the principal points' columns, px.
    #[arg(long, value_name = "PX", default_value_t = 0.0, allow_hyphen_values = true)]
    doffs: f64,
    /// Size of one image of a camera, px, where no calibration file says it.
    #[arg(long, value_name = "WxH", value_parser = parse_size)]
    size: Option<(u32, u32)>,
    /// Standard deviation of disparity, px; the vehicle's if not given. A depth sensor's must be given, here or by --config.
    #[arg(long, value_name = "PX")]
    sigma_px: Option<f32>,
    /// Standard deviation of depth besides, m; the vehicle's if not given.
    #[arg(long, value_name = "M")]
    sigma_m: Option<f32>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum SourceName {
    Stereo,
    Depth,
    Disparity,
}

fn parse_size(text: &str) -> Result<(u32, u32), String> {
    let size =
        text.split_once(['x', ',']).and_then(|(width, height)| Some((width.parse().ok()?, height.parse().ok()?)));
    size.ok_or_else(|| format!("is \"{text}\", expected width x height in whole pixels, 640x480 say"))
}

fn parse_rate(text: &str) -> Result<f64, String> {
    let rate = text.parse().ok().filter(|rate| (0.1..=1000.0).contains(rate));
    rate.ok_or_else(|| format!("is \"{text}\", allowed are 0.1 to 1000"))
}

fn parse_format(text: &str) -> Result<PixelFormat, String> {
    ron::from_str(text)
        .map_err(|_| format!("is \"{text}\", expected grey, y10, y12, y16, yuyv, uyvy, nv12, mjpeg, or z16 for depth"))
}

/// What the frames of a source are.
pub(crate) fn content(source: &Source) -> Content {
    match source {
        Source::Stereo => Content::Pairs,
        Source::Matched | Source::Depth { .. } | Source::Disparity { .. } => Content::Depth,
    }
}

/// The rectified rig, and the raw cameras that become it, if they are raw.
type Geometry = (StereoRig, Option<StereoCalibration>);

/// What is played.
pub(crate) enum Input {
    /// Images of these files, found to be this sequence.
    Files(Vec<PathBuf>, Sequence),
    /// The vehicle's camera, for so many frames.
    Camera(u64),
}

impl InputArguments {
    /// The logs, if it is logs that are to be replayed.
    pub(crate) fn logs(&self) -> Result<Option<&[PathBuf]>, String> {
        let is_log = |path: &PathBuf| path.extension().is_some_and(|extension| extension == "mcap");
        match self.images.iter().filter(|path| is_log(path)).count() {
            0 => Ok(None),
            count if count == self.images.len() => Ok(Some(&self.images)),
            _ => Err("images and logs at a time: expected either".to_owned()),
        }
    }

    /// The first of the options that was given, if any, of those that are for images alone.
    pub(crate) fn given_for_images(&self) -> Option<&'static str> {
        let given = [
            (self.source.is_some(), "--source"),
            (self.rate.is_some(), "--rate"),
            (self.pixel_format.is_some(), "--pixel-format"),
            (self.max_disparity.is_some(), "--max-disparity"),
            (self.calib.is_some(), "--calib"),
            (self.focal.is_some(), "--focal"),
            (self.size.is_some(), "--size"),
            (self.sigma_px.is_some(), "--sigma-px"),
            (self.sigma_m.is_some(), "--sigma-m"),
        ];
        given.into_iter().find(|(is_given, _)| *is_given).map(|(_, name)| name)
    }

    /// Finds the images, and puts their meaning and geometry into the vehicle. `own_vehicle`: whether the configuration is
    /// the user's, so that its rig may stand for theirs.
    pub(crate) fn apply(&self, config: &mut FlightConfig, own_vehicle: bool) -> Result<Input, Box<dyn Error>> {
        let vehicle = &mut config.vehicle;
        vehicle.source = self.source(vehicle.source)?;
        vehicle.stereo.max_disparity_px = self.max_disparity.unwrap_or(64);
        if vehicle.source != Source::Stereo && self.sigma_px.is_none() && !own_vehicle {
            return Err("a depth sensor has a noise of its own: give --sigma-px, or a vehicle with --config".into());
        }
        let NoiseModel { sigma_px, sigma_m, .. } = vehicle.noise;
        vehicle.noise.sigma_px = self.sigma_px.unwrap_or(sigma_px);
        vehicle.noise.sigma_m = self.sigma_m.unwrap_or(sigma_m);
        if let Some(path) = self.images.iter().chain(&self.camera).find(|path| path.to_str().is_none()) {
            return Err(format!("{}: is not UTF-8, which the processes' command lines need", path.display()).into());
        }
        let (input, size_px) = if self.camera.is_empty() {
            vehicle.camera = None;
            let sequence = Sequence::open(&self.images, content(&vehicle.source), self.rate_hz())?;
            let size_px = first_size(&sequence.frames)?;
            (Input::Files(self.images.clone(), sequence), Some(size_px))
        } else {
            if let Some(missing) = self.camera.iter().find(|path| !path.exists()) {
                return Err(format!("{}: no such camera", missing.display()).into());
            }
            vehicle.camera = Some(self.camera(vehicle.camera.as_ref(), &vehicle.source));
            (Input::Camera(self.frames), self.size)
        };
        if let Some((rig, calibration)) = self.geometry(size_px)? {
            (vehicle.rig, vehicle.calibration) = (rig, calibration);
        } else if !own_vehicle {
            return Err(
                "no calibration: give --calib FILE, or --focal PX and --baseline M, or a vehicle with --config".into(),
            );
        }
        let rig = &vehicle.rig;
        match size_px.filter(|size_px| *size_px != (rig.width_px, rig.height_px)) {
            Some((width, height)) => {
                Err(format!("the images are {width} x {height} px, the rig's {} x {} px", rig.width_px, rig.height_px)
                    .into())
            }
            None => Ok(input),
        }
    }

    /// Frames per second.
    pub(crate) fn rate_hz(&self) -> f64 {
        self.rate.unwrap_or(if self.camera.is_empty() { DEFAULT_RATE_HZ } else { 30.0 })
    }

    fn source(&self, vehicles: Source) -> Result<Source, String> {
        Ok(match self.source {
            None => vehicles,
            Some(SourceName::Stereo) => Source::Stereo,
            Some(SourceName::Depth) => {
                Source::Depth { unit_m: self.unit.unwrap_or(0.001), nearest_m: self.nearest, farthest_m: self.farthest }
            }
            Some(SourceName::Disparity) => {
                let most = self
                    .max_disparity
                    .ok_or("give --max-disparity with --source disparity: the largest that the sensor finds")?;
                Source::Disparity { unit_px: self.unit.unwrap_or(1.0 / 256.0), most_px: f64::from(most) }
            }
        })
    }

    fn camera(&self, vehicles: Option<&CameraConfig>, source: &Source) -> CameraConfig {
        let usual = if *source == Source::Stereo { PixelFormat::Yuyv } else { PixelFormat::Z16 };
        let device = |index: usize| self.camera.get(index).map(|path| path.display().to_string());
        CameraConfig {
            left: device(0).unwrap_or_default(),
            right: device(1),
            format: self.pixel_format.unwrap_or(usual),
            rate_hz: self.rate_hz(),
            stamp_delay_ms: self.stamp_delay_ms.or(vehicles.map(|camera| camera.stamp_delay_ms)).unwrap_or_default(),
        }
    }

    /// What the calibration says; `None` where there is none.
    fn geometry(&self, size_px: Option<(u32, u32)>) -> Result<Option<Geometry>, Box<dyn Error>> {
        if let Some(path) = &self.calib {
            return match Calibration::load(path, size_px)? {
                Calibration::Rectified(rig) => Ok(Some((rig, None))),
                Calibration::Raw(raw) => Ok(Some((raw.rectify()?.rig, Some(*raw)))),
            };
        }
        let (Some(focal_px), Some(baseline_m)) = (self.focal, self.baseline) else {
            return Ok(None);
        };
        let (width_px, height_px) = size_px.ok_or("no image size: give --size WxH with --focal and --baseline")?;
        let [cx_px, cy_px] = self.centre.unwrap_or([f64::from(width_px) / 2.0, f64::from(height_px) / 2.0]);
        Ok(Some((StereoRig { width_px, height_px, focal_px, cx_px, cy_px, baseline_m, doffs_px: self.doffs }, None)))
    }
}

/// Size of the first image that can be read, px.
fn first_size(frames: &[SequenceFrame]) -> Result<(u32, u32), Box<dyn Error>> {
    let mut first_error = None;
    for frame in frames {
        match frame.load() {
            Ok(image) => return Ok(image.size_px()),
            Err(error) => first_error = first_error.or(Some(error)),
        }
    }
    Err(first_error.map_or_else(|| "no images".into(), |error| error.to_string().into()))
}
