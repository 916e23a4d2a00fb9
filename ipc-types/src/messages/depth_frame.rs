//! What a depth sensor delivers.

use crate::wire::{Stamp, stamped, wire};

wire! {
    /// Depth image, or disparity image that the sensor matched itself, as delivered. Elements: one 16-bit pixel each,
    /// row-major, no stride; what they are worth is in the vehicle's configuration. Valid at the instant of exposure.
    DepthFrame = "sparrowhawk/DepthFrame/1" {
        /// Origin.
        stamp: Stamp,
        /// Width, px.
        width_px: u32,
        /// Height, px.
        height_px: u32,
    }
}
stamped!(DepthFrame);
