//! The recorder process: every topic in, MCAP files out.

use crate::RecorderConfig;
use crate::file::{LogError, Times};
use crate::files::{Files, Pause};
use encoding::Viewer;
use ipc_types::rig::CameraMount;
use ipc_types::topics::{self, Topic};
use ipc_types::wire::Header;
use ipc_types::{FlightTime, ProcessId, StereoRig, for_each_topic};
use runtime::{Connect, Message, Ports, Process, Report};
use std::collections::{BTreeMap, HashMap};
use std::path::Path;
use std::time::Duration;

/// Flight time between drains.
const INTERVAL: Duration = Duration::from_millis(50);

/// What was written and not flushed when a file failed, of whatever topic.
const UNFLUSHED: &str = "unflushed";

/// Records a run. A file that cannot be written, for the disk is full, say, is left as it is; once it can be, a new one begins.
#[derive(Debug)]
pub struct RecorderProcess {
    files: Files,
    viewer: Viewer,
    /// Last sequence per topic, producer and incarnation.
    sequences: HashMap<(&'static str, u32, u32), u64>,
    lost: BTreeMap<String, u64>,
    images: bool,
    next: FlightTime,
    /// Files that the viewer has been told of.
    files_shown: u32,
    report: Report,
}

/// What a recording is of.
#[derive(Clone, Copy, Debug)]
pub struct Recording<'a> {
    /// Texts to attach: name, content.
    pub attachments: &'a [(&'a str, &'a str)],
    /// Whether pixels are recorded.
    pub images: bool,
    /// The camera ...
    pub rig: StereoRig,
    /// ... and its place.
    pub mount: CameraMount,
    /// Limits.
    pub config: RecorderConfig,
}

impl RecorderProcess {
    /// Records to a new file.
    ///
    /// # Errors
    /// The file cannot be created.
    pub fn create(path: &Path, recording: &Recording<'_>) -> Result<Self, LogError> {
        let mut recorder = Self::without_file(path, recording);
        recorder.files.begin()?;
        Ok(recorder)
    }

    /// As a successor: where the file cannot be created, for what its predecessor died of, a new one begins once it can be.
    pub fn resume(path: &Path, recording: &Recording<'_>) -> Self {
        Self::create(path, recording).unwrap_or_else(|_| Self::without_file(path, recording))
    }

    fn without_file(path: &Path, recording: &Recording<'_>) -> Self {
        Self {
            files: Files::new(path, recording.attachments, recording.images, recording.config),
            viewer: Viewer::new(recording.rig, recording.mount),
            sequences: HashMap::new(),
            lost: BTreeMap::new(),
            images: recording.images,
            next: FlightTime::ZERO,
            files_shown: 0,
            report: Report::waiting("starting"),
        }
    }

    fn drain<T: Topic>(&mut self, ports: &mut impl Ports) -> Result<(), LogError> {
        let mut bytes = Vec::new();
        while let Some(message) = ports.receive::<T>() {
            let (header, elements) = (message.header(), message.elements());
            let stamp = *header.stamp();
            let key = (T::INFO.name, stamp.producer, stamp.incarnation);
            let last = self.sequences.entry(key).or_insert(stamp.sequence);
            let missing = stamp.sequence.saturating_sub(*last + 1);
            *last = stamp.sequence.max(*last);
            if missing > 0 {
                *self.lost.entry(T::INFO.name.to_owned()).or_default() += missing;
            }
            let Ok(file) = self.files.current() else {
                *self.lost.entry(T::INFO.name.to_owned()).or_default() += 1;
                self.report.dropped += 1;
                continue;
            };
            bytes.clear();
            encoding::encode_message::<T>(header, elements, &mut bytes);
            let times = Times { valid_ns: stamp.valid_ns, published_ns: stamp.published_ns };
            file.write(T::INFO.name, stamp.sequence, times, &bytes)?;
            let mut shown = Ok(());
            self.viewer.views::<T>(header, elements, self.images, |view, message| {
                if shown.is_ok() {
                    shown = file.show(view, stamp.sequence, times, &message);
                }
            });
            shown?;
        }
        Ok(())
    }

    fn drain_all(&mut self, ports: &mut impl Ports) -> Result<(), LogError> {
        if self.files_shown != self.files.count() {
            self.files_shown = self.files.count();
            self.viewer.begin();
        }
        macro_rules! drain {
            ($($topic:ident),*) => {$(
                if is_read::<topics::$topic>(self.images) {
                    self.drain::<topics::$topic>(ports)?;
                }
            )*};
        }
        for_each_topic!(drain);
        Ok(())
    }

    /// The file cannot be written: it ends here.
    fn fail(&mut self) -> Report {
        // What was not on disk yet may be lost, too.
        let lost = self.files.fail();
        *self.lost.entry(UNFLUSHED.to_owned()).or_default() += lost;
        self.report.dropped += lost;
        self.report.refuse("cannot write the log")
    }
}

/// Of the images one is always read, for its points.
fn is_read<T: Topic>(images: bool) -> bool {
    images || !T::INFO.is_image || T::INFO.name == topics::Disparity::INFO.name
}

impl Drop for RecorderProcess {
    fn drop(&mut self) {
        self.files.end(&self.lost);
    }
}

impl Process for RecorderProcess {
    const ID: ProcessId = ProcessId::Recorder;

    fn connect(&self, connect: &mut impl Connect) {
        macro_rules! read {
            ($($topic:ident),*) => {$(
                if is_read::<topics::$topic>(self.images) {
                    connect.reads::<topics::$topic>();
                }
            )*};
        }
        for_each_topic!(read);
    }

    fn step<P: Ports>(&mut self, ports: &mut P) -> Report {
        if ports.now() < self.next {
            return self.report.idle();
        }
        self.next = ports.now() + INTERVAL;
        match (self.drain_all(ports), self.files.pause()) {
            (Ok(()), None) => self.report.worked(),
            (Ok(()), Some(Pause::Failed)) => self.report.degraded("without a log: what is published is not recorded"),
            (Ok(()), Some(Pause::NearlyFull)) => self.report.degraded("the disk is nearly full: not recording"),
            // Full disk, or a file that went away: the flight goes on without its log, and says so.
            (Err(_), _) => self.fail(),
        }
    }

    fn finish<P: Ports>(&mut self, ports: &mut P) {
        // What was published while the others were stopping.
        if self.drain_all(ports).is_err() {
            self.fail();
        }
    }

    fn next_wake(&self) -> Option<FlightTime> {
        Some(self.next)
    }

    fn housekeep(&mut self) {
        if self.files.housekeep(&self.lost).is_err() {
            self.fail();
        }
    }
}
