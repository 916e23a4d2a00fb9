//! Ways to goals far beyond what candidates reach: shortest paths around what is known, free of dynamics.
//!
//! [`BitStar`] searches (Gammell, Srinivasa and Barfoot 2015), [`shorten`] pulls what it found taut. Both ask a
//! [`Space`] and know nothing else of the world; effort is counted in segments asked about, never in time. [`Timing`]
//! says how fast a path can be flown.

mod bit_star;
mod endpoint;
mod informed;
mod shorten;
mod timing;

pub use bit_star::{BitStar, Refused};
pub use shorten::shorten;
pub use timing::{Limits, Timed, Timing};

use ipc_types::bounds::Bounds;
use ipc_types::{Point, World};
use serde::{Deserialize, Serialize};

/// What a search asks of the world.
pub trait Space {
    /// Whether the vehicle's centre may be at a place.
    fn is_free(&mut self, place: Point<World>) -> bool;
    /// Whether it may go straight from one place to another. Both ends belong to it, and the way back is the same way.
    fn is_way_free(&mut self, from: Point<World>, to: Point<World>) -> bool;
}

/// How a search goes about it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SearchConfig {
    /// Places drawn at a time.
    pub batch: u32,
    /// Most places in all.
    pub places: u32,
    /// Most neighbours of a place that ways to are tried.
    pub neighbours: u32,
}

impl SearchConfig {
    /// Reports values out of range.
    pub fn check(&self, bounds: &mut Bounds) {
        bounds.range("batch", self.batch, 10..=1000);
        bounds.range("places", self.places, self.batch.max(10)..=5000);
        bounds.range("neighbours", self.neighbours, 4..=64);
    }
}

/// Length of a path, m.
pub fn length_m(path: &[Point<World>]) -> f64 {
    path.windows(2).map(|leg| leg[0].distance(leg[1])).sum()
}
