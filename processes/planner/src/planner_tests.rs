//! The planner as a whole: a vehicle that follows its plans exactly, on maps made by hand.

use crate::fixtures::{FENCE, TAKE_OFF, before_a_wall, config, home_only, situation};
use crate::planner::Planner;
use crate::{Config, Situation};
use ipc_types::limits::Fence;
use ipc_types::messages::{PlanMode, Task};
use ipc_types::{FlightTime, Point, Vector, World};
use memory::View;

/// Where a vehicle is, and how fast, a tenth of a second after a plan that it follows exactly and at once.
fn follow(planner: &Planner) -> (Point<World>, Vector<World>) {
    let next = planner.points().get(1).or(planner.points().last()).expect("a plan has points");
    (Point::from_array(next.position_m), Vector::from_array(next.velocity_mps))
}

/// Follows the planner's own plans, ten a second.
fn fly(view: &View, seconds: f64) -> (Point<World>, f64, Vec<PlanMode>) {
    let mut planner = Planner::new(Config { lead_s: 0.0, ..config() }, FENCE, TAKE_OFF, 4.0);
    let (mut position, mut velocity, mut fastest, mut modes) = (Point::ZERO, Vector::ZERO, 0.0_f64, Vec::new());
    for tick in 0..(seconds * 10.0) as usize {
        let plan = planner.step(&situation(tick as f64 * 0.1, position, velocity), view);
        (position, velocity) = follow(&planner);
        fastest = fastest.max(velocity.norm());
        if modes.last() != Some(&plan.mode) {
            modes.push(plan.mode);
        }
    }
    (position, fastest, modes)
}

#[test]
fn takes_off_flies_and_arrives_where_all_is_free() {
    let (position, fastest, modes) = fly(&home_only(200.0), 30.0);
    assert_eq!(modes, [PlanMode::TakeOff, PlanMode::Cruise, PlanMode::Arrived]);
    assert!(position.distance(Point::new(60.0, 0.0, 2.0)) < 0.5, "{position:?}");
    assert!(fastest > 3.8, "{fastest}");
}

#[test]
fn a_stale_state_or_map_means_holding_even_in_the_climb() {
    let view = home_only(200.0);
    for height_m in [0.5, 2.0] {
        let fresh = situation(10.0, Point::new(0.0, 0.0, height_m), Vector::new(1.0, 0.0, 0.5));
        let early = FlightTime::from_secs_f64(9.0);
        for stale in [Situation { state_valid: early, ..fresh }, Situation { image_valid: early, ..fresh }] {
            let mut planner = Planner::new(config(), FENCE, TAKE_OFF, 4.0);
            assert_ne!(planner.step(&fresh, &view).mode, PlanMode::Hold);
            assert_eq!(planner.step(&stale, &view).mode, PlanMode::Hold);
            assert_eq!(planner.points().last().expect("points").velocity_mps, [0.0; 3]);
        }
    }
}

#[test]
fn the_last_of_the_way_is_flown_only_where_it_is_known_free() {
    let goal = Point::new(30.0, 0.0, 2.0);
    let at = Situation { goal, ..situation(10.0, Point::new(29.4, 0.0, 2.0), Vector::ZERO) };
    for (home_radius_m, end_m) in [(200.0, 30.0), (1.0, 29.4)] {
        let mut view = home_only(home_radius_m);
        // The swept volume alone must not carry it there.
        view.free_space_mut().set_path([Point::new(29.4, 0.0, 2.0)], |_| true);
        let mut planner = Planner::new(config(), FENCE, TAKE_OFF, 4.0);
        assert_eq!(planner.step(&at, &view).mode, PlanMode::Arrived);
        let end = planner.points().last().expect("points").position_m[0];
        assert!((end - end_m).abs() < 0.1, "{end}");
    }
}

#[test]
fn never_leaves_what_is_known_free() {
    let (position, fastest, _) = fly(&home_only(12.0), 20.0);
    assert!((position - Point::ZERO).horizontal_norm() < 12.0, "{position:?}");
    assert!(fastest > 1.0, "it flies at all: {fastest}");
}

