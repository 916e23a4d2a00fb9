//! What a vehicle's sensor delivers: stereo pairs to be matched, depth images, or ready-made disparity images.
//!
//! Depth and ready-made disparity are 16 bit and become the pipeline's fixed-point disparity by a table of all 65,536
//! values. What the sensor did not measure, or reports from beyond its range, is not matched: never far.

use ipc_types::StereoRig;
use ipc_types::bounds::Bounds;
use ipc_types::disparity::{MASKED, NO_MATCH, TEXTURED, TEXTURELESS, encode, is_valid};
use serde::{Deserialize, Serialize};

/// What the sensor delivers.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Source {
    /// Stereo pairs.
    Stereo,
    /// Disparity of the rig's left image as this pipeline has it, codes and all ([`ipc_types::disparity`]): of the
    /// simulator's noise-model camera.
    Matched,
    /// Depth along the optical axis (RealSense, Kinect, time of flight), seen by the rig's left camera. The rig's baseline
    /// sets how finely depth is told apart: f·b/z is kept to 1/64 px.
    Depth {
        /// What a unit is worth, m: 0.001 for most.
        unit_m: f64,
        /// Least depth that the sensor measures, m. What it reports from nearer counts all the same.
        nearest_m: f64,
        /// Largest depth that is believed, m.
        farthest_m: f64,
    },
    /// Disparity, matched by an FPGA or a smart camera, of the rig's left image.
    Disparity {
        /// What a unit is worth, px: 0.0625 for four fractional bits, 0.00390625 for KITTI's files.
        unit_px: f64,
        /// Largest disparity that the sensor finds, px; what lies above is a code.
        most_px: f64,
    },
}

impl Source {
    /// Reports values out of range.
    pub fn check(&self, bounds: &mut Bounds) {
        match *self {
            Self::Stereo | Self::Matched => {}
            Self::Depth { unit_m, nearest_m, farthest_m } => {
                bounds.range("unit_m", unit_m, 1e-5..=0.1);
                bounds.range("nearest_m", nearest_m, 0.01..=10.0);
                bounds.range("farthest_m", farthest_m, nearest_m..=200.0);
            }
            Self::Disparity { unit_px, most_px } => {
                bounds.range("unit_px", unit_px, 1e-3..=1.0);
                bounds.range("most_px", most_px, 1.0..=1023.0);
            }
        }
    }
}

/// Turns a sensor's 16-bit values into disparity.
#[derive(Debug)]
pub struct ValueTable(Box<[u16; VALUES]>);

const VALUES: usize = 1 << 16;
/// Reasons why there is no disparity.
const CODES: [u16; 4] = [NO_MATCH, TEXTURELESS, MASKED, TEXTURED];

impl ValueTable {
    /// For a sensor that delivers depth or disparity; `None` for one that delivers pairs.
    pub fn new(rig: &StereoRig, source: &Source) -> Option<Self> {
        let disparity_px: Box<dyn Fn(f64) -> Option<f64>> = match *source {
            Source::Stereo => return None,
            Source::Matched => Box::new(|_| None),
            Source::Depth { unit_m, farthest_m, .. } => Box::new(move |value| {
                let depth_m = value * unit_m;
                (depth_m <= farthest_m).then(|| rig.disparity_px(depth_m))
            }),
            Source::Disparity { unit_px, most_px } => {
                Box::new(move |value| Some(value * unit_px).filter(|&disparity_px| disparity_px <= most_px))
            }
        };
        let mut table = Box::new([NO_MATCH; VALUES]);
        if *source == Source::Matched {
            for (value, entry) in (0..=u16::MAX).zip(table.iter_mut()) {
                *entry = if is_valid(value) || CODES.contains(&value) { value } else { NO_MATCH };
            }
            return Some(Self(table));
        }
        // Sensors say with the least or the largest value that they measured nothing.
        for (value, entry) in table.iter_mut().enumerate().take(VALUES - 1).skip(1) {
            *entry = disparity_px(value as f64).map_or(NO_MATCH, |disparity_px| encode(disparity_px as f32));
        }
        Some(Self(table))
    }

