//! What the vehicle believes about its own motion.

use crate::frames::{Body, Point, Pose, Rotation, Vector, World};
use crate::wire::{Stamp, stamped, wire};

wire! {
    /// State estimate, valid at `stamp.valid_ns` (which may lie well before publication).
    VehicleState = "sparrowhawk/VehicleState/2" {
        /// Origin.
        stamp: Stamp,
        /// Position of the body's origin in the world, m.
        position_m: [f64; 3],
        /// Velocity in the world, m/s.
        velocity_mps: [f64; 3],
        /// World from body, `[w, x, y, z]`.
        orientation: [f64; 4],
        /// 1 while a pilot flies: the flight control unit does not follow setpoints.
        piloted: u32,
        /// 1 while the flight control unit's land detector says that the vehicle stands on the ground.
        landed: u32,
    }
}
stamped!(VehicleState);

impl VehicleState {
    /// Pose of the body, or `None` when the message is not finite or holds no rotation.
    pub fn world_from_body(&self) -> Option<Pose<World, Body>> {
        let translation = Vector::from_array(self.position_m);
        let rotation = Rotation::from_wxyz(self.orientation)?;
        (translation.is_finite() && self.velocity().is_finite()).then_some(Pose { rotation, translation })
    }

    /// Position of the body's origin.
    pub fn position(&self) -> Point<World> {
        Point::from_array(self.position_m)
    }

    /// Velocity of the body's origin.
    pub fn velocity(&self) -> Vector<World> {
        Vector::from_array(self.velocity_mps)
    }
}
