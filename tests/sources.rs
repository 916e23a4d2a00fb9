//! Sequences, depth sensors and cameras as sources of the multi-process graph.

mod common;

use common::{Run, data, real_time};
use image::{GrayImage, ImageBuffer, Luma};
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Of the synthetic pairs: as many pixels as the pattern is shifted.
const SHIFT: u32 = 12;
const SIZE: (u32, u32) = (160, 120);
const GEOMETRY: [&str; 4] = ["--focal", "120", "--baseline", "0.2"];

/// A textured wall, seen by the left (0) or the right (1) camera.
fn wall(camera: u32) -> GrayImage {
    GrayImage::from_fn(SIZE.0, SIZE.1, |column, row| {
        let place = (column + camera * SHIFT).wrapping_mul(2_654_435_761) ^ row.wrapping_mul(2_246_822_519);
        Luma([(place.wrapping_mul(3_266_489_917) >> 24) as u8])
    })
}

fn replay(run: &Run, arguments: &[&str], prepare: impl FnOnce(&mut Command)) -> (Value, String) {
    let _alone = real_time();
    let mut command = run.command(&["replay", "--run", &run.name, "--summary", "summary.json"]);
    command.args(arguments);
    prepare(&mut command);
    let output = command.output().expect("starts");
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{message}");
    run.assert_nothing_left();
    let text = std::fs::read_to_string(run.path("summary.json")).expect("a summary");
    (serde_json::from_str(&text).expect("JSON"), message)
}

fn number(summary: &Value, key: &str) -> f64 {
    summary[key].as_f64().unwrap_or_else(|| panic!("{key}: {summary}"))
}

/// Share of the columns that the right camera sees whose disparity is the wall's.
fn right_percent(image: &Path) -> f64 {
    let found = stereo_ingest::load_disparity(image, SIZE.0, SIZE.1).expect("readable");
    let seen = found.iter().enumerate().filter(|(index, _)| (index % SIZE.0 as usize) > SHIFT as usize);
    let near = |d: &&Option<f32>| d.is_some_and(|d| (d - SHIFT as f32).abs() < 0.5);
    let (total, right) = (seen.clone().count(), seen.filter(|(_, d)| near(d)).count());
    100.0 * right as f64 / total as f64
}

/// Exposures of the keyframes in a run's log, in ms of the machine's clock.
fn exposures_ms(run: &Run) -> Vec<f64> {
    let log = recorder::Log::open(&run.log()).expect("a log");
    let integer = |value: &Value| value.as_i64().expect("an integer");
    let clock = log.json("flight_clock").expect("readable");
    let offset_ns = clock.last().map(|clock| integer(&clock["host_ns"]) - integer(&clock["flight_ns"]));
    let offset_ns = offset_ns.expect("the clock was read");
    let sets = log.json("keyframe_set").expect("readable");
    sets.iter().map(|set| (integer(&set["stamp"]["valid_ns"]) + offset_ns) as f64 * 1e-6).collect()
}

/// A EuRoC folder of `frames` exposures, 50 ms apart, in which some things are wrong.
fn euroc(run: &Run, frames: u32) -> PathBuf {
    let folder = run.path("sequence");
    for camera in 0..2 {
        let side = folder.join(format!("mav0/cam{camera}"));
        std::fs::create_dir_all(side.join("data")).expect("writable");
        let mut list = "#timestamp [ns],filename\n".to_owned();
        for frame in 0..frames {
            let at_ns = 1_403_715_273_262_142_976_i64 + i64::from(frame) * 50_000_000;
            // The right camera missed the third exposure, and the fifth's file is torn.
            if (camera, frame) == (1, 2) {
                continue;
            }
            list += &format!("{at_ns},{at_ns}.png\r\n");
            let path = side.join(format!("data/{at_ns}.png"));
            wall(camera).save(&path).expect("writable");
            if (camera, frame) == (1, 4) {
                let bytes = std::fs::read(&path).expect("readable");
                std::fs::write(&path, &bytes[..bytes.len() / 2]).expect("writable");
            }
        }
        std::fs::write(side.join("data.csv"), list).expect("writable");
    }
    folder
}

#[test]
fn a_sequence_is_played_at_its_exposures_and_what_is_wrong_with_it_is_counted() {
    let run = Run::new("euroc");
    let folder = euroc(&run, 10).display().to_string();
    let (summary, message) = replay(&run, &[&[folder.as_str(), "--out", "made"], &GEOMETRY[..]].concat(), |_| {});
    let frames = &summary["frames"];
    let counts = ["in_sequence", "unpaired", "left_out", "shown"].map(|key| frames[key].as_u64().expect("a number"));
    assert_eq!(counts, [9, 1, 1, 8], "{summary}");
    assert!(message.contains("1403715273462142976.png"), "the torn file is named: {message}");
    assert_eq!(frames["first_exposure_ns"], 1_403_715_273_262_142_976_i64);
    assert!(right_percent(&run.path("made-disparity.png")) > 95.0);
    // Of the frames that the graph kept up with, each as many intervals after the one before as the list says.
    let exposures = exposures_ms(&run);
    assert!(exposures.len() >= 5, "{exposures:?}");
    let first = exposures[0];
    for at in exposures.iter().filter(|at| **at - first < 460.0) {
        let intervals = (at - first) / 50.0;
        assert!((intervals - intervals.round()).abs() < 1e-3, "{exposures:?}");
    }
}

