//! Tells a camera that delivers the same image again and again from one that has nothing new to see.
//!
//! A frozen image that is given the pose of now says that what it showed from there is seen from here: the most dangerous
//! of sensor faults. Two images of a moving camera are never equal to the bit.

use ipc_types::{Body, Pose, World};
use xxhash_rust::xxh3::xxh3_64;

/// Moved by more than this, m, or turned by more, rad, a camera does not see the same.
const MOVED_M: f64 = 0.03;
const TURNED_RAD: f64 = 0.01;

/// Remembers the last image.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Frozen(Option<(u64, Pose<World, Body>)>);

/// What identifies an image.
pub(crate) fn digest(pixels: &[u16]) -> u64 {
    xxh3_64(bytemuck::cast_slice(pixels))
}

impl Frozen {
    /// Whether an image is that of before, though the vehicle is elsewhere now.
    pub(crate) fn is_frozen(&mut self, digest: u64, pose: Pose<World, Body>) -> bool {
        match self.0 {
            Some((before, from)) if before == digest => {
                let moved_m = from.origin().distance(pose.origin());
                moved_m > MOVED_M || from.rotation.angle_to(pose.rotation) > TURNED_RAD
            }
            _ => {
                self.0 = Some((digest, pose));
                false
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ipc_types::{Rotation, Vector};

    fn pose(x_m: f64, yaw_rad: f64) -> Pose<World, Body> {
        let rotation = Rotation::from_roll_pitch_yaw(0.0, 0.0, yaw_rad);
        Pose { rotation, translation: Vector::new(x_m, 0.0, 0.0) }
    }

    #[test]
    fn the_same_image_from_elsewhere_is_frozen_and_from_the_same_place_is_not() {
        let mut frozen = Frozen::default();
        let (one, two) = (digest(&[1, 2, 3]), digest(&[1, 2, 4]));
        assert!(!frozen.is_frozen(one, pose(0.0, 0.0)));
        assert!(!frozen.is_frozen(one, pose(0.01, 0.0)), "at rest");
        assert!(
            frozen.is_frozen(one, pose(0.2, 0.0)) && frozen.is_frozen(one, pose(0.4, 0.0)),
            "for as long as it lasts"
        );
        assert!(frozen.is_frozen(one, pose(0.0, 0.5)), "turned");
        assert!(!frozen.is_frozen(two, pose(0.6, 0.0)));
        assert!(!frozen.is_frozen(one, pose(0.8, 0.0)));
    }
}
