//! The error of measured disparities: samples, Gaussian fit, histogram (DROAN, sections 3.1.2 and 3.1.3).

use crate::calibration::{Board, Solution};
use ipc_types::StereoRig;
use ipc_types::disparity::decode;
use nalgebra::Matrix3;

/// A disparity that was measured where the truth is known.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// Measured less true, px.
    pub error_px: f32,
    /// True disparity, px.
    pub disparity_px: f32,
}

/// Samples, and how many pixels with a truth were not matched.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ErrorProfile {
    /// Matched pixels.
    pub samples: Vec<Sample>,
    /// The others.
    pub unmatched: usize,
}

/// A normal distribution fitted to errors, outliers left out.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct GaussianFit {
    /// Samples.
    pub samples: usize,
    /// Standard deviation, px.
    pub sigma_px: f64,
    /// Mean, px: what the measured disparities are too large by.
    pub bias_px: f64,
    /// Samples farther than three standard deviations from the mean, percent: wrong matches.
    pub outliers_percent: f64,
}

/// Fewer samples tell nothing.
const LEAST_SAMPLES: usize = 30;

impl GaussianFit {
    /// Fits, or `None` for fewer than 30 samples.
    ///
    /// From median and median absolute deviation, then mean and deviation of what lies within three of them, until that
    /// no longer changes. What the cut takes from a Gaussian's deviation (1.3 %) is given back.
    pub fn new(errors: impl Iterator<Item = f32>) -> Option<Self> {
        let mut errors: Vec<f64> = errors.map(f64::from).filter(|error| error.is_finite()).collect();
        if errors.len() < LEAST_SAMPLES {
            return None;
        }
        errors.sort_by(f64::total_cmp);
        let median = errors[errors.len() / 2];
        let mut deviations: Vec<f64> = errors.iter().map(|error| (error - median).abs()).collect();
        deviations.sort_by(f64::total_cmp);
        let (mut bias, mut sigma) = (median, (1.4826 * deviations[deviations.len() / 2]).max(1e-3));
        let within =
            |bias: f64, sigma: f64| errors.iter().copied().filter(move |error| (error - bias).abs() <= 3.0 * sigma);
        for _ in 0..20 {
            let count = within(bias, sigma).count() as f64;
            let mean = within(bias, sigma).sum::<f64>() / count;
            let variance = within(bias, sigma).map(|error| (error - mean).powi(2)).sum::<f64>() / count;
            let deviation = (variance.sqrt() / 0.9866).max(1e-3);
            let settled = (mean - bias).abs() + (deviation - sigma).abs() < 1e-6;
            (bias, sigma) = (mean, deviation);
            if settled {
                break;
            }
        }
        let outliers = errors.len() - within(bias, sigma).count();
        let outliers_percent = 100.0 * outliers as f64 / errors.len() as f64;
        Some(Self { samples: errors.len(), sigma_px: sigma, bias_px: bias, outliers_percent })
    }

    /// Probability density at an error, 1/px.
    pub fn density(&self, error_px: f64) -> f64 {
        let z = (error_px - self.bias_px) / self.sigma_px;
        (-0.5 * z * z).exp() / (self.sigma_px * (2.0 * std::f64::consts::PI).sqrt())
    }
}

impl ErrorProfile {
    /// Adds an image whose true disparities are known.
    pub fn add_image(&mut self, truth: &[Option<f32>], measured: &[u16]) {
        for (truth, &pixel) in truth.iter().zip(measured) {
            if let Some(truth) = truth {
                self.add(*truth, pixel);
            }
        }
    }

    fn add(&mut self, truth: f32, pixel: u16) {
        match decode(pixel) {
            Some(found) => self.samples.push(Sample { error_px: found - truth, disparity_px: truth }),
            None => self.unmatched += 1,
        }
    }

