//! Looking before leaping: a slow vehicle turns its camera to where it wants to go before it sets out.
//!
//! A sideways plan from rest begins where the camera does not look, so that it can neither be vouched for nor refused
//! by what is there. Two such plans, one on each side of an obstacle, would take turns for ever.
//!
//! What is too near for the camera to see a whole body there is looked at from farther away: the vehicle steps back.

use crate::situation::Situation;
use ipc_types::frames::wrap_angle_rad;
use ipc_types::{FlightTime, Point, World};

/// A heading that differs by less counts as reached, rad.
const ALIGNED_RAD: f64 = 0.14;
/// Longest that a turn may take, s.
const TURN_S: f64 = 4.0;
/// A step back ends so near to where it leads, m ...
const STEPPED_M: f64 = 0.15;
/// ... or after so long, s.
const STEPPING_S: f64 = 3.0;
/// What was looked at is forgotten after this long, s ...
const FORGET_S: f64 = 12.0;
/// ... or this far away, m.
const FORGET_M: f64 = 0.7;
/// Share of the camera's half view that counts as seen: towards the edge a body is not seen whole.
const SEEN_SHARE: f64 = 0.8;

#[derive(Clone, Copy, Debug)]
struct Look {
    heading_rad: f64,
    since: FlightTime,
    at: Point<World>,
}

/// A step back that leads where the vehicle can be seen to come through, and where the camera looks meanwhile.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct StepBack {
    pub(crate) to: Point<World>,
    pub(crate) heading_rad: f64,
}

/// Most looks from one place.
pub(crate) const LOOKS: usize = 6;

/// Where the vehicle turns to look, and where it has looked from here.
#[derive(Clone, Debug)]
pub(crate) struct Gaze {
    turn: Option<Look>,
    step: Option<(StepBack, FlightTime)>,
    looked: Vec<Look>,
}

impl Gaze {
    pub(crate) fn new() -> Self {
        Self { turn: None, step: None, looked: Vec::with_capacity(LOOKS + 2) }
    }

    /// Forgets everything.
    pub(crate) fn reset(&mut self) {
        self.turn = None;
        self.step = None;
        self.looked.clear();
    }

    /// Begins to step back. It is a look, too: it will not do so for ever.
    pub(crate) fn step_back(&mut self, step: StepBack, now: FlightTime, at: Point<World>) {
        self.look(step.heading_rad, now, at);
        self.step = Some((step, now));
    }

    /// The step back, until it is done, or was not within a reasonable time.
    pub(crate) fn stepping(&mut self, now: FlightTime, at: Point<World>) -> Option<StepBack> {
        let (step, since) = self.step?;
        if step.to.distance(at) < STEPPED_M || now.seconds_since(since) > STEPPING_S {
            self.step = None;
        }
        self.step.map(|(step, _)| step)
    }

    /// Ends a step back that may not be flown.
    pub(crate) fn stay(&mut self) {
        self.step = None;
    }

    /// Begins to turn.
    pub(crate) fn look(&mut self, heading_rad: f64, now: FlightTime, at: Point<World>) {
        self.looked.retain(|look| now.seconds_since(look.since) < FORGET_S && look.at.distance(at) < FORGET_M);
        self.turn = Some(Look { heading_rad, since: now, at });
    }

    /// The heading being turned to; `None` once it is reached, or was not within a reasonable time.
    pub(crate) fn turning(&mut self, now: FlightTime, yaw_rad: f64) -> Option<f64> {
        let turn = self.turn?;
        let is_aligned = wrap_angle_rad(turn.heading_rad - yaw_rad).abs() < ALIGNED_RAD;
        if is_aligned || now.seconds_since(turn.since) > TURN_S {
            self.turn = None;
            if self.looked.len() > LOOKS {
                self.looked.remove(0);
            }
            self.looked.push(Look { since: now, ..turn });
            return None;
        }
        Some(turn.heading_rad)
    }

    /// Whether a heading was looked at from here.
    pub(crate) fn has_looked(&self, heading_rad: f64, situation: &Situation, half_view_rad: f64) -> bool {
        self.remembered(situation).any(|look| is_seen(heading_rad, look.heading_rad, half_view_rad))
    }

