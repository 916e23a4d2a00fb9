//! Configuration-space expansion of disparity images (DROAN, sections 3.1.4–3.1.5, 5.5 and 6.2).
//!
//! Every measured pixel stands for the interval d ± λσ in which its surface may lie, inflated by the vehicle's
//! radius. The result says, for the vehicle's *centre* at a pixel and a disparity: free, occupied, or unknown and
//! why ([`ipc_types::messages::ExpandedCells`] defines the layers).
//!
//! * **Front** is never behind the true configuration-space surface. Each pixel covers the bounding box of its
//!   ellipsoid's silhouette, found from the ellipsoid's two tangents per axis (`window.rs`) instead of a table of whole
//!   disparities, and the box is filled by a windowed maximum (`range_max.rs`), columns first, then rows (`inflate.rs`).
//!   The box contains the silhouette, so nothing is missed; corners and rims are over-expanded: what is called
//!   occupied lies within the silhouette's box, and in depth within a radius of the interval.
//! * **Back** is the far end of the surface that owns the front: z(d − λσ) + r of the winning pixel. What continues
//!   behind is occluded, never free.
//! * **Second front and back**, with four layers, are those of the next group of surfaces behind the nearest one
//!   (`next_group.rs`). A surface belongs to the nearest group at least while it lies less than two radii behind the
//!   winner (Algorithm 1's `range`), at most while it lies within two bins of depth (`bins.rs`). Between the groups there
//!   is free space where the **gap limit** says so: the camera saw past the nearest group, all around the body.
//! * **Near limit**: closer than this, a body centred on the pixel's ray would reach pixels that were not
//!   measured or lie outside the image, so the image does not vouch for free space there (`clearance.rs`).
//! * **Margin**: cells beyond the camera's image are occupied where something at its border reaches them, else unknown.
//!
//! The core refuses to read clocks, allocate after construction on one thread, or guess at an image of another size.

mod bins;
mod clearance;
mod expander;
mod inflate;
mod measured;
mod next_group;
mod patches;
mod process;
mod range_groups;
mod range_max;
mod tables;
mod transpose;
mod window;

pub use expander::{ExpandError, Expander, Expansion, Reach};
pub use measured::BackgroundRule;
pub use process::ExpansionProcess;

use ipc_types::StereoRig;
use ipc_types::bounds::Bounds;
use ipc_types::messages::{ExpandedLayout, Layers};
use serde::{Deserialize, Serialize};

/// Parameters of the expansion.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// Radius by which obstacles are inflated: vehicle plus tracking error, m.
    pub radius_m: f32,
    /// The same upwards and downwards, tilt included, m: obstacles are inflated by an ellipsoid, a sphere if both are equal.
    pub half_height_m: f32,
    /// Surfaces held: two, or four.
    pub layers: Layers,
    /// Cells beyond every side of the camera's image, px.
    pub margin_px: u32,
    /// Threads; results do not depend on them.
    pub threads: u32,
    /// Radius of the vehicle's body, for which the ball around a free point must have been measured, m.
    pub body_radius_m: f32,
    /// Half of the body's height, tilt included, m: what must lie between a free point and the image's top and bottom.
    pub body_half_height_m: f32,
    /// Longest run of unmatched pixels, along a row or a column, that takes the nearer of its two ends, px. Along a row
    /// the shadow of a near surface is filled in addition.
    pub hole_px: u32,
    /// Longest side of an unmatched patch within what was measured that takes the nearest of what surrounds it, px.
    pub patch_px: u32,
    /// What clear sky is worth.
    pub background: BackgroundRule,
}

impl Config {
    /// For a sphere that is all body: two layers, no margin, one thread, nothing filled, and sky worth nothing.
    pub const fn for_sphere(radius_m: f32) -> Self {
        Self {
            radius_m,
            half_height_m: radius_m,
            layers: Layers::Two,
            margin_px: 0,
            threads: 1,
            body_radius_m: radius_m,
            body_half_height_m: radius_m,
            hole_px: 0,
            patch_px: 0,
            background: BackgroundRule { limit_m: 0.0, share: 0.0, textureless_share: 1.0 },
        }
    }

    /// Size and layers of what becomes of a rig's images.
    pub const fn layout(&self, rig: &StereoRig) -> ExpandedLayout {
        ExpandedLayout::new(rig, self.margin_px, self.layers)
    }

    /// Reports values out of range.
    pub fn check(&self, bounds: &mut Bounds) {
        bounds.range("radius_m", self.radius_m, 0.05..=5.0);
        bounds.range("half_height_m", self.half_height_m, 0.05..=5.0);
        bounds.range("margin_px", self.margin_px, 0..=ExpandedLayout::MOST_MARGIN_PX);
        bounds.require(
            self.margin_px.is_multiple_of(2),
            "margin_px",
            format_args!("is {}, must be even", self.margin_px),
        );
        bounds.range("threads", self.threads, 1..=64);
        bounds.range("body_radius_m", self.body_radius_m, 0.05..=5.0);
        bounds.range("body_half_height_m", self.body_half_height_m, 0.02..=5.0);
        for (name, body_m, axis, inflation_m) in [
            ("body_radius_m", self.body_radius_m, "radius_m", self.radius_m),
            ("body_half_height_m", self.body_half_height_m, "half_height_m", self.half_height_m),
        ] {
            let fits = body_m <= inflation_m;
            bounds.require(fits, name, format_args!("is {body_m} m, must not exceed {axis} = {inflation_m} m"));
        }
        bounds.range("hole_px", self.hole_px, 0..=128);
        bounds.range("patch_px", self.patch_px, 0..=128);
        bounds.section("background", |bounds| self.background.check(bounds));
    }
}