    /// Adds a view of a board: the truth is the board's plane, whose pose was solved for. The disparity is sampled at
    /// the corners, where there is something to match, as DROAN's authors did.
    pub fn add_board(
        &mut self,
        board: &Board,
        solution: &Solution,
        view: usize,
        rig: &StereoRig,
        turn: &Matrix3<f64>,
        measured: &[u16],
    ) {
        let from_board = solution.boards[view];
        for index in 0..board.columns * board.rows {
            let point = turn * (from_board.rotation * board.corner(index) + from_board.translation.vector);
            let (column, row) =
                (rig.cx_px + rig.focal_px * point.x / point.z, rig.cy_px + rig.focal_px * point.y / point.z);
            let (column, row) = (column.round(), row.round());
            let inside =
                (0.0..f64::from(rig.width_px)).contains(&column) && (0.0..f64::from(rig.height_px)).contains(&row);
            if inside && point.z > 0.0 {
                let pixel = measured[row as usize * rig.width_px as usize + column as usize];
                self.add(rig.disparity_px(point.z) as f32, pixel);
            }
        }
    }

    /// The fit to all samples.
    pub fn fit(&self) -> Option<GaussianFit> {
        GaussianFit::new(self.samples.iter().map(|sample| sample.error_px))
    }

    /// The fit by disparity: as many samples in each of `parts`, from the farthest on; with the least and the largest
    /// disparity of each.
    pub fn fit_by_disparity(&self, parts: usize) -> Vec<(f32, f32, GaussianFit)> {
        let mut sorted = self.samples.clone();
        sorted.sort_by(|a, b| a.disparity_px.total_cmp(&b.disparity_px));
        let fit = |part: &[Sample]| {
            let fit = GaussianFit::new(part.iter().map(|sample| sample.error_px))?;
            Some((part.first()?.disparity_px, part.last()?.disparity_px, fit))
        };
        sorted.chunks(sorted.len().div_ceil(parts).max(1)).filter_map(fit).collect()
    }

    /// Shares of the samples in bins of `width_px` from `-reach_px` to `reach_px`, and of those beyond, in percent.
    pub fn histogram(&self, width_px: f64, reach_px: f64) -> (Vec<f64>, f64) {
        let bins = (2.0 * reach_px / width_px).round() as usize;
        let mut counts = vec![0_usize; bins];
        let mut beyond = 0;
        for sample in &self.samples {
            let bin = ((f64::from(sample.error_px) + reach_px) / width_px).floor();
            if bin >= 0.0 && (bin as usize) < bins { counts[bin as usize] += 1 } else { beyond += 1 }
        }
        let percent = |count: usize| 100.0 * count as f64 / self.samples.len().max(1) as f64;
        (counts.into_iter().map(percent).collect(), percent(beyond))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ipc_types::disparity::{NO_MATCH, encode};
    use rand::SeedableRng;
    use rand_distr::{Distribution, Normal};

    #[test]
    fn a_gaussian_is_found_beneath_outliers() {
        let mut random = rand_pcg::Pcg64Mcg::seed_from_u64(3);
        let normal = Normal::new(0.1_f32, 0.25).expect("possible");
        let errors: Vec<f32> =
            (0..20_000).map(|i| if i % 20 == 0 { 5.0 + (i % 7) as f32 } else { normal.sample(&mut random) }).collect();
        let fit = GaussianFit::new(errors.into_iter()).expect("enough");
        assert!((fit.sigma_px - 0.25).abs() < 0.01 && (fit.bias_px - 0.1).abs() < 0.01, "{fit:?}");
        assert!((5.0..5.6).contains(&fit.outliers_percent), "{fit:?}");
        assert_eq!(GaussianFit::new([0.0; 10].into_iter()), None);
        assert_eq!(GaussianFit::new([f32::NAN; 100].into_iter()), None);
    }

    #[test]
    fn unmatched_pixels_are_counted_apart() {
        let mut profile = ErrorProfile::default();
        profile
            .add_image(&[Some(10.0), Some(10.0), None, Some(4.0)], &[encode(10.5), NO_MATCH, encode(3.0), encode(4.0)]);
        assert_eq!((profile.samples.len(), profile.unmatched), (2, 1));
        let (shares, beyond) = profile.histogram(0.25, 0.25);
        assert_eq!((shares, beyond), (vec![0.0, 50.0], 50.0));
    }
}
