//! Where the flight stands on the degradation ladder.

use crate::wire::{Stamp, Text, stamped, wire};

wire! {
    /// How far the flight is scaled down, and why.
    Degradation = "sparrowhawk/Degradation/1" {
        /// Origin.
        stamp: Stamp,
        /// Share of the cruise speed that may be flown, 0..1; 0 is to stay.
        speed_share: f64,
        /// [`Rung`].
        rung: u32,
        /// Always zero.
        reserved: u32,
        /// Why; empty on the first rung.
        reason: Text,
    }
}
stamped!(Degradation);

/// Rungs of the degradation ladder, from all to nothing.
#[derive(Clone, Copy, PartialEq, Eq, Debug, PartialOrd, Ord, Hash)]
#[repr(u32)]
pub enum Rung {
    /// Everything works.
    Full = 0,
    /// The map holds hardly more than the newest frame.
    SingleFrame = 1,
    /// As fast as what still works allows.
    Slower = 2,
    /// Brake and hover.
    Hover = 3,
    /// The flight control unit is left to do what it does without setpoints.
    HandBack = 4,
}

impl Rung {
    /// All of them, from the first.
    pub const ALL: [Self; 5] = [Self::Full, Self::SingleFrame, Self::Slower, Self::Hover, Self::HandBack];

    /// From the wire; an unknown number reads as [`Rung::Hover`].
    pub fn from_wire(number: u32) -> Self {
        Self::ALL.into_iter().find(|rung| *rung as u32 == number).unwrap_or(Self::Hover)
    }

    /// The rung of that name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|rung| rung.name() == name)
    }

    /// Name, as reports have it.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Full => "full",
            Self::SingleFrame => "single frame",
            Self::Slower => "slower",
            Self::Hover => "hover",
            Self::HandBack => "hand back",
        }
    }
}

impl std::fmt::Display for Rung {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.pad(self.name())
    }
}
