//! The YAML that calibration tools write: ROS `camera_info`, Kalibr's `camchain.yaml`, EuRoC's `sensor.yaml`, OpenCV.
//!
//! Each is read as it is, then turned into the one [`StereoCalibration`]. What a file says that we cannot honour is
//! refused, not ignored.

use super::lens::{Distortion, Lens};
use super::stereo::StereoCalibration;
use nalgebra::{Matrix3, Matrix4, Vector3};
use serde::Deserialize;
use serde::de::{DeserializeOwned, IgnoredAny};
use std::collections::BTreeMap;

/// Formats that are told apart by their keys.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Format {
    Ros,
    Kalibr,
    Euroc,
    OpenCv,
}

/// The format of a file.
pub(super) fn format(text: &str) -> Result<Format, String> {
    let keys: BTreeMap<String, IgnoredAny> = parse(text)?;
    let has = |key: &str| keys.contains_key(key);
    if has("projection_matrix") {
        Ok(Format::Ros)
    } else if has("cam0") {
        Ok(Format::Kalibr)
    } else if has("T_BS") {
        Ok(Format::Euroc)
    } else if ["M1", "K1", "cameraMatrix1", "camera_matrix_1", "R"].into_iter().any(has) {
        Ok(Format::OpenCv)
    } else {
        let found: Vec<_> = keys.keys().take(8).collect();
        Err(format!(
            "has the keys {found:?}; expected ROS camera_info (projection_matrix), Kalibr (cam0), EuRoC (T_BS) or OpenCV (M1 or cameraMatrix1)"
        ))
    }
}

/// Strict limits: calibrations are small, and files may be hostile.
fn parse<T: DeserializeOwned>(text: &str) -> Result<T, String> {
    let text = text.strip_prefix('\u{feff}').unwrap_or(text);
    // OpenCV's first line is no YAML directive; as a comment it keeps line numbers true.
    let text = if text.starts_with("%YAML:") { format!("#{}", &text[1..]) } else { text.to_owned() };
    let options = serde_saphyr::options! {
        budget: serde_saphyr::budget! { max_depth: 16, max_events: 20_000, max_nodes: 20_000, max_anchors: 32,
            max_aliases: 64, max_documents: 1, max_recorded_anchor_events: 20_000,
            max_total_scalar_bytes: 1 << 20, flow_nesting_limit: 16 },
        with_snippet: false
    };
    serde_saphyr::from_str_with_options(&text, options).map_err(|error| error.to_string())
}

/// A matrix as ROS, EuRoC and OpenCV write it.
#[derive(Clone, Debug, Deserialize)]
struct Matrix {
    rows: usize,
    cols: usize,
    data: Vec<f64>,
}

impl Matrix {
    fn require(&self, name: &str, rows: usize, cols: usize) -> Result<(), String> {
        if (self.rows, self.cols, self.data.len()) == (rows, cols, rows * cols) {
            return Ok(());
        }
        Err(format!(
            "{name} is {} x {} with {} numbers, expected {rows} x {cols}",
            self.rows,
            self.cols,
            self.data.len()
        ))
    }

    fn to_3x3(&self, name: &str) -> Result<Matrix3<f64>, String> {
        self.require(name, 3, 3)?;
        Ok(Matrix3::from_row_slice(&self.data))
    }

    fn to_4x4(&self, name: &str) -> Result<Matrix4<f64>, String> {
        self.require(name, 4, 4)?;
        Ok(Matrix4::from_row_slice(&self.data))
    }

    fn to_3(&self, name: &str) -> Result<Vector3<f64>, String> {
        if self.rows * self.cols != 3 || self.data.len() != 3 {
            return Err(format!("{name} has {} numbers, expected 3", self.data.len()));
        }
        Ok(Vector3::from_row_slice(&self.data))
    }
}

/// By the names that ROS, Kalibr and EuRoC use.
fn distortion(model: &str, coefficients: &[f64]) -> Result<Distortion, String> {
    match model {
        "none" | "" => Ok(Distortion::None),
        "radtan" | "radial-tangential" | "plumb_bob" | "rational_polynomial" => radial_tangential(coefficients),
        "equidistant" | "fisheye" => match coefficients.try_into() {
            Ok(all) => Ok(Distortion::Equidistant(all)),
            Err(_) => Err(format!("has {} equidistant coefficients, expected 4", coefficients.len())),
        },
        other => Err(format!(
            "has the distortion model \"{other}\"; known are radial-tangential (radtan, plumb_bob, rational_polynomial), equidistant and none"
        )),
    }
}

