//! Runs the pure cores of the processes, and is the one library that knows iceoryx2.
//!
//! A process is written once, against [`Process`] and [`Ports`], and runs under either driver:
//!
//! * [`ipc`]: one operating-system process each, iceoryx2 shared memory, event wake-ups, heartbeats. What flies.
//! * [`lockstep`]: all in one thread, fixed order, seeded, with modelled latency. Repeatable to the bit.
//!
//! Images that must outlive their writer lie in the [`images`] store, and so does
//! what processes leave to their successors ([`estate`]). [`run_dir`] isolates runs from each other.
//! [`video`] reads cameras. [`faults`] says what may be injected into a flight. [`thread_pool`] serves cores that divide their work.
//! This crate refuses to know what the messages mean.

pub mod estate;
pub mod faults;
pub mod images;
pub mod ipc;
pub mod lockstep;
mod missed;
mod ports;
mod resources;
pub mod run_dir;
mod threads;
pub mod video;

pub use ports::{Connect, Message, Ports, Process, Report, host_now};
pub use resources::Resources;
pub use threads::thread_pool;
