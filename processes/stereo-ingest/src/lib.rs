//! Stereo pairs to disparity.
//!
//! [`Matcher`] is the pure core: sparse census ([`census`](self)), semi-global aggregation along four paths
//! (Hirschmüller 2008), winner-takes-all with parabolic sub-pixel, uniqueness and left-right checks, then speckle
//! removal. What has no texture is reported as [`ipc_types::disparity::TEXTURELESS`], what has no consistent match
//! as [`ipc_types::disparity::NO_MATCH`]; neither is ever "far".
//!
//! [`StereoProcess`] connects the matcher to its topics. [`PairPlayer`] is the source that reads image files.
//! The core refuses images of another size than the rig's, and allocates nothing after construction.

mod aggregate;
mod census;
mod ground_truth;
mod matcher;
mod pairs;
mod player;
mod process;
mod select;
mod speckle;
mod texture;

pub use ground_truth::{DisparityError, GroundTruth};
pub use matcher::{MatchError, MatchStatistics, Matcher};
pub use pairs::{PairError, StereoPair, load_calibration, load_disparity, load_mask, save_disparity};
pub use player::PairPlayer;
pub use process::StereoProcess;

use ipc_types::StereoRig;
use ipc_types::bounds::Bounds;
use serde::{Deserialize, Serialize};

/// Parameters of the matcher.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// Disparities searched: 0 to this, px. One of 32, 64, 96, 128, 192, 256.
    pub max_disparity_px: u32,
    /// Penalty for a disparity step of one between neighbours, in census bits.
    pub small_step_penalty: u8,
    /// Penalty for a larger step, in census bits.
    pub large_step_penalty: u8,
    /// How much worse than the best the second-best match must be, percent.
    pub uniqueness_percent: u32,
    /// Largest difference between the left and the right image's match, px.
    pub left_right_px: u32,
    /// Mean absolute horizontal difference below which a window is textureless, grey levels.
    pub least_texture: f32,
    /// Connected areas smaller than this are removed, px.
    pub speckle_area_px: u32,
    /// ... and so are areas smaller than a square of this side at their own distance, m.
    pub speckle_size_m: f32,
    /// Largest step within a connected area, px.
    pub speckle_step_px: f32,
}

impl Config {
    /// Disparity ranges that are compiled.
    pub const RANGES: [u32; 6] = [32, 64, 96, 128, 192, 256];

    /// Reports values out of range.
    pub fn check(&self, bounds: &mut Bounds, rig: &StereoRig) {
        bounds.require(
            Self::RANGES.contains(&self.max_disparity_px),
            "max_disparity_px",
            format_args!("is {}, allowed are {:?}", self.max_disparity_px, Self::RANGES),
        );
        bounds.require(
            self.max_disparity_px < rig.width_px,
            "max_disparity_px",
            format_args!("is {}, must be below the image width of {} px", self.max_disparity_px, rig.width_px),
        );
        bounds.range("small_step_penalty", self.small_step_penalty, 1..=100);
        bounds.range("large_step_penalty", self.large_step_penalty, self.small_step_penalty..=200);
        bounds.range("uniqueness_percent", self.uniqueness_percent, 0..=100);
        bounds.range("left_right_px", self.left_right_px, 0..=16);
        bounds.range("least_texture", self.least_texture, 0.0..=100.0);
        bounds.range("speckle_area_px", self.speckle_area_px, 0..=10_000);
        bounds.range("speckle_size_m", self.speckle_size_m, 0.0..=0.2);
        bounds.range("speckle_step_px", self.speckle_step_px, 0.1..=16.0);
    }
}
