//! A real depth camera's images as disparity: what its noise is, by distance.

mod common;

use ipc_types::StereoRig;
use ipc_types::disparity::{decode, is_valid};
use ipc_types::noise::NoiseModel;
use nalgebra::{Matrix3, Vector3};
use stereo_ingest::{Content, FrameImage, Sequence, Source, ValueTable};

/// 7-Scenes' camera; the baseline is its projector's.
const RIG: StereoRig = StereoRig {
    width_px: 640,
    height_px: 480,
    focal_px: 585.0,
    cx_px: 320.0,
    cy_px: 240.0,
    baseline_m: 0.075,
    doffs_px: 0.0,
};
const SOURCE: Source = Source::Depth { unit_m: 0.001, nearest_m: 0.5, farthest_m: 6.0 };
/// Side of the windows that a plane is fitted to, px.
const SIDE: usize = 15;

/// Standard deviation of disparities about their plane, px, and their mean; a plane in space is one in disparity too.
fn about_plane(window: &[(f64, f64, f64)]) -> Option<(f64, f64)> {
    let (mut normal, mut moment) = (Matrix3::zeros(), Vector3::zeros());
    for &(u, v, d) in window {
        let row = Vector3::new(u, v, 1.0);
        normal += row * row.transpose();
        moment += row * d;
    }
    let plane = normal.try_inverse()? * moment;
    let squares: f64 = window.iter().map(|&(u, v, d)| (d - plane.x * u - plane.y * v - plane.z).powi(2)).sum();
    Some(((squares / (window.len() - 3) as f64).sqrt(), plane.z))
}

/// Window by window of a disparity image: distance, m, and deviation, px, where every pixel was measured.
fn deviations(disparity: &[u16], found: &mut Vec<(f64, f64)>) {
    let width = RIG.width_px as usize;
    for top in (0..RIG.height_px as usize - SIDE).step_by(SIDE) {
        for left in (0..width - SIDE).step_by(SIDE) {
            let half = (SIDE / 2) as f64;
            let window: Option<Vec<_>> = (0..SIDE * SIDE)
                .map(|index| {
                    let (row, column) = (index / SIDE, index % SIDE);
                    let disparity_px = decode(disparity[(top + row) * width + left + column])?;
                    Some((column as f64 - half, row as f64 - half, f64::from(disparity_px)))
                })
                .collect();
            if let Some((deviation_px, mean_px)) = window.and_then(|window| about_plane(&window)) {
                found.push((RIG.depth_m(mean_px), deviation_px));
            }
        }
    }
}

#[test]
fn noise_of_a_real_depth_camera_is_a_constant_disparity() {
    let Some(data) = common::data() else { return };
    let folder = data.join("depth_7scenes_seq");
    let sequence = Sequence::open(&[folder], Content::Depth, 6.0).expect("a sequence");
    assert_eq!((sequence.frames.len(), sequence.unpaired), (40, 0));
    let table = ValueTable::new(&RIG, &SOURCE).expect("a table");
    let mut found = Vec::new();
    for frame in sequence.frames.iter().step_by(4) {
        let FrameImage::Depth(image) = frame.load().expect("readable") else { panic!("not a depth image") };
        let mut disparity = vec![0; RIG.pixels()];
        let valid = table.convert(&image.values, &mut disparity);
        let measured = image.values.iter().filter(|&&value| (1..=6000).contains(&value)).count();
        assert_eq!(valid, measured, "what was measured is valid, and nothing else");
        assert!(disparity.iter().zip(&image.values).all(|(&d, &value)| is_valid(d) == (1..=6000).contains(&value)));
        deviations(&disparity, &mut found);
    }
    let noise =
        NoiseModel { sigma_px: 0.06, sigma_m: 0.0, lambda_near: 3.0, lambda_far: 1.0, near_px: 20.0, far_px: 8.0 };
    for (from_m, to_m) in [(0.9, 1.2), (1.2, 1.6), (1.6, 2.0), (2.0, 2.5), (2.5, 3.0)] {
        let mut here: Vec<f64> =
            found.iter().filter(|(depth_m, _)| (from_m..to_m).contains(depth_m)).map(|found| found.1).collect();
        here.sort_by(f64::total_cmp);
        assert!(here.len() > 200, "{from_m} m: {} windows", here.len());
        let (sigma_px, depth_m) = (here[here.len() / 2], 0.5 * (from_m + to_m));
        let fb = RIG.focal_baseline_px_m();
        let model_px = f64::from(noise.at(RIG.disparity_px(depth_m) as f32, fb as f32));
        println!(
            "{from_m} to {to_m} m: sigma {sigma_px:.3} px, {:.1} mm; model {model_px:.3} px",
            1e3 * sigma_px * depth_m * depth_m / fb
        );
        assert!((0.8..1.25).contains(&(sigma_px / model_px)), "{from_m} m: {sigma_px} px");
    }
}
