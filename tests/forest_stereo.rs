//! What the vehicle's matcher sees of the forest it flies in, against what the renderer knows.

use ipc_types::disparity::{decode, is_valid};
use ipc_types::{Pose, Rotation, Vector};
use simulator::StereoCamera;
use sparrowhawk::config::FlightConfig;
use sparrowhawk::graph;
use std::sync::Arc;
use stereo_ingest::Matcher;

/// Off by more than this is wrong, px.
const TOLERANCE_PX: f32 = 2.0;
/// A trunk no wider than this in the image is thin, px.
const THIN_PX: usize = 5;

#[derive(Debug, Default)]
struct Tally {
    seen: usize,
    matched: usize,
    wrong: usize,
    /// Matched, and farther than the truth: free space where there is none.
    far: usize,
    /// Rows of thin things, and those of them without a near enough match within a pixel.
    thin_rows: usize,
    thin_missed: usize,
    /// ... where instead something farther was measured all across: a hole in the trunk, not a gap in the knowledge.
    thin_far: usize,
}

impl Tally {
    fn add(&mut self, truth: &[f32], found: &[u16], width: usize) {
        for (&truth, &found) in truth.iter().zip(found).filter(|(truth, _)| **truth > 0.0) {
            self.seen += 1;
            self.matched += usize::from(is_valid(found));
            let error = decode(found).map_or(0.0, |found| found - truth);
            self.wrong += usize::from(error.abs() > TOLERANCE_PX);
            self.far += usize::from(error < -TOLERANCE_PX);
        }
        for (truth, found) in truth.chunks_exact(width).zip(found.chunks_exact(width)) {
            self.add_thin(truth, found);
        }
    }

    /// Runs of near pixels, not wider than [`THIN_PX`], with something at least 3 px farther on both sides.
    fn add_thin(&mut self, truth: &[f32], found: &[u16]) {
        let mut start = 1;
        for x in 1..truth.len() {
            if (truth[x] - truth[x - 1]).abs() <= 1.0 {
                continue;
            }
            let run = start..x;
            start = x;
            let nearer = truth[run.start] > truth[run.start - 1] + 3.0 && truth[x - 1] > truth[x] + 3.0;
            // Nearer than about 12 m: what lies beyond is avoided later.
            if run.len() > THIN_PX || run.len() < 2 || !nearer || truth[run.start] < 5.0 {
                continue;
            }
            self.thin_rows += 1;
            let around = run.start - 1..(run.end + 1).min(truth.len());
            let is_near = |x: usize| decode(found[x]).is_some_and(|found| found > truth[run.start] - TOLERANCE_PX);
            self.thin_missed += usize::from(!around.clone().any(is_near));
            let is_far = |x: usize| decode(found[x]).is_some_and(|found| found < truth[run.start] - TOLERANCE_PX);
            self.thin_far += usize::from(run.clone().all(is_far));
        }
    }
}

#[test]
fn few_thin_trunks_are_taken_for_far() {
    let config = FlightConfig::load(None, None).expect("loads");
    let rig = config.vehicle.rig;
    let mut matcher = Matcher::new(&rig, config.vehicle.stereo);
    let (mut tally, mut disparity) = (Tally::default(), vec![0; rig.pixels()]);
    for seed in 101..=106 {
        let mut config = config.clone();
        config.seed = seed;
        let world = Arc::new(graph::world(&config).expect("no file"));
        let mut camera = StereoCamera::new(Arc::clone(&world), rig, config.vehicle.simulator.camera, seed);
        for place in 0..8 {
            let body = Pose {
                rotation: Rotation::from_roll_pitch_yaw(0.03, 0.05, f64::from(place) * 0.8),
                translation: Vector::new(f64::from(place) * 7.0, 0.0, 2.0),
            };
            let pose = body * config.vehicle.mount.body_from_camera();
            let mut pixels = vec![0; 2 * rig.pixels()];
            camera.expose(pose, &mut pixels);
            let (left, right) = pixels.split_at(rig.pixels());
            matcher.step(left, right, &mut disparity).expect("sizes agree");
            tally.add(&camera.true_disparity(pose), &disparity, rig.width_px as usize);
        }
    }
    let percent = |part: usize, whole: usize| 100.0 * part as f64 / whole as f64;
    let (bad, far) = (percent(tally.wrong, tally.matched), percent(tally.far, tally.matched));
    let (missed, thin_far) = (percent(tally.thin_missed, tally.thin_rows), percent(tally.thin_far, tally.thin_rows));
    println!(
        "density {:.1} %, bad2 {bad:.2} %, too far {far:.2} % of the matched; of {} rows of thin things {missed:.1} % missed, {thin_far:.1} % taken for far",
        percent(tally.matched, tally.seen),
        tally.thin_rows,
    );
    assert!(tally.thin_rows > 1000, "{tally:?}");
    assert!(bad < 3.0 && far < 0.9, "{bad:.2} % wrong, {far:.2} % too far");
    assert!(missed < 42.0 && thin_far < 12.0, "{missed:.1} % missed, {thin_far:.1} % taken for far");
}
