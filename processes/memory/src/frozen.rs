//! Tells a camera that delivers the same image again and again from one that has nothing new to see.
//!
//! A frozen image that is given the pose of now says that what it showed from there is seen from here: the most dangerous
//! of sensor faults. Two images of a moving camera are never equal to the bit.

use ipc_types::{Camera, Pose, World};

/// Values of a cell of an expanded image.
const LAYERS: usize = 4;
/// Moved by more than this, m, or turned by more, rad, a camera does not see the same.
const MOVED_M: f64 = 0.03;
const TURNED_RAD: f64 = 0.01;

/// Remembers the last image.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Frozen(Option<(u64, Pose<World, Camera>)>);

/// What identifies an image, by its checksum; nothing does one that shows the same everywhere, as fog and clear sky do.
pub(crate) fn digest(pixels: &[u16], cells: usize, checksum: u64) -> Option<u64> {
    let mut layers = pixels.chunks_exact(LAYERS).take(cells);
    let first = layers.next();
    let shows_something = layers.any(|cell| Some(cell) != first);
    shows_something.then_some(checksum)
}

impl Frozen {
    /// Goes on from an image of a predecessor's.
    pub(crate) fn since(digest: Option<u64>, pose: Pose<World, Camera>) -> Self {
        Self(digest.map(|digest| (digest, pose)))
    }

    /// Whether an image is that of before, though the vehicle is elsewhere now.
    pub(crate) fn is_frozen(&mut self, digest: Option<u64>, pose: Pose<World, Camera>) -> bool {
        let Some(digest) = digest else { return false };
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

    fn pose(x_m: f64, yaw_rad: f64) -> Pose<World, Camera> {
        let rotation = Rotation::from_roll_pitch_yaw(0.0, 0.0, yaw_rad);
        Pose { rotation, translation: Vector::new(x_m, 0.0, 0.0) }
    }

    #[test]
    fn the_same_image_from_elsewhere_is_frozen_and_from_the_same_place_is_not() {
        let mut frozen = Frozen::default();
        let (one, two) = (digest(&[0, 9, 8, 0, 0, 9, 7, 0], 2, 1), digest(&[0, 9, 8, 0, 0, 9, 6, 0], 2, 2));
        assert!(!frozen.is_frozen(one, pose(0.0, 0.0)));
        assert!(!frozen.is_frozen(one, pose(0.01, 0.0)), "at rest");
        assert!(
            frozen.is_frozen(one, pose(0.2, 0.0)) && frozen.is_frozen(one, pose(0.4, 0.0)),
            "for as long as it lasts"
        );
        assert!(frozen.is_frozen(one, pose(0.0, 0.5)), "turned");
        assert!(!frozen.is_frozen(two, pose(0.6, 0.0)));
        assert!(!frozen.is_frozen(one, pose(0.8, 0.0)));
        let fog = digest(&[0, 65535, 65535, 0].repeat(9), 9, 3);
        assert_eq!(fog, None);
        assert!(!frozen.is_frozen(fog, pose(0.8, 0.0)) && !frozen.is_frozen(fog, pose(1.8, 0.0)));
        let mut heir = Frozen::since(one, pose(0.0, 0.0));
        assert!(heir.is_frozen(one, pose(0.2, 0.0)), "a successor knows the last image, too");
    }
}
