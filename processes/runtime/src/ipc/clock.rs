//! Flight time in a process that does not make it.

use ipc_types::messages::FlightClock;
use ipc_types::{FlightTime, HostTime};

/// Follows the flight clock's readings and extrapolates between them.
#[derive(Debug, Default)]
pub(super) struct ClockFollower {
    reading: Option<(FlightTime, HostTime, f64)>,
    /// Flight time never runs backwards, even when a reading corrects an extrapolation.
    latest: FlightTime,
}

/// A reading older than this is not extrapolated further: flight time waits, or its source has died. A few periods of
/// the clock, so that a slowed world does not look stale to those who live in it.
const LONGEST_EXTRAPOLATION_S: f64 = 0.05;

impl ClockFollower {
    pub(super) fn read(&mut self, clock: &FlightClock) {
        let sane = clock.rate.is_finite() && (0.0..=100.0).contains(&clock.rate);
        if sane {
            let (flight, host) = (FlightTime::from_nanos(clock.flight_ns), HostTime::from_nanos(clock.host_ns));
            self.reading = Some((flight, host, clock.rate));
        }
    }

    /// Flight time at a host time; zero before the first reading.
    pub(super) fn at(&mut self, host: HostTime) -> FlightTime {
        if let Some((flight, read_at, rate)) = self.reading {
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
        follower.read(&reading);
        assert!((follower.at(host(10.04)).as_secs_f64() - 2.02).abs() < 1e-6);
        follower.read(&FlightClock { host_ns: 10_040_000_000, ..reading });
        assert!((follower.at(host(10.04)).as_secs_f64() - 2.02).abs() < 1e-6);
        follower.read(&FlightClock { rate: f64::NAN, ..reading });
        assert!((follower.at(host(100.0)).as_secs_f64() - 2.025).abs() < 1e-6, "it waits with its source");
    }
}