    /// How many headings were looked at from here.
    pub(crate) fn looks(&self, situation: &Situation) -> usize {
        self.remembered(situation).count()
    }

    fn remembered(&self, situation: &Situation) -> impl Iterator<Item = &Look> {
        let (now, here) = (situation.now, situation.position);
        let remembers =
            move |look: &&Look| now.seconds_since(look.since) < FORGET_S && look.at.distance(here) < FORGET_M;
        self.looked.iter().filter(remembers)
    }
}

/// Whether a heading is within the view of a camera that looks along `yaw_rad`.
pub(crate) fn is_seen(heading_rad: f64, yaw_rad: f64, half_view_rad: f64) -> bool {
    wrap_angle_rad(yaw_rad - heading_rad).abs() < SEEN_SHARE * half_view_rad
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::situation;
    use ipc_types::Vector;

    const HALF_VIEW_RAD: f64 = 0.6;

    #[test]
    fn what_was_looked_at_is_remembered_for_a_while() {
        let here = Point::new(0.0, 0.0, 2.0);
        let at = |now: f64, place| situation(now, place, Vector::ZERO);
        let mut gaze = Gaze::new();
        assert!(is_seen(0.3, 0.0, HALF_VIEW_RAD) && !is_seen(1.5, 0.0, HALF_VIEW_RAD));
        assert!(is_seen(-3.1, 3.1, HALF_VIEW_RAD), "across the wrap");
        assert!(!gaze.has_looked(1.5, &at(0.0, here), HALF_VIEW_RAD));
        gaze.look(1.5, FlightTime::ZERO, here);
        assert_eq!(gaze.turning(FlightTime::from_secs_f64(0.5), 0.4), Some(1.5));
        assert_eq!(gaze.turning(FlightTime::from_secs_f64(1.0), 1.45), None, "aligned");
        assert!(gaze.has_looked(1.7, &at(2.0, here), HALF_VIEW_RAD));
        assert!(!gaze.has_looked(-1.5, &at(2.0, here), HALF_VIEW_RAD), "the other side");
        assert!(!gaze.has_looked(1.7, &at(30.0, here), HALF_VIEW_RAD), "long ago");
        assert!(!gaze.has_looked(1.7, &at(2.0, Point::new(2.0, 0.0, 2.0)), HALF_VIEW_RAD), "elsewhere");
    }

    #[test]
    fn a_step_back_ends_where_it_leads_or_in_time_and_counts_as_a_look() {
        let at = |x_m: f64| Point::new(x_m, 0.0, 2.0);
        let t = FlightTime::from_secs_f64;
        let step = StepBack { to: at(-0.6), heading_rad: 0.0 };
        let mut gaze = Gaze::new();
        gaze.step_back(step, t(0.0), at(0.0));
        assert_eq!(gaze.stepping(t(0.5), at(-0.3)), Some(step));
        assert_eq!(gaze.stepping(t(1.0), at(-0.55)), None, "there");
        assert_eq!(gaze.turning(t(1.1), 0.0), None, "it looks there already");
        assert_eq!(gaze.looks(&situation(1.2, at(-0.55), Vector::ZERO)), 1);
        for ends in [|gaze: &mut Gaze| gaze.stay(), |gaze: &mut Gaze| gaze.reset()] {
            gaze.step_back(step, t(2.0), at(0.0));
            assert!(gaze.stepping(t(2.1), at(0.0)).is_some());
            ends(&mut gaze);
            assert_eq!(gaze.stepping(t(2.2), at(0.0)), None);
        }
        gaze.step_back(step, t(3.0), at(0.0));
        assert_eq!(gaze.stepping(t(3.1 + STEPPING_S), at(0.0)), None, "late");
    }

    #[test]
    fn a_turn_that_does_not_come_about_ends() {
        let mut gaze = Gaze::new();
        gaze.look(3.0, FlightTime::ZERO, Point::ZERO);
        let turning: Vec<_> =
            (0..100).map(|tick| gaze.turning(FlightTime::from_secs_f64(f64::from(tick) * 0.1), 0.0)).collect();
        assert_eq!(turning.first(), Some(&Some(3.0)));
        assert_eq!(turning.last(), Some(&None));
    }
}
