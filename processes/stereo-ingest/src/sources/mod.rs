//! Where frames come from: images on disk, and live cameras.

use std::time::Duration;

mod camera;
mod device;
mod pixel_format;
mod player;
mod sequence;
mod times;

pub use camera::CameraProcess;
pub use device::CameraConfig;
pub use pixel_format::PixelFormat;
pub use player::{ALL_SHOWN, Player};
pub use sequence::{Content, FrameImage, Sequence, SequenceFrame};

/// How far apart the images of a pair may have been exposed: a quarter of the interval between pairs, 5 ms at most.
fn together(interval: Duration) -> Duration {
    Duration::from_millis(5).min(interval / 4)
}
