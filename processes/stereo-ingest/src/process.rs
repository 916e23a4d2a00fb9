//! The stereo-ingest process: what the sensor delivers in, disparity out.

use crate::calibration::Rectifier;
use crate::source::{Source, ValueTable};
use crate::{Config, Matcher, PairCheck, PairFault};
use ipc_types::disparity::{MASKED, NO_MATCH};
use ipc_types::messages::DisparityImage;
use ipc_types::time::FlightTime;
use ipc_types::topics::{DepthFrames, Disparity, StereoFrames};
use ipc_types::{ProcessId, StereoRig};
use runtime::{Connect, Message, Ports, Process, Report};

/// Connects a front end to its topics: a [`Matcher`] for stereo pairs, a [`ValueTable`] for depth and ready-made disparity.
#[derive(Debug)]
pub struct StereoProcess {
    front_end: FrontEnd,
    rig: StereoRig,
    report: Report,
}

#[derive(Debug)]
enum FrontEnd {
    Pairs(Box<PairFrontEnd>),
    Values(ValueTable),
}

#[derive(Debug)]
struct PairFrontEnd {
    matcher: Matcher,
    check: PairCheck,
    /// For raw frames, with room for the rectified pair.
    rectifier: Option<(Rectifier, Vec<u8>)>,
}

impl PairFrontEnd {
    /// Disparity of a pair (left image, then right image).
    fn step(&mut self, raw: &[u8], out: &mut DisparityImage, disparity: &mut [u16]) -> Option<PairFault> {
        let pixels = disparity.len();
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
        let forbidden = fault.is_some_and(PairFault::forbids_matching);
        let found = if forbidden { None } else { self.matcher.step(left, right, disparity).ok() };
        match found {
            Some(found) => (out.valid, out.textureless) = (found.valid as u32, found.textureless as u32),
            // Such a pair would be matched wrong: nothing is known instead.
            None => disparity.fill(NO_MATCH),
        }
        outside.iter().for_each(|&pixel| disparity[pixel as usize] = MASKED);
        fault
    }
}

impl StereoProcess {
    /// For a rig's sensor. Its pairs are rectified, or raw and `rectifier` makes them the rig's.
    pub fn new(rig: StereoRig, source: &Source, config: Config, rectifier: Option<Rectifier>) -> Self {
        let front_end = match ValueTable::new(&rig, source) {
            Some(table) => FrontEnd::Values(table),
            None => FrontEnd::Pairs(Box::new(PairFrontEnd {
                check: PairCheck::new(&rig, config.max_disparity_px),
                matcher: Matcher::new(&rig, config),
                rectifier: rectifier.map(|rectifier| (rectifier, vec![0; 2 * rig.pixels()])),
            })),
        };
        Self { front_end, rig, report: Report::waiting("waiting for frames") }
    }
}

/// Whether a frame has the rig's size, and so many elements for each of its pixels.
fn is_of_the_rig(rig: &StereoRig, size_px: (u32, u32), elements: usize, per_pixel: usize) -> bool {
    size_px == (rig.width_px, rig.height_px) && elements == per_pixel * rig.pixels()
}

fn match_pair(front_end: &mut PairFrontEnd, rig: &StereoRig, report: &mut Report, ports: &mut impl Ports) -> Report {
    let Some(frame) = ports.latest::<StereoFrames>() else {
        return report.idle();
    };
    let header = *frame.header();
    if !is_of_the_rig(rig, (header.width_px, header.height_px), frame.elements().len(), 2) {
        return report.refuse("stereo frame is not of the rig's size");
    }
    let mut fault = None;
    ports.publish::<Disparity>(FlightTime::from_nanos(header.stamp.valid_ns), rig.pixels(), |out, disparity| {
        (out.width_px, out.height_px) = (header.width_px, header.height_px);
        fault = front_end.step(frame.elements(), out, disparity);
    });
    match fault {
        Some(fault) => report.degraded(fault.note()),
        None => report.worked(),
    }
}

fn convert_values(table: &ValueTable, rig: &StereoRig, report: &mut Report, ports: &mut impl Ports) -> Report {
    let Some(frame) = ports.latest::<DepthFrames>() else {
        return report.idle();
    };
    let header = *frame.header();
    if !is_of_the_rig(rig, (header.width_px, header.height_px), frame.elements().len(), 1) {
        return report.refuse("depth frame is not of the rig's size");
    }
    let mut valid = 0;
    ports.publish::<Disparity>(FlightTime::from_nanos(header.stamp.valid_ns), rig.pixels(), |out, disparity| {
        (out.width_px, out.height_px) = (header.width_px, header.height_px);
        valid = table.convert(frame.elements(), disparity);
        out.valid = valid as u32;
    });
    match valid {
        0 => report.degraded("the depth sensor measures nothing"),
        _ => report.worked(),
    }
}

impl Process for StereoProcess {
    const ID: ProcessId = ProcessId::StereoIngest;

    fn connect(&self, connect: &mut impl Connect) {
        match self.front_end {
            FrontEnd::Pairs(_) => connect.reads::<StereoFrames>(),
            FrontEnd::Values(_) => connect.reads::<DepthFrames>(),
        }
        connect.writes::<Disparity>();
    }

    fn step<P: Ports>(&mut self, ports: &mut P) -> Report {
        match &mut self.front_end {
            FrontEnd::Pairs(front_end) => match_pair(front_end, &self.rig, &mut self.report, ports),
            FrontEnd::Values(table) => convert_values(table, &self.rig, &mut self.report, ports),
        }
    }
}
