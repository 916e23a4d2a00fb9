//! Calibration files of every kind say the same; real ones rectify real images.

mod common;

use common::data;
use std::fs;
use std::path::{Path, PathBuf};
use stereo_ingest::calibration::{Distortion, StereoCalibration};
use stereo_ingest::{Calibration, StereoPair};

/// Two cameras 0.1 m apart, the right one turned by 0.02 rad about y, as each tool would write them.
const KALIBR: &str = "cam0:
  cam_overlaps: [1]
  camera_model: pinhole
  distortion_coeffs: [-0.3, 0.1, 0.001, -0.0005]
  distortion_model: radtan
  intrinsics: [400.0, 401.0, 322.0, 238.0]
  resolution: [640, 480]
  rostopic: /cam0/image_raw
cam1:
  T_cn_cnm1:
  - [0.9998000066665778, 0.0, -0.01999866669333308, -0.1]
  - [0.0, 1.0, 0.0, 0.0]
  - [0.01999866669333308, 0.0, 0.9998000066665778, 0.002]
  - [0.0, 0.0, 0.0, 1.0]
  camera_model: pinhole
  distortion_coeffs: [-0.31, 0.11, 0.0, 0.0]
  distortion_model: radtan
  intrinsics: [402.0, 403.0, 318.0, 241.0]
  resolution: [640, 480]
";
const OPENCV_INTRINSICS: &str = "%YAML:1.0
---
M1: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 400., 0., 322., 0., 401., 238., 0., 0., 1. ]
D1: !!opencv-matrix
   rows: 1
   cols: 5
   dt: d
   data: [ -3.0e-01, 1.0e-01, 1.0e-03, -5.0e-04, 0. ]
M2: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 402., 0., 318., 0., 403., 241., 0., 0., 1. ]
D2: !!opencv-matrix
   rows: 1
   cols: 5
   dt: d
   data: [ -0.31, 0.11, 0., 0., 0. ]
";
const OPENCV_EXTRINSICS: &str = "%YAML:1.0
---
R: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 0.9998000066665778, 0., -0.01999866669333308, 0., 1., 0., 0.01999866669333308, 0., 0.9998000066665778 ]
T: !!opencv-matrix
   rows: 3
   cols: 1
   dt: d
   data: [ -0.1, 0., 0.002 ]
";

fn euroc(pose: &str, intrinsics: &str, distortion: &str) -> String {
    format!(
        "# a comment\nsensor_type: camera\nT_BS:\n  cols: 4\n  rows: 4\n  data: [{pose}]\nrate_hz: 20\nresolution: [640, 480]\ncamera_model: pinhole\nintrinsics: [{intrinsics}] #fu, fv, cu, cv\ndistortion_model: radial-tangential\ndistortion_coefficients: [{distortion}]\n"
    )
}

fn folder(name: &str) -> PathBuf {
    let folder = std::env::temp_dir().join(format!("sparrowhawk-calibration-{name}-{}", std::process::id()));
    let _ = fs::remove_dir_all(&folder);
    fs::create_dir_all(folder.join("cam0")).expect("writable");
    fs::create_dir_all(folder.join("cam1")).expect("writable");
    folder
}

fn raw(path: &Path) -> StereoCalibration {
    match Calibration::load(path, Some((640, 480))).unwrap_or_else(|error| panic!("{error}")) {
        Calibration::Raw(raw) => *raw,
        other => panic!("{other:?}"),
    }
}

fn assert_close(a: &StereoCalibration, b: &StereoCalibration) {
    let numbers = |c: &StereoCalibration| {
        let lens = |lens: &stereo_ingest::calibration::Lens| {
            let k = match lens.distortion {
                Distortion::RadialTangential(k) => k.to_vec(),
                ref other => panic!("{other:?}"),
            };
            [lens.focal_px.to_vec(), lens.centre_px.to_vec(), k].concat()
        };
        [lens(&c.left), lens(&c.right), c.rotation.concat(), c.translation_m.to_vec()].concat()
    };
    for (a, b) in numbers(a).into_iter().zip(numbers(b)) {
        assert!((a - b).abs() < 1e-9, "{a} and {b}");
    }
}