/// OpenCV's order. More than eight coefficients (thin prism, tilt) must be zero.
fn radial_tangential(coefficients: &[f64]) -> Result<Distortion, String> {
    let known = coefficients.len().min(8);
    if !matches!(coefficients.len(), 4 | 5 | 8 | 12 | 14) || coefficients[known..].iter().any(|&k| k != 0.0) {
        return Err(format!(
            "has distortion coefficients {coefficients:?}; expected 4, 5 or 8 of them, and no thin prism or tilt"
        ));
    }
    let mut all = [0.0; 8];
    all[..known].copy_from_slice(&coefficients[..known]);
    Ok(Distortion::RadialTangential(all))
}

fn stereo(left: Lens, right: Lens, rotation: Matrix3<f64>, translation: Vector3<f64>) -> StereoCalibration {
    let rotation = [0, 1, 2].map(|row| [0, 1, 2].map(|column| rotation[(row, column)]));
    StereoCalibration { left, right, rotation, translation_m: translation.into() }
}

#[derive(Deserialize)]
struct RosCamera {
    image_width: u32,
    image_height: u32,
    camera_matrix: Matrix,
    distortion_model: String,
    distortion_coefficients: Matrix,
    rectification_matrix: Matrix,
    projection_matrix: Matrix,
}

/// Left and right `camera_info`. Their rectification says how the cameras are turned, the right projection how far apart.
pub(super) fn ros(left: &str, right: &str) -> Result<StereoCalibration, String> {
    let side = |text: &str| -> Result<(Lens, Matrix3<f64>, f64), String> {
        let camera: RosCamera = parse(text)?;
        let intrinsics = camera.camera_matrix.to_3x3("camera_matrix")?;
        camera.projection_matrix.require("projection_matrix", 3, 4)?;
        let lens = Lens {
            width_px: camera.image_width,
            height_px: camera.image_height,
            focal_px: [intrinsics[(0, 0)], intrinsics[(1, 1)]],
            centre_px: [intrinsics[(0, 2)], intrinsics[(1, 2)]],
            distortion: distortion(&camera.distortion_model, &camera.distortion_coefficients.data)?,
        };
        let shift_m = camera.projection_matrix.data[3] / camera.projection_matrix.data[0];
        Ok((lens, camera.rectification_matrix.to_3x3("rectification_matrix")?, shift_m))
    };
    let ((left, left_turn, left_shift_m), (right, right_turn, right_shift_m)) = (side(left)?, side(right)?);
    if left_shift_m != 0.0 || right_shift_m >= 0.0 {
        return Err(format!(
            "has the baselines {left_shift_m} m (left) and {} m (right) in projection_matrix; expected 0 and a positive one",
            -right_shift_m
        ));
    }
    let rotation = right_turn.transpose() * left_turn;
    Ok(stereo(left, right, rotation, right_turn.transpose() * Vector3::new(right_shift_m, 0.0, 0.0)))
}

#[derive(Deserialize)]
struct KalibrCamera {
    camera_model: String,
    distortion_model: String,
    intrinsics: [f64; 4],
    distortion_coeffs: Vec<f64>,
    resolution: [u32; 2],
    #[serde(rename = "T_cn_cnm1", default)]
    from_previous: Option<[[f64; 4]; 4]>,
}

#[derive(Deserialize)]
struct KalibrChain {
    cam0: KalibrCamera,
    cam1: Option<KalibrCamera>,
}

/// Kalibr's camera chain: cam0 is the left camera.
pub(super) fn kalibr(text: &str) -> Result<StereoCalibration, String> {
    let chain: KalibrChain = parse(text)?;
    let lens = |camera: &KalibrCamera| {
        pinhole(
            &camera.camera_model,
            camera.resolution,
            camera.intrinsics,
            &camera.distortion_model,
            &camera.distortion_coeffs,
        )
    };
    let cam1 = chain.cam1.ok_or("has no cam1; expected two cameras")?;
    let from_previous = cam1.from_previous.ok_or("cam1 has no T_cn_cnm1")?;
    let pose = Matrix4::from_fn(|row, column| from_previous[row][column]);
    Ok(stereo(
        lens(&chain.cam0)?,
        lens(&cam1)?,
        pose.fixed_view::<3, 3>(0, 0).into(),
        pose.fixed_view::<3, 1>(0, 3).into(),
    ))
}

fn pinhole(
    model: &str,
    size: [u32; 2],
    intrinsics: [f64; 4],
    distortion_model: &str,
    coefficients: &[f64],
) -> Result<Lens, String> {
    if model != "pinhole" {
        return Err(format!("has the camera model \"{model}\", known is pinhole"));
    }
    let [fx, fy, cx, cy] = intrinsics;
    let distortion = distortion(distortion_model, coefficients)?;
    Ok(Lens { width_px: size[0], height_px: size[1], focal_px: [fx, fy], centre_px: [cx, cy], distortion })
}

#[derive(Deserialize)]
struct EurocCamera {
    #[serde(rename = "T_BS")]
    body_from_camera: Matrix,
    resolution: [u32; 2],
    camera_model: String,
    intrinsics: [f64; 4],
    distortion_model: String,
    distortion_coefficients: Vec<f64>,
}

