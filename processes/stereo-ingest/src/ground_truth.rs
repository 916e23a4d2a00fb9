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

    /// The same without pixels whose place in the right image something nearer covers, or that lie outside of it: no
    /// matcher can see them. What has no truth covers nothing.
    pub fn not_occluded(&self, width_px: u32) -> Self {
        let mut seen = self.0.clone();
        let mut nearest = vec![0.0_f32; width_px as usize];
        for row in seen.chunks_exact_mut(width_px as usize) {
            let place = |column: usize, disparity: f32| {
                let right = (column as f32 - disparity).round();
                (right >= 0.0).then_some(right as usize)
            };
            nearest.fill(0.0);
            for (column, truth) in row.iter().enumerate() {
                if let Some(disparity) = *truth
                    && let Some(right) = place(column, disparity)
                {
                    nearest[right] = nearest[right].max(disparity);
                }
            }
            for (column, truth) in row.iter_mut().enumerate() {
                *truth = truth.filter(|&disparity| {
                    place(column, disparity).is_some_and(|right| nearest[right] <= disparity + 1.0)
                });
            }
        }
        Self(seen)
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
    fn what_something_nearer_covers_is_not_scored() {
        let mut truth = vec![Some(2.0); 20];
        truth[10..13].fill(Some(6.0));
        let seen = GroundTruth(truth).not_occluded(20).0;
        let hidden: Vec<usize> = (0..20).filter(|&column| seen[column].is_none()).collect();
        // 0 and 1 lie outside of the right image, 6 to 8 where 10 to 12 are seen from there.
        assert_eq!(hidden, [0, 1, 6, 7, 8]);
    }

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
