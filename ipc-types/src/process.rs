//! The processes of the graph.

use serde::{Deserialize, Serialize};

/// One node of the process graph. The number is its wire identity and never changes meaning.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[repr(u32)]
pub enum ProcessId {
    /// Starts, watches and restarts the others; owns every shared-memory service.
    Supervisor = 0,
    /// The world, the vehicle's dynamics and its cameras.
    Simulator = 1,
    /// Stereo frames → disparity.
    StereoIngest = 2,
    /// Disparity → configuration-space layers.
    Expansion = 3,
    /// Expanded images → occupancy.
    Memory = 4,
    /// Occupancy and goal → trajectory.
    Planner = 5,
    /// Trajectory and state → velocity setpoint.
    Controller = 6,
    /// Everything → log.
    Recorder = 7,
    /// Image files → frames (`replay`).
    Player = 8,
    /// Live cameras → frames.
    Camera = 9,
    /// Topics ↔ network.
    Bridge = 10,
}

impl ProcessId {
    /// All of them, in start-up order.
    pub const ALL: [Self; 11] = [
        Self::Supervisor,
        Self::Simulator,
        Self::StereoIngest,
        Self::Expansion,
        Self::Memory,
        Self::Planner,
        Self::Controller,
        Self::Recorder,
        Self::Player,
        Self::Camera,
        Self::Bridge,
    ];

    /// Name on the command line, in logs and in shared memory.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Supervisor => "supervisor",
            Self::Simulator => "simulator",
            Self::StereoIngest => "stereo-ingest",
            Self::Expansion => "expansion",
            Self::Memory => "memory",
            Self::Planner => "planner",
            Self::Controller => "controller",
            Self::Recorder => "recorder",
            Self::Player => "player",
            Self::Camera => "camera",
            Self::Bridge => "bridge",
        }
    }

    /// The process of that name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|process| process.name() == name)
    }

    /// The process of that wire number.
    pub fn from_wire(number: u32) -> Option<Self> {
        Self::ALL.into_iter().find(|process| *process as u32 == number)
    }
}

impl std::fmt::Display for ProcessId {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.pad(self.name())
    }
}
