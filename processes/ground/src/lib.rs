//! The ground: sees vehicles over a Zenoh network, and commands them.
//!
//! [`Watch`] subscribes to everything that vehicles tell and keeps the newest of it, apart by vehicle, with its age.
//! [`Operator`] sends commands and waits for their answers. [`serve`] is a page of both, which needs nothing from elsewhere.
//!
//! Nothing here is in the loop of a flight, and nothing is trusted: what does not decode is counted and left out.

mod obstacles;
mod operator;
mod vehicle;
mod watch;
mod web;

pub use obstacles::ObstacleCells;
pub use operator::{Asked, Operator, OperatorError};
pub use vehicle::{ProcessView, VehicleView};
pub use watch::Watch;
pub use web::{WebError, serve};
