//! Which candidate to fly: all are priced, and the map is asked about them in the order of their prices.
//!
//! What a candidate costs is known before the map is asked. Most are never asked about, and the answer is the same as if all
//! had been.

use crate::admission::{Admission, Tally};
use crate::gaze::{LOOKS, StepBack};
use crate::pricing::{Flown, Prices, Pricing};
use crate::rollout::{Rollout, Target};
use ipc_types::Vector;
use std::f64::consts::PI;

/// How far to step back to look, as a share of what the camera cannot see a body within.
const STEP_SHARE: f64 = 0.7;
/// Speed of stepping back, m/s.
pub(crate) const STEP_MPS: f64 = 0.8;
/// Directions of stepping back, from straight back, rad.
const ASIDE_RAD: [f64; 5] = [0.0, 0.5, -0.5, 1.0, -1.0];
/// What is to be known, or promised, of where the camera does not look, s.
const FORESEEN_S: f64 = 1.5;

/// What the cheapest candidate asks for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Course {
    /// There is none.
    None,
    /// Fly it.
    Go(Flown),
    /// Look along its heading, rad, before it may be flown.
    Look(f64),
    /// Look along its heading from farther away.
    StepBack(StepBack),
}

impl Prices<'_> {
    /// Asks about candidates, cheapest first, and leaves the first admissible one in `best`.
    pub(crate) fn choose(
        &self,
        admission: &Admission<'_>,
        pricing: &mut Pricing,
        best: &mut Rollout,
        tally: &mut Tally,
    ) -> Course {
        self.price_all(pricing);
        let Pricing { priced, refined, .. } = pricing;
        tally.candidates = priced.len() as u32;
        let looked = self.gaze.looks(self.situation);
        let slow = self.is_slow();
        let mut hidden: Option<(f64, StepBack)> = None;
        for candidate in priced.iter() {
            if let Some((_, step)) = hidden.filter(|(price_m, _)| *price_m < candidate.price_m) {
                return Course::StepBack(step);
            }
            let threshold =
                if self.is_flying(candidate.index) { self.config.gamma_high } else { self.config.gamma_low };
            let heading_rad = candidate.heading_rad;
            self.roll_out(self.target(candidate.index, refined), best);
            let admitted = tally.count(admission.admit(best, threshold));
            // What is known, though not from here, needs no look.
            let looks =
                candidate.turns && looked < LOOKS && !(admitted && admission.knows(best, threshold, FORESEEN_S));
            if looks && !self.gaze.has_looked(heading_rad, self.situation, self.half_view_rad) {
                if admission.promises(best, threshold, FORESEEN_S, self.config.blind_m) {
                    return Course::Look(heading_rad);
                }
            } else if admitted {
                let go = || Course::Go(self.flown(candidate.index, refined));
                return if looks { Course::Look(heading_rad) } else { go() };
            }
            let hides = slow && hidden.is_none() && looked < LOOKS;
            if hides
                && admission.promises(best, threshold, FORESEEN_S, 0.0)
                && let Some(step) = self.step_back(heading_rad, admission, best)
            {
                hidden = Some((candidate.price_m + self.config.step_back_price_m * (looked + 1).pow(2) as f64, step));
            }
        }
        hidden.map_or(Course::None, |(_, step)| Course::StepBack(step))
    }

    /// A place from where what hides on a heading, too near for the camera, can be seen: straight back or aside of that, as
    /// far as all of the way is known free. Leaves the way in `best`.
    fn step_back(&self, heading_rad: f64, admission: &Admission<'_>, best: &mut Rollout) -> Option<StepBack> {
        let (from, threshold) = (self.aim.from, self.config.gamma_high);
        ASIDE_RAD.into_iter().find_map(|aside_rad| {
            let back_rad = heading_rad + PI + aside_rad;
            let to =
                from.position + Vector::new(back_rad.cos(), back_rad.sin(), 0.0) * (STEP_SHARE * self.config.blind_m);
            best.fill(from, Target::Place(to, STEP_MPS), FORESEEN_S, self.config);
            let is_free = admission.admit(best, threshold).is_ok() && admission.knows(best, threshold, f64::INFINITY);
            is_free.then_some(StepBack { to, heading_rad })
        })
    }
}
