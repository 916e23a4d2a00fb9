//! What the map says of a candidate.

use crate::Config;
use crate::rollout::{Rollout, STEP_S, Sample, brake};
use ipc_types::limits::Fence;
use ipc_types::{Point, World};
use memory::{Occupancy, View};

/// Spacing at which the start of a candidate is searched for the way out, m.
const ESCAPE_SPACING_M: f64 = 0.05;

/// A retreat along the path flown may begin with an occupied stretch so long, m: no view shows where the vehicle is, and
/// that it came through says more than what views from afar make of the place.
const RETREAT_M: f64 = 2.5;

/// Asks the map about candidates.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Admission<'a> {
    view: &'a View,
    fence: &'a Fence,
    config: &'a Config,
    /// Longest occupied stretch at the start, m.
    escape_m: f64,
}

impl<'a> Admission<'a> {
    pub(crate) fn new(view: &'a View, fence: &'a Fence, config: &'a Config) -> Self {
        Self { view, fence, config, escape_m: config.escape_m }
    }

    /// For the way that the vehicle came by: it has been there, so it may leave a margin that way from deeper inside.
    /// What was seen too late, such as a branch that points at the camera, is met so, and so are phantoms.
    pub(crate) fn of_retreat(view: &'a View, fence: &'a Fence, config: &'a Config) -> Self {
        Self { escape_m: RETREAT_M.max(config.escape_m), ..Self::new(view, fence, config) }
    }
}

/// The occupied stretch at a candidate's start: a vehicle that has come too near to something may leave its margin.
///
/// A straight line that leaves every ball of radius R it starts in within s comes nearer to none of their centres, but
/// for s²/8R. So a short stretch leads out, and a way deeper in is never short. What lies on the other side of the
/// start is not part of it: a vehicle that still moves inwards must come to rest without it.
#[derive(Clone, Copy, Debug)]
struct Escape {
    from: Point<World>,
    exit: Point<World>,
}

impl Escape {
    fn covers(&self, point: Point<World>) -> bool {
        let (out, way) = (self.exit - self.from, point - self.from);
        way.norm() <= out.norm() + ESCAPE_SPACING_M && way.dot(out) >= 0.0 && out.norm() > 0.0
    }
}

/// What became of the candidates. Those that could not win, or are out of the camera's view, are not asked about.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Tally {
    /// Candidates rolled out.
    pub candidates: u32,
    /// Found admissible.
    pub admissible: u32,
    /// Refused because they touch something occupied.
    pub occupied: u32,
    /// Refused because what they commit to is not known free.
    pub unknown: u32,
    /// Refused because they leave the fence.
    pub outside: u32,
}

impl Tally {
    /// Counts a candidate; whether it is admissible.
    pub(crate) fn count(&mut self, found: Result<(), Refusal>) -> bool {
        *match found {
            Ok(_) => &mut self.admissible,
            Err(Refusal::Occupied) => &mut self.occupied,
            Err(Refusal::Unknown) => &mut self.unknown,
            Err(Refusal::Outside) => &mut self.outside,
        } += 1;
        found.is_ok()
    }
}

/// Why a candidate may not be flown.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Refusal {
    /// It touches something occupied.
    Occupied,
    /// What it commits to is not known free.
    Unknown,
    /// It leaves the fence.
    Outside,
}

