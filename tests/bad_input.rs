//! Bad input ends in one clear message and a non-zero exit, with nothing left behind.

mod common;

use common::{Run, data};
use std::fs;

/// Runs the executable; returns its message, which must be there, and must not be a panic.
fn refused(run: &Run, arguments: &[&str]) -> String {
    let output = run.command(arguments).output().expect("starts");
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(!output.status.success(), "accepted {arguments:?}");
    assert!(!message.contains("panicked") && !message.trim().is_empty(), "{message}");
    run.assert_nothing_left();
    message
}

/// The shipped configuration in the run's folder, with one replacement in one file.
fn configuration(run: &Run, file: &str, from: &str, to: &str) -> String {
    let shipped = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("config");
    for name in ["default.ron", "vehicles/scout.ron", "worlds/forest.ron", "graphs/droan.ron"] {
        let mut text = fs::read_to_string(shipped.join(name)).expect("shipped");
        if name == file {
            assert!(text.contains(from), "{name} has no {from}");
            text = text.replacen(from, to, 1);
        }
        let path = run.path(name);
        fs::create_dir_all(path.parent().expect("a parent")).expect("writable");
        fs::write(path, text).expect("writable");
    }
    run.path("default.ron").display().to_string()
}

#[test]
fn configurations_that_cannot_be() {
    let cases = [
        (
            "default.ron",
            "cruise_speed_mps: 5.5",
            "cruise_speed_mps: NaN",
            vec!["mission.cruise_speed_mps", "NaN", "0.2 to 20"],
        ),
        ("default.ron", "cruise_speed_mps: 5.5", "cruise_speed_mps: 15.0", vec!["cruise_speed_mps", "stopping takes"]),
        ("default.ron", "mission: (", "mision: (", vec!["default.ron:", "mision"]),
        ("default.ron", "scout.ron", "absent.ron", vec!["absent.ron", "No such file"]),
        ("vehicles/scout.ron", "sigma_px: 0.4", "sigma_px: -1.0", vec!["scout.ron", "noise.sigma_px", "-1"]),
        ("vehicles/scout.ron", "radius_m: 0.65", "radius_m: 0.3", vec!["scout.ron", "expansion.radius_m", "hull"]),
        ("vehicles/scout.ron", "braking_mps2: 4.0", "braking_mps2: 0.5", vec!["controller.braking_mps2", "0.5"]),
        ("default.ron", "start_m: (0.0, 0.0)", "start_m: (300.0, 0.0)", vec!["mission.start_m", "fence"]),
        ("default.ron", "height_m: 3.0", "height_m: 1.0", vec!["home.height_m", "cruise_height_m"]),
        ("default.ron", "height_m: 3.0", "height_m: 1.6", vec!["mission.home.height_m", "1.6", "up to 1.70 m"]),
        ("default.ron", "radius_m: 2.0", "radius_m: 0.3", vec!["mission.home.radius_m", "0.3", "body's radius"]),
        ("vehicles/scout.ron", "rate_hz: 12.5", "rate_hz: 2.0", vec!["image_deadline_s", "interval"]),
        ("graphs/droan.ron", "process: memory,", "process: planner,", vec!["memory", "planner", "once"]),
        ("worlds/forest.ron", "trees_per_m2: 0.05", "trees_per_m2: 7.0", vec!["forest.ron", "trees_per_m2", "7"]),
        ("worlds/forest.ron", "walls: []", "walls: [", vec!["forest.ron:"]),
        ("graphs/droan.ron", "lease_s: 5.0", "lease_s: 5.0, surprise: 1", vec!["droan.ron:", "surprise"]),
    ];
    for (file, from, to, expected) in cases {
        let run = Run::new("badconfig");
        let path = configuration(&run, file, from, to);
        for command in [&["check", &path][..], &["fly", "--run", &run.name, "--config", &path]] {
            let message = refused(&run, command);
            for part in &expected {
                assert!(message.contains(part), "no \"{part}\" in: {message}");
            }
        }
    }
}

