//! Where frames come from: images on disk, and live cameras.

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
