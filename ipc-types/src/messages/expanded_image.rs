//! The configuration-space image: where the vehicle's centre may be, seen from one exposure.

use crate::disparity::SCALE;
use crate::wire::{Stamp, stamped, wire};

/// Front plane value of a pixel of which nothing is known.
pub const UNKNOWN_FRONT: u16 = u16::MAX;
/// Back plane value of a pixel behind whose front nothing is known to be occupied (far background).
pub const NEVER_OCCUPIED: u16 = u16::MAX;

wire! {
    /// Expanded image. Elements: three row-major planes of `width × height` fixed-point disparities
    /// ([`crate::disparity::SCALE`]): front, back, near limit. A query at a pixel with disparity `d` reads:
    ///
    /// | condition | answer |
    /// |---|---|
    /// | front = [`UNKNOWN_FRONT`] | unknown: no return |
    /// | d > front and d > near limit | unknown: the vehicle's body there would reach pixels that were not measured |
    /// | d > front | free; if back = [`NEVER_OCCUPIED`], by the far-background rule |
    /// | front ≥ d > back | occupied |
    /// | otherwise | unknown: occluded |
    ///
    /// Valid at the instant of exposure.
    ExpandedImage = "sparrowhawk/ExpandedImage/1" {
        /// Origin.
        stamp: Stamp,
        /// Width, px.
        width_px: u32,
        /// Height, px.
        height_px: u32,
        /// Radius by which obstacles were inflated, m.
        radius_m: f32,
        /// Share of pixels that vouch for free space at no distance.
        unknown_share: f32,
    }
}
stamped!(ExpandedImage);

/// The three planes of an expanded image.
#[derive(Clone, Copy, Debug)]
pub struct ExpandedPlanes<'a> {
    /// Nearest surface of configuration space, disparity.
    pub front: &'a [u16],
    /// Farthest surface of the obstacle that owns the front, disparity.
    pub back: &'a [u16],
    /// Disparity above which this image does not vouch for free space.
    pub near_limit: &'a [u16],
}

impl<'a> ExpandedPlanes<'a> {
    /// Planes of an image of `pixels` pixels, or `None` when the length is not three planes.
    pub fn split(elements: &'a [u16], pixels: usize) -> Option<Self> {
        if elements.len() != 3 * pixels {
            return None;
        }
        let (front, rest) = elements.split_at(pixels);
        let (back, near_limit) = rest.split_at(pixels);
        Some(Self { front, back, near_limit })
    }

    /// Front and back at a pixel in px, `None` where unknown.
    pub fn interval_px(&self, index: usize) -> Option<(f32, f32)> {
        let front = self.front[index];
        (front != UNKNOWN_FRONT).then(|| (f32::from(front) / SCALE, f32::from(self.back[index]) / SCALE))
    }
}
