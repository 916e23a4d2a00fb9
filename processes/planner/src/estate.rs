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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::{FENCE, TAKE_OFF, before_a_wall, config, situation};
    use crate::{Config, Situation};
    use ipc_types::messages::PlanMode;

    fn planner() -> Planner {
        Planner::new(Config { lead_s: 0.0, ..config() }, FENCE, TAKE_OFF, 4.0)
    }

    fn goal(task: Task) -> Goal {
        let position_m = [60.0, 0.0, 2.0];
        Goal { position_m, cruise_speed_mps: 4.0, task: task as u32, ..Goal::zeroed() }
    }

    fn under_way(now_s: f64) -> Situation {
        situation(now_s, Point::new(0.5 + now_s, 1.0, 2.0), Vector::new(2.0, 0.5, 0.0))
    }

    #[test]
    fn a_successor_goes_on_with_the_plan_being_flown() {
        let (view, mut first) = (before_a_wall(), planner());
        for tick in 0..5 {
            first.step(&under_way(0.1 * f64::from(tick)), &view);
        }
        assert!(first.flying.is_some(), "something is flown");
        let mut places = Vec::new();
        let estate = first.estate(goal(Task::Hover), FlightTime::from_secs_f64(0.4), &mut places);
        let mut second = planner();
        second.inherit(&estate, &places);
        assert_eq!((second.flying, second.goal, second.replans()), (first.flying, first.goal, first.replans()));
        let next = under_way(0.5);
        first.step(&next, &view);
        second.step(&next, &view);
        assert_eq!(second.points(), first.points(), "the same plan");
        assert_eq!(second.replans(), first.replans());
    }

    #[test]
    fn what_is_too_old_or_makes_no_sense_is_not_flown_on() {
        let (view, mut first) = (before_a_wall(), planner());
        first.step(&under_way(0.0), &view);
        let estate = first.estate(goal(Task::Hover), FlightTime::ZERO, &mut Vec::new());
        let mut late = planner();
        late.inherit(&estate, &[]);
        late.lapse(FlightTime::from_secs_f64(5.0));
        assert_eq!(late.flying, None);
        for hostile in [
            PlannerEstate { flown: 1, candidate: u64::MAX, ..estate },
            PlannerEstate { flown: 2, first_mps: [f64::NAN; 3], ..estate },
            PlannerEstate { flown: 7, ..estate },
        ] {
            let mut planner = planner();
            planner.inherit(&hostile, &[EstatePlace { position_m: [f64::NAN; 3], dwelt_s: 1.0 }]);
            assert_eq!(planner.flying, None, "{hostile:?}");
            planner.step(&under_way(0.5), &view);
        }
    }

    #[test]
    fn to_stay_for_a_while_stops_the_vehicle_and_forgets_nothing() {
        let (view, mut planner) = (before_a_wall(), planner());
        planner.step(&under_way(0.0), &view);
        planner.stuck.remember(Point::new(9.0, 0.0, 2.0), 3.0);
        let stay = Situation { task: Task::Stay, ..under_way(0.1) };
        assert_eq!(planner.step(&stay, &view).mode, PlanMode::Hold);
        assert_eq!(planner.points().last().expect("points").velocity_mps, [0.0; 3]);
        planner.step(&under_way(0.2), &view);
        assert!(planner.stuck.remembered().any(|(_, dwelt_s)| dwelt_s == 3.0), "it remembers where it dwelt");
    }
}