impl Admission<'_> {
    /// Whether a candidate may be flown, with `threshold` (γ) for occupied. Leaves at the first reason why not. What lies
    /// beyond the part that it commits to is asked about when it is flown.
    pub(crate) fn admit(&self, rollout: &Rollout, threshold: f32) -> Result<(), Refusal> {
        let escape = self.escape(rollout, threshold)?;
        let committed = (self.config.commit_s / STEP_S).ceil() as usize;
        let committed = &rollout.samples[..=committed.min(rollout.samples.len() - 1)];
        // At every step until the next plan, not only at the last: braking leaves a curve along its tangent.
        for &sample in committed.iter().rev() {
            self.stops_in_free_space(sample, threshold, escape)?;
        }
        self.walk(committed, committed.len(), threshold, escape)
    }

    /// Whether a candidate is known free for so long, or to its end.
    pub(crate) fn knows(&self, rollout: &Rollout, threshold: f32, seconds: f64) -> bool {
        let Ok(escape) = self.escape(rollout, threshold) else { return false };
        let known = first(rollout, seconds);
        self.walk(known, known.len(), threshold, escape).is_ok()
    }

    /// Whether nothing known stands in a candidate's way for so long, were all of it seen that can be seen: good enough to
    /// look there, not to fly. What is nearer than `near_m` must be known already.
    pub(crate) fn promises(&self, rollout: &Rollout, threshold: f32, seconds: f64, near_m: f64) -> bool {
        let from = rollout.samples[0].position;
        let near = rollout.samples.iter().take_while(|sample| sample.position.distance(from) < near_m).count();
        self.escape(rollout, threshold)
            .is_ok_and(|escape| self.walk(first(rollout, seconds), near, threshold, escape).is_ok())
    }

    /// How much of a trajectory is occupied, or outside of the fence, and how much is unknown, m.
    pub(crate) fn risk(&self, rollout: &Rollout, threshold: f32) -> (f64, f64) {
        let (mut occupied_m, mut unknown_m) = (0.0, 0.0);
        for pair in rollout.samples.windows(2) {
            let (from, to) = (pair[0].position, pair[1].position);
            let places = self.places(from, to);
            let piece_m = from.distance(to) / places.len() as f64;
            for place in places {
                match self.view.occupancy(place, threshold) {
                    _ if !self.fence.contains(place) => occupied_m += piece_m,
                    Occupancy::Free => {}
                    Occupancy::Occupied => occupied_m += piece_m,
                    Occupancy::Unknown(_) => unknown_m += piece_m,
                }
            }
        }
        (occupied_m, unknown_m)
    }

    /// Asks along samples, of which the first `known` steps must be known free.
    fn walk(&self, samples: &[Sample], known: usize, threshold: f32, escape: Escape) -> Result<(), Refusal> {
        for (index, pair) in samples.windows(2).enumerate() {
            self.leg(pair[0].position, pair[1].position, threshold, index < known, escape)?;
        }
        Ok(())
    }

    /// The occupied stretch at the start, if it is short enough to leave.
    fn escape(&self, rollout: &Rollout, threshold: f32) -> Result<Escape, Refusal> {
        let from = rollout.samples[0].position;
        for pair in rollout.samples.windows(2) {
            let pieces = (pair[0].position.distance(pair[1].position) / ESCAPE_SPACING_M).ceil().max(1.0) as usize;
            for piece in 0..pieces {
                let exit = pair[0].position.lerp(pair[1].position, piece as f64 / pieces as f64);
                if from.distance(exit) > self.escape_m {
                    return Err(Refusal::Occupied);
                }
                if self.view.occupancy(exit, threshold) != Occupancy::Occupied {
                    return Ok(Escape { from, exit });
                }
            }
        }
        Err(Refusal::Occupied)
    }

    /// Invariant 2: the braking segment along the velocity lies in space known free.
    fn stops_in_free_space(&self, from: Sample, threshold: f32, escape: Escape) -> Result<(), Refusal> {
        let mut at = from.position;
        brake(from, self.config.braking_mps2).try_for_each(|sample| {
            let leg = (at, sample.position);
            at = sample.position;
            self.leg(leg.0, leg.1, threshold, true, escape)
        })
    }

    /// Whether a leg (its start not included) may be flown.
    fn leg(
        &self,
        from: Point<World>,
        to: Point<World>,
        threshold: f32,
        must_be_known: bool,
        escape: Escape,
    ) -> Result<(), Refusal> {
        for point in self.places(from, to) {
            if !self.fence.contains(point) && !self.is_way_back_in(from, to) {
                return Err(Refusal::Outside);
            }
            match self.view.occupancy(point, threshold) {
                Occupancy::Free => {}
                Occupancy::Occupied if escape.covers(point) => {}
                Occupancy::Occupied => return Err(Refusal::Occupied),
                Occupancy::Unknown(_) if must_be_known => return Err(Refusal::Unknown),
                Occupancy::Unknown(_) => {}
            }
        }
        Ok(())
    }

    /// The places of a leg that are asked about, its start not included.
    fn places(&self, from: Point<World>, to: Point<World>) -> impl ExactSizeIterator<Item = Point<World>> {
        let count = (from.distance(to) / self.config.sample_m).ceil().max(1.0) as u32;
        (0..count).map(move |place| from.lerp(to, f64::from(place + 1) / f64::from(count)))
    }

    /// Outside the fence only what leads back in is allowed.
    fn is_way_back_in(&self, from: Point<World>, to: Point<World>) -> bool {
        let step = to - from;
        self.fence.limit(from, step, f64::MIN_POSITIVE) == step && !self.fence.contains(from)
    }
}

