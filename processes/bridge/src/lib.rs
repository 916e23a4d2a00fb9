//! Joins the process graph to a Zenoh network: telemetry out, commands in.
//!
//! ```text
//! sparrowhawk/<vehicle>/alive                 liveliness token of the vehicle
//!                      /process/<name>        liveliness token of a process that beats
//!                      /topic/<topic>         messages (protobuf, schema below): vehicle_state, health, mission, answer, ...
//!                      /view/<view>           what viewers show (Foxglove's protobuf): obstacles
//!                      /image/left, /image/disparity   previews (JPEG)
//!                      /command/<operator>    commands (protobuf: sparrowhawk.Command) of the operator whom they name
//!                      /schema, /config, /status, /logs    to be queried: FileDescriptorSet, RON, JSON, JSON
//! ```
//!
//! The flight never waits for the network: this process only reads, with buffers whose oldest messages give way, never blocks
//! on a peer, and keeps to a budget, in which telemetry comes before images. What it receives is checked for being a message
//! at all, and is judged by whoever keeps the mission. Beyond the loopback interface it listens with mutual TLS only.

mod budget;
mod config;
pub mod keys;
mod link;
mod network;
mod preview;
mod process;
mod refusals;

pub use config::{BridgeConfig, RatesConfig, TlsConfig};
pub use network::{NetworkError, open};
pub use process::{About, BridgeProcess};
pub use refusals::RefusalLayer;
