//! The one table of topics: name, message, rate, history, depth, producers, consumers.
//!
//! Both drivers, the recorder and the supervisor read it; there is no other place where topics are named.

use crate::messages::*;
use crate::process::ProcessId::{self, *};
use crate::rig::StereoRig;
use crate::wire::{Header, Kind, Wire, schema_hash};

/// A consumer of a topic.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Consumer {
    /// Who reads.
    pub process: ProcessId,
    /// Whether a new message wakes the consumer.
    pub wakes: bool,
}

const fn wakes(process: ProcessId) -> Consumer {
    Consumer { process, wakes: true }
}
const fn reads(process: ProcessId) -> Consumer {
    Consumer { process, wakes: false }
}

/// A row of the table.
#[derive(Clone, Copy, Debug)]
pub struct TopicInfo {
    /// Name on the bus, in logs and in reports.
    pub name: &'static str,
    /// What a header is made of.
    pub header: Kind,
    /// What an element is made of.
    pub element: Kind,
    /// Hash of both layouts; a service, or a log, with another hash is refused.
    pub schema_hash: fn() -> u64,
    /// Nominal rate, Hz.
    pub rate_hz: f64,
    /// Messages a late subscriber still gets.
    pub history: usize,
    /// Messages a flying consumer's buffer holds; the recorder's holds [`RECORDER_DEPTH`].
    pub depth: usize,
    /// Whether elements are pixels: large, and logged on request only.
    pub is_image: bool,
    /// Who may write.
    pub producers: &'static [ProcessId],
    /// Who reads.
    pub consumers: &'static [Consumer],
}

/// A topic known at compile time.
pub trait Topic: 'static {
    /// Fixed-size part.
    type Header: Header;
    /// What the slice is made of.
    type Element: Wire;
    /// The row of the table.
    const INFO: TopicInfo;

    /// Largest number of elements of a message.
    fn max_elements(rig: &StereoRig) -> usize;
}

/// Depth of the recorder's buffers: more than a second of the fastest topic, so that a busy disk loses nothing.
pub const RECORDER_DEPTH: usize = 128;
/// Depth of the recorder's buffers for images.
pub const RECORDER_IMAGE_DEPTH: usize = 8;

/// Calls a macro with every topic type, e.g. to open them all.
#[macro_export]
macro_rules! for_each_topic {
    ($callback:ident) => {
        $callback!(
            Clock,
            Truth,
            State,
            StereoFrames,
            DepthFrames,
            Disparity,
            Expanded,
            Keyframes,
            Path,
            Goals,
            Plan,
            Setpoints,
            HealthReports,
            Rungs,
            Commands,
            Answers,
            MissionStates
        );
    };
}