    /// Converts an image; returns how many of its pixels were measured. What one image has more pixels than the other
    /// stays as it is.
    pub fn convert(&self, values: &[u16], disparity: &mut [u16]) -> usize {
        let mut valid = 0;
        for (out, &value) in disparity.iter_mut().zip(values) {
            *out = self.0[usize::from(value)];
            valid += usize::from(is_valid(*out));
        }
        valid
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ipc_types::disparity::{MINIMUM, decode};

    /// 7-Scenes' depth camera with its projector's baseline.
    const RIG: StereoRig = StereoRig {
        width_px: 640,
        height_px: 480,
        focal_px: 585.0,
        cx_px: 320.0,
        cy_px: 240.0,
        baseline_m: 0.075,
        doffs_px: 0.0,
    };

    fn converted(source: Source, values: &[u16]) -> (Vec<Option<f32>>, usize) {
        let mut disparity = vec![7; values.len()];
        let valid = ValueTable::new(&RIG, &source).expect("a table").convert(values, &mut disparity);
        (disparity.into_iter().map(decode).collect(), valid)
    }

    #[test]
    fn depth_becomes_disparity_and_what_was_not_measured_is_never_far() {
        let source = Source::Depth { unit_m: 0.001, nearest_m: 0.4, farthest_m: 8.0 };
        let (found, valid) = converted(source, &[0, 1, 100, 400, 1000, 4000, 8000, 8001, 20_000, 65_534, 65_535]);
        assert_eq!(valid, 6);
        assert_eq!((found[0], &found[7..]), (None, &[None; 4][..]));
        assert_eq!(found[1], Some(f32::from(u16::MAX) / 64.0), "nearer than can be told: as near as can be told");
        for (index, depth_m) in [(2, 0.1), (3, 0.4), (4, 1.0), (5, 4.0), (6, 8.0)] {
            let disparity_px = found[index].expect("measured");
            assert!((f64::from(disparity_px) - 43.875 / depth_m).abs() <= 0.5 / 64.0 + 1e-4, "{depth_m}");
        }
    }

    #[test]
    fn ready_made_disparity_keeps_its_fraction_and_codes_are_not_disparities() {
        let source = Source::Disparity { unit_px: 0.0625, most_px: 96.0 };
        // OpenCV's fixed point marks a miss by -16, which is 65,520 here.
        let (found, valid) = converted(source, &[0, 1, 16, 163, 1536, 1537, 65_520, 65_535]);
        assert_eq!(valid, 4);
        let least = Some(f32::from(MINIMUM) / 64.0);
        assert_eq!(found, [None, least, Some(1.0), Some(10.1875), Some(96.0), None, None, None]);
    }

    #[test]
    fn what_is_matched_already_stays_as_it_is() {
        let table = ValueTable::new(&RIG, &Source::Matched).expect("a table");
        let (values, mut out) = ([0, 1, 2, 3, 4, 15, 16, 640, u16::MAX], [7; 9]);
        assert_eq!(table.convert(&values, &mut out), 3);
        assert_eq!(out, [NO_MATCH, TEXTURELESS, MASKED, TEXTURED, NO_MATCH, NO_MATCH, 16, 640, u16::MAX]);
    }

    #[test]
    fn every_value_of_every_source_is_a_disparity_or_a_code() {
        for source in [
            Source::Depth { unit_m: 1e-5, nearest_m: 0.01, farthest_m: 200.0 },
            Source::Depth { unit_m: 0.1, nearest_m: 0.01, farthest_m: 200.0 },
            Source::Disparity { unit_px: 1e-3, most_px: 1023.0 },
            Source::Disparity { unit_px: 1.0, most_px: 1023.0 },
        ] {
            let values: Vec<u16> = (0..=u16::MAX).collect();
            let mut disparity = vec![7; values.len()];
            let valid = ValueTable::new(&RIG, &source).expect("a table").convert(&values, &mut disparity);
            assert_eq!(disparity.iter().filter(|&&pixel| is_valid(pixel)).count(), valid);
            assert!(disparity.iter().all(|&pixel| is_valid(pixel) || pixel == NO_MATCH), "{source:?}");
            assert_eq!((disparity[0], disparity[65_535]), (NO_MATCH, NO_MATCH));
        }
    }

    #[test]
    fn impossible_sensors_are_named() {
        let complaints = |source: Source| {
            let mut bounds = Bounds::default();
            source.check(&mut bounds);
            bounds.into_violations().len()
        };
        assert_eq!(complaints(Source::Stereo), 0);
        assert_eq!(complaints(Source::Depth { unit_m: 0.001, nearest_m: 0.4, farthest_m: 8.0 }), 0);
        assert_eq!(complaints(Source::Depth { unit_m: 0.0, nearest_m: f64::NAN, farthest_m: 0.1 }), 3);
        assert_eq!(complaints(Source::Disparity { unit_px: -1.0, most_px: 5000.0 }), 2);
    }
}
