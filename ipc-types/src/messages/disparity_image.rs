//! Disparity of the left image.

use crate::wire::{Stamp, stamped, wire};

wire! {
    /// Disparity image, left view. Elements: one fixed-point pixel each, row-major; encoding and codes in
    /// [`crate::disparity`]. Valid at the instant of exposure of its stereo pair.
    DisparityImage = "sparrowhawk/DisparityImage/1" {
        /// Origin.
        stamp: Stamp,
        /// Width, px.
        width_px: u32,
        /// Height, px.
        height_px: u32,
        /// Pixels that hold a disparity.
        valid: u32,
        /// Pixels too textureless to match.
        textureless: u32,
    }
}
stamped!(DisparityImage);
