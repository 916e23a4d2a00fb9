//! The stereo-ingest process: stereo frames in, disparity out.

use crate::{Config, Matcher};
use ipc_types::time::FlightTime;
use ipc_types::topics::{Disparity, StereoFrames};
use ipc_types::{ProcessId, StereoRig};
use runtime::{Connect, Message, Ports, Process, Report};

/// Connects a [`Matcher`] to its topics.
#[derive(Debug)]
pub struct StereoProcess {
    matcher: Matcher,
    rig: StereoRig,
    report: Report,
}

impl StereoProcess {
    /// For a rig's pairs.
    pub fn new(rig: StereoRig, config: Config) -> Self {
        Self { matcher: Matcher::new(&rig, config), rig, report: Report::waiting("waiting for stereo frames") }
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
        let matcher = &mut self.matcher;
        let valid = FlightTime::from_nanos(header.stamp.valid_ns);
        ports.publish::<Disparity>(valid, pixels, |out, disparity| {
            (out.width_px, out.height_px) = (header.width_px, header.height_px);
            // Sizes were checked above, so this cannot fail; were it to, nothing would be matched.
            match matcher.step(left, right, disparity) {
                Ok(found) => (out.valid, out.textureless) = (found.valid as u32, found.textureless as u32),
                Err(_) => disparity.fill(ipc_types::disparity::NO_MATCH),
            }
        });
        self.report.worked()
    }
}
