//! The vocabulary that every Sparrowhawk process shares.
//!
//! Two halves that meet in the messages:
//!
//! * **Wire**: [`messages`] (one file each) and the one [`topics`] table. Wire types are `repr(C)`, of fixed size,
//!   and made of integers, floats and arrays only, so that any bit pattern is valid to receive.
//! * **Geometry and time**: [`frames`] (typed points, vectors, rotations, poses), [`time`], [`rig`] (rectified
//!   stereo camera), [`disparity`] (fixed-point encoding), [`noise`] (σ and the λ schedule) and
//!   [`pose_history`] (pose at the instant of exposure), and
//!   [`rounding`] for the code that looks images up.
//!
//! This crate refuses to know transport, files, clocks and threads.

pub mod bounds;
pub mod disparity;
pub mod estates;
pub mod frames;
pub mod limits;
pub mod messages;
pub mod noise;
pub mod pose_history;
pub mod process;
pub mod rig;
pub mod rounding;
pub mod time;
pub mod topics;
pub mod wire;

pub use frames::{Body, Camera, Point, Pose, Rotation, Vector, World};
pub use process::ProcessId;
pub use rig::StereoRig;
pub use time::{FlightTime, HostTime};
