//! Commands, and what becomes of them.

use crate::Watch;
use bridge::keys;
use ipc_types::messages::{Command, Order, Waypoint};
use ipc_types::topics::Commands;
use ipc_types::wire::Text;
use std::collections::HashMap;
use std::sync::Mutex;
use std::time::{Duration, Instant};
use zenoh::Wait;
use zenoh::qos::CongestionControl;

/// A command that was not answered is sent again after so long.
const AGAIN: Duration = Duration::from_millis(300);
/// Between two looks for an answer.
const LOOK: Duration = Duration::from_millis(20);

/// Flight time that lies so far behind the last number is another flight's, ns.
const ANOTHER_FLIGHT_NS: u64 = 5_000_000_000;

/// What is asked of a vehicle.
#[derive(Clone, Debug, PartialEq, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Asked {
    /// The vehicle's name.
    pub vehicle: String,
    /// [`Order`], by name.
    pub order: String,
    /// Places, m.
    #[serde(default)]
    pub places_m: Vec<[f64; 3]>,
    /// Highest speed, m/s; 0: as before.
    #[serde(default)]
    pub speed_mps: f64,
    /// For so long it may be followed, s.
    #[serde(default = "two_seconds")]
    pub valid_s: f64,
}

impl Asked {
    fn check(&self) -> Result<(), OperatorError> {
        let Self { valid_s, places_m, .. } = self;
        if !(0.1..=Command::LONGEST_S).contains(valid_s) {
            let reason = format!("valid for {valid_s} s, allowed is 0.1 to {}", Command::LONGEST_S);
            return Err(OperatorError::Rejected(reason));
        }
        if places_m.len() > Command::MOST_PLACES {
            let reason = format!("{} places, allowed are {}", places_m.len(), Command::MOST_PLACES);
            return Err(OperatorError::Rejected(reason));
        }
        Ok(())
    }
}

fn two_seconds() -> f64 {
    2.0
}

/// Why a command was not followed, or may not have been.
#[derive(Debug, thiserror::Error)]
pub enum OperatorError {
    /// There is no such order.
    #[error("no order is called {0}")]
    NoOrder(String),
    /// Without its time a command cannot be dated.
    #[error("{0} was not heard: without its flight time no command can be dated")]
    NotHeard(String),
    /// The network did not take it.
    #[error("it was not sent: {0}")]
    NotSent(String),
    /// The vehicle does not want to.
    #[error("rejected: {0}")]
    Rejected(String),
    /// It may have been followed, and the answer lost.
    #[error("no answer while it was valid: it is not followed any more, and may have been")]
    NoAnswer,
}

/// One who commands, by a name that nobody else has; with certificates, the one in his own.
#[derive(Debug)]
pub struct Operator {
    watch: Watch,
    name: String,
    /// The last number by vehicle.
    numbers: Mutex<HashMap<String, u64>>,
}

impl Operator {
    /// Numbers are flight times, so that those of one who begins anew, or of another program of the same operator, are larger
    /// than those before, whatever clocks on the ground say.
    pub fn new(watch: Watch, name: &str) -> Self {
        Self { watch, name: name.to_owned(), numbers: Mutex::default() }
    }

    /// Sends a command and waits for what becomes of it.
    ///
    /// # Errors
    /// It is rejected, or there is no answer while it is valid.
    pub fn ask(&self, asked: &Asked) -> Result<(), OperatorError> {
        let order = Order::from_name(&asked.order).ok_or_else(|| OperatorError::NoOrder(asked.order.clone()))?;
        asked.check()?;
        // From drawing a number to sending it, so that they are sent in their order.
        let mut numbers = self.numbers.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        let now_ns = self.flight_ns(&asked.vehicle)?;
        let number = next_number(numbers.get(&asked.vehicle).copied(), now_ns.max(0) as u64);
        numbers.insert(asked.vehicle.clone(), number);
        let command = self.command(order, asked, number, now_ns);
        self.put(&asked.vehicle, &command)?;
        drop(numbers);
        let (begun, mut sent) = (Instant::now(), Instant::now());
        while begun.elapsed().as_secs_f64() < asked.valid_s + 1.0 {
            let answer = self.watch.vehicles().get(&asked.vehicle).and_then(|v| v.answer(&self.name, number));
            match answer {
                Some((true, _)) => return Ok(()),
                Some((false, reason)) => return Err(OperatorError::Rejected(reason)),
                None => std::thread::sleep(LOOK),
            }
            // A command that comes twice is followed once, and answered twice: either may be lost on the way.
            if sent.elapsed() > AGAIN {
                sent = Instant::now();
                self.put(&asked.vehicle, &command)?;
            }
        }
        Err(OperatorError::NoAnswer)
    }

    /// Whether a vehicle says that this operator commands it.
    pub fn commands(&self, vehicle: &str) -> bool {
        self.watch.vehicles().get(vehicle).is_some_and(|vehicle| vehicle.is_commanded_by(&self.name))
    }

    /// Tells a vehicle that the operator is there.
    ///
    /// # Errors
    /// It was not heard, or the network did not take it.
    pub fn tell_present(&self, vehicle: &str) -> Result<(), OperatorError> {
        let asked = Asked {
            vehicle: vehicle.to_owned(),
            order: String::new(),
            places_m: Vec::new(),
            speed_mps: 0.0,
            valid_s: 2.0,
        };
        // It has no number: when it comes does not matter.
        let present = self.command(Order::Present, &asked, 0, self.flight_ns(vehicle)?);
        self.put(&asked.vehicle, &present)
    }

    /// The vehicle's flight time, ns, as far as it was heard.
    fn flight_ns(&self, vehicle: &str) -> Result<i64, OperatorError> {
        let now_ns = self.watch.vehicles().get(vehicle).and_then(crate::vehicle::Vehicle::flight_ns);
        now_ns.ok_or_else(|| OperatorError::NotHeard(vehicle.to_owned()))
    }

    /// A command, encoded.
    fn command(&self, order: Order, asked: &Asked, number: u64, now_ns: i64) -> Vec<u8> {
        let command = Command {
            number,
            expires_ns: now_ns + (asked.valid_s * 1e9) as i64,
            speed_mps: asked.speed_mps,
            order: order as u32,
            operator: Text::from(self.name.as_str()),
            ..bytemuck::Zeroable::zeroed()
        };
        let places: Vec<_> = asked.places_m.iter().map(|&position_m| Waypoint { position_m }).collect();
        let mut bytes = Vec::new();
        encoding::encode_message::<Commands>(&command, &places, &mut bytes);
        bytes
    }

    fn put(&self, vehicle: &str, command: &[u8]) -> Result<(), OperatorError> {
        let put = self.watch.session.put(keys::key(vehicle, &keys::command(&self.name)), command);
        put.congestion_control(CongestionControl::Block)
            .wait()
            .map_err(|error| OperatorError::NotSent(error.to_string()))
    }
}

/// A number that is larger than the last one of the same flight: the flight time. In a flight that has begun since, it is small
/// again.
fn next_number(last: Option<u64>, now_ns: u64) -> u64 {
    last.filter(|&last| last < now_ns + ANOTHER_FLIGHT_NS).map_or(now_ns, |last| now_ns.max(last + 1))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_grow_within_a_flight_and_begin_anew_with_the_next() {
        assert_eq!(next_number(None, 3_000), 3_000);
        assert_eq!(next_number(Some(3_000), 3_000), 3_001);
        assert_eq!(next_number(Some(3_001), 2_000_000_000), 2_000_000_000);
        assert_eq!(next_number(Some(900_000_000_000), 5_000_000_000), 5_000_000_000);
    }
}
