//! Messages as others read them, in log files and over the network.
//!
//! * Every wire message as **protobuf** ([`encode`], [`decode`]), with a schema that is generated from the same description as
//!   the layout in shared memory ([`descriptor_set`]): field numbers count from 1 in the order of the fields, a message's
//!   elements are field [`ELEMENTS`]. Nothing is lost on the way: what is decoded is the message, to the bit; but for texts that are
//!   none, in which what is no text is replaced.
//! * What viewers show without a plugin, in **Foxglove's** schemas ([`Viewer`]): images, transforms, lines, clouds.
//! * The same as JSON, for scripts ([`to_json`]).
//!
//! This crate refuses to know files, transports and the time. What it decodes may come from anywhere: every field is checked.

mod cloud;
mod decode;
mod encode;
mod json;
mod schema;
mod views;

pub use cloud::points;
pub use decode::{DecodeError, MOST_ELEMENTS, decode, decode_message};
pub use encode::{encode, encode_message};
pub use json::to_json;
pub use schema::{ELEMENTS, descriptor_set, message_name};
pub use views::{View, Viewer};
