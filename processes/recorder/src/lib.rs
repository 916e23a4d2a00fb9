//! Writes every topic to MCAP, from the first flight on, and reads what was written.
//!
//! Every topic is a channel of protobuf messages with their schema, lossless (`encoding`). Beside them stand, in Foxglove's
//! own schemas, what its viewers show without a plugin of ours: transforms, plan, path, goal, keyframes, points of
//! obstacles, complaints; and, on request, images. Attached are the configuration and whatever else reproduces the flight.
//!
//! The recorder never holds up a flight: its buffers are deep and the oldest messages give way; the gaps in the sequence
//! numbers are counted and written into the log's metadata. The log is flushed every half second, so that a kill loses no
//! more than that; [`recover`] gives such a file its index. A file that has grown large or old is followed by another, and a
//! disk that is nearly full is left as it is.
//!
//! The way back is [`LogPlayer`]: it feeds a graph with what a recorded flight's was fed with.

mod config;
mod file;
mod files;
mod inputs;
mod lengths;
mod player;
mod process;
mod read;
mod recover;
mod scan;

pub use config::RecorderConfig;
pub use file::LogError;
pub use inputs::{Feed, Input, Inputs};
pub use player::{ALL_PLAYED, LogPlayer};
pub use process::{RecorderProcess, Recording};
pub use read::{Entry, Log, Reading, Record};
pub use recover::{Recovered, recover};
pub use scan::Damage;