/// The first samples of a roll-out, for so long.
fn first(rollout: &Rollout, seconds: f64) -> &[Sample] {
    &rollout.samples[..rollout.samples.len().min(((seconds / STEP_S) as usize).saturating_add(1))]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::{FENCE, before_a_wall, config, home_only};
    use crate::rollout::{Target, Turn};
    use ipc_types::Vector;

    fn admit(x_m: f64, velocity: Vector<World>, to: Vector<World>) -> Result<(), Refusal> {
        let (config, view) = (config(), before_a_wall());
        let admission = Admission::new(&view, &FENCE, &config);
        let mut rollout = Rollout::new();
        let from = Sample { position: Point::new(x_m, 0.0, 2.0), velocity };
        rollout.fill(from, Target::Turn(Turn { first: to, then: to, switch_s: 1.0 }), 1.0, &config);
        admission.admit(&rollout, config.gamma_low)
    }

    #[test]
    fn a_vehicle_inside_a_margin_may_leave_it_and_go_no_deeper() {
        let (out, deeper, along) =
            (Vector::new(-1.5, 0.0, 0.0), Vector::new(1.5, 0.0, 0.0), Vector::new(0.0, 1.5, 0.0));
        assert!(admit(4.15, Vector::ZERO, out).is_ok());
        assert_eq!(admit(4.15, Vector::ZERO, deeper), Err(Refusal::Occupied));
        assert_eq!(admit(4.15, Vector::ZERO, along), Err(Refusal::Occupied));
        assert_eq!(admit(4.6, Vector::ZERO, out), Err(Refusal::Occupied), "too deep for the allowance");
        let inwards = Vector::new(1.2, 0.0, 0.0);
        assert_eq!(admit(4.15, inwards, out), Err(Refusal::Occupied), "still moves deeper before it turns");
    }

    #[test]
    fn a_look_promises_what_it_can_make_known_and_no_more() {
        let (config, mut rollout) = (config(), Rollout::new());
        // Nothing is known beyond the home cylinder.
        for (home_radius_m, x_m, promises) in [(1.5, 0.0, true), (1.5, 1.0, false)] {
            let view = home_only(home_radius_m);
            let admission = Admission::new(&view, &FENCE, &config);
            let from = Sample { position: Point::new(x_m, 0.0, 2.0), velocity: Vector::new(2.0, 0.0, 0.0) };
            let ahead = Vector::new(4.0, 0.0, 0.0);
            rollout.fill(from, Target::Turn(Turn { first: ahead, then: ahead, switch_s: 1.0 }), 1.0, &config);
            assert_eq!(admission.admit(&rollout, config.gamma_low), Err(Refusal::Unknown));
            assert_eq!(admission.promises(&rollout, config.gamma_low, 1.0, config.blind_m), promises, "from {x_m} m");
        }
    }

    #[test]
    fn what_cannot_stop_before_the_margin_is_refused() {
        let ahead = Vector::new(4.0, 0.0, 0.0);
        assert!(admit(-1.0, ahead, Vector::new(-1.0, 0.0, 0.0)).is_ok(), "stops in time");
        assert_eq!(admit(1.9, ahead, Vector::new(-1.0, 0.0, 0.0)), Err(Refusal::Occupied), "does not");
    }

    #[test]
    fn the_tally_knows_why() {
        let mut tally = Tally::default();
        for found in [Ok(()), Err(Refusal::Unknown), Err(Refusal::Outside)] {
            assert_eq!(tally.count(found), found.is_ok());
        }
        assert_eq!((tally.admissible, tally.occupied, tally.unknown, tally.outside), (1, 0, 1, 1));
    }
}
