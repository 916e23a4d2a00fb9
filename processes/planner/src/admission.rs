//! What the map says of a candidate.

use crate::Config;
use crate::rollout::{Rollout, STEP_S, Sample, brake};
use ipc_types::limits::Fence;
use ipc_types::{Point, Vector, World};
use memory::{Occupancy, View};

/// Asks the map about candidates.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Admission<'a> {
    pub(crate) view: &'a View,
    pub(crate) fence: &'a Fence,
    pub(crate) config: &'a Config,
}

/// What was found along an admissible candidate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Admitted {
    /// Length of the going part that nobody vouches for, m.
    pub(crate) unknown_m: f64,
}

impl Admission<'_> {
    /// Whether a candidate may be flown, with `threshold` (γ) for occupied. Leaves at the first reason why not.
    pub(crate) fn admit(&self, rollout: &Rollout, threshold: f32) -> Option<Admitted> {
        let committed = (self.config.commit_s / STEP_S).ceil() as usize;
        let committed = committed.min(rollout.samples.len() - 1);
        // At every step until the next plan, not only at the last: braking leaves a curve along its tangent.
        let committed_samples = rollout.samples[..=committed].iter().rev();
        if !committed_samples.clone().all(|&sample| self.stops_in_free_space(sample, threshold)) {
            return None;
        }
        let mut unknown_m = 0.0;
        for (index, pair) in rollout.samples.windows(2).enumerate() {
            let must_be_known = index < committed;
            unknown_m += self.leg(pair[0].position, pair[1].position, threshold, must_be_known)?;
        }
        Some(Admitted { unknown_m })
    }

    /// Invariant 2: the braking segment along the velocity lies in space known free.
    fn stops_in_free_space(&self, from: Sample, threshold: f32) -> bool {
        let (mut at, mut safe) = (from.position, true);
        brake(from, self.config, |sample| {
            safe = safe && self.leg(at, sample.position, threshold, true).is_some();
            at = sample.position;
        });
        safe
    }

    /// Length of unknown space along a leg (its start not included), or `None` where it may not be flown.
    fn leg(&self, from: Point<World>, to: Point<World>, threshold: f32, must_be_known: bool) -> Option<f64> {
        let length = from.distance(to);
        let samples = (length / self.config.sample_m).ceil().max(1.0) as usize;
        let mut unknown = 0;
        for sample in 1..=samples {
            let point = from.lerp(to, sample as f64 / samples as f64);
            if !self.fence.contains(point) && !self.is_way_back_in(from, to) {
                return None;
            }
            match self.view.occupancy(point, threshold) {
                Occupancy::Free => {}
                Occupancy::Occupied => return None,
                Occupancy::Unknown(_) if must_be_known => return None,
                Occupancy::Unknown(_) => unknown += 1,
            }
        }
        Some(length * f64::from(unknown) / samples as f64)
    }

    /// Outside the fence only what leads back in is allowed.
    fn is_way_back_in(&self, from: Point<World>, to: Point<World>) -> bool {
        let step = to - from;
        self.fence.limit(from, step, f64::MIN_POSITIVE) == step && !self.fence.contains(from)
    }

    /// Length of the straight way from `from` towards `goal` up to the first occupied point, at most `reach_m`.
    pub(crate) fn clear_m(&self, from: Point<World>, goal: Point<World>, reach_m: f64, threshold: f32) -> f64 {
        let reach_m = reach_m.min(from.distance(goal));
        let direction = (goal - from).direction().unwrap_or(Vector::ZERO);
        // The look ahead only ranks candidates: coarser samples do.
        let spacing = 2.0 * self.config.sample_m;
        let samples = (reach_m / spacing) as usize;
        let hit = (1..=samples)
            .find(|&i| self.view.occupancy(from + direction * (i as f64 * spacing), threshold) == Occupancy::Occupied);
        hit.map_or(reach_m, |i| (i - 1) as f64 * spacing)
    }
}
