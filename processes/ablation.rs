//! Flying without a part, to see what the part is worth.

use crate::config::FlightConfig;
use ipc_types::messages::Layers;
use serde::{Deserialize, Serialize};

/// A part of the system that can be done without.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Part {
    /// Keyframes: the map is the newest frames alone, as many as must agree.
    Memory,
    /// The noise model: obstacles are inflated by the radius alone, λσ is nearly nothing.
    Noise,
    /// The lenient threshold for the plan being flown: γ_high = γ_low, and no hysteresis.
    Hysteresis,
    /// The gaze: the camera looks towards the goal, not where the vehicle flies, and not around.
    Gaze,
    /// The layers: four instead of two, or two instead of four.
    Layers,
    /// The camera's tilt: it looks 15 degrees down, as that of the thesis's large platform, and so under where it flies when it
    /// speeds up.
    Tilt,
}

/// Thinnest noise that is allowed, px.
const HARDLY_PX: f32 = 0.01;
/// What the newest frames span, s: so short that there are no more than must agree.
const HARDLY_S: f64 = 0.1;

/// How far down the thesis's cameras look, degrees.
const DOWN_DEG: f64 = 15.0;
/// What every camera sees, degrees above the flight path.
const LEAST_UP_DEG: f64 = -60.0;
/// More than a half height is rounded by, m.
const ROUNDING_M: f32 = 1e-6;

impl Part {
    /// As it is called on the command line and in tables.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Memory => "memory",
            Self::Noise => "noise",
            Self::Hysteresis => "hysteresis",
            Self::Gaze => "gaze",
            Self::Layers => "layers",
            Self::Tilt => "tilt",
        }
    }

    /// Takes it out of a configuration.
    pub(crate) fn remove(self, config: &mut FlightConfig) {
        let vehicle = &mut config.vehicle;
        match self {
            Self::Memory => {
                // One of two nodes is the newest frame.
                vehicle.memory.graph.keyframes = 2;
                vehicle.memory.forget_s = HARDLY_S;
            }
            Self::Noise => (vehicle.noise.sigma_px, vehicle.noise.sigma_m) = (HARDLY_PX, 0.0),
            Self::Hysteresis => {
                vehicle.planner.gamma_high = vehicle.planner.gamma_low;
                vehicle.planner.hysteresis_m = 0.0;
            }
            Self::Gaze => vehicle.planner.gaze_follows_flight = false,
            Self::Tilt => {
                vehicle.mount.pitch_up_deg = -DOWN_DEG;
                vehicle.planner.least_view_up_deg = LEAST_UP_DEG;
                let half_height_m = vehicle.tilted_half_height_m() as f32 + ROUNDING_M;
                vehicle.expansion.body_half_height_m = vehicle.expansion.body_half_height_m.max(half_height_m);
            }
            Self::Layers => {
                vehicle.expansion.layers = match vehicle.expansion.layers {
                    Layers::Two => Layers::Four,
                    Layers::Four => Layers::Two,
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::ValueEnum;

    #[test]
    fn what_is_left_without_a_part_can_fly_and_is_another() {
        for flight in ["default", "fast", "thesis_large", "thesis_small"] {
            let whole = FlightConfig::load(Some(flight.as_ref()), None).expect("it is shipped");
            for part in Part::value_variants() {
                let mut left = whole.clone();
                part.remove(&mut left);
                assert_ne!(left.vehicle, whole.vehicle, "{flight} without {}", part.name());
                left.check().unwrap_or_else(|problem| panic!("{flight} without {}: {problem}", part.name()));
            }
        }
    }
}