#[test]
fn real_sequences_are_played() {
    let Some(data) = data() else { return };
    let run = Run::new("v101");
    let folder = data.join("euroc_v101_static").display().to_string();
    let (summary, _) = replay(&run, &[&folder, "--calib", &folder], |_| {});
    assert_eq!((&summary["frames"]["in_sequence"], &summary["frames"]["shown"]), (&6.into(), &6.into()), "{summary}");
    // The vehicle stands still: the frames are alike.
    let spread = &summary["frames"]["valid_percent"];
    assert!(number(spread, "least") > 60.0 && number(spread, "most") - number(spread, "least") < 3.0, "{summary}");
    let run = Run::new("kinect");
    let folder = data.join("depth_7scenes_seq").display().to_string();
    let camera = ["--source", "depth", "--focal", "585", "--baseline", "0.075", "--centre", "320,240", "--rate", "20"];
    let (summary, _) =
        replay(&run, &[&[folder.as_str(), "--sigma-px", "0.05", "--out", "made"], &camera[..]].concat(), |_| {});
    assert_eq!((&summary["frames"]["in_sequence"], &summary["frames"]["shown"]), (&40.into(), &40.into()), "{summary}");
    let last = image::open(data.join("depth_7scenes_seq/frame-000195.depth.png")).expect("readable").into_luma16();
    let found = stereo_ingest::load_disparity(&run.path("made-disparity.png"), 640, 480).expect("readable");
    for (Luma([value]), found) in last.pixels().zip(found) {
        let expected = (1..=10_000).contains(value).then(|| 43_875.0 / f32::from(*value));
        let is_same = match (expected, found) {
            (Some(expected), Some(found)) => (expected - found).abs() < 0.01,
            (expected, found) => expected.is_none() && found.is_none(),
        };
        assert!(is_same, "{value} mm: {expected:?}, {found:?}");
    }
}

#[test]
fn ready_made_disparity_passes_as_it_is() {
    let run = Run::new("smart");
    // Four fractional bits; a miss is -1 px, as OpenCV marks it.
    let value = |column: u32| if column < 20 { 65_520 } else { (SHIFT * 16) as u16 };
    let image = ImageBuffer::<Luma<u16>, _>::from_fn(SIZE.0, SIZE.1, |column, _| Luma([value(column)]));
    image.save(run.path("disparity.png")).expect("writable");
    let arguments = [
        "disparity.png",
        "--source",
        "disparity",
        "--unit",
        "0.0625",
        "--max-disparity",
        "64",
        "--sigma-px",
        "0.3",
        "--out",
        "made",
    ];
    let (summary, _) = replay(&run, &[&arguments[..], &GEOMETRY].concat(), |_| {});
    assert!((number(&summary, "valid_percent") - 100.0 * 140.0 / 160.0).abs() < 1e-9, "{summary}");
    let found = stereo_ingest::load_disparity(&run.path("made-disparity.png"), SIZE.0, SIZE.1).expect("readable");
    let expected = (0..SIZE.0 * SIZE.1).map(|index| (index % SIZE.0 >= 20).then_some(SHIFT as f32));
    assert!(found.into_iter().eq(expected));
}

#[test]
fn a_file_of_raw_frames_is_played_like_a_camera() {
    let run = Run::new("raw");
    let (left, right) = (wall(0), wall(1));
    let row = |image: &GrayImage, row: u32| (0..SIZE.0).flat_map(|x| [image[(x, row)].0[0], 128]).collect::<Vec<_>>();
    let frame: Vec<u8> = (0..SIZE.1).flat_map(|y| [row(&left, y), row(&right, y)].concat()).collect();
    std::fs::write(run.path("side-by-side.yuyv"), frame.repeat(3)).expect("writable");
    let camera =
        ["--camera", "side-by-side.yuyv", "--size", "160x120", "--frames", "12", "--rate", "40", "--out", "made"];
    let (summary, _) = replay(&run, &[&camera[..], &GEOMETRY].concat(), |_| {});
    assert_eq!(summary["frames"]["shown"], 12, "{summary}");
    assert!(right_percent(&run.path("made-disparity.png")) > 95.0, "{summary}");
}

