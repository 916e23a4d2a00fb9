//! Writes every topic to MCAP, from the first flight on.
//!
//! Messages are JSON with a JSON schema, which viewers and scripts read without a plugin of ours: the header's fields,
//! and `elements` where they are not pixels. Images are recorded on request, as Foxglove `RawImage` messages.
//! Attached are the configuration and whatever else reproduces the flight. The log is flushed every half second, so that a kill
//! loses no more than that.
//!
//! The recorder never holds up a flight: its buffers are deep and the oldest messages give way; the gaps in the
//! sequence numbers are counted and written into the log's metadata.

mod encode;
mod log;
mod process;

pub use log::{LogError, LogWriter};
pub use process::RecorderProcess;
