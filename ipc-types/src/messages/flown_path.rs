//! Where the vehicle has been: free by its own swept volume, and the way back out.

use crate::wire::{Stamp, stamped, wire};

wire! {
    /// The path flown so far, thinned. Elements: one [`PathPoint`] each, oldest first.
    FlownPath = "sparrowhawk/FlownPath/1" {
        /// Origin.
        stamp: Stamp,
    }
}
stamped!(FlownPath);

wire! {
    /// A place where the vehicle's centre has been.
    PathPoint = "sparrowhawk/PathPoint/1" {
        /// World position, m.
        position_m: [f64; 3],
    }
}
