//! `sparrowhawk stereo` and `sparrowhawk calibrate` on files that nobody here made.

mod common;

use common::data;
use serde_json::Value;
use std::path::Path;
use std::process::{Command, Output};

fn sparrowhawk(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_sparrowhawk")).args(arguments).output().expect("runs")
}

fn text(path: &Path) -> String {
    path.display().to_string()
}

/// Runs with `--summary`, which is read back.
fn summary(folder: &Path, arguments: &[&str]) -> (Value, String) {
    let file = folder.join("summary.json");
    let output = sparrowhawk(&[arguments, &["--summary", &text(&file)]].concat());
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{message}");
    (serde_json::from_str(&std::fs::read_to_string(&file).expect("written")).expect("JSON"), message)
}

#[test]
fn a_pair_becomes_files_that_say_the_same() {
    let Some(data) = data() else { return };
    let scratch = tempfile::tempdir().expect("writable");
    let cones = data.join("mid2003_cones");
    let (left, right) = (text(&cones.join("im2.png")), text(&cones.join("im6.png")));
    let [png, pfm, preview] = ["d.png", "d.pfm", "p.png"].map(|name| text(&scratch.path().join(name)));
    let truth = text(&cones.join("derived_gt_u16x256.png"));
    let base = ["stereo", &left, &right, "--ground-truth", &truth, "--out"];
    let (scored, message) = summary(scratch.path(), &[&base[..], &[&png, "--preview", &preview]].concat());
    assert!(message.contains("taken as rectified"), "{message}");
    summary(scratch.path(), &[&base[..], &[&pfm, "--threads", "2"]].concat());
    let read = |path: &str| stereo_ingest::load_disparity(Path::new(path), 450, 375).expect("readable");
    assert!(read(&png) == read(&pfm), "PNG and PFM, one and two threads");
    let error = |name: &str| scored[name]["bad_or_unmatched_percent"][1].as_f64().expect("a number");
    // All pixels with a truth hold those that the right camera cannot see, which are rightly unmatched.
    assert!(error("error_not_occluded") < 6.0 && error("error") > error("error_not_occluded"), "{scored}");
    let preview = image::open(preview).expect("a picture");
    assert_eq!((preview.width(), preview.height()), (450, 375));
}

#[test]
fn raw_images_are_rectified_and_swapped_ones_are_noticed() {
    let Some(data) = data() else { return };
    let scratch = tempfile::tempdir().expect("writable");
    let euroc = data.join("euroc_v101_static/mav0");
    let image = |camera: &str| text(&euroc.join(camera).join("data/1403715273262142976.png"));
    let (left, right, calib) = (image("cam0"), image("cam1"), text(&euroc));
    let (found, message) = summary(scratch.path(), &["stereo", &left, &right, "--calib", &calib]);
    assert!(found["rectify_ms"].is_number() && found["fault"].is_null() && message.is_empty(), "{found} {message}");
    assert!(found["valid_percent"].as_f64().expect("a number") > 80.0, "{found}");
    let [cones, other] = ["im2.png", "im6.png"].map(|name| text(&data.join("mid2003_cones").join(name)));
    let output = sparrowhawk(&["stereo", &other, &cones]);
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(!output.status.success() && message.contains("swapped") && message.contains("im6.png"), "{message}");
    let (found, message) = summary(scratch.path(), &["stereo", &other, &cones, "--force"]);
    assert!(found["fault"].as_str().expect("a fault").contains("swapped"), "{found}");
    assert!(message.contains("WARNING"), "{message}");
    let output = sparrowhawk(&["stereo", &cones, &cones, "--calib", &calib]);
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(!output.status.success() && message.contains("752 x 480") && message.contains("450 x 375"), "{message}");
    let output = sparrowhawk(&["stereo", &cones, &cones, "--max-disparity", "65"]);
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(!output.status.success() && message.contains("65") && message.contains("64"), "{message}");
}

#[test]
fn chessboards_give_cameras_and_the_noise_that_is_flown_with() {
    let Some(data) = data() else { return };
    let scratch = tempfile::tempdir().expect("writable");
    let boards = data.join("calib_opencv_chessboard");
    let numbers = ["01", "02", "03", "04", "05", "06", "07", "08", "09", "11", "12", "13", "14"];
    let files = |side: &str| numbers.map(|number| text(&boards.join(format!("{side}{number}.jpg"))));
    let (left, right) = (files("left"), files("right"));
    let [ron, svg, vehicle] = ["c.ron", "n.svg", "v.ron"].map(|name| text(&scratch.path().join(name)));
    std::fs::copy(concat!(env!("CARGO_MANIFEST_DIR"), "/config/vehicles/scout.ron"), &vehicle).expect("copied");
    let images: Vec<&str> = ["calibrate", "--left"]
        .into_iter()
        .chain(left.iter().map(String::as_str))
        .chain(["--right"])
        .chain(right.iter().map(String::as_str))
        .collect();
    let board = ["--board", "9x6", "--square", "0.025"];
    let more = ["--out", &ron, "--plot", &svg, "--write", &vehicle];
    let (found, message) = summary(scratch.path(), &[&images[..], &board, &more].concat());
    println!("{found:#}");
    let number = |value: &Value| value.as_f64().expect("a number");
    let cameras = &found["cameras"];
    assert_eq!(cameras["boards"], 13, "{message}");
    assert!(number(&cameras["rms_px"]) <= 0.25 && number(&cameras["mean_vertical_px"]) < 0.2, "{cameras}");
    let sigma_px = number(&found["all"]["sigma_px"]);
    assert!((0.1..0.6).contains(&sigma_px) && number(&found["all"]["bias_px"]).abs() < 0.2, "{found}");
    assert_eq!(found["by_distance"].as_array().expect("a list").len(), 4);
    let plot = std::fs::read_to_string(&svg).expect("written");
    assert!(plot.trim_end().ends_with("</svg>") && plot.contains("Gaussian fit"));
    assert!(std::fs::read_to_string(&vehicle).expect("readable").contains(&format!("sigma_px: {sigma_px:.2},")));
    // The calibration that was written explains the boards as well.
    let (checked, _) = summary(scratch.path(), &[&images[..], &board, &["--calib", &ron]].concat());
    assert!((number(&checked["cameras"]["rms_px"]) - number(&cameras["rms_px"])).abs() < 0.01, "{checked}");
}

#[test]
fn true_disparities_give_the_noise_too() {
    let Some(data) = data() else { return };
    let scratch = tempfile::tempdir().expect("writable");
    let pair = data.join("eth3d_playground");
    let [left, right, truth, calib] =
        ["im0.png", "im1.png", "disp0.pfm", "calib.txt"].map(|name| text(&pair.join(name)));
    let (found, _) = summary(
        scratch.path(),
        &["calibrate", "--left", &left, "--right", &right, "--ground-truth", &truth, "--calib", &calib],
    );
    let sigma_px = found["all"]["sigma_px"].as_f64().expect("a number");
    assert!((0.1..0.6).contains(&sigma_px), "{found}");
    assert!(found["by_distance"][0]["to_m"].as_f64() > found["by_distance"][3]["to_m"].as_f64(), "{found}");
}
