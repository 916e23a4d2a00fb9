//! The messages, one file each.
//!
//! A message is a fixed-size header and a slice of elements, both plain old data. A header-only message has an
//! empty slice. Lengths are metres, times nanoseconds of flight time, quaternions `[w, x, y, z]`.

mod command;
mod degradation;
mod depth_frame;
mod disparity_image;
mod expanded_image;
mod flight_clock;
mod flown_path;
mod goal;
mod health;
mod keyframe_set;
mod mission_state;
mod setpoint;
mod stereo_frame;
mod trajectory;
mod vehicle_state;
mod world_truth;

pub use command::{Answer, Command, Order, Waypoint};
pub use degradation::{Degradation, Rung};
pub use depth_frame::DepthFrame;
pub use disparity_image::DisparityImage;
pub use expanded_image::{ExpandedCells, ExpandedImage, ExpandedLayout, Layers, NEVER_OCCUPIED, Seen, UNKNOWN_FRONT};
pub use flight_clock::FlightClock;
pub use flown_path::{FlownPath, PathPoint};
pub use goal::{Goal, Task};
pub use health::{Health, HealthLevel};
pub use keyframe_set::{Keyframe, KeyframeSet};
pub use mission_state::MissionState;
pub use setpoint::{Setpoint, SetpointMode};
pub use stereo_frame::StereoFrame;
pub use trajectory::{PlanMode, Trajectory, TrajectoryPoint};
pub use vehicle_state::VehicleState;
pub use world_truth::WorldTruth;
