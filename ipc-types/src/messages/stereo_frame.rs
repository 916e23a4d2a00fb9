//! A grey stereo pair.

use crate::wire::{Stamp, stamped, wire};

wire! {
    /// Stereo pair, rectified or raw as the vehicle's configuration says. Elements: the left image, then the right one, 8-bit grey, row-major, no stride.
    /// Valid at the instant of exposure.
    StereoFrame = "sparrowhawk/StereoFrame/1" {
        /// Origin.
        stamp: Stamp,
        /// Width of each image, px.
        width_px: u32,
        /// Height of each image, px.
        height_px: u32,
    }
}
stamped!(StereoFrame);
