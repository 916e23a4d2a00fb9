//! The configuration of a vehicle: geometry, sensor, and the parameters of every stage.

use crate::config::{ConfigError, impossible, parse, read_text};
use ipc_types::bounds::Bounds;
use ipc_types::noise::NoiseModel;
use ipc_types::rig::{CameraMount, StereoRig};
use serde::{Deserialize, Serialize};
use simulator::SimulatorConfig;
use std::f64::consts::FRAC_PI_2;
use std::path::Path;
use stereo_ingest::calibration::StereoCalibration;

/// A vehicle: geometry and the parameters of every stage.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct VehicleConfig {
    /// What it is called.
    pub name: String,
    /// Stereo rig, rectified.
    pub rig: StereoRig,
    /// The raw cameras that are rectified to it; none where the images are rectified already, as the simulator's are.
    pub calibration: Option<StereoCalibration>,
    /// What the sensor delivers.
    pub source: stereo_ingest::Source,
    /// The camera that delivers it; none in the simulator, and where images come from files.
    pub camera: Option<stereo_ingest::CameraConfig>,
    /// Where the camera sits.
    pub mount: CameraMount,
    /// Its noise.
    pub noise: NoiseModel,
    /// Matcher.
    pub stereo: stereo_ingest::Config,
    /// Expansion.
    pub expansion: expansion::Config,
    /// Memory.
    pub memory: memory::Config,
    /// Planner.
    pub planner: planner::Config,
    /// Controller.
    pub controller: controller::Config,
    /// How the simulator imitates it.
    pub simulator: SimulatorConfig,
}

/// Least allowance for tracking and state errors, m.
const TRACKING_MARGIN_M: f64 = 0.1;

/// Whether two rigs are the same but for rounding: a thousandth of a pixel, a hundredth of a millimetre.
fn is_near(a: &StereoRig, b: &StereoRig) -> bool {
    let pixels = [(a.focal_px, b.focal_px), (a.cx_px, b.cx_px), (a.cy_px, b.cy_px), (a.doffs_px, b.doffs_px)];
    let same_size = (a.width_px, a.height_px) == (b.width_px, b.height_px);
    same_size && pixels.iter().all(|(a, b)| (a - b).abs() < 1e-3) && (a.baseline_m - b.baseline_m).abs() < 1e-5
}

impl VehicleConfig {
    /// Reads a vehicle's file, and checks its values.
    ///
    /// # Errors
    /// It cannot be read or parsed, or has impossible values.
    pub fn load(path: &Path) -> Result<Self, ConfigError> {
        let label = path.display().to_string();
        let vehicle: Self = parse(&label, &read_text(path)?)?;
        let mut bounds = Bounds::default();
        bounds.section(&format!("{label}: "), |bounds| vehicle.check(bounds));
        impossible(bounds)?;
        Ok(vehicle)
    }

