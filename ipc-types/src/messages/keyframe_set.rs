//! The pose graph of expanded images.

use crate::frames::{Camera, Pose, Rotation, Vector, World};
use crate::wire::{Stamp, stamped, wire};

wire! {
    /// The nodes of the disparity graph. Elements: one [`Keyframe`] each, the newest frame first, then the keyframes from
    /// the newest to the oldest, then what else is recent. Valid at the newest exposure. The pixels lie in the run's image store under `image_id`.
    KeyframeSet = "sparrowhawk/KeyframeSet/2" {
        /// Origin.
        stamp: Stamp,
        /// Expanded images dropped because no pose was known for their exposure.
        without_pose: u64,
        /// Those dropped because they were not newer than the one before, or from the future; and such states.
        late: u64,
        /// Those dropped because they are of another rig, margin, radius or number of layers.
        misfits: u64,
        /// Images and records that could not be stored.
        not_stored: u64,
        /// Times that the estimate of the pose jumped, and the map began anew.
        jumps: u64,
    }
}
stamped!(KeyframeSet);

wire! {
    /// One node.
    Keyframe = "sparrowhawk/Keyframe/1" {
        /// Name of the expanded image in the run's image store.
        image_id: u64,
        /// Exposure, ns of flight time.
        exposure_ns: i64,
        /// Camera position in the world at exposure, m.
        position_m: [f64; 3],
        /// Camera orientation: world from camera, `[w, x, y, z]`.
        orientation: [f64; 4],
    }
}

impl Keyframe {
    /// The camera's pose, or `None` when the message holds no rotation.
    pub fn world_from_camera(&self) -> Option<Pose<World, Camera>> {
        let translation = Vector::from_array(self.position_m);
        let rotation = Rotation::from_wxyz(self.orientation)?;
        translation.is_finite().then_some(Pose { rotation, translation })
    }
}
