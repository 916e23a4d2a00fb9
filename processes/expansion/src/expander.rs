//! The pure core: one disparity image in, an expanded image out, in place.

use crate::Config;
use crate::clearance::{Body, Clearance};
use crate::inflate::Inflate;
use crate::measured::{column_values, fill_holes};
use crate::next_group::NextGroup;
use crate::patches::Patches;
use crate::range_max::RangeMax;
use crate::tables::Tables;
use crate::transpose::transpose;
use crate::window::Axis;
use ipc_types::StereoRig;
use ipc_types::disparity::encode;
use ipc_types::messages::{ExpandedLayout, Layers, UNKNOWN_FRONT};
use ipc_types::noise::NoiseModel;
use rayon::ThreadPool;
use runtime::thread_pool;

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
    /// The result does not fit.
    #[error("there is room for {found} elements, the expanded image has {expected}")]
    WrongRoom {
        /// Elements given.
        found: usize,
        /// Elements of the layout.
        expected: usize,
    },
}

/// What an expansion found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Expansion {
    /// Share of the camera's pixels of which nothing is known.
    pub unknown_share: f32,
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

/// Expands the images of one rig for one vehicle. All scratch is allocated here, once.
#[derive(Debug)]
pub struct Expander {
    config: Config,
    layout: ExpandedLayout,
    tables: Tables,
    inflate: Inflate<RangeMax>,
    next: Option<NextGroup>,
    clearance: Clearance,
    threads: Option<ThreadPool>,
    scratch: Scratch,
}

/// Images of the camera's size.
#[derive(Debug)]
struct Scratch {
    filled: Vec<u16>,
    patches: Patches,
    /// Values, column by column and row by row.
    columns: Vec<u16>,
    values: Vec<u16>,
    near_limits: Vec<u16>,
    /// Near limits of an image without holes: what its border allows.
    border_limits: Vec<u16>,
}

impl Expander {
    /// Prepares tables and scratch. No image vouches for what is nearer than the sensor reaches.
    pub fn new(rig: StereoRig, noise: &NoiseModel, reach: Reach, config: Config) -> Self {
        let body = Body { radius_m: config.body_radius_m, half_height_m: config.body_half_height_m };
        let mut clearance = Clearance::new(&rig, body);
        let border_limits = clearance.border_limits(|_, column| {
            encode(match reach {
                // A pixel's match lies to the left in the right image, at most as far as that image goes.
                Reach::Matched { most_px } => most_px.min(column as f32),
                Reach::Ranged { nearest_m } => rig.disparity_px(nearest_m) as f32,
            })
        });
        let (margin, threads) = (config.margin_px as usize, config.threads.max(1) as usize);
        let stretch = f64::from(config.half_height_m) / f64::from(config.radius_m);
        let column_axis = Axis::new(rig.focal_px, rig.cy_px, rig.height_px as usize, margin, stretch);
        let row_axis = Axis::new(rig.focal_px, rig.cx_px, rig.width_px as usize, margin, 1.0);
        let tables = Tables::new(rig, *noise, f64::from(config.radius_m));
        let image = || vec![0; rig.pixels()];
        let next = || NextGroup::new(&tables, body, margin, stretch, threads);
        Self {
            next: (config.layers == Layers::Four).then(next),
            tables,
            inflate: Inflate::new(column_axis, row_axis, threads),
            clearance,
            threads: thread_pool(threads),
            scratch: Scratch {
                filled: image(),
                patches: Patches::new(rig.pixels()),
                columns: image(),
                values: image(),
                near_limits: image(),
                border_limits,
            },
            layout: config.layout(&rig),
            config,
        }
    }

    /// Size and layers of the result.
    pub fn layout(&self) -> ExpandedLayout {
        self.layout
    }

    /// Expands `disparity` (row-major, [`ipc_types::disparity`]) into `elements`
    /// ([`ipc_types::messages::ExpandedImage`]).
    ///
    /// # Errors
    /// Either slice is not of the layout's size; `elements` is then untouched.
    pub fn step(&mut self, disparity: &[u16], elements: &mut [u16]) -> Result<Expansion, ExpandError> {
        let (pixels, expected) = (self.scratch.values.len(), self.layout.elements());
        if disparity.len() != pixels {
            return Err(ExpandError::WrongSize { found: disparity.len(), expected: pixels });
        }
        if elements.len() != expected {
            return Err(ExpandError::WrongRoom { found: elements.len(), expected });
        }
        let Self { config, layout, tables, inflate, next, clearance, threads, scratch } = self;
        let mut work = || {
            scratch.find_values(disparity, tables, config);
            clearance.step(&scratch.values, &scratch.border_limits, &mut scratch.near_limits);
            let first = inflate.step(tables, &scratch.columns);
            write_nearest(tables, &scratch.near_limits, first, *layout, elements);
            if let Some(next) = next {
                next.step(tables, &scratch.values, &scratch.near_limits, first, *layout, elements);
            }
        };
        match threads {
            Some(threads) => threads.install(work),
            None => work(),
        }
        let unknown = self.scratch.near_limits.iter().filter(|&&limit| limit == 0).count();
        Ok(Expansion { unknown_share: unknown as f32 / pixels as f32 })
    }
}

impl Scratch {
    /// Fills holes and turns disparities and clear sky into values.
    fn find_values(&mut self, disparity: &[u16], tables: &Tables, config: &Config) {
        let rig = tables.rig();
        let (width, height) = (rig.width_px as usize, rig.height_px as usize);
        let longest = config.hole_px as usize;
        self.filled.copy_from_slice(disparity);
        self.filled.chunks_exact_mut(width).for_each(|row| fill_holes(row, longest, true));
        transpose(&self.filled, width, &mut self.values);
        self.values.chunks_exact_mut(height).for_each(|column| fill_holes(column, longest, false));
        self.patches.fill(&mut self.values, height, config.patch_px as usize);
        for (column, values) in self.values.chunks_exact(height).zip(self.columns.chunks_exact_mut(height)) {
            column_values(column, tables, rig, &config.background, values);
        }
        transpose(&self.columns, height, &mut self.values);
    }
}

/// Looks up front and back of what won. Cells of the margin vouch for nothing.
fn write_nearest(tables: &Tables, near_limits: &[u16], first: &[u16], layout: ExpandedLayout, elements: &mut [u16]) {
    let (wide, margin) = (layout.width_px as usize, layout.margin_px as usize);
    let cells = elements.as_chunks_mut::<4>().0;
    for (cell, &value) in cells.iter_mut().zip(first) {
        let [front, back] = if value == 0 { [UNKNOWN_FRONT; 2] } else { tables.faces(value) };
        *cell = [0, front, back, 0];
    }
    let rows = near_limits.chunks_exact(wide - 2 * margin);
    for (cells, limits) in cells.chunks_exact_mut(wide).skip(margin).zip(rows) {
        cells[margin..].iter_mut().zip(limits).for_each(|(cell, &limit)| cell[0] = limit);
    }
}
