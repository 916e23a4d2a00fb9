//! What operators ask for: who may, whether it is possible, and what follows.
//!
//! Pure: a command and the time in, a verdict out. Whoever delivers commands has made sure that they come from somebody who
//! may command at all. What is checked here: that a command is understood, not expired, not one that was followed already,
//! from the one who commands, and within what the vehicle and its fence allow. Anybody may make it hover.
//!
//! A command expires in the vehicle's own flight time, which operators are told with every state: no clock has to agree with
//! another, and what a slow link delivers late is not followed.

use crate::mission_config::MissionConfig;
use ipc_types::bounds::Bounds;
use ipc_types::limits::Fence;
use ipc_types::messages::{Command, Order, VehicleState, Waypoint};
use ipc_types::{FlightTime, Point, World};
use serde::{Deserialize, Serialize};

/// What happens when the operator who commands, and said that he is there, is not heard any more.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LinkLoss {
    /// The mission goes on.
    Continue,
    /// The vehicle hovers.
    Hover,
    /// It flies back along the path flown.
    Return,
}

/// Operators and their link.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LinkConfig {
    /// The one who commands is lost after so much silence, s; another may command then.
    pub lost_s: f64,
    /// What follows.
    pub then: LinkLoss,
}

impl LinkConfig {
    /// Reports values out of range.
    pub fn check(&self, bounds: &mut Bounds) {
        bounds.range("lost_s", self.lost_s, 2.5..=600.0);
    }
}

/// What follows from a command.
#[derive(Clone, Debug, PartialEq)]
pub enum Directive {
    /// Nothing else.
    Nothing,
    /// Fly by these places and hover at the last, at most this fast where that is said.
    Route(Vec<[f64; 3]>, Option<f64>),
    /// Another highest speed, m/s.
    Speed(f64),
    /// Hover.
    Hover,
    /// Go on.
    Resume,
    /// Land below this place.
    Land([f64; 3]),
}

/// What becomes of a command.
#[derive(Clone, Debug, PartialEq)]
pub struct Verdict {
    /// What follows from it, or why nothing does.
    pub directive: Result<Directive, String>,
    /// Whether the answer is one given before: nothing follows again.
    pub is_repeated: bool,
}

/// The last that was heard of an operator.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
struct Operator {
    name: String,
    number: u64,
    /// Why that was refused, if it was.
    refused: Option<String>,
    /// He has said that he is there, and is missed when he is silent. Who asks once and goes is not.
    stays: bool,
    heard_ns: i64,
}

/// Who commands, and what was asked for.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Orders {
    operators: Vec<Operator>,
    commander: Option<String>,
    is_link_lost: bool,
    /// Places flown by, for the way back.
    flown: Vec<[f64; 3]>,
    /// Distance between them, m; grows when they become many.
    apart_m: f64,
}

/// Operators that are remembered.
const MOST_OPERATORS: usize = 16;
const SLOWEST_MPS: f64 = 0.2;
/// Between remembered places flown by, m.
const APART_M: f64 = 2.0;

impl Orders {
    /// Who commands.
    pub fn commander(&self) -> Option<&str> {
        self.commander.as_deref()
    }

    /// Remembers where the vehicle flew by, without the loops: where it has come back to a place, what it flew in between is no
    /// part of the way back.
    pub fn note_place(&mut self, place: Point<World>) {
        self.apart_m = self.apart_m.max(APART_M);
        if !place.is_finite() {
            return;
        }
        let is_near = |flown: &[f64; 3]| Point::from_array(*flown).distance(place) < self.apart_m;
        if let Some(earliest) = self.flown.iter().position(is_near) {
            self.flown.truncate(earliest + 1);
            return;
        }
        if self.flown.len() == Command::MOST_PLACES - 1 {
            // Every second of them, twice as far apart from now on; the first stays.
            let mut index = 0;
            self.flown.retain(|_| {
                index += 1;
                index % 2 == 1
            });
            self.apart_m *= 2.0;
        }
        self.flown.push(place.to_array());
    }

