//! The relation between flight time and host time.

use crate::wire::{Stamp, stamped, wire};

wire! {
    /// One reading of both clocks. Flight time at host time `h` is `flight_ns + (h - host_ns)·rate`.
    FlightClock = "sparrowhawk/FlightClock/1" {
        /// Origin.
        stamp: Stamp,
        /// Flight time, ns.
        flight_ns: i64,
        /// Host monotonic time, ns.
        host_ns: i64,
        /// Flight seconds per host second, over the last second.
        rate: f64,
    }
}
stamped!(FlightClock);