#[test]
fn a_vehicle_deep_inside_a_margin_leaves_it_by_the_way_it_came() {
    let mut view = before_a_wall();
    let flown = (0..=18).map(|place| Point::new(f64::from(place) * 0.25, 0.0, 2.0));
    view.free_space_mut().set_path(flown, |_| true);
    let mut planner = Planner::new(Config { lead_s: 0.0, ..config() }, FENCE, TAKE_OFF, 4.0);
    let (mut position, mut velocity, mut modes) = (Point::new(4.5, 0.0, 2.0), Vector::ZERO, Vec::new());
    for tick in 0..300 {
        let plan = planner.step(&situation(f64::from(tick) * 0.1, position, velocity), &view);
        (position, velocity) = follow(&planner);
        if modes.last() != Some(&plan.mode) {
            modes.push(plan.mode);
        }
        assert!(position.x < 4.55, "no deeper: {position:?}");
        if position.x < 3.9 {
            break; // Out of it, and free to fly around what the image shows.
        }
    }
    assert!(modes.contains(&PlanMode::BackOut) && !modes.contains(&PlanMode::GivenUp), "{modes:?} {position:?}");
    assert!(position.x < 3.9, "{position:?}");
}

#[test]
fn a_vehicle_that_all_views_wall_in_goes_by_what_it_saw_while_it_looked_around() {
    // Its place, the way it came and all around is occupied, as the wall's views have it.
    let way: Vec<_> = (0..=30).map(|place| Point::new(f64::from(place) * 0.19, 0.0, 2.0)).collect();
    let (mut walled_in, mut fresh) = (before_a_wall(), home_only(1.0));
    for view in [&mut walled_in, &mut fresh] {
        view.free_space_mut().set_path(way.iter().copied(), |_| true);
    }
    let mut planner = Planner::new(Config { lead_s: 0.0, ..config() }, FENCE, TAKE_OFF, 4.0);
    let (mut position, mut velocity, mut modes) = (way[30], Vector::ZERO, Vec::new());
    let seen = FlightTime::from_secs_f64(0.1);
    for tick in 0..600 {
        let view = if planner.disregards_before() > seen { &fresh } else { &walled_in };
        let plan = planner.step(&situation(f64::from(tick) * 0.1, position, velocity), view);
        (position, velocity) = follow(&planner);
        modes.push(plan.mode);
        if position.x < way[30].x - 0.5 {
            break;
        }
    }
    modes.dedup();
    assert!(planner.disregards_before() > seen, "{modes:?}");
    assert!(position.x < way[30].x - 0.5 && !modes.contains(&PlanMode::GivenUp), "{position:?} {modes:?}");
}

#[test]
fn gives_up_and_hovers_in_the_end() {
    let (_, _, modes) = fly(&home_only(6.0), 200.0);
    assert_eq!(modes.last(), Some(&PlanMode::GivenUp), "{modes:?}");
}

#[test]
fn goals_that_change_every_frame_or_cannot_be_reached_do_no_harm() {
    let view = before_a_wall();
    // The images show no more of the wall: beside them all is free.
    let fence = Fence { least_m: [-20.0, -2.5, 0.5], most_m: [100.0, 2.5, 4.0] };
    let mut planner = Planner::new(Config { lead_s: 0.0, ..config() }, fence, TAKE_OFF, 4.0);
    let (mut position, mut velocity) = (Point::new(0.0, 0.0, 2.0), Vector::ZERO);
    for tick in 0..400 {
        let angle = f64::from(tick) * 2.4;
        let goal = match tick % 4 {
            0 => Point::new(30.0 * angle.cos(), 30.0 * angle.sin(), 2.0),
            1 => position,
            // Inside the wall, and beyond the fence.
            2 => Point::new(5.0, 0.0, 2.0),
            _ => Point::new(1e6, -1e6, 1e6),
        };
        let situation = Situation { goal, ..situation(f64::from(tick) * 0.1, position, velocity) };
        planner.step(&situation, &view);
        let last = planner.points().last().expect("a plan has points");
        assert_eq!(last.velocity_mps, [0.0; 3], "it ends at rest");
        (position, velocity) = follow(&planner);
        assert!(position.x < 4.1 && fence.contains(position), "{tick}: {position:?}");
    }
}

