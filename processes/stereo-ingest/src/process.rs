//! The stereo-ingest process: stereo frames in, raw or rectified; disparity out.

use crate::calibration::Rectifier;
use crate::{Config, Matcher, PairCheck, PairFault};
use ipc_types::disparity::{MASKED, NO_MATCH};
use ipc_types::time::FlightTime;
use ipc_types::topics::{Disparity, StereoFrames};
use ipc_types::{ProcessId, StereoRig};
use runtime::{Connect, Message, Ports, Process, Report};

/// Connects a [`Matcher`] to its topics.
#[derive(Debug)]
pub struct StereoProcess {
    matcher: Matcher,
    check: PairCheck,
    /// For raw frames, with room for the rectified pair.
    rectifier: Option<(Rectifier, Vec<u8>)>,
    rig: StereoRig,
    report: Report,
}

impl StereoProcess {
    /// For a rig's pairs: rectified ones, or raw ones that `rectifier` makes the rig's.
    pub fn new(rig: StereoRig, config: Config, rectifier: Option<Rectifier>) -> Self {
        let check = PairCheck::new(&rig, config.max_disparity_px);
        let rectifier = rectifier.map(|rectifier| (rectifier, vec![0; 2 * rig.pixels()]));
        Self {
            matcher: Matcher::new(&rig, config),
            check,
            rectifier,
            rig,
            report: Report::waiting("waiting for stereo frames"),
        }
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
        let raw = frame.elements();
        if let Some((rectifier, rectified)) = &mut self.rectifier {
            let sides = raw.chunks(pixels).zip(rectified.chunks_mut(pixels));
            sides.enumerate().for_each(|(camera, (raw, out))| rectifier.remap(camera, raw, out));
        }
        let (pair, outside) = match &self.rectifier {
            None => (raw, &[][..]),
            Some((rectifier, rectified)) => (&rectified[..], rectifier.outside()),
        };
        let (left, right) = pair.split_at(pixels);
        let fault = self.check.step(left, right);
        let matcher = &mut self.matcher;
        let valid = FlightTime::from_nanos(header.stamp.valid_ns);
        ports.publish::<Disparity>(valid, pixels, |out, disparity| {
            (out.width_px, out.height_px) = (header.width_px, header.height_px);
            let forbidden = fault.is_some_and(PairFault::forbids_matching);
            let found = if forbidden { None } else { matcher.step(left, right, disparity).ok() };
            match found {
                Some(found) => (out.valid, out.textureless) = (found.valid as u32, found.textureless as u32),
                // Such a pair would be matched wrong: nothing is known instead. (Sizes were checked above.)
                None => disparity.fill(NO_MATCH),
            }
            outside.iter().for_each(|&pixel| disparity[pixel as usize] = MASKED);
        });
        match fault {
            Some(fault) => self.report.degraded(fault.note()),
            None => self.report.worked(),
        }
    }
}
