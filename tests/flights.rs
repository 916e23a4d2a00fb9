//! Flights in lockstep: full pipeline, rendered stereo, modelled latency.

mod common;

use common::{Run, on_threads, real_time};
use sparrowhawk::config::FlightConfig;
use sparrowhawk::graph::Flight;
use std::sync::OnceLock;
use supervisor::{Outcome, Summary};

/// Graphs of processes that fly at a time: one takes about half a core.
const PROCESS_GRAPHS: usize = 3;

/// Lockstep flights that fly at a time.
fn cores() -> usize {
    std::thread::available_parallelism().map_or(2, std::num::NonZero::get)
}

fn configuration(world: Option<&str>, seed: u64) -> FlightConfig {
    let mut config = FlightConfig::load(None, world).expect("the shipped configuration loads");
    config.seed = seed;
    config.mission.cruise_speed_mps = 4.0;
    config
}

fn fly(config: &FlightConfig) -> Summary {
    Flight::new(config, None).expect("there is a world").fly(|_| true)
}

/// 30 forests of 0.05 trees/m², flown once for all tests that look at them.
fn campaign() -> &'static [Summary] {
    static FLIGHTS: OnceLock<Vec<Summary>> = OnceLock::new();
    FLIGHTS.get_or_init(|| on_threads(cores(), 1..=30, |seed| fly(&configuration(None, seed))))
}

#[test]
fn thirty_forests_without_a_collision() {
    let _alone = real_time();
    for (index, flight) in campaign().iter().enumerate() {
        println!(
            "seed {:2}: {:?} in {:.1} s, {:.1} m, clearance {:?} m",
            index + 1,
            flight.outcome,
            flight.flight_time_s,
            flight.path_length_m,
            flight.min_clearance_m
        );
    }
    let count = |outcome| campaign().iter().filter(|flight| flight.outcome == outcome).count();
    assert_eq!(count(Outcome::Collided), 0);
    assert!(count(Outcome::Arrived) >= 29, "{} arrived", count(Outcome::Arrived));
}

#[test]
fn a_curvy_corridor_is_flown_through() {
    let _alone = real_time();
    let flown = on_threads(cores(), 1..=10, |seed| {
        let path = std::path::Path::new("corridor");
        let mut config = FlightConfig::load_for_simulator(Some(path), None).expect("it is shipped");
        config.seed = seed;
        fly(&config)
    });
    for (flight, seed) in flown.iter().zip(1..) {
        assert_eq!(flight.outcome, Outcome::Arrived, "seed {seed}: {flight:?}");
    }
}

#[test]
fn without_avoidance_nine_of_ten_of_them_end_in_a_collision() {
    let _alone = real_time();
    let blind = on_threads(cores(), 1..=30, |seed| {
        let mut config = configuration(None, seed);
        config.avoidance = false;
        // What nobody looks at need not be seen often.
        config.vehicle.simulator.camera.rate_hz = 5.0;
        fly(&config).outcome
    });
    let collisions = blind.iter().filter(|outcome| **outcome == Outcome::Collided).count();
    assert!(collisions >= 27, "{collisions} of 30 collide without avoidance: the worlds are too empty");
}

/// The ipc driver against the lockstep driver.
#[test]
fn ten_forests_end_alike_as_processes_and_in_lockstep() {
    let _alone = real_time();
    let flown = on_threads(PROCESS_GRAPHS, 1..=10, |seed| {
        let run = Run::new(&format!("alike{seed}"));
        let flown = run.fly(&["--seed", &seed.to_string(), "--speed", "4"]);
        run.assert_nothing_left();
        flown.summary
    });
    for (index, (processes, lockstep)) in flown.iter().zip(campaign()).enumerate() {
        println!("seed {}: {} with clock {}", index + 1, processes["outcome"], processes["clock_ratio"]);
        let expected = serde_json::to_value(lockstep.outcome).expect("serialises");
        assert_eq!(processes["outcome"], expected, "seed {}: {processes}", index + 1);
    }
}

#[test]
fn the_same_seed_repeats_to_the_bit_and_another_differs() {
    let _alone = real_time();
    let brief = |seed| {
        let mut config = configuration(None, seed);
        config.mission.time_limit_s = 8.0;
        fly(&config)
    };
    let results = on_threads(cores(), 0..=2, |index| brief([11, 11, 12][index as usize]));
    assert_eq!(results[0], results[1]);
    assert_ne!(results[0].log_hash, results[2].log_hash);
}

#[test]
fn an_open_field_under_a_clear_sky_is_crossed() {
    let _alone = real_time();
    let flight = fly(&configuration(Some("field"), 1));
    assert_eq!(flight.outcome, Outcome::Arrived, "{flight:?}");
    assert!(flight.max_speed_mps > 3.0, "{flight:?}");
}

#[test]
fn a_hedge_across_the_way_is_flown_over() {
    let _alone = real_time();
    let flights = on_threads(cores(), 1..=4, |seed| {
        let hedge = FlightConfig::load(Some("hedge".as_ref()), None).expect("it is shipped");
        fly(&FlightConfig { seed, ..hedge })
    });
    for flight in &flights {
        assert_eq!(flight.outcome, Outcome::Arrived, "{flight:?}");
        // It is 60 m wide: around it are 86 m.
        assert!(flight.path_length_m < 72.0, "{flight:?}");
    }
}

#[test]
fn a_blank_wall_across_the_way_stops_the_vehicle() {
    let _alone = real_time();
    let mut config = configuration(Some("wall"), 1);
    config.mission.time_limit_s = 40.0;
    let flight = fly(&config);
    assert!(matches!(flight.outcome, Outcome::TimedOut | Outcome::GaveUp), "{flight:?}");
    assert!(flight.distance_to_goal_m > 39.0, "{flight:?}");
    assert!(flight.max_speed_mps > 2.0, "it flies at all: {flight:?}");
}

#[test]
fn a_fast_vehicle_crosses_100_m_of_forest() {
    let _alone = real_time();
    let flights = on_threads(cores(), 1..=4, |seed| {
        let fast = FlightConfig::load(Some("fast".as_ref()), None).expect("the shipped configuration loads");
        fly(&FlightConfig { seed, ..fast })
    });
    for flight in &flights {
        println!("{:?} in {:.1} s, on the way {:.1} m/s", flight.outcome, flight.flight_time_s, flight.way_speed_mps);
        assert_ne!(flight.outcome, Outcome::Collided, "{flight:?}");
        assert!(flight.max_speed_mps > 8.0, "{flight:?}");
    }
    assert!(flights.iter().filter(|flight| flight.outcome == Outcome::Arrived).count() >= 3);
    let fast = flights.iter().filter(|flight| flight.way_speed_mps > 6.0).count();
    assert!(fast >= 3, "{fast} of 4 are flown at 6 m/s and more");
}

#[test]
fn the_vehicles_of_the_thesis_and_the_wren_cross_the_forests_they_are_made_for() {
    let _alone = real_time();
    let flights = on_threads(cores(), 0..=5, |index| {
        let name = ["thesis_large", "thesis_small", "thicket"][index as usize % 3];
        let flight = FlightConfig::load(Some(name.as_ref()), None).expect("it is shipped");
        fly(&FlightConfig { seed: 1 + index / 3, noise_camera: true, ..flight })
    });
    assert!(flights.iter().all(|flight| flight.outcome != Outcome::Collided), "{flights:?}");
    let arrived = flights.iter().filter(|flight| flight.outcome == Outcome::Arrived).count();
    assert!(arrived >= 5, "{arrived} of 6 arrive: {flights:?}");
}
