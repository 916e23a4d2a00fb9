//! The recorder process: every topic in, one MCAP file out.

use crate::encode;
use crate::log::{LogError, LogWriter};
use ipc_types::topics::{self, Topic};
use ipc_types::wire::Header;
use ipc_types::{FlightTime, HostTime, ProcessId, StereoRig, for_each_topic};
use runtime::{Connect, Message, Ports, Process, Report, host_now};
use std::collections::{BTreeMap, HashMap};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Flight time between drains.
const INTERVAL: Duration = Duration::from_millis(50);
/// Host time between flushes.
const FLUSH_INTERVAL: Duration = Duration::from_millis(500);

/// Between two attempts at a new file after one could not be written.
const AGAIN: Duration = Duration::from_secs(1);

/// What was written and not flushed when a file failed, of whatever topic.
const UNFLUSHED: &str = "unflushed";

/// Records a run. A file that cannot be written, for the disk is full, say, is left as it is; once it can be, a new one begins.
#[derive(Debug)]
pub struct RecorderProcess {
    /// Absent while nothing can be written.
    log: Option<Log>,
    path: PathBuf,
    attachments: Vec<(String, String)>,
    /// Files begun.
    files: u32,
    /// Messages written since the last flush.
    unflushed: u64,
    tried: HostTime,
    /// Last sequence per topic, producer and incarnation.
    sequences: HashMap<(&'static str, u32, u32), u64>,
    lost: BTreeMap<String, u64>,
    images: bool,
    width: usize,
    next: FlightTime,
    flushed: HostTime,
    report: Report,
}

impl RecorderProcess {
    /// Records to a new file, with texts attached (name, content). `images` asks for pixels too.
    ///
    /// # Errors
    /// The file cannot be created.
    pub fn create(path: &Path, attachments: &[(&str, &str)], images: bool, rig: &StereoRig) -> Result<Self, LogError> {
        let mut recorder = Self::without_log(path, attachments, images, rig);
        recorder.log = Some(Log::create(path, &recorder.attachments, images)?);
        Ok(recorder)
    }

    /// As a successor: where the file cannot be created, for what its predecessor died of, a new one begins once it can be.
    pub fn resume(path: &Path, attachments: &[(&str, &str)], images: bool, rig: &StereoRig) -> Self {
        let mut recorder = Self::without_log(path, attachments, images, rig);
        recorder.log = Log::create(path, &recorder.attachments, images).ok();
        recorder
    }

    fn without_log(path: &Path, attachments: &[(&str, &str)], images: bool, rig: &StereoRig) -> Self {
        let attachments = attachments.iter().map(|(name, text)| ((*name).to_owned(), (*text).to_owned())).collect();
        Self {
            log: None,
            path: path.to_owned(),
            attachments,
            files: 1,
            unflushed: 0,
            tried: host_now(),
            sequences: HashMap::new(),
            lost: BTreeMap::new(),
            images,
            width: rig.width_px as usize,
            next: FlightTime::ZERO,
            flushed: host_now(),
            report: Report::waiting("starting"),
        }
    }

    fn drain<T: Topic>(&mut self, ports: &mut impl Ports) -> Result<(), LogError> {
        while let Some(message) = ports.receive::<T>() {
            let stamp = *message.header().stamp();
            let key = (T::INFO.name, stamp.producer, stamp.incarnation);
            let expected = self.sequences.insert(key, stamp.sequence).map_or(stamp.sequence, |last| last + 1);
            if stamp.sequence > expected {
                *self.lost.entry(T::INFO.name.to_owned()).or_default() += stamp.sequence - expected;
            }
            let Some(log) = &mut self.log else {
                *self.lost.entry(T::INFO.name.to_owned()).or_default() += 1;
                self.report.dropped += 1;
                continue;
            };
            let Some(&channel) = log.channels.get(T::INFO.name) else { continue };
            let json = if T::INFO.is_image {
                encode::image::<T>(message.header(), message.elements(), self.width)
            } else {
                encode::message::<T>(message.header(), message.elements())
            };
            self.unflushed += 1;
            log.writer.write(channel, stamp.sequence, stamp.valid_ns, stamp.published_ns, &json)?;
        }
        Ok(())
    }

