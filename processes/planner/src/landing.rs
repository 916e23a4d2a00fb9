//! Landing: straight down where the goal is, until the vehicle sinks no more.
//!
//! No image sees what is below: whoever asks for a landing declares the column under the goal free, as for take-off.

use crate::situation::Situation;
use ipc_types::{FlightTime, Point, World};

/// Speed of sinking, m/s.
pub(crate) const SINK_MPS: f64 = 0.5;
/// So far below the vehicle it aims, m: far enough not to slow down for it.
const AIM_M: f64 = 2.0;
/// Slower than this it does not sink, m/s ...
const STILL_MPS: f64 = 0.15;
/// ... and for so long it has landed, s: longer than it takes to begin.
const STILL_S: f64 = 1.5;

/// A landing that has begun.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Landing {
    /// Since when it has not sunk.
    still: FlightTime,
    pub(crate) has_landed: bool,
}

impl Landing {
    pub(crate) fn begin(now: FlightTime) -> Self {
        Self { still: now, has_landed: false }
    }

    /// Notes how the vehicle moves; where to aim.
    pub(crate) fn aim(&mut self, situation: &Situation) -> Point<World> {
        if situation.velocity.norm() > STILL_MPS {
            self.still = situation.now;
        }
        self.has_landed |= situation.now.seconds_since(self.still) > STILL_S;
        Point::new(situation.goal.x, situation.goal.y, situation.position.z - AIM_M)
    }

    /// While something else holds the vehicle, it does not sink for that.
    pub(crate) fn wait(&mut self, now: FlightTime) {
        self.still = now;
    }
}