#[test]
fn keeps_inside_the_fence() {
    let config = Config { lead_s: 0.0, ..config() };
    let mut planner = Planner::new(config, Fence { most_m: [20.0, 50.0, 6.0], ..FENCE }, TAKE_OFF, 4.0);
    let view = home_only(200.0);
    let (mut position, mut velocity) = (Point::new(0.0, 0.0, 2.0), Vector::ZERO);
    for tick in 0..200 {
        planner.step(&situation(f64::from(tick) * 0.1, position, velocity), &view);
        (position, velocity) = follow(&planner);
        assert!(position.x <= 20.0, "{position:?}");
    }
}

/// Follows plans for half a minute, down to the ground at a height of 0.1 m; `tell` says what to do at a tick.
fn land(
    planner: &mut Planner,
    from: (usize, Point<World>),
    tell: impl Fn(usize, Situation) -> Situation,
) -> Vec<PlanMode> {
    let view = home_only(200.0);
    let (mut position, mut velocity, mut landed, mut modes) = (from.1, Vector::ZERO, false, Vec::new());
    for tick in from.0..from.0 + 300 {
        let now = tell(tick, situation(tick as f64 * 0.1, position, velocity));
        let plan = planner.step(&Situation { landed, ..now }, &view);
        let is_on_ground = position.z <= 0.1;
        (position, velocity) = follow(planner);
        landed = is_on_ground && velocity.z <= 0.0;
        if landed {
            (position, velocity) = (Point::new(position.x, position.y, 0.1), Vector::ZERO);
        }
        if now.task == Task::Stay && !now.piloted && tick % 30 > 15 {
            assert!(velocity.norm() < 0.3, "it stays: {velocity:?}");
        }
        if plan.mode == PlanMode::Land {
            assert!((position - now.goal).horizontal_norm() < 1.0, "above where it lands: {position:?}");
        }
        if modes.last() != Some(&plan.mode) {
            modes.push(plan.mode);
        }
    }
    assert_eq!(landed, modes.last() == Some(&PlanMode::Landed), "{modes:?} {position:?}");
    modes
}

const LANDING: [PlanMode; 5] =
    [PlanMode::TakeOff, PlanMode::Cruise, PlanMode::Arrived, PlanMode::Land, PlanMode::Landed];

#[test]
fn it_lands_where_it_was_asked_to_and_stays_where_it_is_told_to_stay() {
    let goal = Point::new(8.0, 3.0, 2.0);
    let mut planner = Planner::new(Config { lead_s: 0.0, ..config() }, FENCE, TAKE_OFF, 4.0);
    // Told to stay for three seconds on the way: from 3.0 s on.
    let mut modes = land(&mut planner, (0, Point::ZERO), |tick, now| {
        let task = if (30..60).contains(&tick) { Task::Stay } else { Task::Land };
        Situation { goal, task, ..now }
    });
    assert!(modes.contains(&PlanMode::Hold), "{modes:?}");
    modes.retain(|mode| *mode != PlanMode::Hold);
    modes.dedup();
    assert_eq!(modes, LANDING);
    // A pilot who only touches his sticks, and a planner that starts anew, let it stand.
    for planner in [&mut planner, &mut Planner::new(config(), FENCE, TAKE_OFF, 4.0)] {
        let standing = Situation {
            goal,
            task: Task::Land,
            landed: true,
            ..situation(40.0, Point::new(8.0, 3.0, 0.1), Vector::ZERO)
        };
        for piloted in [true, false] {
            assert_eq!(planner.step(&Situation { piloted, ..standing }, &home_only(200.0)).mode, PlanMode::Landed);
        }
    }
}

