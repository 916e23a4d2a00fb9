//! Flights in trouble, with the noise-model camera: wind, lost frames, blindness, a state estimate that jumps or lags;
//! and missions that are not straight.

mod common;

use common::{on_threads, real_time};
use simulator::Trouble;
use sparrowhawk::config::FlightConfig;
use sparrowhawk::graph::Flight;
use supervisor::{Outcome, Summary};

/// Flights at a time.
const JOBS: usize = 2;

/// Flies a shipped mission with some seeds.
fn fly(mission: &str, seeds: std::ops::RangeInclusive<u64>, trouble: Trouble) -> Vec<Summary> {
    let _alone = real_time();
    let template = FlightConfig::load(Some(mission.as_ref()), None).expect("the shipped configuration loads");
    let flights = on_threads(JOBS, seeds, |seed| {
        let mut config = FlightConfig { seed, noise_camera: true, trouble, ..template.clone() };
        config.mission.cruise_speed_mps =
            config.mission.cruise_speed_mps.min(if mission == "default" { 4.0 } else { 20.0 });
        config.check().expect("possible");
        Flight::new(&config, None).expect("there is a world").fly(|_| true)
    });
    for flight in &flights {
        let (time_s, clearance_m) = (flight.flight_time_s, flight.min_clearance_m);
        println!("{mission}, {trouble:?}: {:?} in {time_s:.1} s, clearance {clearance_m:?} m", flight.outcome);
        assert_ne!(flight.outcome, Outcome::Collided, "{flight:?}");
    }
    flights
}

fn arrived(flights: &[Summary]) -> usize {
    flights.iter().filter(|flight| flight.outcome == Outcome::Arrived).count()
}

#[test]
fn wind_with_gusts_is_held_against() {
    let wind = Trouble { wind_mps: [4.0, 4.0], gust_mps: 2.0, ..Trouble::default() };
    assert!(arrived(&fly("default", 601..=604, wind)) >= 3);
}

#[test]
fn of_ten_frames_three_may_be_lost() {
    assert!(arrived(&fly("default", 601..=604, Trouble { lost_frames: 0.3, ..Trouble::default() })) >= 3);
}

#[test]
fn an_estimate_that_jumps_by_a_metre_or_lags_leads_into_nothing() {
    assert!(arrived(&fly("default", 601..=603, Trouble { jump: [10.0, 1.0], ..Trouble::default() })) >= 2);
    assert!(arrived(&fly("default", 601..=602, Trouble { lag_ms: 60.0, ..Trouble::default() })) >= 1);
}

#[test]
fn two_seconds_of_blindness_in_fast_flight_end_in_a_stop_not_in_a_tree() {
    assert!(arrived(&fly("fast", 601..=602, Trouble { blind_s: [6.0, 2.0], ..Trouble::default() })) >= 1);
}

#[test]
fn missions_that_are_not_straight_are_flown() {
    assert!(arrived(&fly("behind", 401..=402, Trouble::default())) >= 1);
    assert!(arrived(&fly("corner", 401..=402, Trouble::default())) >= 1);
    assert!(arrived(&fly("canopy", 401..=402, Trouble::default())) >= 1);
    assert!(arrived(&fly("cul_de_sac", 401..=402, Trouble::default())) >= 1);
}
