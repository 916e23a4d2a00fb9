//! The matcher on real pairs with ground truth, which nobody here made. Skips, loudly, where they are absent.

mod common;

use common::data;
use ipc_types::StereoRig;
use stereo_ingest::{Config, GroundTruth, Matcher, StereoPair};

/// Folder, left, right, disparities, largest tolerated share (percent) of pixels unmatched or off by more than 2 px.
const PAIRS: [(&str, &str, &str, u32, f64); 6] = [
    ("mid2001_tsukuba", "imL2l.bmp", "imL2.bmp", 16, 4.3),
    ("mid2003_cones", "im2.png", "im6.png", 64, 4.8),
    ("mid2006_aloe_full", "aloeL.jpg", "aloeR.jpg", 256, 6.0),
    ("mid2014_motorcycle_perfect_q", "motorcycle_left.png", "motorcycle_right.png", 64, 6.0),
    ("eth3d_playground", "im0.png", "im1.png", 64, 2.4),
    ("kitti2012_pair_gt", "kittiL.png", "kittiR.png", 96, 7.1),
];

#[test]
fn real_pairs_are_matched_densely_and_soundly() {
    let Some(data) = data() else { return };
    for (folder, left, right, max_disparity_px, tolerated) in PAIRS {
        let folder = data.join(folder);
        let pair = StereoPair::load(&folder.join(left), &folder.join(right)).expect("a pair");
        let rig = StereoRig {
            width_px: pair.width_px,
            height_px: pair.height_px,
            focal_px: 500.0,
            cx_px: 100.0,
            cy_px: 100.0,
            baseline_m: 0.1,
            doffs_px: 0.0,
        };
        let config = Config::dense(max_disparity_px);
        let truth = folder.join("derived_gt_u16x256.png");
        let mask = folder.join("derived_nocc.png");
        let truth = GroundTruth::load(&truth, Some(&mask), pair.width_px, pair.height_px).expect("ground truth");
        let mut disparity = vec![0; rig.pixels()];
        let (left, right) = pair.pixels.split_at(rig.pixels());
        Matcher::new(&rig, config).step(left, right, &mut disparity).expect("sizes agree");
        let error = truth.score(&disparity);
        println!("{}: {error:.2?}", folder.display());
        assert!(error.bad_or_unmatched_percent[1] <= tolerated, "{}: {error:?}", folder.display());
        assert!(error.bad_percent[1] <= 6.0, "{}: {error:?}", folder.display());
    }
}