macro_rules! topics {
    ($($(#[$doc:meta])* $topic:ident: $name:literal, $header:ty, [$element:ty; $max:expr], $rate:literal Hz,
        history $history:literal, depth $depth:literal, image $image:literal,
        from $producers:expr, to $consumers:expr;)*) => {
        $(
            $(#[$doc])*
            #[derive(Clone, Copy, Debug)]
            pub struct $topic;
            impl Topic for $topic {
                type Header = $header;
                type Element = $element;
                const INFO: TopicInfo = TopicInfo {
                    name: $name,
                    header: <$header>::KIND,
                    element: <$element>::KIND,
                    schema_hash: schema_hash::<$header, $element>,
                    rate_hz: $rate,
                    history: $history,
                    depth: $depth,
                    is_image: $image,
                    producers: &$producers,
                    consumers: &$consumers,
                };
                fn max_elements(rig: &StereoRig) -> usize {
                    let max: fn(&StereoRig) -> usize = $max;
                    max(rig)
                }
            }
        )*
        /// The table.
        pub const TOPICS: &[TopicInfo] = &[$($topic::INFO),*];
    };
}

const NONE: fn(&StereoRig) -> usize = |_| 0;

topics! {
    /// Flight time against host time.
    Clock: "flight_clock", FlightClock, [u8; NONE], 100.0 Hz, history 1, depth 4, image false,
        from [Simulator, Player], to [reads(Camera), reads(StereoIngest), reads(Expansion), reads(Memory), reads(Planner),
            reads(Controller), reads(Recorder), reads(Supervisor)];
    /// Truth, for reports alone.
    Truth: "world_truth", WorldTruth, [u8; NONE], 100.0 Hz, history 1, depth 64, image false,
        from [Simulator], to [reads(Recorder), reads(Supervisor)];
    /// State estimate.
    State: "vehicle_state", VehicleState, [u8; NONE], 100.0 Hz, history 1, depth 16, image false,
        from [Simulator, Player], to [wakes(Memory), reads(Planner), wakes(Controller), reads(Recorder), reads(Supervisor), reads(Bridge)];
    /// Stereo pairs.
    StereoFrames: "stereo_frame", StereoFrame, [u8; |rig| 2 * rig.pixels()], 12.5 Hz, history 1, depth 1, image true,
        from [Simulator, Player, Camera], to [wakes(StereoIngest), reads(Recorder), reads(Supervisor), reads(Bridge)];
    /// Depth images, and disparity images that the sensor matched itself.
    DepthFrames: "depth_frame", DepthFrame, [u16; |rig| rig.pixels()], 12.5 Hz, history 1, depth 1, image true,
        from [Simulator, Player, Camera], to [wakes(StereoIngest), reads(Recorder), reads(Supervisor)];
    /// Disparity images.
    Disparity: "disparity_image", DisparityImage, [u16; |rig| rig.pixels()], 12.5 Hz, history 1, depth 1, image true,
        from [StereoIngest, Player], to [wakes(Expansion), reads(Recorder), reads(Supervisor), reads(Bridge)];
    /// Configuration-space images.
    Expanded: "expanded_image", ExpandedImage, [u16; |rig| ExpandedLayout::largest(rig).elements()], 12.5 Hz, history 1, depth 1, image true,
        from [Expansion], to [wakes(Memory), reads(Recorder), reads(Supervisor)];
    /// The disparity graph.
    Keyframes: "keyframe_set", KeyframeSet, [Keyframe; |_| 64], 12.5 Hz, history 1, depth 1, image false,
        from [Memory], to [wakes(Planner), reads(Recorder), reads(Supervisor), reads(Bridge)];
    /// The path flown.
    Path: "flown_path", FlownPath, [PathPoint; |_| 512], 12.5 Hz, history 1, depth 1, image false,
        from [Memory], to [reads(Planner), reads(Recorder), reads(Bridge)];
    /// Goals.
    Goals: "goal", Goal, [u8; NONE], 2.0 Hz, history 1, depth 1, image false,
        from [Supervisor, Player], to [reads(Planner), reads(Recorder), reads(Bridge)];
    /// Trajectories.
    Plan: "trajectory", Trajectory, [TrajectoryPoint; |_| 256], 12.5 Hz, history 1, depth 1, image false,
        from [Planner], to [wakes(Controller), reads(Recorder), reads(Supervisor), reads(Bridge)];
    /// Setpoints.
    Setpoints: "setpoint", Setpoint, [u8; NONE], 50.0 Hz, history 1, depth 1, image false,
        from [Controller], to [reads(Simulator), reads(Recorder), reads(Supervisor), reads(Bridge)];
    /// Heartbeats.
    HealthReports: "health", Health, [u8; NONE], 10.0 Hz, history 1, depth 32, image false,
        from [Simulator, Player, Camera, StereoIngest, Expansion, Memory, Planner, Controller, Recorder, Bridge],
        to [reads(Player), reads(Recorder), reads(Supervisor), reads(Bridge)];
    /// Rungs of the degradation ladder.
    Rungs: "degradation", Degradation, [u8; NONE], 2.0 Hz, history 1, depth 4, image false,
        from [Supervisor], to [reads(Recorder), reads(Bridge)];
    /// What operators ask for.
    Commands: "command", Command, [Waypoint; |_| Command::MOST_PLACES], 2.0 Hz, history 1, depth 32, image false,
        from [Bridge], to [reads(Supervisor), reads(Recorder)];
    /// What became of it.
    Answers: "answer", Answer, [u8; NONE], 2.0 Hz, history 1, depth 32, image false,
        from [Supervisor, Player], to [reads(Memory), reads(Recorder), reads(Bridge)];
    /// How far the mission is.
    MissionStates: "mission", MissionState, [Waypoint; |_| Command::MOST_PLACES], 2.0 Hz, history 1, depth 1, image false,
        from [Supervisor], to [reads(Recorder), reads(Bridge)];
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::HashSet;

    #[test]
    fn names_are_unique_and_everything_is_recorded() {
        let names: HashSet<_> = TOPICS.iter().map(|topic| topic.name).collect();
        assert_eq!(names.len(), TOPICS.len());
        for topic in TOPICS {
            assert!(topic.consumers.iter().any(|consumer| consumer.process == Recorder), "{}", topic.name);
            assert!(!topic.producers.is_empty() && topic.depth >= 1 && topic.history <= 1);
        }
    }

    #[test]
    fn nothing_that_flies_reads_the_truth() {
        for consumer in Truth::INFO.consumers {
            assert!(matches!(consumer.process, Recorder | Supervisor), "{}", consumer.process);
        }
    }

    #[test]
    fn the_macro_lists_every_topic() {
        let mut listed = 0;
        macro_rules! count {
            ($($topic:ident),*) => { $(let _ = $topic; listed += 1;)* };
        }
        crate::for_each_topic!(count);
        assert_eq!(listed, TOPICS.len());
    }
}
