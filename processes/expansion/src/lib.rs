//! Configuration-space expansion of disparity images (DROAN, sections 3.1.4–3.1.5).
//!
//! Every measured pixel stands for the interval d ± λσ in which its surface may lie, inflated by the vehicle's
//! radius. The result says, for the vehicle's *centre* at a pixel and a disparity: free, occupied, or unknown and
//! why ([`ipc_types::messages::ExpandedImage`] defines the three planes).
//!
//! * **Front** is never behind the true configuration-space surface. Each pixel covers the bounding box of its
//!   sphere's silhouette, found from the sphere's two tangents per axis (`window.rs`) instead of a table of whole
//!   disparities, and the box is filled by a windowed maximum (`range_max.rs`), rows first, then columns. The box
//!   contains the silhouette, so nothing is missed; the corners are over-expanded.
//! * **Back** is the far end of the obstacle that owns the front: z(d − λσ) + r of the winning pixel. This is
//!   Algorithm 1's `connectedComponent` with a range of zero: a surface that continues behind the winner is
//!   reported as occluded, never as free.
//! * **Near limit**: closer than this, a body centred on the pixel's ray would reach pixels that were not
//!   measured or lie outside the image, so the image does not vouch for free space there (`measured.rs`).
//!
//! The core refuses to read clocks, allocate after construction, or guess at an image of another size.

mod expander;
mod measured;
mod process;
mod range_max;
mod tables;
mod window;

pub use expander::{ExpandError, Expander, Expansion, Reach};
pub use measured::BackgroundRule;
pub use process::ExpansionProcess;

use ipc_types::bounds::Bounds;
use serde::{Deserialize, Serialize};

/// Parameters of the expansion.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// Radius by which obstacles are inflated: vehicle plus tracking error, m.
    pub radius_m: f32,
    /// Radius of the vehicle's body, for which the ball around a free point must have been measured, m.
    pub body_radius_m: f32,
    /// Half of the body's height, tilt included, m: what must lie between a free point and the image's top and bottom.
    pub body_half_height_m: f32,
    /// Longest run of unmatched pixels, along a row or a column, that takes the nearer of its two ends, px. Along a row
    /// the shadow of a near surface is filled in addition.
    pub hole_px: u32,
    /// What clear sky is worth.
    pub background: BackgroundRule,
}

impl Config {
    /// Reports values out of range.
    pub fn check(&self, bounds: &mut Bounds) {
        bounds.range("radius_m", self.radius_m, 0.05..=5.0);
        bounds.range("body_radius_m", self.body_radius_m, 0.05..=5.0);
        bounds.require(
            self.body_radius_m <= self.radius_m,
            "body_radius_m",
            format_args!("is {} m, must not exceed radius_m = {} m", self.body_radius_m, self.radius_m),
        );
        bounds.range("body_half_height_m", self.body_half_height_m, 0.02..=5.0);
        bounds.range("hole_px", self.hole_px, 0..=128);
        bounds.section("background", |bounds| self.background.check(bounds));
    }
}