    fn drain_all(&mut self, ports: &mut impl Ports) -> Result<(), LogError> {
        macro_rules! drain {
            ($($topic:ident),*) => {$(
                if !topics::$topic::INFO.is_image || self.images {
                    self.drain::<topics::$topic>(ports)?;
                }
            )*};
        }
        for_each_topic!(drain);
        Ok(())
    }

    /// Writes the index and ends the file.
    fn end_log(&mut self) {
        let lost = self.lost.iter().map(|(topic, count)| (format!("lost {topic}"), count.to_string()));
        // The log is readable without its end; there is nobody left to tell.
        let _ = self.log.as_mut().map(|log| log.writer.finish(lost.collect()));
    }

    /// The file cannot be written: it ends here.
    fn fail(&mut self) -> Report {
        // What was not on disk yet may be lost, too.
        let lost = std::mem::take(&mut self.unflushed);
        *self.lost.entry(UNFLUSHED.to_owned()).or_default() += lost;
        self.report.dropped += lost;
        self.log = None;
        self.tried = host_now();
        self.report.refuse("cannot write the log")
    }

    /// Begins a new file, `log.part2.mcap` and so on, if the last attempt is long enough ago.
    fn begin_again(&mut self) {
        if host_now().saturating_since(self.tried) < AGAIN {
            return;
        }
        self.tried = host_now();
        let path = self.path.with_extension(format!("part{}.mcap", self.files + 1));
        match Log::create(&path, &self.attachments, self.images) {
            Ok(log) => (self.log, self.files) = (Some(log), self.files + 1),
            Err(_) => {
                self.report.refuse("cannot write the log");
            }
        }
    }
}

/// A file being written.
#[derive(Debug)]
struct Log {
    writer: LogWriter,
    channels: HashMap<&'static str, u16>,
}

impl Log {
    fn create(path: &Path, attachments: &[(String, String)], images: bool) -> Result<Self, LogError> {
        let mut writer = LogWriter::create(path)?;
        for (name, text) in attachments {
            writer.attach(name, text)?;
        }
        let mut channels = HashMap::new();
        macro_rules! add {
            ($($topic:ident),*) => {$(
                let info = topics::$topic::INFO;
                if !info.is_image {
                    let schema = encode::schema::<topics::$topic>();
                    channels.insert(info.name, writer.add_channel(info.name, info.header_type, &schema)?);
                } else if images {
                    let schema = encode::IMAGE_SCHEMA;
                    channels.insert(info.name, writer.add_channel(info.name, "foxglove.RawImage", schema)?);
                }
            )*};
        }
        for_each_topic!(add);
        // Not only in the buffer: a disk that is still full is to show here.
        writer.flush()?;
        Ok(Self { writer, channels })
    }
}

impl Drop for RecorderProcess {
    fn drop(&mut self) {
        self.end_log();
    }
}

impl Process for RecorderProcess {
    const ID: ProcessId = ProcessId::Recorder;

    fn connect(&self, connect: &mut impl Connect) {
        macro_rules! read {
            ($($topic:ident),*) => {$(
                if !topics::$topic::INFO.is_image || self.images {
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
        match self.drain_all(ports) {
            Ok(()) if self.log.is_none() => self.report.degraded("without a log: what is published is not recorded"),
            Ok(()) => self.report.worked(),
            // Full disk, or a file that went away: the flight goes on without its log, and says so.
            Err(_) => self.fail(),
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
        if host_now().saturating_since(self.flushed) >= FLUSH_INTERVAL {
            self.flushed = host_now();
            match self.log.as_mut().map(|log| log.writer.flush()) {
                Some(Ok(())) => self.unflushed = 0,
                Some(Err(_)) => {
                    self.fail();
                }
                None => self.begin_again(),
            }
        }
    }
}
