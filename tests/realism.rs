//! Rendered pairs are as hard for the matcher as real ones: density and outliers lie within the range of real pairs.

mod common;

use common::data;
use ipc_types::{Pose, Rotation, StereoRig, Vector};
use simulator::StereoCamera;
use sparrowhawk::config::FlightConfig;
use sparrowhawk::graph;
use std::sync::Arc;
use stereo_ingest::{DisparityError, GroundTruth, Matcher, StereoPair};

fn match_and_score(
    rig: &StereoRig,
    config: stereo_ingest::Config,
    pixels: &[u8],
    truth: &GroundTruth,
) -> DisparityError {
    let mut disparity = vec![0; rig.pixels()];
    let (left, right) = pixels.split_at(rig.pixels());
    Matcher::new(rig, config).step(left, right, &mut disparity).expect("sizes agree");
    truth.score(&disparity)
}

/// Scores of the shipped vehicle's matcher on real pairs with ground truth.
fn real(config: &FlightConfig) -> Option<Vec<DisparityError>> {
    let data = data()?;
    let pairs = [
        ("mid2001_tsukuba", "imL2l.bmp", "imL2.bmp"),
        ("mid2003_cones", "im2.png", "im6.png"),
        ("mid2014_motorcycle_perfect_q", "motorcycle_left.png", "motorcycle_right.png"),
        ("eth3d_playground", "im0.png", "im1.png"),
        ("kitti2012_pair_gt", "kittiL.png", "kittiR.png"),
    ];
    let score = |(folder, left, right): (&str, &str, &str)| {
        let folder = data.join(folder);
        let pair = StereoPair::load(&folder.join(left), &folder.join(right)).expect("a pair");
        let (width_px, height_px) = (pair.width_px, pair.height_px);
        let rig = StereoRig { width_px, height_px, ..config.vehicle.rig };
        let truth = folder.join("derived_gt_u16x256.png");
        let mask = folder.join("derived_nocc.png");
        let truth = GroundTruth::load(&truth, Some(&mask), width_px, height_px).expect("ground truth");
        match_and_score(&rig, config.vehicle.stereo, &pair.pixels, &truth)
    };
    Some(pairs.map(score).to_vec())
}

/// Scores on rendered forests: twelve places in three worlds, sky left out.
fn rendered(config: &FlightConfig) -> Vec<DisparityError> {
    let mut scores = Vec::new();
    let rig = config.vehicle.rig;
    for seed in 1..=3 {
        let mut config = config.clone();
        config.seed = seed;
        let world = Arc::new(graph::world(&config).expect("no file"));
        let mut camera = StereoCamera::new(Arc::clone(&world), rig, config.vehicle.simulator.camera, seed);
        for place in 0..4 {
            let yaw = f64::from(place) * 1.3;
            let body = Pose {
                rotation: Rotation::from_roll_pitch_yaw(0.0, 0.05, yaw),
                translation: Vector::new(f64::from(place) * 8.0, 0.0, 2.0),
            };
            let pose = body * config.vehicle.mount.body_from_camera();
            let mut pixels = vec![0; 2 * rig.pixels()];
            camera.expose(pose, &mut pixels);
            let truth = camera.true_disparity(pose);
            let truth: Vec<Option<f32>> = truth.into_iter().map(|d| (d > 0.0).then_some(d)).collect();
            scores.push(match_and_score(&rig, config.vehicle.stereo, &pixels, &truth.into()));
        }
    }
    scores
}

#[test]
fn rendered_pairs_are_as_hard_as_real_ones() {
    let config = FlightConfig::load(None, None).expect("loads");
    let rendered = rendered(&config);
    let mean = |scores: &[DisparityError], value: fn(&DisparityError) -> f64| {
        scores.iter().map(value).sum::<f64>() / scores.len() as f64
    };
    let density: fn(&DisparityError) -> f64 = |score| score.density_percent;
    let bad2: fn(&DisparityError) -> f64 = |score| score.bad_percent[1];
    let (density_here, bad2_here) = (mean(&rendered, density), mean(&rendered, bad2));
    println!("rendered: density {density_here:.1} %, bad2 {bad2_here:.2} %");
    let Some(real) = real(&config) else { return };
    for score in &real {
        println!("real: density {:.1} %, bad2 {:.2} %", density(score), bad2(score));
    }
    let range = |value: fn(&DisparityError) -> f64| {
        let values = real.iter().map(value);
        (values.clone().fold(f64::INFINITY, f64::min), values.fold(0.0, f64::max))
    };
    let ((least, most), (least_bad, most_bad)) = (range(density), range(bad2));
    assert!((least..=most).contains(&density_here), "density {density_here} outside {least}..{most}");
    assert!((least_bad..=most_bad).contains(&bad2_here), "bad2 {bad2_here} outside {least_bad}..{most_bad}");
}
