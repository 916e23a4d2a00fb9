//! What the graph of a recorded flight was fed with: states, goals, answers to commands, and images or disparity.
//!
//! Pixels are taken from the images that viewers show, which are lossless, and put together with the header that was
//! recorded before them. What cannot be put together is counted and left out.

use crate::file::LogError;
use crate::read::{Entry, Log, Reading, Record};
use encoding::View;
use foxglove::messages::RawImage;
use ipc_types::FlightTime;
use ipc_types::messages::{DepthFrame, DisparityImage, StereoFrame};
use ipc_types::topics::{Answers, DepthFrames, Disparity, Goals, State, StereoFrames, Topic};
use ipc_types::wire::Stamp;
use prost::Message;
use std::ops::RangeInclusive;

/// What of a recorded flight the graph is fed with.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Feed {
    /// What the cameras delivered, or the sensor that measured depth.
    Frames,
    /// Disparity, as stereo-ingest made it: that process is left out.
    Disparity,
}

/// A message that the graph was fed with.
#[derive(Clone, Debug, PartialEq)]
pub struct Input {
    /// Name of its topic.
    pub topic: &'static str,
    /// Its header, as in shared memory.
    pub header: Vec<u8>,
    /// Its elements, in native byte order: pixels, row by row; of a pair the left image's, then the right one's, a byte each; else
    /// two bytes each, in the sensor's unit or 1/64 px of disparity. None of what has no pixels.
    pub elements: Vec<u8>,
    /// Its stamp.
    pub stamp: Stamp,
}

impl Input {
    /// When it was published.
    pub fn published(&self) -> FlightTime {
        FlightTime::from_nanos(self.stamp.published_ns)
    }
}

/// All that the graph was fed with, in the order published.
#[derive(Clone, Debug, Default)]
pub struct Inputs {
    /// The messages.
    pub inputs: Vec<Input>,
    /// Images of which not all pixels were found.
    pub incomplete: u64,
    /// How the files were read.
    pub readings: Vec<Reading>,
}

/// Images whose pixels are being gathered.
#[derive(Default)]
struct Gathered {
    inputs: Vec<Input>,
    /// The last image's header; pixels follow it.
    pending: Option<Input>,
    incomplete: u64,
}

impl Inputs {
    /// Takes what was published in a range of flight time, s, from the files of a recording in their order.
    ///
    /// # Errors
    /// Another version wrote one of them.
    pub fn of(logs: &[Log], range_s: &RangeInclusive<f64>, feed: Feed) -> Result<Self, LogError> {
        let (mut gathered, mut readings) = (Gathered::default(), Vec::new());
        for log in logs {
            readings.push(gathered.read(log, range_s, feed)?);
            gathered.give_up();
        }
        let Gathered { mut inputs, incomplete, .. } = gathered;
        // Topics were written one after the other; at the same instant they stay so.
        inputs.sort_by_key(|input| input.stamp.published_ns);
        Ok(Self { inputs, incomplete, readings })
    }

    /// Images among them.
    pub fn images(&self) -> usize {
        self.inputs.iter().filter(|input| !input.elements.is_empty()).count()
    }
}

/// Topics that have no pixels.
const PLAIN: [&str; 3] = [State::INFO.name, Goals::INFO.name, Answers::INFO.name];

/// Whether a channel is one that the graph is fed from.
fn is_wanted(channel: &str, feed: Feed) -> bool {
    let images = match feed {
        Feed::Frames => [
            StereoFrames::INFO.name,
            DepthFrames::INFO.name,
            View::Left.topic(),
            View::Right.topic(),
            View::Depth.topic(),
        ]
        .contains(&channel),
        Feed::Disparity => [Disparity::INFO.name, View::Disparity.topic()].contains(&channel),
    };
    images || PLAIN.contains(&channel)
}

impl Gathered {
    fn read(&mut self, log: &Log, range_s: &RangeInclusive<f64>, feed: Feed) -> Result<Reading, LogError> {
        log.entries(
            |channel| is_wanted(channel, feed),
            |entry| match entry {
                Entry::Record(record) => self.take(record, range_s),
                Entry::View(view, data) => self.add_pixels(view, data),
            },
        )
    }

    fn take(&mut self, record: Record, range_s: &RangeInclusive<f64>) {
        let name = record.topic.name;
        let stamp = record.stamp();
        if !range_s.contains(&FlightTime::from_nanos(stamp.published_ns).as_secs_f64()) {
            return;
        }
        let input = Input { topic: name, header: record.header, elements: Vec::new(), stamp };
        if PLAIN.contains(&name) {
            self.inputs.push(input);
        } else {
            self.give_up();
            self.pending = Some(input);
        }
    }

    /// Pixels of the last image, if they are its.
    fn add_pixels(&mut self, view: View, data: &[u8]) {
        let Some(pending) = &mut self.pending else { return };
        let of_topic = match view {
            View::Left | View::Right => StereoFrames::INFO.name,
            View::Depth => DepthFrames::INFO.name,
            View::Disparity => Disparity::INFO.name,
            _ => return,
        };
        let Ok(image) = RawImage::decode(data) else { return };
        let exposure = image.timestamp.map(|time| i64::from(time.sec()) * 1_000_000_000 + i64::from(time.nsec()));
        if of_topic != pending.topic || exposure != Some(pending.stamp.valid_ns) {
            return;
        }
        pending.elements.extend_from_slice(&image.data);
        if pending.elements.len() == bytes_of_pixels(pending) {
            self.inputs.extend(self.pending.take());
        }
    }

    /// What has not got its pixels by now gets none.
    fn give_up(&mut self) {
        self.incomplete += u64::from(self.pending.take().is_some());
    }
}

/// Bytes of an image's pixels, as its header says.
fn bytes_of_pixels(image: &Input) -> usize {
    let of = |width_px: u32, height_px: u32| (width_px as usize).saturating_mul(height_px as usize).saturating_mul(2);
    // Two images of one byte a pixel, or one of two bytes.
    if image.topic == StereoFrames::INFO.name {
        let header: StereoFrame = bytemuck::pod_read_unaligned(&image.header);
        of(header.width_px, header.height_px)
    } else if image.topic == DepthFrames::INFO.name {
        let header: DepthFrame = bytemuck::pod_read_unaligned(&image.header);
        of(header.width_px, header.height_px)
    } else {
        let header: DisparityImage = bytemuck::pod_read_unaligned(&image.header);
        of(header.width_px, header.height_px)
    }
}
