//! The pure core: one disparity image in, three planes out, in place.

use crate::Config;
use crate::measured::{Body, Clear, column_keys, distance_to_unmeasured, fill_holes, near_limit};
use crate::range_max::RangeMax;
use crate::tables::Tables;
use crate::window::Axis;
use ipc_types::StereoRig;
use ipc_types::disparity::encode;
use ipc_types::messages::{ExpandedPlanes, UNKNOWN_FRONT};
use ipc_types::noise::NoiseModel;
use multiversion::multiversion;

/// Why an image was refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ExpandError {
    /// The image is not the rig's.
    #[error("disparity image has {found} pixels, the rig's has {expected}")]
    WrongSize {
        /// Pixels received.
        found: usize,
        /// Pixels of the rig.
        expected: usize,
    },
}

/// What an expansion found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Expansion {
    /// Share of pixels of which nothing is known.
    pub unknown_share: f32,
}

/// Expands the images of one rig for one vehicle. All scratch is allocated here, once.
#[derive(Debug)]
pub struct Expander {
    rig: StereoRig,
    config: Config,
    body: Body,
    tables: Tables,
    rows: RangeMax,
    columns: RangeMax,
    row_axis: Axis,
    column_axis: Axis,
    row_windows: Windows,
    column_windows: Windows,
    filled: Vec<u16>,
    transposed: Vec<u16>,
    keys: Vec<u16>,
    distance: Vec<u16>,
    /// Near limits of an image without holes: what its border allows.
    border_limits: Vec<u16>,
}

/// How near a sensor still measures.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Reach {
    /// As disparities of a pair of images, up to so many pixels.
    Matched {
        /// Largest disparity, px.
        most_px: f32,
    },
    /// From this depth on, in every pixel.
    Ranged {
        /// Least depth, m.
        nearest_m: f64,
    },
}

impl Expander {
    /// Prepares tables and scratch. No image vouches for what is nearer than the sensor reaches.
    pub fn new(rig: StereoRig, noise: &NoiseModel, reach: Reach, config: Config) -> Self {
        let (width, height) = (rig.width_px as usize, rig.height_px as usize);
        let focal_px = rig.focal_px as f32;
        let scratch = || vec![0; width * height];
        let row_axis = Axis { focal_px, centre_px: rig.cx_px as f32, length_px: width };
        let column_axis = Axis { focal_px, centre_px: rig.cy_px as f32, length_px: height };
        let body = Body { radius_m: config.body_radius_m, half_height_m: config.body_half_height_m };
        let border_limit = |index: usize| {
            let (row, column) = (index / width, index % width);
            let border = near_limit(
                &rig,
                body,
                Clear {
                    across_px: f32::from(row_axis.to_border(column)),
                    up_px: f32::from(column_axis.to_border(row)),
                    x: row_axis.slope(column),
                    y: column_axis.slope(row),
                },
            );
            border.min(encode(match reach {
                // A pixel's match lies to the left in the right image, at most as far as that image goes.
                Reach::Matched { most_px } => most_px.min(column as f32),
                Reach::Ranged { nearest_m } => rig.disparity_px(nearest_m) as f32,
            }))
        };
        Self {
            border_limits: (0..width * height).map(border_limit).collect(),
            tables: Tables::new(&rig, noise, &config),
            rows: RangeMax::new(width),
            columns: RangeMax::new(height),
            row_windows: Windows::new(row_axis),
            column_windows: Windows::new(column_axis),
            row_axis,
            column_axis,
            filled: scratch(),
            transposed: scratch(),
            keys: scratch(),
            distance: scratch(),
            rig,
            body,
            config,
        }
    }

    /// Expands `disparity` (row-major, [`ipc_types::disparity`]) into `planes` (front, back, near limit).
    ///
    /// # Errors
    /// Either slice is not of the rig's size; `planes` is then untouched.
    pub fn step(&mut self, disparity: &[u16], planes: &mut [u16]) -> Result<Expansion, ExpandError> {
        let pixels = self.rig.pixels();
        if disparity.len() != pixels {
            return Err(ExpandError::WrongSize { found: disparity.len(), expected: pixels });
        }
        if ExpandedPlanes::split(planes, pixels).is_none() {
            return Err(ExpandError::WrongSize { found: planes.len() / 3, expected: pixels });
        }
        self.find_keys(disparity);
        let (front, rest) = planes.split_at_mut(pixels);
        let (back, near) = rest.split_at_mut(pixels);
        self.write_near_limits(near);
        self.inflate();
        let mut unknown = 0_usize;
        for ((front, back), (&key, &near)) in front.iter_mut().zip(back).zip(self.keys.iter().zip(near.iter())) {
            (*front, *back) = match key {
                0 => (UNKNOWN_FRONT, UNKNOWN_FRONT),
                key => (self.tables.front(key), self.tables.back(key)),
            };
            unknown += usize::from(near == 0);
        }
        Ok(Expansion { unknown_share: unknown as f32 / pixels as f32 })
    }

