//! What an operator asks of the vehicle, and what becomes of it.

use crate::wire::{Stamp, Text, stamped, wire};

wire! {
    /// Asked for by an operator. Elements: places to fly by, in order, for [`Order::Route`]; none otherwise.
    Command = "sparrowhawk/Command/1" {
        /// Origin.
        stamp: Stamp,
        /// Counts this operator's commands; one that is not larger than the last is not followed again.
        number: u64,
        /// Flight time after which it is not to be followed any more, ns.
        expires_ns: i64,
        /// Highest speed on the way, m/s, for [`Order::Route`] and [`Order::Speed`]; 0: as before.
        speed_mps: f64,
        /// [`Order`].
        order: u32,
        /// Always zero.
        reserved: u32,
        /// Who asks: no two at a time have the same name.
        operator: Text,
    }
}
stamped!(Command);

impl Command {
    /// Places of a route, at most.
    pub const MOST_PLACES: usize = 64;
    /// No command may be valid for longer, s.
    pub const LONGEST_S: f64 = 60.0;
}

wire! {
    /// A place to fly to.
    Waypoint = "sparrowhawk/Waypoint/1" {
        /// World position, m.
        position_m: [f64; 3],
    }
}

wire! {
    /// What became of a command.
    Answer = "sparrowhawk/Answer/1" {
        /// Origin.
        stamp: Stamp,
        /// Of the command.
        number: u64,
        /// 1 if it is followed.
        accepted: u32,
        /// Of the command.
        order: u32,
        /// Of the command.
        operator: Text,
        /// Why not, or what follows.
        reason: Text,
    }
}
stamped!(Answer);

/// What an operator may ask for.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Hash)]
#[repr(u32)]
pub enum Order {
    /// The operator is there. Not answered.
    Present = 0,
    /// To command from now on, if nobody else does.
    Take = 1,
    /// Fly by these places, and hover at the last.
    Route = 2,
    /// Another highest speed.
    Speed = 3,
    /// Stop, and hover.
    Hover = 4,
    /// Go on with what was under way before it was told to hover.
    Resume = 5,
    /// Land below where the vehicle is: the operator declares that place free.
    Land = 6,
    /// Back along the path flown, and hover where it began.
    Return = 7,
    /// Forget what was seen.
    ClearMap = 8,
}

impl Order {
    /// All of them.
    pub const ALL: [Self; 9] = [
        Self::Present,
        Self::Take,
        Self::Route,
        Self::Speed,
        Self::Hover,
        Self::Resume,
        Self::Land,
        Self::Return,
        Self::ClearMap,
    ];

    /// From the wire; `None` for an unknown number: what is not understood is not followed.
    pub fn from_wire(number: u32) -> Option<Self> {
        Self::ALL.into_iter().find(|order| *order as u32 == number)
    }

    /// From its name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|order| order.name() == name)
    }

    /// Its name.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Present => "present",
            Self::Take => "take",
            Self::Route => "route",
            Self::Speed => "speed",
            Self::Hover => "hover",
            Self::Resume => "resume",
            Self::Land => "land",
            Self::Return => "return",
            Self::ClearMap => "clear-map",
        }
    }
}

impl std::fmt::Display for Order {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.pad(self.name())
    }
}
