//! A pilot who takes over from the vehicle's own commands, and hands back.

use ipc_types::bounds::Bounds;
use ipc_types::{FlightTime, Vector, World};
use serde::{Deserialize, Serialize};

/// A stretch that a pilot flies.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Piloted {
    /// Takes over at this flight time, s.
    pub from_s: f64,
    /// Flies for so long, s.
    pub for_s: f64,
    /// World velocity that the sticks ask for, m/s.
    pub velocity_mps: [f64; 3],
}

impl Piloted {
    /// Reports values out of range.
    pub fn check(&self, bounds: &mut Bounds) {
        bounds.range("from_s", self.from_s, 0.0..=36_000.0);
        bounds.range("for_s", self.for_s, 0.0..=36_000.0);
        self.velocity_mps.iter().for_each(|&velocity| bounds.range("velocity_mps", velocity, -30.0..=30.0));
    }
}

/// What a pilot's sticks ask for at an instant; `None` while the vehicle flies itself. Of stretches that overlap the first.
pub(crate) fn sticks(pilot: &[Piloted], now: FlightTime) -> Option<Vector<World>> {
    let now_s = now.as_secs_f64();
    let flies = |piloted: &&Piloted| (piloted.from_s..piloted.from_s + piloted.for_s).contains(&now_s);
    pilot.iter().find(flies).map(|piloted| Vector::from_array(piloted.velocity_mps))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn he_flies_within_his_stretches_and_of_two_at_a_time_the_first() {
        let stretch = |from_s, for_s, x| Piloted { from_s, for_s, velocity_mps: [x, 0.0, 0.0] };
        let pilot = [stretch(2.0, 3.0, 1.0), stretch(4.0, 3.0, 2.0)];
        let at = |now_s: f64| sticks(&pilot, FlightTime::from_secs_f64(now_s)).map(|velocity| velocity.x);
        assert_eq!([1.9, 2.0, 4.5, 5.0, 7.0].map(at), [None, Some(1.0), Some(1.0), Some(2.0), None]);
        assert_eq!(sticks(&[], FlightTime::ZERO), None);
    }
}
