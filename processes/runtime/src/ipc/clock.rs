//! Flight time in a process that does not make it.

use ipc_types::messages::FlightClock;
use ipc_types::{FlightTime, HostTime};

/// Follows the flight clock's readings and extrapolates between them.
///
/// A single reading that does not follow from those before it is not believed: time cannot be taken back, and whoever once
/// believed to be in the future would hold all that is for stale, for good. Several in a row that agree with each other are.
#[derive(Debug, Default)]
pub(super) struct ClockFollower {
    reading: Option<Reading>,
    /// One that does not follow from it; or the very first.
    suspect: Option<Reading>,
    /// So many in a row agree with each other, though not with the reading.
    agreeing: u32,
    /// Flight time never runs backwards, even when a reading corrects an extrapolation.
    latest: FlightTime,
}

#[derive(Clone, Copy, Debug)]
struct Reading {
    flight: FlightTime,
    host: HostTime,
    rate: f64,
}

/// A reading older than this is not extrapolated further: flight time waits, or its source has died. A few periods of
/// the clock, so that a slowed world does not look stale to those who live in it.
const LONGEST_EXTRAPOLATION_S: f64 = 0.05;
/// So many that agree are believed: at first, when there is nothing to hold against them, and against what was read before. Two
/// messages in a row may be damaged alike.
const AGREEING: (u32, u32) = (2, 6);
/// A reading that is older is not taken, s.
const LATEST_S: f64 = 1.0;
/// Flight time may be ahead of host time by this between two readings, for a world that catches up, s.
const AHEAD_S: f64 = 0.1;

impl Reading {
    /// Whether another may come after it: flight time may wait, and hardly run ahead.
    fn is_followed_by(&self, next: &Self) -> bool {
        let (flight_s, host_s) = (next.flight.seconds_since(self.flight), next.host.seconds_since(self.host));
        host_s >= 0.0 && (0.0..=host_s * self.rate.max(next.rate) + AHEAD_S).contains(&flight_s)
    }
}

impl ClockFollower {
    /// Takes a reading, at a host time.
    pub(super) fn read(&mut self, clock: &FlightClock, now: HostTime) {
        // One of another host time was damaged as well, and its flight time would seem to follow.
        let is_of_now = now.seconds_since(HostTime::from_nanos(clock.host_ns)).abs() < LATEST_S;
        let is_sane = is_of_now && clock.rate.is_finite() && (0.0..=100.0).contains(&clock.rate);
        let (flight, host) = (FlightTime::from_nanos(clock.flight_ns), HostTime::from_nanos(clock.host_ns));
        let next = Reading { flight, host, rate: clock.rate };
        let follows = |before: &Option<Reading>| before.is_some_and(|before| before.is_followed_by(&next));
        if !is_sane {
            return;
        }
        self.agreeing = if follows(&self.suspect) { self.agreeing + 1 } else { 1 };
        let needed = if self.reading.is_none() { AGREEING.0 } else { AGREEING.1 };
        if follows(&self.reading) || self.agreeing >= needed {
            (self.reading, self.suspect) = (Some(next), None);
        } else {
            self.suspect = Some(next);
        }
    }

    /// Flight time per host time; 1 while it stands still, or is not known.
    pub(super) fn rate(&self) -> f64 {
        self.reading.map(|reading| reading.rate).filter(|&rate| rate > 0.0).unwrap_or(1.0)
    }

