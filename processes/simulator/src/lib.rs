//! The world on a desktop.
//!
//! * [`World`]: seeded random forests on uneven ground, walls, OctoMap files; made of capsules and boxes.
//! * [`Renderer`]: what the stereo camera sees of it.
//! * [`NoiseCamera`]: disparity without images, by a model of what camera and matcher get wrong.
//! * [`Vehicle`]: a quadrotor behind a velocity-command flight control unit that brakes by itself when setpoints stop.
//! * [`Trouble`]: wind, lost frames, blindness, estimates that jump or lag.
//! * [`Piloted`]: a pilot who takes over and hands back.
//! * [`Estimator`]: what the vehicle believes of its own state: late, noisy, drifting.
//! * [`Collider`]: true clearance and continuous whole-body collision, by parry3d.
//!
//! [`SimulatorProcess`] makes flight time. It never waits for its consumers; when rendering cannot keep up it slows
//! flight time down and says so.

mod camera;
mod collider;
mod estimator;
mod ground;
mod noise3;
mod noise_camera;
mod octomap;
mod pilot;
mod process;
mod raster;
mod render;
mod sensor_faults;
mod trouble;
mod vehicle;
mod world;

pub use camera::{CameraConfig, StereoCamera};
pub use collider::{Clearance, Collider};
pub use estimator::{Estimator, EstimatorConfig};
pub use noise_camera::{Class, NoiseCamera, NoiseCameraConfig, Shares};
pub use octomap::{Octomap, OctomapError};
pub use pilot::Piloted;
pub use process::{SimulatorConfig, SimulatorProcess, SimulatorSetup};
pub use render::Renderer;
pub use trouble::Trouble;
pub use vehicle::{Vehicle, VehicleConfig};
pub use world::{Forest, Obstacle, Shape, Wall, World, WorldConfig, WorldError};