    /// Reports values out of range, and those that do not fit each other.
    pub(crate) fn check(&self, bounds: &mut Bounds) {
        bounds.section("rig", |bounds| self.rig.check(bounds));
        if let Some(raw) = &self.calibration {
            bounds.section("calibration", |bounds| raw.check(bounds));
            match raw.rectify() {
                Ok(rectified) if is_near(&rectified.rig, &self.rig) => {}
                Ok(rectified) => bounds.require(
                    false,
                    "rig",
                    format_args!("is {:?}, but the calibration's cameras become {:?}", self.rig, rectified.rig),
                ),
                Err(problem) => bounds.require(false, "calibration", format_args!("{problem}")),
            }
        }
        bounds.section("mount", |bounds| self.mount.check(bounds));
        bounds.section("source", |bounds| self.source.check(bounds));
        bounds.section("camera", |bounds| self.camera.iter().for_each(|camera| camera.check(bounds, &self.source)));
        let is_raw_depth = self.calibration.is_some() && self.source != stereo_ingest::Source::Stereo;
        bounds.require(
            !is_raw_depth,
            "calibration",
            format_args!("is for stereo pairs, but the source is {:?}; expected None", self.source),
        );
        bounds.section("noise", |bounds| self.noise.check(bounds, &self.rig));
        bounds.section("stereo", |bounds| self.stereo.check(bounds, &self.rig));
        bounds.section("expansion", |bounds| self.expansion.check(bounds));
        bounds.section("memory", |bounds| self.memory.check(bounds));
        bounds.section("planner", |bounds| self.planner.check(bounds));
        bounds.section("controller", |bounds| self.controller.check(bounds));
        bounds.section("simulator", |bounds| self.simulator.check(bounds));
        let hull_m = self.simulator.vehicle.hull_radius_m;
        let (radius_m, body_m) = (f64::from(self.expansion.radius_m), f64::from(self.expansion.body_radius_m));
        bounds.require(
            radius_m >= hull_m + TRACKING_MARGIN_M,
            "expansion.radius_m",
            format_args!(
                "is {radius_m}, must be at least the hull's {hull_m} m plus {TRACKING_MARGIN_M} m of tracking error"
            ),
        );
        if let memory::Inference::LogOdds { prior } = self.memory.inference {
            let most = 2.0 * (1.0 / prior).ln();
            bounds.require(
                self.planner.gamma_high < most,
                "planner.gamma_high",
                format_args!(
                    "is {}, must be less than {most:.2}, the most that votes weigh with a prior of {prior}",
                    self.planner.gamma_high
                ),
            );
        }
        let (brakes, planned) = (self.controller.braking_mps2, self.planner.braking_mps2);
        bounds.require(
            brakes >= planned,
            "controller.braking_mps2",
            format_args!("is {brakes}, must be at least planner.braking_mps2 = {planned}"),
        );
        let (slew, hard) = (self.controller.slew_mps2, self.planner.hard_braking_mps2);
        bounds.require(
            slew >= hard,
            "controller.slew_mps2",
            format_args!("is {slew}, must be at least planner.hard_braking_mps2 = {hard}"),
        );
        let half_height_m = self.tilted_half_height_m();
        bounds.require(
            f64::from(self.expansion.body_half_height_m) >= half_height_m,
            "expansion.body_half_height_m",
            format_args!(
                "is {}, must be at least that of the hull tilted by hard braking and the mount, {half_height_m:.3} m",
                self.expansion.body_half_height_m
            ),
        );
        bounds.require(
            body_m >= hull_m,
            "expansion.body_radius_m",
            format_args!("is {body_m}, must be at least the hull's {hull_m} m"),
        );
        let escape_m = self.planner.escape_m;
        bounds.require(
            escape_m <= 0.6 * radius_m,
            "planner.escape_m",
            format_args!("is {escape_m}, must be at most 0.6 x expansion.radius_m = {:.2}", 0.6 * radius_m),
        );
        let deadline_s = self.controller.trajectory_deadline_s + self.planner.lead_s;
        bounds.require(
            self.planner.commit_s >= deadline_s,
            "planner.commit_s",
            format_args!(
                "is {}, must be at least controller.trajectory_deadline_s + planner.lead_s = {deadline_s}",
                self.planner.commit_s
            ),
        );
        let able = self.simulator.vehicle.acceleration_mps2;
        for (key, value) in [
            ("planner.acceleration_mps2", self.planner.acceleration_mps2),
            ("planner.braking_mps2", self.planner.braking_mps2),
            ("planner.hard_braking_mps2", self.planner.hard_braking_mps2),
        ] {
            bounds.require(
                value < able,
                key,
                format_args!("is {value}, must be below what the vehicle can, {able} m/s²"),
            );
        }
    }
}

impl VehicleConfig {
    /// Half of the height that the hull takes up in the camera's frame when the vehicle brakes hard, m.
    pub(crate) fn tilted_half_height_m(&self) -> f64 {
        let hull = &self.simulator.vehicle;
        let tilt_rad = self.mount.pitch_up_deg.to_radians().abs() + (self.planner.hard_braking_mps2 / 9.81).atan();
        let (sin, cos) = tilt_rad.min(FRAC_PI_2).sin_cos();
        hull.hull_radius_m * sin + hull.hull_height_m / 2.0 * cos
    }
}