#[test]
fn command_lines_that_cannot_be() {
    let run = Run::new("badline");
    assert!(refused(&run, &["fly", "--config", "nowhere.ron"]).contains("nowhere.ron"));
    assert!(refused(&run, &["fly", "--run", "a/b"]).contains("run name"));
    assert!(refused(&run, &["fly", "--run", "a-name-that-is-far-too-long-for-a-socket"]).contains("24 characters"));
    assert!(refused(&run, &["fly", "--goal", "1,2"]).contains("expected 3 numbers"));
    assert!(refused(&run, &["fly", "--pilot", "1,2,3"]).contains("expected 5 numbers"));
    assert!(refused(&run, &["fly", "--pilot", "1,-2,0,0,0"]).contains("for_s"));
    assert!(refused(&run, &["fly", "--waypoint", "1,900,2"]).contains("waypoints_m"));
    assert!(refused(&run, &["fly", "--goal", "500,0,2"]).contains("fence"));
    assert!(refused(&run, &["fly", "--world", "moon"]).contains("moon"));
    fs::create_dir_all(run.path("runs/again")).expect("writable");
    fs::write(run.path("kept.json"), "kept").expect("writable");
    let message = refused(&run, &["fly", "--run", "again", "--summary", "kept.json"]);
    assert!(message.contains("runs/again") && message.contains("exists already"), "{message}");
    assert_eq!(fs::read_to_string(run.path("kept.json")).expect("there"), "kept", "a refused run spoils no file");
    assert!(refused(&run, &["process", "pilot"]).contains("no process of that name"));
}

#[test]
fn a_run_directory_that_cannot_be_written() {
    let run = Run::new("nowrite");
    fs::write(run.path("runs"), b"a file, not a folder").expect("writable");
    let message = refused(&run, &["fly", "--run", &run.name]);
    assert!(message.contains("runs"), "{message}");
}

#[test]
fn images_and_calibrations_that_cannot_be() {
    let run = Run::new("badimage");
    fs::write(run.path("torn.png"), b"\x89PNG\r\n\x1a\nrest is missing").expect("writable");
    let rig = ["--focal", "500", "--baseline", "0.1"];
    let with_rig = |left: &str, right: &str| {
        let mut arguments = vec!["replay", left, right];
        arguments.extend_from_slice(&rig);
        refused(&run, &arguments)
    };
    assert!(with_rig("absent.png", "absent.png").contains("absent.png"));
    assert!(with_rig("torn.png", "torn.png").contains("torn.png"));
    let Some(data) = data() else { return };
    let image = |name: &str| data.join(name).display().to_string();
    let (small, large) = (image("mid2003_cones/im2.png"), image("kitti2012_pair_gt/kittiR.png"));
    let message = with_rig(&small, &large);
    assert!(message.contains("450 x 375") && message.contains("1226 x 370"), "{message}");
    let right = image("mid2003_cones/im6.png");
    assert!(refused(&run, &["replay", &small, &right]).contains("no calibration"));
    let playground = image("eth3d_playground/calib.txt");
    fs::write(
        run.path("other.ron"),
        "(width_px: 640, height_px: 480, focal_px: 400.0, cx_px: 320.0, cy_px: 240.0, baseline_m: 0.1, doffs_px: 0.0)",
    )
    .expect("writable");
    let message = refused(&run, &["replay", &small, &right, "--calib", "other.ron"]);
    assert!(message.contains("640 x 480") && message.contains("450 x 375"), "{message}");
    fs::write(
        run.path("nan.ron"),
        "(width_px: 450, height_px: 375, focal_px: NaN, cx_px: 225.0, cy_px: 187.0, baseline_m: 0.1, doffs_px: 0.0)",
    )
    .expect("writable");
    assert!(refused(&run, &["replay", &small, &right, "--calib", "nan.ron"]).contains("focal_px is NaN"));
    let truth = image("kitti2012_pair_gt/derived_gt_u16x256.png");
    let message = refused(&run, &["replay", &small, &right, "--calib", &playground]);
    assert!(message.contains("941 x 490"), "{message}");
    let arguments = ["replay", &small, &right, "--focal", "500", "--baseline", "0.1", "--ground-truth", &truth];
    assert!(refused(&run, &arguments).contains("expected 450 x 375"));
    let eight_bit = image("mid2003_cones/disp2.png");
    let arguments = ["replay", &small, &right, "--focal", "500", "--baseline", "0.1", "--ground-truth", &eight_bit];
    assert!(refused(&run, &arguments).contains("16-bit"));
}