/// Both cameras' `sensor.yaml`.
pub(super) fn euroc(left: &str, right: &str) -> Result<StereoCalibration, String> {
    let side = |text: &str| -> Result<(Lens, Matrix4<f64>), String> {
        let camera: EurocCamera = parse(text)?;
        let lens = pinhole(
            &camera.camera_model,
            camera.resolution,
            camera.intrinsics,
            &camera.distortion_model,
            &camera.distortion_coefficients,
        )?;
        Ok((lens, camera.body_from_camera.to_4x4("T_BS")?))
    };
    let ((left, body_from_left), (right, body_from_right)) = (side(left)?, side(right)?);
    let pose = body_from_right.try_inverse().ok_or("T_BS cannot be inverted")? * body_from_left;
    Ok(stereo(left, right, pose.fixed_view::<3, 3>(0, 0).into(), pose.fixed_view::<3, 1>(0, 3).into()))
}

/// The keys that OpenCV's samples and their descendants write.
#[derive(Default, Deserialize)]
struct OpenCv {
    #[serde(alias = "M1", alias = "K1", alias = "cameraMatrix1", alias = "camera_matrix_1")]
    left_matrix: Option<Matrix>,
    #[serde(alias = "M2", alias = "K2", alias = "cameraMatrix2", alias = "camera_matrix_2")]
    right_matrix: Option<Matrix>,
    #[serde(alias = "D1", alias = "distCoeffs1", alias = "distortion_coefficients_1")]
    left_distortion: Option<Matrix>,
    #[serde(alias = "D2", alias = "distCoeffs2", alias = "distortion_coefficients_2")]
    right_distortion: Option<Matrix>,
    #[serde(alias = "R")]
    rotation: Option<Matrix>,
    #[serde(alias = "T")]
    translation: Option<Matrix>,
    /// Where the file says it: `fisheye` and `equidistant` are one; four coefficients alone could be either model.
    #[serde(alias = "model", alias = "camera_model")]
    distortion_model: Option<String>,
    #[serde(alias = "imageWidth", alias = "width")]
    image_width: Option<u32>,
    #[serde(alias = "imageHeight", alias = "height")]
    image_height: Option<u32>,
    #[serde(alias = "imageSize", alias = "img_size")]
    image_size: Option<[u32; 2]>,
}

/// OpenCV's `stereo_calib`: one file, or intrinsics and extrinsics apart; what the first has, the second does not change.
/// Most do not tell the images' size; one that does must be for this one.
pub(super) fn open_cv(files: &[&str], size: Option<(u32, u32)>) -> Result<StereoCalibration, String> {
    let mut all = OpenCv::default();
    for text in files {
        let file: OpenCv = parse(text)?;
        all.left_matrix = all.left_matrix.or(file.left_matrix);
        all.right_matrix = all.right_matrix.or(file.right_matrix);
        all.left_distortion = all.left_distortion.or(file.left_distortion);
        all.right_distortion = all.right_distortion.or(file.right_distortion);
        all.rotation = all.rotation.or(file.rotation);
        all.translation = all.translation.or(file.translation);
        all.distortion_model = all.distortion_model.or(file.distortion_model);
        all.image_size = all.image_size.or(file.image_size);
        all.image_size =
            all.image_size.or(file.image_width.zip(file.image_height).map(|(width, height)| [width, height]));
    }
    let told = all.image_size.map(|[width, height]| (width, height));
    let (width_px, height_px) =
        told.or(size).ok_or("does not tell the images' size; it can only be read together with images")?;
    let model = all.distortion_model.map(|model| model.to_lowercase()).filter(|model| model != "pinhole");
    let model = model.unwrap_or_else(|| "radial-tangential".to_owned());
    let lens = |matrix: Option<Matrix>, distortion: Option<Matrix>, name: [&str; 2]| -> Result<Lens, String> {
        let intrinsics = matrix.ok_or(format!("has no {}", name[0]))?.to_3x3(name[0])?;
        Ok(Lens {
            width_px,
            height_px,
            focal_px: [intrinsics[(0, 0)], intrinsics[(1, 1)]],
            centre_px: [intrinsics[(0, 2)], intrinsics[(1, 2)]],
            distortion: self::distortion(&model, &distortion.ok_or(format!("has no {}", name[1]))?.data)?,
        })
    };
    let left = lens(all.left_matrix, all.left_distortion, ["M1 (cameraMatrix1)", "D1 (distCoeffs1)"])?;
    let right = lens(all.right_matrix, all.right_distortion, ["M2 (cameraMatrix2)", "D2 (distCoeffs2)"])?;
    let rotation = all.rotation.ok_or("has no R: the extrinsics are missing")?.to_3x3("R")?;
    let translation = all.translation.ok_or("has no T: the extrinsics are missing")?.to_3("T")?;
    Ok(stereo(left, right, rotation, translation))
}
