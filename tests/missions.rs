//! Missions: waypoints, landing, a pilot who takes over and hands back, shadow mode.

mod common;

use common::{Run, real_time};
use ipc_types::{Point, World};
use simulator::Piloted;
use sparrowhawk::config::FlightConfig;
use sparrowhawk::graph::Flight;
use supervisor::{AtGoal, Outcome};

/// Setpoints a second, as the shipped vehicle's controller is configured.
const RATE_HZ: f64 = 50.0;

fn configuration(world: Option<&str>, seed: u64) -> FlightConfig {
    let mut config = FlightConfig::load(None, world).expect("the shipped configuration loads");
    (config.seed, config.noise_camera, config.mission.cruise_speed_mps) = (seed, true, 4.0);
    config
}

#[test]
fn waypoints_are_passed_in_order_and_it_lands_where_it_took_off() {
    for seed in [3, 4] {
        let mut config = configuration(None, seed);
        config.mission.waypoints_m = vec![[18.0, 6.0, 1.5], [18.0, -8.0, 1.5]];
        (config.mission.goal_m, config.mission.at_goal) = ([0.0, 0.0, 1.5], AtGoal::Land);
        let places: Vec<_> = config.mission.places().collect();
        let mut nearest = vec![(f64::INFINITY, 0.0); places.len()];
        let mut landed = false;
        let flight = Flight::new(&config, None).expect("a world").fly(|mission| {
            if let Some(truth) = mission.truth() {
                landed = truth.airborne == 0;
                let at = Point::<World>::from_array(truth.position_m);
                for (nearest, place) in nearest.iter_mut().zip(&places).filter(|_| mission.now().as_secs_f64() > 5.0) {
                    let gap_m = at.distance(*place);
                    if gap_m < nearest.0 {
                        *nearest = (gap_m, mission.now().as_secs_f64());
                    }
                }
            }
            true
        });
        assert_eq!(flight.outcome, Outcome::Arrived, "{flight:?}");
        assert!(nearest.iter().all(|(gap_m, _)| *gap_m < 3.0), "{nearest:?}");
        assert!(nearest.windows(2).all(|pair| pair[0].1 < pair[1].1), "in order: {nearest:?}");
        assert!(landed && flight.distance_to_goal_m < 0.6, "on the ground: {flight:?}");
    }
}

#[test]
fn a_pilot_takes_over_and_hands_back_and_the_flight_goes_on() {
    let mut config = configuration(Some("field"), 1);
    config.pilot = vec![Piloted { from_s: 6.0, for_s: 3.0, velocity_mps: [0.0, 3.0, 0.0] }];
    let mut farthest_m = 0.0_f64;
    let flight = Flight::new(&config, None).expect("a world").fly(|mission| {
        farthest_m = farthest_m.max(mission.truth().map_or(0.0, |truth| truth.position_m[1]));
        true
    });
    assert_eq!(flight.outcome, Outcome::Arrived, "{flight:?}");
    assert!(farthest_m > 5.0, "the pilot flew: {farthest_m}");
    assert!((flight.shadow_setpoints as f64 - 3.0 * RATE_HZ).abs() < 10.0, "{flight:?}");
}

#[test]
fn in_shadow_mode_everything_is_planned_and_nothing_followed() {
    let mut config = configuration(None, 5);
    // Straight up, then along a line well above the trees.
    config.mission.time_limit_s = 16.0;
    config.mission.fence.most_m[2] = 20.0;
    config.pilot = vec![
        Piloted { from_s: 0.0, for_s: 8.0, velocity_mps: [0.0, 0.0, 1.5] },
        Piloted { from_s: 8.0, for_s: 600.0, velocity_mps: [2.0, 0.0, 0.0] },
    ];
    let flight = Flight::new(&config, None).expect("a world").fly(|_| true);
    assert_eq!(flight.outcome, Outcome::TimedOut, "{flight:?}");
    assert!((flight.path_length_m - 28.0).abs() < 2.0, "only the pilot's way was flown: {flight:?}");
    assert!(flight.shadow_setpoints as f64 > 0.9 * 16.0 * RATE_HZ, "{flight:?}");
    assert!(flight.frames_without_map < 10, "it looked on: {flight:?}");
}

/// The same over shared memory, from the command line.
#[test]
fn a_pilot_and_a_landing_as_processes() {
    let _alone = real_time();
    let run = Run::new("landing");
    let goal = ["--world", "field", "--speed", "4", "--goal", "25,0,1.5"];
    let flown = run.fly(&[&goal[..], &["--land", "--waypoint", "12,3,1.5", "--pilot", "5,1.5,0,-2,0"]].concat());
    assert!(flown.output.status.success() && flown.outcome() == "arrived", "{}", flown.summary);
    assert!(flown.number("shadow_setpoints") > 50.0, "{}", flown.summary);
    assert!(flown.number("distance_to_goal_m") < 0.6, "{}", flown.summary);
    run.assert_nothing_left();
}
