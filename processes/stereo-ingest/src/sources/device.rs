//! A camera: a Video4Linux device, or a file of raw frames played like one.

use super::pixel_format::PixelFormat;
use crate::source::Source;
use ipc_types::HostTime;
use ipc_types::bounds::Bounds;
use runtime::host_now;
use runtime::video::{VideoFormat, VideoQueue};
use serde::{Deserialize, Serialize};
use std::fs::File;
use std::io::{self, Read, Seek};
use std::os::unix::fs::FileTypeExt;
use std::path::Path;
use std::time::Duration;

/// The camera of a vehicle. Its images are of the size that the calibration, or else the rig, says.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CameraConfig {
    /// Device of the left camera, such as `/dev/video0`, or of one that delivers left and right side by side, or depth.
    /// A file is played like a camera: raw frames without gaps, as `v4l2-ctl --stream-to` writes them.
    pub left: String,
    /// Device of the right camera, if it has its own.
    pub right: Option<String>,
    /// Format of its pixels.
    pub format: PixelFormat,
    /// Frames per second.
    pub rate_hz: f64,
    /// From the middle of the exposure to the driver's time stamp, ms: 0 for one that stamps the exposure itself.
    pub stamp_delay_ms: f64,
}

impl CameraConfig {
    /// Reports values out of range, and what does not fit the source.
    pub fn check(&self, bounds: &mut Bounds, source: &Source) {
        let is_pair = *source == Source::Stereo;
        let delivers_values = matches!(self.format, PixelFormat::Z16 | PixelFormat::Y16);
        bounds.require(
            if is_pair { self.format != PixelFormat::Z16 } else { delivers_values },
            "format",
            format_args!(
                "is {:?}, but the source is {source:?}: depth comes as z16 or y16, pairs do not as z16",
                self.format
            ),
        );
        bounds.require(
            is_pair || self.right.is_none(),
            "right",
            format_args!("is {:?}, but the source is {source:?}, which has one device; expected None", self.right),
        );
        bounds.range("rate_hz", self.rate_hz, 0.5..=1000.0);
        bounds.range("stamp_delay_ms", self.stamp_delay_ms, -100.0..=1000.0);
        bounds.require(
            self.right.as_ref() != Some(&self.left),
            "right",
            format_args!("is {:?}, the left camera's device; expected None for images side by side", self.right),
        );
    }
}

/// What is known of a frame besides its pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Taken {
    pub(crate) at: HostTime,
    /// Whether `at` is the driver's time stamp rather than the arrival.
    pub(crate) is_stamped: bool,
    /// Frames that the camera made and nobody saw, before this one.
    pub(crate) lost: u64,
    /// Whether the driver says that data are missing.
    pub(crate) is_damaged: bool,
    /// Whether `at` is the end of the frame rather than of its exposure.
    pub(crate) is_end: bool,
}

/// Where frames come from.
#[derive(Debug)]
pub(crate) enum Device {
    Camera { queue: VideoQueue, sequence: Option<u32> },
    Recording(Recording),
}

/// A file of raw frames, played at a rate and from the start again.
#[derive(Debug)]
pub(crate) struct Recording {
    file: File,
    frames: u64,
    frame: Vec<u8>,
    interval: Duration,
    next: HostTime,
}

impl Device {
    /// Opens a device or a file.
    pub(crate) fn open(path: &Path, format: VideoFormat, pixels: PixelFormat) -> io::Result<Self> {
        if std::fs::metadata(path)?.file_type().is_char_device() {
            return Ok(Self::Camera { queue: VideoQueue::start(path, format)?, sequence: None });
        }
        let bytes = pixels.frame_bytes(format.width_px as usize, format.height_px as usize);
        let bytes = bytes.ok_or_else(|| io::Error::other("compressed frames are played from devices alone"))?;
        let file = File::open(path)?;
        let length = file.metadata()?.len();
        if length == 0 || length % bytes as u64 != 0 {
            let (width, height) = (format.width_px, format.height_px);
            return Err(io::Error::other(format!(
                "has {length} bytes, which are no whole frames: one of {width} x {height} px {pixels:?} has {bytes}"
            )));
        }
        let interval = Duration::from_secs_f64(1.0 / format.rate_hz);
        let frames = length / bytes as u64;
        Ok(Self::Recording(Recording { file, frames, frame: vec![0; bytes], interval, next: host_now() }))
    }

    /// Frames of a recording.
    pub(crate) fn frames(&self) -> Option<u64> {
        match self {
            Self::Camera { .. } => None,
            Self::Recording(recording) => Some(recording.frames),
        }
    }

    /// Hands the next frame's bytes and the bytes from row to row to `take`, unless `patience` is over before.
    pub(crate) fn next<R>(
        &mut self,
        patience: Duration,
        take: impl FnOnce(&[u8], usize) -> R,
    ) -> io::Result<Option<(Taken, R)>> {
        match self {
            Self::Camera { queue, sequence } => {
                let stride = queue.stride();
                let Some(frame) = queue.next(patience)? else { return Ok(None) };
                let number = frame.sequence();
                let before = sequence.replace(number);
                // A counter that runs backwards is a camera that began anew.
                let lost = before.map_or(0, |before| number.wrapping_sub(before).wrapping_sub(1));
                let lost = if lost < 1 << 16 { u64::from(lost) } else { 0 };
                let stamped = frame.stamped();
                let taken = Taken {
                    at: stamped.unwrap_or_else(host_now),
                    is_stamped: stamped.is_some(),
                    lost,
                    is_damaged: frame.is_damaged(),
                    is_end: frame.is_stamped_at_end(),
                };
                Ok(Some((taken, take(frame.bytes(), stride))))
            }
            Self::Recording(recording) => {
                let Some(at) = recording.advance(patience)? else { return Ok(None) };
                let taken = Taken { at, is_stamped: true, lost: 0, is_damaged: false, is_end: false };
                Ok(Some((taken, take(&recording.frame, 0))))
            }
        }
    }
}

impl Recording {
    /// Reads the next frame when it is due.
    fn advance(&mut self, patience: Duration) -> io::Result<Option<HostTime>> {
        let wait = self.next.saturating_since(host_now());
        std::thread::sleep(wait.min(patience));
        if wait > patience {
            return Ok(None);
        }
        match self.file.read_exact(&mut self.frame) {
            Err(error) if error.kind() == io::ErrorKind::UnexpectedEof => {
                self.file.rewind()?;
                self.file.read_exact(&mut self.frame)?;
            }
            result => result?,
        }
        let at = self.next;
        self.next = at + self.interval;
        Ok(Some(at))
    }
}
