//! The driver that flies: operating-system processes over iceoryx2.
//!
//! The supervisor creates every service first ([`Services`]) and holds it; processes only open. A schema hash on
//! every service refuses a process that was built with other messages. Consumers sleep on one event each, their
//! *bell*, which producers ring after publishing; every wake-up drains all topics, so no ring is ever needed twice.

mod black_box;
mod bus;
mod clock;
mod drive;
mod half_made;
mod injection;
mod lease;
mod ports;
mod services;
mod stall;

pub use black_box::{LastInput, last_inputs};
pub use drive::{DriveOptions, drive};
pub use ports::{IpcMessage, IpcPorts};
pub use services::Services;
pub use stall::{Ballast, hold_messages};

/// What iceoryx2 or the run's folder refused.
#[derive(Debug, thiserror::Error)]
#[error("shared memory: cannot {action}: {reason}")]
pub struct IpcError {
    action: String,
    reason: String,
}

impl IpcError {
    fn new(action: impl Into<String>) -> impl FnOnce(&dyn std::fmt::Debug) -> Self {
        let action = action.into();
        move |reason| Self { action, reason: format!("{reason:?}") }
    }
}

/// Turns any iceoryx2 error into an [`IpcError`] that says what was being done.
trait While<T> {
    fn doing(self, action: impl Into<String>) -> Result<T, IpcError>;
}

impl<T, E: std::fmt::Debug> While<T> for Result<T, E> {
    fn doing(self, action: impl Into<String>) -> Result<T, IpcError> {
        self.map_err(|error| IpcError::new(action)(&error))
    }
}
