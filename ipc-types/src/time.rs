//! Two clocks that must never be mixed.
//!
//! [`FlightTime`] is the time of the flight: simulated, or the aircraft's monotonic clock. Exposures, trajectories
//! and staleness are expressed in it. [`HostTime`] is the machine's monotonic clock: watchdogs, restarts and
//! latency probes use it. The two are different types, so comparing them does not compile:
//!
//! ```compile_fail
//! use ipc_types::{FlightTime, HostTime};
//! let late = FlightTime::from_nanos(5) > HostTime::from_nanos(4);
//! ```

use std::time::Duration;

macro_rules! instant {
    ($(#[$doc:meta])* $name:ident) => {
        $(#[$doc])*
        #[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug, Default, Hash)]
        pub struct $name(i64);

        impl $name {
            /// The clock's zero.
            pub const ZERO: Self = Self(0);

            /// From nanoseconds since the clock's zero.
            pub const fn from_nanos(nanos: i64) -> Self {
                Self(nanos)
            }

            /// From seconds since the clock's zero (saturates; NaN becomes zero).
            pub fn from_secs_f64(seconds_s: f64) -> Self {
                Self((seconds_s * 1e9).round() as i64)
            }

            /// Nanoseconds since the clock's zero.
            pub const fn as_nanos(self) -> i64 {
                self.0
            }

            /// Seconds since the clock's zero.
            pub fn as_secs_f64(self) -> f64 {
                self.0 as f64 * 1e-9
            }

            /// Signed seconds from `earlier` to `self`.
            pub fn seconds_since(self, earlier: Self) -> f64 {
                self.0.saturating_sub(earlier.0) as f64 * 1e-9
            }

            /// Time from `earlier` to `self`, zero if `earlier` is later.
            pub fn saturating_since(self, earlier: Self) -> Duration {
                Duration::from_nanos(self.0.saturating_sub(earlier.0).max(0) as u64)
            }
        }

        impl std::ops::Add<Duration> for $name {
            type Output = Self;
            fn add(self, rhs: Duration) -> Self {
                Self(self.0.saturating_add(i64::try_from(rhs.as_nanos()).unwrap_or(i64::MAX)))
            }
        }

        impl std::ops::Sub<Duration> for $name {
            type Output = Self;
            fn sub(self, rhs: Duration) -> Self {
                Self(self.0.saturating_sub(i64::try_from(rhs.as_nanos()).unwrap_or(i64::MAX)))
            }
        }
    };
}

instant!(
    /// Time of the flight (simulated, or the aircraft's monotonic clock), in nanoseconds.
    FlightTime
);
instant!(
    /// The machine's monotonic clock, in nanoseconds.
    HostTime
);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arithmetic_saturates_instead_of_wrapping() {
        let end = FlightTime::from_nanos(i64::MAX);
        assert_eq!(end + Duration::from_secs(1), end);
        assert_eq!(FlightTime::ZERO.saturating_since(end), Duration::ZERO);
        assert_eq!(FlightTime::from_secs_f64(f64::NAN), FlightTime::ZERO);
    }

    #[test]
    fn seconds_round_trip() {
        let t = FlightTime::from_secs_f64(12.345_678_9);
        assert!((t.as_secs_f64() - 12.345_678_9).abs() < 1e-9);
        assert!((FlightTime::ZERO.seconds_since(t) + 12.345_678_9).abs() < 1e-9);
    }
}
