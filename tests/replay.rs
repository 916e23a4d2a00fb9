//! Real stereo pairs, which nobody here made, through the multi-process graph.

mod common;

use common::{Run, data, real_time};
use serde_json::Value;

fn replay(run: &Run, arguments: &[&str]) -> Value {
    let _alone = real_time();
    let mut all = vec!["replay", "--run", &run.name, "--summary", "summary.json"];
    all.extend_from_slice(arguments);
    let output = run.command(&all).output().expect("starts");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    println!("{}", String::from_utf8_lossy(&output.stdout));
    run.assert_nothing_left();
    serde_json::from_str(&std::fs::read_to_string(run.path("summary.json")).expect("a summary")).expect("JSON")
}

/// `least_valid`: percent of the pixels that must be matched.
fn assert_digested(summary: &Value, least_valid: f64) {
    let number = |key: &str| summary[key].as_f64().unwrap_or_else(|| panic!("{key}: {summary}"));
    assert!(number("valid_percent") > least_valid, "{summary}");
    // A body among unmatched pixels is vouched for by no single view: a cluttered pair may well have no free space.
    assert!(number("occupied_percent") > 2.0, "{summary}");
    assert!(number("expanded_unknown_percent") < 10.0, "{summary}");
    let shares = ["free_percent", "occupied_percent", "unknown_percent"].map(number);
    assert!((shares.iter().sum::<f64>() - 100.0).abs() < 1e-6, "{summary}");
    assert_eq!(summary["keyframes"], 1);
}

#[test]
fn oak_d_pairs_are_digested() {
    let Some(data) = data() else { return };
    let folder = data.join("oakd_indoor_nogt");
    // The corridor is mostly blank walls.
    for (scene, least_valid) in [("corridor", 20.0), ("toy", 55.0)] {
        let run = Run::new(scene);
        let image = |side: &str| folder.join(format!("{scene}_{side}.png")).display().to_string();
        let (left, right) = (image("left"), image("right"));
        let arguments =
            [left.as_str(), &right, "--focal", "451.0345", "--baseline", "0.075", "--centre", "299.038,255.165"];
        assert_digested(&replay(&run, &arguments), least_valid);
    }
}

#[test]
fn motorcycle_and_kitti_are_digested_and_scored() {
    let Some(data) = data() else { return };
    let motorcycle = [
        "mid2014_motorcycle_perfect_q/motorcycle_left.png",
        "mid2014_motorcycle_perfect_q/motorcycle_right.png",
        "mid2014_motorcycle_perfect_q/derived_gt_u16x256.png",
        "mid2014_motorcycle_perfect_q/derived_nocc.png",
    ];
    let calibration =
        ["--focal", "994.978", "--baseline", "0.193001", "--centre", "311.193,254.877", "--doffs", "31.086"];
    score(&data, "motorcycle", motorcycle, &calibration, 70.0);
    let kitti = [
        "kitti2012_pair_gt/kittiL.png",
        "kitti2012_pair_gt/kittiR.png",
        "kitti2012_pair_gt/derived_gt_u16x256.png",
        "kitti2012_pair_gt/derived_nocc.png",
    ];
    let calibration =
        ["--focal", "707.0912", "--baseline", "0.53715", "--centre", "601.8873,183.1104", "--max-disparity", "96"];
    let summary = score(&data, "kitti", kitti, &calibration, 50.0);
    assert!(summary["free_percent"].as_f64().expect("a number") > 5.0, "{summary}");
}

fn score(data: &std::path::Path, name: &str, files: [&str; 4], calibration: &[&str], least_valid: f64) -> Value {
    let run = Run::new(name);
    let [left, right, truth, mask] = files.map(|file| data.join(file).display().to_string());
    let mut arguments = vec![left.as_str(), &right, "--ground-truth", &truth, "--mask", &mask, "--out", "made"];
    arguments.extend_from_slice(calibration);
    let summary = replay(&run, &arguments);
    assert_digested(&summary, least_valid);
    let error = &summary["disparity_error"];
    assert!(error["bad_percent"][1].as_f64().expect("scored") < 6.0, "{error}");
    assert!(error["density_percent"].as_f64().expect("scored") > 70.0, "{error}");
    let side = |key: &str| summary[key].as_u64().and_then(|pixels| u32::try_from(pixels).ok()).expect("a size");
    let margin = 2 * side("margin_px");
    for (product, larger) in [("disparity", 0), ("front", margin), ("back", margin), ("occupied", 0)] {
        let file = run.path(&format!("made-{product}.png"));
        let (width, height) = (side("width_px") + larger, side("height_px") + larger);
        let image = stereo_ingest::load_disparity(&file, width, height).expect(product);
        let found = image.iter().flatten().count();
        assert!(found > image.len() / 20, "{product}: {found} of {} pixels", image.len());
    }
    summary
}