    /// Fills holes and turns disparities and clear sky into keys.
    fn find_keys(&mut self, disparity: &[u16]) {
        let (width, height) = (self.rig.width_px as usize, self.rig.height_px as usize);
        let longest = self.config.hole_px as usize;
        self.filled.copy_from_slice(disparity);
        self.filled.chunks_exact_mut(width).for_each(|row| fill_holes(row, longest, true));
        transpose(&self.filled, width, &mut self.transposed);
        let columns = self.transposed.chunks_exact_mut(height).zip(self.filled.chunks_exact_mut(height));
        for (column, keys) in columns {
            fill_holes(column, longest, false);
            column_keys(column, &self.tables, &self.rig, &self.config.background, keys);
        }
        transpose(&self.filled, height, &mut self.keys);
    }

    /// The image vouches no nearer than its border and its unmeasured pixels let the body be seen whole.
    fn write_near_limits(&mut self, near: &mut [u16]) {
        let width = self.rig.width_px as usize;
        let stretch = (self.body.radius_m / self.body.half_height_m).max(1.0);
        distance_to_unmeasured(&self.keys, width, stretch, &mut self.distance);
        let lines = near.chunks_exact_mut(width).zip(self.distance.chunks_exact(width));
        for (row, ((near, distance), border)) in lines.zip(self.border_limits.chunks_exact(width)).enumerate() {
            let y = self.column_axis.slope(row);
            for (column, ((near, &clear_px), &border)) in near.iter_mut().zip(distance).zip(border).enumerate() {
                let across_px = f32::from(clear_px);
                let clear = Clear { across_px, up_px: across_px / stretch, x: self.row_axis.slope(column), y };
                *near = near_limit(&self.rig, self.body, clear).min(border);
            }
        }
    }

    /// Replaces every key by the largest whose box covers the pixel: rows first, then columns.
    ///
    /// Columns work on what the rows left. That loses nothing: a larger key's window contains a smaller one's.
    fn inflate(&mut self) {
        let (width, height) = (self.rig.width_px as usize, self.rig.height_px as usize);
        inflate_lines(&mut self.rows, self.row_axis, &self.tables, &mut self.row_windows, &mut self.keys);
        transpose(&self.keys, width, &mut self.transposed);
        inflate_lines(
            &mut self.columns,
            self.column_axis,
            &self.tables,
            &mut self.column_windows,
            &mut self.transposed,
        );
        transpose(&self.transposed, height, &mut self.keys);
    }
}

#[multiversion(targets("x86_64+avx512f+avx512bw+avx512vl", "x86_64+avx2+fma", "x86_64+sse4.1", "aarch64+neon"))]
fn inflate_lines(range_max: &mut RangeMax, axis: Axis, tables: &Tables, windows: &mut Windows, keys: &mut [u16]) {
    for line in keys.chunks_exact_mut(axis.length_px) {
        // Apart from the updates, so that the tangents vectorise.
        for (q, &key) in windows.radius_over_depth.iter_mut().zip(line.iter()) {
            *q = tables.radius_over_depth(key);
        }
        let ends = windows.first.iter_mut().zip(windows.last.iter_mut());
        for (pixel, ((first, last), &q)) in ends.zip(windows.radius_over_depth.iter()).enumerate() {
            (*first, *last) = axis.window(pixel, q);
        }
        let ends = windows.first.iter().zip(windows.last.iter());
        for ((&first, &last), &key) in ends.zip(line.iter()).filter(|(_, key)| **key != 0) {
            range_max.raise(first as usize, last as usize, key);
        }
        range_max.finish(line);
    }
}

/// Scratch of one line: the window of every pixel.
#[derive(Debug)]
struct Windows {
    radius_over_depth: Vec<f32>,
    first: Vec<i32>,
    last: Vec<i32>,
}

impl Windows {
    fn new(axis: Axis) -> Self {
        let length = axis.length_px;
        Self { radius_over_depth: vec![0.0; length], first: vec![0; length], last: vec![0; length] }
    }
}

/// Transposes a row-major image of rows of `width`, in blocks that fit the first-level cache.
fn transpose(from: &[u16], width: usize, to: &mut [u16]) {
    const BLOCK: usize = 32;
    let height = from.len() / width;
    for top in (0..height).step_by(BLOCK) {
        for left in (0..width).step_by(BLOCK) {
            for column in left..(left + BLOCK).min(width) {
                for row in top..(top + BLOCK).min(height) {
                    to[column * height + row] = from[row * width + column];
                }
            }
        }
    }
}