    /// Flight time at a host time; zero before the first reading.
    pub(super) fn at(&mut self, host: HostTime) -> FlightTime {
        if let Some(Reading { flight, host: read_at, rate }) = self.reading {
            let elapsed_s = host.seconds_since(read_at).clamp(0.0, LONGEST_EXTRAPOLATION_S);
            let now = FlightTime::from_nanos(flight.as_nanos().saturating_add((elapsed_s * rate * 1e9) as i64));
            self.latest = self.latest.max(now);
        }
        self.latest
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;

    #[test]
    fn extrapolates_at_the_given_rate_and_never_runs_backwards() {
        let mut follower = ClockFollower::default();
        let host = HostTime::from_secs_f64;
        assert_eq!(follower.at(host(9.0)), FlightTime::ZERO);
        let reading =
            FlightClock { flight_ns: 2_000_000_000, host_ns: 10_000_000_000, rate: 0.5, ..FlightClock::zeroed() };
        follower.read(&reading, host(10.0));
        assert_eq!(follower.at(host(10.0)), FlightTime::ZERO, "one alone may be anything");
        follower.read(&reading, host(10.0));
        assert!((follower.at(host(10.04)).as_secs_f64() - 2.02).abs() < 1e-6);
        follower.read(&FlightClock { host_ns: 10_040_000_000, ..reading }, host(10.04));
        assert!((follower.at(host(10.04)).as_secs_f64() - 2.02).abs() < 1e-6);
        follower.read(&FlightClock { rate: f64::NAN, ..reading }, host(10.05));
        assert!((follower.at(host(100.0)).as_secs_f64() - 2.025).abs() < 1e-6, "it waits with its source");
    }

    #[test]
    fn a_reading_that_does_not_follow_is_not_believed_and_a_step_that_lasts_is() {
        let mut follower = ClockFollower::default();
        let host = HostTime::from_secs_f64;
        let reading = |flight_s: f64, host_s: f64| FlightClock {
            flight_ns: FlightTime::from_secs_f64(flight_s).as_nanos(),
            host_ns: host(host_s).as_nanos(),
            rate: 1.0,
            ..FlightClock::zeroed()
        };
        follower.read(&reading(5.0, 100.0), host(100.0));
        for tick in 0..100 {
            let s = 0.01 * f64::from(tick);
            follower.read(&reading(5.0 + s, 100.0 + s), host(100.0 + s));
            // Damaged: far ahead, long ago, of a host in the future.
            let damaged =
                [reading(3.6e6, 100.0 + s), reading(0.0, 100.0 + s), reading(5.2 + s, 99.0), reading(4e6, 4e7)];
            follower.read(&damaged[tick as usize % 4], host(100.0 + s));
            let now_s = follower.at(host(100.0 + s)).as_secs_f64();
            assert!((now_s - 5.0 - s).abs() < 1e-6, "{now_s} at {s}");
        }
        // A world that stood still for a while, then goes on.
        follower.read(&reading(6.0, 103.0), host(103.0));
        assert!((follower.at(host(103.0)).as_secs_f64() - 6.0).abs() < 1e-6);
        // A step that lasts.
        for tick in 0..6 {
            let s = 0.01 * f64::from(tick);
            follower.read(&reading(9.0 + s, 103.1 + s), host(103.1 + s));
        }
        assert!((follower.at(host(103.15)).as_secs_f64() - 9.05).abs() < 1e-6);
    }

    /// Whatever bytes are damaged, of one message in three, time goes on by what the others say.
    #[test]
    fn damaged_readings_never_carry_time_away() {
        use rand::{RngExt, SeedableRng};
        for seed in 0..50 {
            let (mut random, mut follower) = (rand_pcg::Pcg64Mcg::seed_from_u64(seed), ClockFollower::default());
            for tick in 0..2000 {
                let (flight_s, host_s) = (1.0 + 0.01 * f64::from(tick), 5000.0 + 0.01 * f64::from(tick));
                let (flight, host) = (FlightTime::from_secs_f64(flight_s), HostTime::from_secs_f64(host_s));
                let mut reading = FlightClock {
                    flight_ns: flight.as_nanos(),
                    host_ns: host.as_nanos(),
                    rate: 1.0,
                    ..FlightClock::zeroed()
                };
                let is_damaged = random.random::<f64>() < 0.3;
                if tick > 1 && (is_damaged || (1000..1003).contains(&tick)) {
                    let bytes = &mut bytemuck::bytes_of_mut(&mut reading)[size_of::<ipc_types::wire::Stamp>()..];
                    // Three in a row alike, once.
                    let alike = (1000..1003).contains(&tick);
                    let at = if alike { 6 } else { random.random_range(0..bytes.len()) };
                    bytes[at] = if alike { 0x97 } else { random.random() };
                }
                follower.read(&reading, host);
                let now_s = follower.at(host).as_secs_f64();
                assert!(tick < 2 || (now_s - flight_s).abs() < 0.5, "seed {seed}: {now_s} s at {flight_s} s");
            }
        }
    }
}