#[test]
fn what_has_landed_at_home_may_take_off_again() {
    let mut planner = Planner::new(Config { lead_s: 0.0, ..config() }, FENCE, TAKE_OFF, 4.0);
    let home = Point::new(0.0, 0.0, 2.0);
    let away = Point::new(8.0, 0.0, 2.0);
    let modes = land(&mut planner, (0, Point::ZERO), |tick, now| {
        // Away at first, then back.
        if tick < 60 { Situation { goal: away, ..now } } else { Situation { goal: home, task: Task::Land, ..now } }
    });
    assert_eq!(modes.last(), Some(&PlanMode::Landed), "{modes:?}");
    let modes = land(&mut planner, (300, Point::new(0.0, 0.0, 0.1)), |_, now| Situation {
        goal: away,
        task: Task::Land,
        ..now
    });
    assert_eq!(modes, LANDING);
}

#[test]
fn a_landing_that_is_carried_off_does_not_go_on_down() {
    let view = home_only(200.0);
    let mut planner = Planner::new(Config { lead_s: 0.0, ..config() }, FENCE, TAKE_OFF, 4.0);
    let goal = Point::new(8.0, 3.0, 2.0);
    let mut step = |tick: i32, at| {
        let now = Situation { goal, task: Task::Land, ..situation(f64::from(tick) * 0.1, at, Vector::ZERO) };
        let mode = planner.step(&now, &view).mode;
        (mode, planner.points().last().expect("points").position_m[2] - at.z)
    };
    step(0, goal);
    assert_eq!(step(1, goal).0, PlanMode::Land);
    let (mode, sinks_m) = step(2, goal + Vector::new(0.6, 0.0, -1.0));
    assert!(mode == PlanMode::Land && sinks_m.abs() < 0.05, "it comes nearer first: {mode} {sinks_m}");
    let (mode, sinks_m) = step(3, goal + Vector::new(1.5, 0.0, -1.0));
    assert!(mode != PlanMode::Land && sinks_m > -0.05, "{mode} {sinks_m}");
}

#[test]
fn a_pilot_forgives_a_vehicle_that_gave_up() {
    let view = home_only(1.5);
    let mut planner = Planner::new(config(), FENCE, TAKE_OFF, 4.0);
    let at = Point::new(0.0, 0.0, 2.0);
    let gave_up = (0..4000).find(|&tick| {
        let plan = planner.step(&situation(f64::from(tick) * 0.1, at, Vector::ZERO), &view);
        plan.mode == PlanMode::GivenUp
    });
    let now = f64::from(gave_up.expect("it gives up")) * 0.1 + 0.1;
    let piloted = Situation { piloted: true, ..situation(now, at, Vector::ZERO) };
    assert_ne!(planner.step(&piloted, &view).mode, PlanMode::GivenUp);
    assert_ne!(planner.step(&situation(now + 0.1, at, Vector::ZERO), &view).mode, PlanMode::GivenUp);
}

#[test]
fn plans_do_not_depend_on_the_number_of_threads() {
    let view = before_a_wall();
    let plans = |threads: u32| {
        let mut planner = Planner::new(Config { threads, lead_s: 0.0, ..config() }, FENCE, TAKE_OFF, 4.0);
        let (mut position, mut velocity, mut places) = (Point::new(-20.0, 0.5, 2.0), Vector::ZERO, Vec::new());
        for tick in 0..60 {
            let plan = planner.step(&situation(f64::from(tick) * 0.1, position, velocity), &view);
            (position, velocity) = follow(&planner);
            places.push((position, plan.tally));
        }
        assert!(position.x > -10.0, "it flies: {position:?}");
        places
    };
    let one = plans(1);
    for threads in [2, 3, 7] {
        assert_eq!(plans(threads), one, "{threads} threads");
    }
}
