//! The pure core: one rectified pair in, one disparity image out, in place.

use super::census::PLANES;
use super::simd::SimdLevel;
use super::speckle::{Least, Speckles};
use super::strip::{Cost, Features};
use super::worker::{Work, worker};
use crate::Config;
use ipc_types::StereoRig;
use ipc_types::disparity::{SCALE, TEXTURELESS, is_valid};
use rayon::prelude::*;
use runtime::thread_pool;

/// Why a pair was refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{what} has {found} pixels, the rig's has {expected}")]
pub struct MatchError {
    /// Which image.
    pub what: &'static str,
    /// Pixels received.
    pub found: usize,
    /// Pixels of the rig.
    pub expected: usize,
}

/// What a match found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MatchStatistics {
    /// Pixels with a disparity.
    pub valid: usize,
    /// Pixels without texture.
    pub textureless: usize,
}

/// Matches the pairs of one rig. All memory is allocated here, once.
pub struct Matcher {
    config: Config,
    width: usize,
    pixels: usize,
    features: Features,
    strips: Vec<Box<dyn Work>>,
    /// Rows of a strip.
    strip_rows: usize,
    speckles: Speckles,
    least: Least,
    /// Absent when one thread does all.
    threads: Option<rayon::ThreadPool>,
}

impl std::fmt::Debug for Matcher {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.debug_struct("Matcher").field("config", &self.config).finish_non_exhaustive()
    }
}

/// A strip and what it writes of the left and the right image's features.
type Description<'a> = (&'a mut Box<dyn Work>, (&'a mut [u8], &'a mut [u8]));

/// Strips are about this high. Their number depends on the image alone, so results do not depend on the threads.
const STRIP_ROWS: usize = 120;

impl Matcher {
    /// Allocates for a rig and a disparity range, for the fastest instructions of this machine; `config` is as checked
    /// by [`Config::check`].
    pub fn new(rig: &StereoRig, config: Config) -> Self {
        Self::with_level(rig, config, SimdLevel::best())
    }

    /// The same for other instructions. Results do not depend on them.
    ///
    /// # Panics
    /// The machine does not have them.
    pub fn with_level(rig: &StereoRig, config: Config, level: SimdLevel) -> Self {
        assert!(level.is_available(), "this machine has no {level:?}");
        let (width, height) = (rig.width_px as usize, rig.height_px as usize);
        let (pixels, range) = (width * height, config.max_disparity_px as usize);
        let planes = if config.weights().cost == Cost::Hamming { PLANES } else { 1 };
        let (left_stride, right_stride) = (width + 64, width + range.next_multiple_of(64) + 64);
        let count = height.div_ceil(2 * STRIP_ROWS) * 2;
        let threads = config.threads as usize;
        Self {
            config,
            width,
            pixels,
            features: Features {
                width,
                height,
                left_stride,
                right_stride,
                left: vec![0; left_stride * planes * height],
                right: vec![0; right_stride * planes * height],
                planes,
            },
            strips: (0..count).map(|_| worker(level, width, &config)).collect(),
            strip_rows: height.div_ceil(count),
            speckles: Speckles::new(width, height),
            least: Least {
                area_px: config.speckle_area_px as usize,
                side_baselines: config.speckle_size_m / rig.baseline_m as f32,
                doffs_px: rig.doffs_px as f32,
            },
            threads: thread_pool(threads),
        }
    }

    /// Matches `left` with `right` (row-major grey) into `disparity`, encoded as [`ipc_types::disparity`].
    ///
    /// # Errors
    /// A slice is not of the rig's size; `disparity` is then untouched.
    pub fn step(&mut self, left: &[u8], right: &[u8], disparity: &mut [u16]) -> Result<MatchStatistics, MatchError> {
        let expected = self.pixels;
        for (what, found) in [("left", left.len()), ("right", right.len()), ("disparity", disparity.len())] {
            if found != expected {
                return Err(MatchError { what, found, expected });
            }
        }
        self.describe(left, right);
        self.aggregate([left, right], disparity);
        let step = (self.config.speckle_step_px * SCALE) as u16;
        self.speckles.remove(disparity, self.least, step);
        Ok(MatchStatistics {
            valid: disparity.iter().filter(|&&pixel| is_valid(pixel)).count(),
            textureless: disparity.iter().filter(|&&pixel| pixel == TEXTURELESS).count(),
        })
    }

    /// Features of both images, a strip's rows at a time.
    fn describe(&mut self, left: &[u8], right: &[u8]) {
        let Self { features, strips, strip_rows, .. } = self;
        let rows = *strip_rows;
        let strides = [features.left_stride, features.right_stride];
        let [left_rows, right_rows] = strides.map(|stride| rows * features.planes * stride);
        let (left_out, right_out) = (&mut features.left[..], &mut features.right[..]);
        let work = |(index, (strip, (left_out, right_out))): (usize, Description<'_>)| {
            strip.describe([left, right], index * rows, [left_out, right_out], strides);
        };
        match &self.threads {
            None => {
                let out = left_out.chunks_mut(left_rows).zip(right_out.chunks_mut(right_rows));
                strips.iter_mut().zip(out).enumerate().for_each(work);
            }
            Some(pool) => {
                let out = left_out.par_chunks_mut(left_rows).zip(right_out.par_chunks_mut(right_rows));
                pool.install(|| strips.par_iter_mut().zip(out).enumerate().for_each(work));
            }
        }
    }

    fn aggregate(&mut self, images: [&[u8]; 2], disparity: &mut [u16]) {
        let length = self.strip_rows * self.width;
        let (features, rows) = (&self.features, self.strip_rows);
        let work = |(index, (strip, out)): (usize, (&mut Box<dyn Work>, &mut [u16]))| {
            strip.run(features, images, index * rows, out)
        };
        match &self.threads {
            None => self.strips.iter_mut().zip(disparity.chunks_mut(length)).enumerate().for_each(work),
            Some(pool) => {
                let strips = self.strips.par_iter_mut().zip(disparity.par_chunks_mut(length));
                pool.install(|| strips.enumerate().for_each(work));
            }
        }
    }
}
