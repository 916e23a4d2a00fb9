//! The camera process: live cameras to frames on the bus.

use super::device::{CameraConfig, Device, Taken};
use super::pixel_format::{Layout, PixelFormat, Unusable};
use super::together;
use crate::source::Source;
use ipc_types::topics::{DepthFrames, StereoFrames};
use ipc_types::{FlightTime, HostTime, ProcessId, StereoRig};
use runtime::video::VideoFormat;
use runtime::{Connect, Ports, Process, Report, host_now};
use std::io;
use std::path::Path;
use std::time::Duration;

/// Longest wait for a frame within a step, so that heartbeats go on.
const PATIENCE: Duration = Duration::from_millis(20);
/// A camera that delivers nothing for so long is degraded.
const SILENCE: Duration = Duration::from_millis(500);
/// Between attempts to open a camera that failed.
const REOPEN: Duration = Duration::from_secs(1);

/// Takes frames from one device (both images side by side, or depth) or from two, pairs them by time, and publishes them
/// valid at their exposure.
#[derive(Debug)]
pub struct CameraProcess {
    config: CameraConfig,
    kind: Kind,
    /// Size of one image, px.
    size_px: (u32, u32),
    eyes: Vec<Eye>,
    /// When to open the devices again.
    reopen: HostTime,
    last: HostTime,
    report: Report,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    SideBySide,
    TwoDevices,
    Depth,
}

/// A device and the frame that it delivered last, until it is paired.
#[derive(Debug)]
struct Eye {
    device: Device,
    image: Pixels,
    taken: Option<Taken>,
}

#[derive(Debug)]
enum Pixels {
    Grey(Vec<u8>),
    Values(Vec<u16>),
}

impl CameraProcess {
    /// Opens the devices.
    ///
    /// # Errors
    /// A device is missing, in use, or does not offer the format; the message names it.
    pub fn open(config: CameraConfig, source: &Source, rig: &StereoRig) -> io::Result<Self> {
        let kind = match (source, &config.right) {
            (Source::Stereo, Some(_)) => Kind::TwoDevices,
            (Source::Stereo, None) => Kind::SideBySide,
            _ => Kind::Depth,
        };
        let now = host_now();
        let mut camera = Self {
            config,
            kind,
            size_px: (rig.width_px, rig.height_px),
            eyes: Vec::new(),
            reopen: now,
            last: now,
            report: Report::waiting("waiting for the camera"),
        };
        camera.eyes = camera.open_devices()?;
        Ok(camera)
    }

    fn layout(&self, stride: usize) -> Layout {
        let (width, height) = (self.size_px.0 as usize, self.size_px.1 as usize);
        Layout { width: if self.kind == Kind::SideBySide { 2 * width } else { width }, height, stride }
    }

    fn open_devices(&self) -> io::Result<Vec<Eye>> {
        let layout = self.layout(0);
        let format = VideoFormat {
            width_px: layout.width as u32,
            height_px: layout.height as u32,
            four_cc: self.config.format.four_cc(),
            rate_hz: self.config.rate_hz,
        };
        let devices = [Some(&self.config.left), self.config.right.as_ref()];
        let open = |path: &String| {
            let named = |error: io::Error| io::Error::new(error.kind(), format!("camera {path}: {error}"));
            let image = match self.kind {
                Kind::Depth => Pixels::Values(vec![0; layout.width * layout.height]),
                _ => Pixels::Grey(vec![0; layout.width * layout.height]),
            };
            let device = Device::open(Path::new(path), format, self.config.format).map_err(named)?;
            Ok(Eye { device, image, taken: None })
        };
        let eyes: io::Result<Vec<Eye>> = devices.into_iter().flatten().map(open).collect();
        let eyes = eyes?;
        // Recordings begin anew at their end: together, or they would be paired wrong.
        let frames: Vec<u64> = eyes.iter().filter_map(|eye| eye.device.frames()).collect();
        if frames.len() == 2 && frames[0] != frames[1] {
            let [left, right] = [&self.config.left, self.config.right.as_ref().unwrap_or(&self.config.left)];
            let problem = format!("{left} has {} frames, {right} has {}; expected as many", frames[0], frames[1]);
            return Err(io::Error::other(problem));
        }
        Ok(eyes)
    }

    /// Waits for a frame of every device that has none, each for a while. False while one is missing.
    fn gather(&mut self) -> io::Result<bool> {
        for index in 0..self.eyes.len() {
            let (layout, format) = (self.layout(0), self.config.format);
            let eye = &mut self.eyes[index];
            if eye.taken.is_some() {
                continue;
            }
            let image = &mut eye.image;
            let next =
                eye.device.next(PATIENCE, |bytes, stride| image.take(bytes, Layout { stride, ..layout }, format))?;
            let Some((taken, result)) = next else { return Ok(false) };
            self.last = host_now();
            self.report.dropped += taken.lost;
            if taken.is_damaged || result.is_err() {
                self.report.degraded("the camera delivers damaged frames");
                self.report.dropped += 1;
                return Ok(false);
            }
            eye.taken = Some(taken);
        }
        Ok(true)
    }