#[test]
fn every_tool_says_the_same() {
    let folder = folder("same");
    fs::write(folder.join("camchain.yaml"), KALIBR).expect("writable");
    fs::write(folder.join("intrinsics.yml"), OPENCV_INTRINSICS).expect("writable");
    fs::write(folder.join("extrinsics.yml"), OPENCV_EXTRINSICS).expect("writable");
    // The body frame is the left camera's; T_BS of the right one is the inverse of Kalibr's pose.
    let (c, s) = (0.9998000066665778, 0.01999866669333308);
    let (x, z) = (c * 0.1 - s * 0.002, -s * 0.1 - c * 0.002);
    let inverse = format!("{c}, 0.0, {s}, {x}, 0.0, 1.0, 0.0, 0.0, {}, 0.0, {c}, {z}, 0.0, 0.0, 0.0, 1.0", -s);
    let identity = "1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0";
    let left = euroc(identity, "400.0, 401.0, 322.0, 238.0", "-0.3, 0.1, 0.001, -0.0005");
    let right = euroc(&inverse, "402.0, 403.0, 318.0, 241.0", "-0.31, 0.11, 0.0, 0.0");
    fs::write(folder.join("cam0/sensor.yaml"), left).expect("writable");
    fs::write(folder.join("cam1/sensor.yaml"), right).expect("writable");
    let kalibr = raw(&folder.join("camchain.yaml"));
    assert_eq!(kalibr.left.focal_px, [400.0, 401.0]);
    assert_close(&kalibr, &raw(&folder.join("intrinsics.yml")));
    assert_close(&kalibr, &raw(&folder.join("extrinsics.yml")));
    assert_close(&kalibr, &raw(&folder.join("cam0/sensor.yaml")));
    assert_close(&kalibr, &raw(&folder));
    // And ours, written and read back.
    let ron = folder.join("raw.ron");
    fs::write(&ron, ron::ser::to_string(&kalibr).expect("serialises")).expect("writable");
    assert_close(&kalibr, &raw(&ron));
    fs::remove_dir_all(&folder).expect("removable");
}

#[test]
fn ros_camera_info_gives_both_cameras_their_turn() {
    let folder = folder("ros");
    let camera = |centre: f64, turn: &str, shift: f64| {
        format!(
            "image_width: 640\nimage_height: 480\ncamera_name: stereo\ncamera_matrix:\n  rows: 3\n  cols: 3\n  data: [400, 0, {centre}, 0, 400, 240, 0, 0, 1]\ndistortion_model: plumb_bob\ndistortion_coefficients:\n  rows: 1\n  cols: 5\n  data: [0.1, 0, 0, 0, 0]\nrectification_matrix:\n  rows: 3\n  cols: 3\n  data: [{turn}]\nprojection_matrix:\n  rows: 3\n  cols: 4\n  data: [420, 0, 320, {shift}, 0, 420, 240, 0, 0, 0, 1, 0]\n"
        )
    };
    let (c, s) = (0.9998000066665778, 0.01999866669333308);
    let identity = "1, 0, 0, 0, 1, 0, 0, 0, 1";
    fs::write(folder.join("left.yaml"), camera(320.0, identity, 0.0)).expect("writable");
    let turned = format!("{c}, 0, {s}, 0, 1, 0, {}, 0, {c}", -s);
    fs::write(folder.join("right.yaml"), camera(321.0, &turned, -42.0)).expect("writable");
    let raw = raw(&folder.join("left.yaml"));
    let (rig, _) = Calibration::Raw(Box::new(raw)).rectify().expect("overlap");
    assert!((rig.baseline_m - 0.1).abs() < 1e-12);
    assert_eq!((raw.left.centre_px[0], raw.right.centre_px[0]), (320.0, 321.0));
    assert!((raw.rotation[0][2] + s).abs() < 1e-12 && (raw.rotation[0][0] - c).abs() < 1e-12);
    fs::remove_file(folder.join("right.yaml")).expect("removable");
    let message = Calibration::load(&folder.join("left.yaml"), None).expect_err("half a pair").to_string();
    assert!(message.contains("right.yaml"), "{message}");
    fs::remove_dir_all(&folder).expect("removable");
}

#[test]
fn broken_files_are_refused_with_a_reason() {
    let folder = folder("broken");
    let path = folder.join("camchain.yaml");
    let complaint = |text: &str, size: (u32, u32)| {
        fs::write(&path, text).expect("writable");
        Calibration::load(&path, Some(size)).expect_err("refused").to_string()
    };
    for (from, to, expected) in [
        ("camera_model: pinhole", "camera_model: omni", "omni"),
        ("distortion_model: radtan", "distortion_model: fov", "fov"),
        ("[-0.3, 0.1, 0.001, -0.0005]", "[-0.3, 0.1]", "coefficients"),
        ("[400.0, 401.0, 322.0, 238.0]", "[400.0, .nan, 322.0, 238.0]", "finite"),
        ("[400.0, 401.0, 322.0, 238.0]", "[400.0, 401.0]", "line"),
        ("-0.01999866669333308, -0.1]", "-0.01999866669333308, 0.1]", "swapped"),
        ("0.01999866669333308, 0.0, 0.9998", "0.5, 0.0, 0.9998", "rotation"),
        ("cam1:", "cam2:", "cam1"),
    ] {
        let message = complaint(&KALIBR.replace(from, to), (640, 480));
        assert!(message.contains(expected) && message.contains("camchain.yaml"), "{from}: {message}");
    }
    let message = complaint(KALIBR, (752, 480));
    assert!(message.contains("640 x 480") && message.contains("752 x 480"), "{message}");
    assert!(complaint("a: [1, 2", (640, 480)).contains("line"));
    assert!(complaint("something: 1", (640, 480)).contains("something"));
    assert!(complaint(&"[".repeat(100_000), (640, 480)).len() < 1000);
    let message = Calibration::load(&folder.join("cam0"), None).expect_err("empty folder").to_string();
    assert!(message.contains("camchain.yaml"), "{message}");
    fs::remove_dir_all(&folder).expect("removable");
}

