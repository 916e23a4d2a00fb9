//! Troubles of simulated flights, from the command line.

use crate::numbers::parse_numbers;
use clap::Args;
use simulator::Trouble;

/// What to trouble a simulated flight with.
#[derive(Clone, Debug, Args)]
pub(crate) struct TroubleArguments {
    /// Mean wind, towards east and north, m/s.
    #[arg(long, value_name = "X,Y", value_parser = parse_numbers::<2>, allow_hyphen_values = true, help_heading = "Trouble")]
    wind: Option<[f64; 2]>,
    /// Gusts: standard deviation along each axis, m/s.
    #[arg(long, value_name = "M/S", default_value_t = 0.0, help_heading = "Trouble")]
    gusts: f64,
    /// Share of the camera's frames that are lost, 0 to 1.
    #[arg(long, value_name = "SHARE", default_value_t = 0.0, help_heading = "Trouble")]
    lost_frames: f64,
    /// No frames from this flight time on, for so long, s.
    #[arg(long, value_name = "FROM,FOR", value_parser = parse_numbers::<2>, help_heading = "Trouble")]
    blind: Option<[f64; 2]>,
    /// The position estimate jumps at this flight time, s, by so much to the north, m.
    #[arg(long, value_name = "AT,BY", value_parser = parse_numbers::<2>, allow_hyphen_values = true, help_heading = "Trouble")]
    jump: Option<[f64; 2]>,
    /// The state estimate is late by this much more, ms.
    #[arg(long, value_name = "MS", default_value_t = 0.0, help_heading = "Trouble")]
    lag: f64,
}

impl TroubleArguments {
    /// As the simulator is told; its values are checked with the configuration.
    pub(crate) fn trouble(&self) -> Trouble {
        Trouble {
            wind_mps: self.wind.unwrap_or_default(),
            gust_mps: self.gusts,
            lost_frames: self.lost_frames,
            blind_s: self.blind.unwrap_or_default(),
            jump: self.jump.unwrap_or_default(),
            lag_ms: self.lag,
        }
    }
}