    /// The pair's time stamp; the older of two frames that do not belong together is dropped.
    fn paired(&mut self) -> Option<Taken> {
        let left = self.eyes.first()?.taken?;
        let Some(right) = self.eyes.get(1).map(|eye| eye.taken) else { return Some(left) };
        let right = right?;
        let tolerance_s = together(Duration::from_secs_f64(1.0 / self.config.rate_hz)).as_secs_f64();
        let apart_s = left.at.seconds_since(right.at);
        if apart_s.abs() <= tolerance_s {
            return Some(left);
        }
        self.eyes[usize::from(apart_s > 0.0)].taken = None;
        self.report.degraded("left and right cameras are out of step");
        self.report.dropped += 1;
        None
    }

    fn publish(&self, ports: &mut impl Ports, exposure: FlightTime) {
        let (width_px, height_px) = self.size_px;
        let (width, pixels) = (width_px as usize, width_px as usize * height_px as usize);
        match (self.kind, self.eyes.first().map(|eye| &eye.image), self.eyes.get(1).map(|eye| &eye.image)) {
            (Kind::Depth, Some(Pixels::Values(values)), _) => {
                ports.publish::<DepthFrames>(exposure, pixels, |frame, out| {
                    (frame.width_px, frame.height_px) = (width_px, height_px);
                    out.copy_from_slice(values);
                });
            }
            (_, Some(Pixels::Grey(left)), right) => {
                ports.publish::<StereoFrames>(exposure, 2 * pixels, |frame, out| {
                    (frame.width_px, frame.height_px) = (width_px, height_px);
                    let (out_left, out_right) = out.split_at_mut(pixels);
                    if let Some(Pixels::Grey(right)) = right {
                        out_left.copy_from_slice(left);
                        out_right.copy_from_slice(right);
                        return;
                    }
                    let rows = out_left.chunks_exact_mut(width).zip(out_right.chunks_exact_mut(width));
                    for (both, (out_left, out_right)) in left.chunks_exact(2 * width).zip(rows) {
                        out_left.copy_from_slice(&both[..width]);
                        out_right.copy_from_slice(&both[width..]);
                    }
                })
            }
            _ => {}
        }
    }

    /// Instant of the exposure in flight time, from what both clocks showed when the step began: a frame that the step
    /// waited for was exposed later than that.
    fn exposure(&self, began: (FlightTime, HostTime), stamped: HostTime) -> FlightTime {
        let delay_ns = (self.config.stamp_delay_ms * 1e6) as i64;
        let since_ns = stamped.as_nanos().saturating_sub(began.1.as_nanos()).saturating_sub(delay_ns);
        FlightTime::from_nanos(began.0.as_nanos().saturating_add(since_ns))
    }

    fn recover(&mut self) -> Report {
        let now = host_now();
        if now >= self.reopen {
            self.reopen = now + REOPEN;
            match self.open_devices() {
                Ok(eyes) => self.eyes = eyes,
                Err(error) => eprintln!("sparrowhawk: {error}"),
            }
        }
        self.report.idle()
    }
}

impl Pixels {
    fn take(&mut self, bytes: &[u8], layout: Layout, format: PixelFormat) -> Result<(), Unusable> {
        match self {
            Self::Grey(out) => format.grey(bytes, layout, out),
            Self::Values(out) => format.values(bytes, layout, out),
        }
    }
}

impl Process for CameraProcess {
    const ID: ProcessId = ProcessId::Camera;

    fn connect(&self, connect: &mut impl Connect) {
        match self.kind {
            Kind::Depth => connect.writes::<DepthFrames>(),
            Kind::SideBySide | Kind::TwoDevices => connect.writes::<StereoFrames>(),
        }
    }

    fn step<P: Ports>(&mut self, ports: &mut P) -> Report {
        if self.eyes.is_empty() {
            return self.recover();
        }
        let began = (ports.now(), host_now());
        match self.gather() {
            Ok(true) => {}
            Ok(false) if host_now().saturating_since(self.last) > SILENCE => {
                self.report.degraded("the camera delivers no frames");
                return self.report.idle();
            }
            Ok(false) => return self.report.idle(),
            Err(error) => {
                eprintln!("sparrowhawk: camera {}: {error}", self.config.left);
                self.eyes.clear();
                self.reopen = host_now() + REOPEN;
                return self.report.refuse("the camera failed: opening it again");
            }
        }
        let Some(taken) = self.paired() else { return self.report.idle() };
        if began.0 == FlightTime::ZERO {
            // There is no flight time yet: an exposure could not be told.
            self.eyes.iter_mut().for_each(|eye| eye.taken = None);
            self.report.dropped += 1;
            return self.report.idle();
        }
        let exposure = self.exposure(began, taken.at);
        self.publish(ports, exposure);
        self.eyes.iter_mut().for_each(|eye| eye.taken = None);
        match (taken.is_stamped, taken.is_end && self.config.stamp_delay_ms == 0.0) {
            (true, false) => self.report.worked(),
            (true, true) => self.report.degraded("frames are stamped at their end: stamp_delay_ms is not set"),
            (false, _) => self.report.degraded("the camera has another clock: arrival is taken for exposure"),
        }
    }

    fn next_wake(&self) -> Option<FlightTime> {
        // A step waits for the next frame by itself; without a camera there is nothing to be quick about.
        (!self.eyes.is_empty()).then_some(FlightTime::ZERO)
    }
}