    /// The way back: no lower than it is flown at, and inside the fence, which where it took off may not be.
    fn way_back(&self, mission: &MissionConfig) -> Vec<[f64; 3]> {
        let inside = |place: &[f64; 3]| {
            let [x, y, z] = nearest_inside(*place, &mission.fence);
            [x, y, z.max(mission.cruise_height_m)]
        };
        self.flown.iter().rev().map(inside).collect()
    }

    /// Judges a command. `mission` is as configured: no order exceeds its speed or its fence.
    pub fn judge(
        &mut self,
        now: FlightTime,
        command: &Command,
        places: &[Waypoint],
        state: Option<&VehicleState>,
        mission: &MissionConfig,
        link: &LinkConfig,
    ) -> Verdict {
        let name = command.operator.to_string_lossy();
        let refuse = |reason: String| Verdict { directive: Err(reason), is_repeated: false };
        if name.is_empty() {
            return refuse("it does not say who asks".to_owned());
        }
        let Some(order) = Order::from_wire(command.order) else {
            return refuse(format!("no order has the number {}", command.order));
        };
        let known = self.operators.iter().find(|operator| operator.name == name);
        if let Some(known) = known.filter(|known| known.number == command.number && order != Order::Present) {
            let directive = known.refused.clone().map_or(Ok(Directive::Nothing), Err);
            return Verdict { directive, is_repeated: true };
        }
        let expires_s = FlightTime::from_nanos(command.expires_ns).seconds_since(now);
        if expires_s <= 0.0 {
            return refuse(format!("expired {:.1} s ago", -expires_s));
        }
        if expires_s > Command::LONGEST_S {
            return refuse(format!("expires in {expires_s:.0} s, allowed are {}", Command::LONGEST_S));
        }
        if order == Order::Present {
            let operator = known.cloned().unwrap_or(Operator { name, ..Operator::default() });
            return match self.hear(Operator { stays: true, heard_ns: now.as_nanos(), ..operator }) {
                true => Verdict { directive: Ok(Directive::Nothing), is_repeated: false },
                false => refuse("there are too many operators".to_owned()),
            };
        }
        // To stop is never too often.
        if let Some(known) = known.filter(|known| command.number < known.number && order != Order::Hover) {
            return refuse(format!("number {} after {}: out of order", command.number, known.number));
        }
        let (stays, before) = known.map_or((false, 0), |known| (known.stays, known.number));
        let directive =
            self.who_may(now, &name, order, link).and_then(|()| self.directive(order, command, places, state, mission));
        let refused = directive.as_ref().err().cloned();
        let (number, heard_ns) = (command.number.max(before), now.as_nanos());
        if !self.hear(Operator { name: name.clone(), number, refused, stays, heard_ns }) {
            // Whose number is not remembered could be followed twice.
            return refuse("there are too many operators".to_owned());
        }
        if directive.is_ok() && order != Order::Hover {
            self.commander = Some(name);
        }
        Verdict { directive, is_repeated: false }
    }

    /// What follows from an order of somebody who may give it.
    fn directive(
        &self,
        order: Order,
        command: &Command,
        places: &[Waypoint],
        state: Option<&VehicleState>,
        mission: &MissionConfig,
    ) -> Result<Directive, String> {
        let moves = matches!(order, Order::Route | Order::Land | Order::Return | Order::Resume);
        if moves && state.is_some_and(|state| state.piloted != 0) {
            return Err("a pilot flies it".to_owned());
        }
        match order {
            Order::Present | Order::Take | Order::ClearMap => Ok(Directive::Nothing),
            Order::Hover => Ok(Directive::Hover),
            Order::Resume => Ok(Directive::Resume),
            Order::Speed => {
                speed(command, mission)?.map(Directive::Speed).ok_or_else(|| "it does not say how fast".to_owned())
            }
            Order::Route => route(command, places, mission),
            Order::Land => land(state, mission),
            Order::Return if self.flown.is_empty() => Err("nothing was flown yet".to_owned()),
            Order::Return => Ok(Directive::Route(self.way_back(mission), None)),
        }
    }

