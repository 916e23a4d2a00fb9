//! Parameters of the matcher.

use crate::matching::{Cost, Weights};
use ipc_types::StereoRig;
use ipc_types::bounds::Bounds;
use serde::{Deserialize, Serialize};

/// Parameters of the matcher.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// Disparities searched: 0 to this, px. One of [`Config::RANGES`].
    pub max_disparity_px: u32,
    /// Threads that match. Results do not depend on them.
    pub threads: u32,
    /// How matches are found.
    pub method: Method,
    /// How much worse than the best the second-best match must be, percent. 0 asks nothing.
    pub uniqueness_percent: u32,
    /// Largest difference between the left and the right image's match, px.
    pub left_right_px: u32,
    /// Longest run of pixels that may keep matches the right image contradicts, if they continue both sides, px.
    pub bridge_px: u32,
    /// Mean absolute horizontal difference below which a window of either image is textureless, grey levels.
    pub least_texture: f32,
    /// Connected areas smaller than this are removed, px.
    pub speckle_area_px: u32,
    /// ... and so are areas smaller than a square of this side at their own distance, m.
    pub speckle_size_m: f32,
    /// Largest step within a connected area, px.
    pub speckle_step_px: f32,
}

/// How matches are found.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "snake_case")]
pub enum Method {
    /// Census costs, aggregated along paths (Hirschmüller 2008).
    SemiGlobal {
        /// 3: from the left, the right and above. 5: from above on both diagonals, too.
        paths: u32,
        /// Side of the square over which costs are averaged, px: 1, 3, 5 or 7.
        window_px: u32,
        /// Penalty for a disparity step of one between neighbours, in census bits.
        small_step_penalty: u8,
        /// Penalty for a larger step, in census bits.
        large_step_penalty: u8,
    },
    /// Sums of absolute differences of the horizontal gradient over a square: cheap, and blind to weak texture.
    Block {
        /// Side of the square, px: odd, 5 to 21.
        window_px: u32,
    },
}

impl Config {
    /// Disparity ranges that are compiled.
    pub const RANGES: [u32; 7] = [16, 32, 64, 96, 128, 192, 256];

    /// Dense and accurate on pictures of all kinds: what `sparrowhawk stereo` uses.
    pub const fn dense(max_disparity_px: u32) -> Self {
        Self {
            max_disparity_px,
            threads: 1,
            method: Method::SemiGlobal { paths: 3, window_px: 5, small_step_penalty: 14, large_step_penalty: 60 },
            uniqueness_percent: 0,
            left_right_px: 2,
            bridge_px: 16,
            least_texture: 0.2,
            speckle_area_px: 100,
            speckle_size_m: 0.0,
            speckle_step_px: 2.0,
        }
    }

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
        bounds.range("threads", self.threads, 1..=64);
        self.method.check(bounds);
        bounds.range("uniqueness_percent", self.uniqueness_percent, 0..=100);
        bounds.range("left_right_px", self.left_right_px, 0..=16);
        bounds.range("bridge_px", self.bridge_px, 0..=64);
        bounds.range("least_texture", self.least_texture, 0.0..=100.0);
        bounds.range("speckle_area_px", self.speckle_area_px, 0..=10_000);
        bounds.range("speckle_size_m", self.speckle_size_m, 0.0..=0.2);
        bounds.range("speckle_step_px", self.speckle_step_px, 0.1..=16.0);
    }

    /// The same in the kernel's integer units.
    ///
    /// Costs are cut so that the column sums of a window fit a byte, and shifted so that the window's sum does; what
    /// remains of a bit (or of a grey level) is the unit of the penalties.
    pub(crate) fn weights(&self) -> Weights {
        let (cost, paths, window, small, large) = match self.method {
            Method::SemiGlobal { paths, window_px, small_step_penalty, large_step_penalty } => {
                (Cost::Hamming, paths, window_px, small_step_penalty, large_step_penalty)
            }
            Method::Block { window_px } => (Cost::AbsoluteDifference, 0, window_px, 0, 0),
        };
        let most = if cost == Cost::Hamming { 32 } else { 62 };
        let largest = most.min(255 / window);
        // Path costs leave room for penalties and are added up, the more of them the smaller.
        let room = [255, 72, 40][paths as usize / 2];
        let column_shift = (0..8).find(|&shift| window * ((window * largest) >> shift) <= 255).unwrap_or(7);
        let full = window * ((window * largest) >> column_shift);
        let window_shift = (0..8).find(|&shift| full >> shift <= room).unwrap_or(7);
        let unit = (window * window) as f32 / (1 << (column_shift + window_shift)) as f32;
        let highest = (255 - (full >> window_shift)) as f32;
        let penalty = |bits: u8| (f32::from(bits) * unit).round().min(highest) as u8;
        Weights {
            cost,
            largest: largest as u8,
            window: window as usize,
            column_shift,
            window_shift,
            small_step: penalty(small),
            large_step: penalty(large),
            paths: paths as usize,
            range: self.max_disparity_px as usize,
            uniqueness_percent: self.uniqueness_percent,
        }
    }
}

impl Method {
    fn check(&self, bounds: &mut Bounds) {
        match *self {
            Self::SemiGlobal { paths, window_px, small_step_penalty, large_step_penalty } => {
                bounds.require(
                    [3, 5].contains(&paths),
                    "method.paths",
                    format_args!("is {paths}, allowed are 3 and 5"),
                );
                bounds.require(
                    [1, 3, 5, 7].contains(&window_px),
                    "method.window_px",
                    format_args!("is {window_px}, allowed are 1, 3, 5 and 7"),
                );
                bounds.range("method.small_step_penalty", small_step_penalty, 1..=100);
                bounds.range("method.large_step_penalty", large_step_penalty, small_step_penalty..=200);
            }
            Self::Block { window_px } => {
                let odd = (5..=21).contains(&window_px) && !window_px.is_multiple_of(2);
                bounds.require(odd, "method.window_px", format_args!("is {window_px}, allowed are odd numbers 5..21"));
            }
        }
    }
}
