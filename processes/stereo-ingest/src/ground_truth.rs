//! How far a disparity image is from the truth.

use crate::pairs::{PairError, load_disparity, load_mask};
use ipc_types::disparity::decode;
use serde::Serialize;
use std::path::Path;

/// True disparities of the pixels to be scored.
#[derive(Clone, Debug)]
pub struct GroundTruth(Vec<Option<f32>>);

/// Error figures, over the pixels that have a truth.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct DisparityError {
    /// Pixels scored.
    pub scored: usize,
    /// Matched share, percent.
    pub density_percent: f64,
    /// Matched pixels off by more than 1, 2, 3 px, percent of the matched.
    pub bad_percent: [f64; 3],
    /// The same with unmatched pixels counted as bad, percent of all.
    pub bad_or_unmatched_percent: [f64; 3],
    /// Mean absolute error of the matched, px.
    pub mean_error_px: f64,
}

impl GroundTruth {
    /// Reads a disparity file, and a mask of the pixels to score if there is one.
    ///
    /// # Errors
    /// As [`load_disparity`] and [`load_mask`].
    pub fn load(path: &Path, mask: Option<&Path>, width_px: u32, height_px: u32) -> Result<Self, PairError> {
        let mut truth = load_disparity(path, width_px, height_px)?;
        if let Some(mask) = mask {
            let mask = load_mask(mask, width_px, height_px)?;
            truth.iter_mut().zip(mask).filter(|(_, scored)| !scored).for_each(|(truth, _)| *truth = None);
        }
        Ok(Self(truth))
    }

    /// Scores a disparity image of the same size.
    pub fn score(&self, disparity: &[u16]) -> DisparityError {
        let (mut scored, mut matched, mut bad, mut total_error) = (0_usize, 0_usize, [0_usize; 3], 0.0);
        for (truth, &pixel) in self.0.iter().zip(disparity) {
            let Some(truth) = truth else { continue };
            scored += 1;
            if let Some(found) = decode(pixel) {
                matched += 1;
                let error = (found - truth).abs();
                total_error += f64::from(error);
                for (limit, bad) in [1.0, 2.0, 3.0].into_iter().zip(&mut bad) {
                    *bad += usize::from(error > limit);
                }
            }
        }
        let percent = |part: usize, whole: usize| 100.0 * part as f64 / whole.max(1) as f64;
        DisparityError {
            scored,
            density_percent: percent(matched, scored),
            bad_percent: bad.map(|bad| percent(bad, matched)),
            bad_or_unmatched_percent: bad.map(|bad| percent(bad + scored - matched, scored)),
            mean_error_px: total_error / matched.max(1) as f64,
        }
    }
}

impl From<Vec<Option<f32>>> for GroundTruth {
    fn from(truth: Vec<Option<f32>>) -> Self {
        Self(truth)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ipc_types::disparity::{NO_MATCH, encode};

    #[test]
    fn unmatched_counts_as_bad() {
        let truth = GroundTruth(vec![Some(10.0), Some(10.0), Some(10.0), Some(10.0), None]);
        let error = truth.score(&[encode(10.0), encode(11.5), encode(13.5), NO_MATCH, encode(1.0)]);
        assert_eq!(error.scored, 4);
        assert_eq!(error.density_percent, 75.0);
        assert_eq!(error.bad_or_unmatched_percent, [75.0, 50.0, 50.0]);
        assert!((error.mean_error_px - 5.0 / 3.0).abs() < 1e-6);
    }
}
