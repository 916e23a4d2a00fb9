//! Stereo pairs to disparity.
//!
//! [`Matcher`] is the pure core: census or gradient costs averaged over a window, semi-global aggregation along up to
//! five paths (Hirschmüller 2008), winner-takes-all with sub-pixel, uniqueness and left-right checks, then speckle
//! removal. What has no texture is reported as [`ipc_types::disparity::TEXTURELESS`], what has no consistent match
//! as [`ipc_types::disparity::NO_MATCH`], or [`ipc_types::disparity::TEXTURED`] where there is texture right there; none is
//! ever "far".
//!
//! [`StereoProcess`] connects the matcher to its topics, or a depth sensor's images ([`Source`]). [`Player`] feeds it from
//! image files, [`CameraProcess`] from live cameras.
//! The core refuses images of another size than the rig's, and allocates nothing after construction.

pub mod calibration;
mod config;
mod error_profile;
mod ground_truth;
mod matching;
mod pair_check;
mod pairs;
mod process;
mod source;
mod sources;

pub use calibration::Calibration;
pub use config::{Config, Method};
pub use error_profile::{ErrorProfile, GaussianFit, Sample};
pub use ground_truth::{DisparityError, GroundTruth};
pub use matching::{MatchError, MatchStatistics, Matcher, SimdLevel};
pub use pair_check::{PairCheck, PairFault};
pub use pairs::{DepthImage, PairError, StereoPair, load_disparity, load_mask, save_disparity};
pub use process::StereoProcess;
pub use source::{Source, ValueTable};
pub use sources::{
    ALL_SHOWN, CameraConfig, CameraProcess, Content, FrameImage, PixelFormat, Player, Sequence, SequenceFrame,
};