/// Rows between where a patch of the left image is found in the right one and its own row, px.
fn vertical_residuals(left: &[u8], right: &[u8], width: usize, height: usize) -> Vec<f64> {
    const HALF: usize = 5;
    const REACH: isize = 3;
    let patch_difference = |x: usize, y: usize, shift: usize, dy: isize| -> f64 {
        let mut sum = 0.0;
        for row in y - HALF..=y + HALF {
            let other = row.saturating_add_signed(dy) * width;
            for column in x - HALF..=x + HALF {
                sum += (f64::from(left[row * width + column]) - f64::from(right[other + column - shift])).abs();
            }
        }
        sum
    };
    let mut residuals = Vec::new();
    for y in (20..height - 20).step_by(12) {
        for x in (110..width - 20).step_by(12) {
            // A corner: strong gradients both ways, so that a patch has one place only.
            let (mut along, mut across) = (0, 0);
            for row in y - HALF..=y + HALF {
                for column in x - HALF..=x + HALF {
                    let at = row * width + column;
                    along += i32::from(left[at].abs_diff(left[at + 1]));
                    across += i32::from(left[at].abs_diff(left[at + width]));
                }
            }
            if along.min(across) < 900 {
                continue;
            }
            let places = (0..90).flat_map(|shift| (-REACH..=REACH).map(move |dy| (shift, dy)));
            let best = places
                .map(|(shift, dy)| (patch_difference(x, y, shift, dy), shift, dy))
                .min_by(|a, b| a.0.total_cmp(&b.0));
            let Some((least, shift, dy)) = best else { continue };
            if dy.abs() == REACH || least > 121.0 * 12.0 {
                continue;
            }
            let (above, below) = (patch_difference(x, y, shift, dy - 1), patch_difference(x, y, shift, dy + 1));
            let slope = above.max(below) - least;
            residuals.push(dy as f64 + if slope > 0.0 { (above - below) / (2.0 * slope) } else { 0.0 });
        }
    }
    residuals
}

#[test]
fn rectified_euroc_frames_lie_row_by_row() {
    let Some(data) = data() else { return };
    let data = data.join("euroc_v101_static/mav0");
    let calibration = Calibration::load(&data, Some((752, 480))).expect("the data set's own");
    let (rig, rectifier) = calibration.rectify().expect("overlap");
    let rectifier = rectifier.expect("raw images");
    println!("rectified: focal length {:.1} px, baseline {:.6} m", rig.focal_px, rig.baseline_m);
    assert!((rig.baseline_m - 0.110078).abs() < 1e-6, "as OpenCV has it: {}", rig.baseline_m);
    let mut residuals = Vec::new();
    let mut raw_residuals = Vec::new();
    for image in fs::read_dir(data.join("cam0/data")).expect("images").map(|entry| entry.expect("an entry").file_name())
    {
        let pair = StereoPair::load(&data.join("cam0/data").join(&image), &data.join("cam1/data").join(&image))
            .expect("a pair");
        let (left, right) = pair.pixels.split_at(752 * 480);
        let rectify = |camera: usize, image: &[u8]| {
            let mut out = vec![0; image.len()];
            rectifier.remap(camera, image, &mut out);
            out
        };
        residuals.extend(vertical_residuals(&rectify(0, left), &rectify(1, right), 752, 480));
        raw_residuals.extend(vertical_residuals(left, right, 752, 480));
    }
    let median = |values: &mut Vec<f64>| {
        values.iter_mut().for_each(|value| *value = value.abs());
        values.sort_by(f64::total_cmp);
        values[values.len() / 2]
    };
    let (count, after, before) = (residuals.len(), median(&mut residuals), median(&mut raw_residuals));
    println!("{count} matches: median |dy| {after:.3} px, {before:.3} px before rectification");
    assert!(count > 200, "{count} matches");
    assert!(after < 0.25, "{after} px");
    assert!(before > 1.5 * after, "{before} px in the raw images");
}