    /// Whether one may ask for that: nobody else commands, or is not heard any more.
    fn who_may(&self, now: FlightTime, name: &str, order: Order, link: &LinkConfig) -> Result<(), String> {
        let other = self.commander.as_deref().filter(|commander| *commander != name);
        match other.filter(|other| self.silent_s(now, other) < link.lost_s) {
            Some(other) if order != Order::Hover => Err(format!("{other} commands")),
            _ => Ok(()),
        }
    }

    fn silent_s(&self, now: FlightTime, name: &str) -> f64 {
        let operator = self.operators.iter().find(|operator| operator.name == name);
        operator.map_or(f64::INFINITY, |operator| now.seconds_since(FlightTime::from_nanos(operator.heard_ns)))
    }

    /// Remembers somebody; whether there was room. Of whom a command may still be valid is not forgotten.
    fn hear(&mut self, heard: Operator) -> bool {
        self.operators.retain(|operator| operator.name != heard.name);
        if self.operators.len() >= MOST_OPERATORS {
            let now_ns = heard.heard_ns;
            let commander = self.commander.as_ref();
            let is_over = |operator: &&Operator| {
                let silent_s = (now_ns - operator.heard_ns) as f64 * 1e-9;
                silent_s > Command::LONGEST_S && Some(&operator.name) != commander
            };
            let silent = self.operators.iter().filter(is_over).min_by_key(|operator| operator.heard_ns);
            let Some(silent) = silent.map(|operator| operator.name.clone()) else { return false };
            self.operators.retain(|operator| operator.name != silent);
        }
        self.operators.push(heard);
        true
    }

    /// What follows from the link's loss, once; and once it is back, nothing: who commands decides.
    pub fn look(&mut self, now: FlightTime, link: &LinkConfig, mission: &MissionConfig) -> Option<Directive> {
        let commander = self.commander.as_deref()?;
        let stays = self.operators.iter().any(|operator| operator.name == commander && operator.stays);
        let was_lost = self.is_link_lost;
        self.is_link_lost = stays && self.silent_s(now, commander) >= link.lost_s;
        if was_lost || !self.is_link_lost {
            return None;
        }
        match link.then {
            LinkLoss::Continue => None,
            LinkLoss::Return if !self.flown.is_empty() => Some(Directive::Route(self.way_back(mission), None)),
            LinkLoss::Hover | LinkLoss::Return => Some(Directive::Hover),
        }
    }

    /// Whether the one who commands is not heard any more.
    pub fn is_link_lost(&self) -> bool {
        self.is_link_lost
    }
}

/// The speed that a command asks for, if it asks for one.
fn speed(command: &Command, mission: &MissionConfig) -> Result<Option<f64>, String> {
    let (asked, most) = (command.speed_mps, mission.cruise_speed_mps);
    match asked {
        0.0 => Ok(None),
        _ if (SLOWEST_MPS..=most).contains(&asked) => Ok(Some(asked)),
        _ => Err(format!("speed is {asked} m/s, allowed is {SLOWEST_MPS} to {most}")),
    }
}

fn route(command: &Command, places: &[Waypoint], mission: &MissionConfig) -> Result<Directive, String> {
    if !(1..=Command::MOST_PLACES).contains(&places.len()) {
        return Err(format!("{} places, allowed are 1 to {}", places.len(), Command::MOST_PLACES));
    }
    for (index, place) in places.iter().enumerate() {
        let [x, y, z] = place.position_m;
        if !mission.fence.contains(Point::from_array(place.position_m)) {
            return Err(format!("place {index} ({x:.1}, {y:.1}, {z:.1}) is outside the fence"));
        }
    }
    let places = places.iter().map(|place| place.position_m).collect();
    Ok(Directive::Route(places, speed(command, mission)?))
}

fn land(state: Option<&VehicleState>, mission: &MissionConfig) -> Result<Directive, String> {
    let at = state.map(VehicleState::position).filter(|at| at.is_finite()).ok_or("where it is is not known")?;
    Ok(Directive::Land(nearest_inside(at.to_array(), &mission.fence)))
}

/// The place inside the fence that is nearest.
fn nearest_inside(place: [f64; 3], fence: &Fence) -> [f64; 3] {
    std::array::from_fn(|axis| place[axis].clamp(fence.least_m[axis], fence.most_m[axis]))
}