/// The driver in user space, or a loud `None` where it cannot be compiled.
fn virtual_driver(run: &Run) -> Option<PathBuf> {
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/virtual_camera.c");
    let library = run.path("virtual_camera.so");
    let output =
        Command::new("cc").args(["-O1", "-shared", "-fPIC", "-o"]).arg(&library).arg(source).arg("-ldl").output();
    match output {
        Ok(output) if output.status.success() => Some(library),
        Ok(output) => {
            eprintln!("SKIPPED: no virtual camera: {}", String::from_utf8_lossy(&output.stderr));
            None
        }
        Err(error) => {
            eprintln!("SKIPPED: no virtual camera: cc: {error}");
            None
        }
    }
}

/// Replays /dev/zero and /dev/full, which the driver makes cameras that show these images.
fn replay_virtual(
    run: &Run,
    driver: &Path,
    images: [Vec<u8>; 2],
    size: &str,
    faults: &str,
    arguments: &[&str],
) -> (Value, String) {
    std::fs::write(run.path("0.grey"), &images[0]).expect("writable");
    std::fs::write(run.path("1.grey"), &images[1]).expect("writable");
    let base = ["--pixel-format", "grey", "--size", "160x120", "--rate", "20", "--out", "made"];
    replay(run, &[arguments, &base, &GEOMETRY].concat(), |command| {
        command.env("LD_PRELOAD", driver).env("VIRTUAL_CAMERA_SIZE", size).env("VIRTUAL_CAMERA_FAULTS", faults);
        command.env("VIRTUAL_CAMERA_0", run.path("0.grey")).env("VIRTUAL_CAMERA_1", run.path("1.grey"));
    })
}

#[test]
fn two_cameras_are_paired_stamped_at_exposure_and_opened_again_when_they_fail() {
    let run = Run::new("cameras");
    let Some(driver) = virtual_driver(&run) else { return };
    let images = [wall(0).into_raw(), wall(1).into_raw()];
    let arguments = ["--camera", "/dev/zero", "/dev/full", "--frames", "30"];
    let (summary, message) = replay_virtual(&run, &driver, images, "160x120", "damage unplug", &arguments);
    assert_eq!(summary["frames"]["shown"], 30, "{summary}");
    // Of each camera one damaged frame and two lost ones, before and after it was unplugged, and that itself.
    // Cameras that begin an interval apart cost a few more.
    let left_out = summary["frames"]["left_out"].as_u64().expect("a number");
    assert!((13..=20).contains(&left_out), "{summary}");
    assert!(message.contains("/dev/zero: No such device"), "{message}");
    assert!(right_percent(&run.path("made-disparity.png")) > 95.0);
    // The driver exposes at multiples of 50 ms of the machine's clock.
    for at_ms in exposures_ms(&run) {
        let off_ms = (at_ms / 50.0 - (at_ms / 50.0).round()) * 50.0;
        assert!(off_ms.abs() < 2.0, "exposed {off_ms} ms beside");
    }
}

#[test]
fn one_camera_that_delivers_both_images_side_by_side_is_split() {
    let run = Run::new("side");
    let Some(driver) = virtual_driver(&run) else { return };
    let (left, right) = (wall(0), wall(1));
    let rows = left.as_raw().chunks(SIZE.0 as usize).zip(right.as_raw().chunks(SIZE.0 as usize));
    let both: Vec<u8> = rows.flat_map(|(left, right)| [left, right].concat()).collect();
    let arguments = ["--camera", "/dev/zero", "--frames", "10"];
    let (summary, _) = replay_virtual(&run, &driver, [both, Vec::new()], "320x120", "", &arguments);
    let frames = &summary["frames"];
    // A frame may come before there is a flight time to date it by.
    assert!(frames["shown"] == 10 && frames["left_out"].as_u64().is_some_and(|count| count <= 1), "{summary}");
    assert!(right_percent(&run.path("made-disparity.png")) > 95.0);
}

#[test]
fn a_camera_that_offers_something_else_is_refused_with_what_it_offers() {
    let run = Run::new("other");
    let Some(driver) = virtual_driver(&run) else { return };
    let _alone = real_time();
    let mut command = run.command(&["replay", "--run", &run.name, "--camera", "/dev/zero", "--size", "160x120"]);
    command.args(GEOMETRY).env("LD_PRELOAD", driver).env("VIRTUAL_CAMERA_SIZE", "640x480");
    let output = command.output().expect("starts");
    let message = String::from_utf8_lossy(&output.stderr);
    assert!(!output.status.success());
    assert!(message.contains("/dev/zero: delivers 640 x 480 px GREY where 320 x 120 px YUYV was asked"), "{message}");
    assert!(message.contains("it offers GREY"), "{message}");
    run.assert_nothing_left();
}
