//! What a planner leaves to its successor, and how that goes on: with the same goal, the plan being flown, and what it knows of
//! where it was stuck.

use crate::planner::Planner;
use crate::pricing::Flown;
use crate::rollout::Turn;
use bytemuck::Zeroable;
use ipc_types::estates::{EstatePlace, PlannerEstate};
use ipc_types::messages::{Goal, Task};
use ipc_types::{FlightTime, Point, Vector, World};

/// A plan that is older than this by now is not gone on with, s: it was stopped meanwhile.
const LAPSES_S: f64 = 1.0;

impl Planner {
    /// What a successor needs, and, in `places`, where the vehicle was stuck and where it dwelt.
    pub fn estate(&self, goal: Goal, now: FlightTime, places: &mut Vec<EstatePlace>) -> PlannerEstate {
        let mut estate = PlannerEstate {
            goal,
            planned_ns: now.as_nanos(),
            replans: self.replans,
            disregards_before_ns: self.stuck.disregards_before.as_nanos(),
            airborne: u64::from(self.airborne),
            ..PlannerEstate::zeroed()
        };
        match self.flying {
            None => {}
            Some(Flown::Aimed(index)) => (estate.flown, estate.candidate) = (1, index as u64),
            Some(Flown::Turn(turn, begun)) => {
                (estate.flown, estate.switch_s, estate.begun_ns) = (2, turn.switch_s, begun.as_nanos());
                (estate.first_mps, estate.then_mps) = (turn.first.to_array(), turn.then.to_array());
            }
        }
        places.clear();
        let place = |(place, dwelt_s): (Point<World>, f64)| EstatePlace { position_m: place.to_array(), dwelt_s };
        places.extend(self.stuck.remembered().map(place));
        estate
    }

    /// Goes on where a predecessor died. What does not make sense is left out.
    pub fn inherit(&mut self, estate: &PlannerEstate, places: &[EstatePlace]) {
        let (first, then) = (Vector::from_array(estate.first_mps), Vector::from_array(estate.then_mps));
        let is_sane = first.is_finite() && then.is_finite() && estate.switch_s.is_finite();
        self.flying = match estate.flown {
            1 if (estate.candidate as usize) < self.library_size() => Some(Flown::Aimed(estate.candidate as usize)),
            2 if is_sane => {
                let turn = Turn { first, then, switch_s: estate.switch_s };
                Some(Flown::Turn(turn, FlightTime::from_nanos(estate.begun_ns)))
            }
            _ => None,
        };
        self.inherited = Some(FlightTime::from_nanos(estate.planned_ns));
        (self.replans, self.airborne) = (estate.replans, estate.airborne != 0);
        self.stuck.disregards_before = FlightTime::from_nanos(estate.disregards_before_ns);
        let goal = Point::from_array(estate.goal.position_m);
        self.goal = goal.is_finite().then(|| (goal, Task::from_wire(estate.goal.task)));
        for place in places {
            let at = Point::from_array(place.position_m);
            if at.is_finite() && place.dwelt_s.is_finite() {
                self.stuck.remember(at, place.dwelt_s);
            }
        }
    }

    /// Lets go of what was inherited if it is too old to be flown on.
    pub(crate) fn lapse(&mut self, now: FlightTime) {
        if let Some(planned) = self.inherited.take()
            && !(0.0..=LAPSES_S).contains(&now.seconds_since(planned))
        {
            self.flying = None;
        }
    }
}
