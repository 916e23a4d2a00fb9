//! The stereo-ingest process: stereo frames in, disparity out.

use crate::{Config, Matcher, PairCheck, PairFault};
use ipc_types::time::FlightTime;
use ipc_types::topics::{Disparity, StereoFrames};
use ipc_types::{ProcessId, StereoRig};
use runtime::{Connect, Message, Ports, Process, Report};

/// Connects a [`Matcher`] to its topics.
#[derive(Debug)]
pub struct StereoProcess {
    matcher: Matcher,
    check: PairCheck,
    rig: StereoRig,
    report: Report,
}

impl StereoProcess {
    /// For a rig's pairs.
    pub fn new(rig: StereoRig, config: Config) -> Self {
        let check = PairCheck::new(rig.width_px as usize, rig.height_px as usize, config.max_disparity_px as usize);
        Self { matcher: Matcher::new(&rig, config), check, rig, report: Report::waiting("waiting for stereo frames") }
    }
}

impl Process for StereoProcess {
    const ID: ProcessId = ProcessId::StereoIngest;

    fn connect(&self, connect: &mut impl Connect) {
        connect.reads::<StereoFrames>();
        connect.writes::<Disparity>();
    }

    fn step<P: Ports>(&mut self, ports: &mut P) -> Report {
        let Some(frame) = ports.latest::<StereoFrames>() else {
            return self.report.idle();
        };
        let (header, pixels) = (*frame.header(), self.rig.pixels());
        let sized = (header.width_px, header.height_px) == (self.rig.width_px, self.rig.height_px);
        if !sized || frame.elements().len() != 2 * pixels {
            return self.report.refuse("stereo frame is not of the rig's size");
        }
        let (left, right) = frame.elements().split_at(pixels);
        let fault = self.check.step(left, right);
        let blocked = fault.is_some_and(PairFault::forbids_matching);
        let matcher = &mut self.matcher;
        let valid = FlightTime::from_nanos(header.stamp.valid_ns);
        ports.publish::<Disparity>(valid, pixels, |out, disparity| {
            (out.width_px, out.height_px) = (header.width_px, header.height_px);
            let found = if blocked { None } else { matcher.step(left, right, disparity).ok() };
            match found {
                Some(found) => (out.valid, out.textureless) = (found.valid as u32, found.textureless as u32),
                // Such a pair would be matched wrong: nothing is known instead. (Sizes were checked above.)
                None => disparity.fill(ipc_types::disparity::NO_MATCH),
            }
        });
        match fault {
            Some(fault) => self.report.degraded(fault.note()),
            None => self.report.worked(),
        }
    }
}
