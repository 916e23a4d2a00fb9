//! The files of a recording, one after the other: `log.mcap`, `log.part2.mcap` and so on.
//!
//! A file ends when it is large or old enough, when it cannot be written, and when the disk is nearly full; the next one
//! begins as soon as it can be.

use crate::RecorderConfig;
use crate::file::{LogError, LogFile};
use ipc_types::HostTime;
use runtime::host_now;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Host time between flushes.
const FLUSH_INTERVAL: Duration = Duration::from_millis(500);
/// Between two attempts at a new file after one could not be written.
const AGAIN: Duration = Duration::from_secs(1);
const MIB: u64 = 1 << 20;

/// Why nothing is being written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Pause {
    /// The file cannot be written.
    Failed,
    /// Too little room is left on the disk.
    NearlyFull,
}

/// What a recording is written to.
#[derive(Debug)]
pub(crate) struct Files {
    config: RecorderConfig,
    attachments: Vec<(String, String)>,
    images: bool,
    first: PathBuf,
    /// The current one.
    path: PathBuf,
    file: Result<LogFile, Pause>,
    begun: HostTime,
    count: u32,
    flushed: HostTime,
    tried: HostTime,
    /// Messages written since the last flush.
    unflushed: u64,
    /// Losses that the current file has on record.
    noted: u64,
}

impl Files {
    /// Without a file yet.
    pub(crate) fn new(path: &Path, attachments: &[(&str, &str)], images: bool, config: RecorderConfig) -> Self {
        Self {
            config,
            attachments: attachments.iter().map(|(name, text)| ((*name).to_owned(), (*text).to_owned())).collect(),
            images,
            first: path.to_owned(),
            path: path.to_owned(),
            file: Err(Pause::Failed),
            begun: host_now(),
            count: 0,
            flushed: host_now(),
            tried: host_now(),
            unflushed: 0,
            noted: 0,
        }
    }

    /// The next file.
    pub(crate) fn begin(&mut self) -> Result<(), LogError> {
        self.tried = host_now();
        if self.is_nearly_full() {
            self.file = Err(Pause::NearlyFull);
            return Ok(());
        }
        let path = match self.count {
            0 => self.first.clone(),
            before => part(&self.first, before + 1),
        };
        self.file = Ok(LogFile::create(&path, &self.attachments, self.images)?);
        (self.path, self.begun, self.count, self.noted) = (path, host_now(), self.count + 1, 0);
        Ok(())
    }

    /// What is being written to, or why nothing is.
    pub(crate) fn current(&mut self) -> Result<&mut LogFile, Pause> {
        self.unflushed += u64::from(self.file.is_ok());
        self.file.as_mut().map_err(|pause| *pause)
    }

    /// Why nothing is being written, if nothing is.
    pub(crate) fn pause(&self) -> Option<Pause> {
        self.file.as_ref().err().copied()
    }

    /// The file cannot be written: it ends here. Returns how many messages may not be on the disk.
    pub(crate) fn fail(&mut self) -> u64 {
        self.file = Err(Pause::Failed);
        self.tried = host_now();
        std::mem::take(&mut self.unflushed)
    }

    /// Files begun so far.
    pub(crate) fn count(&self) -> u32 {
        self.count
    }

    /// Flushes now and then, and goes on to the next file where that is due. What was `lost` so far goes along.
    ///
    /// # Errors
    /// The file cannot be written: [`Files::fail`] is to be called.
    pub(crate) fn housekeep(&mut self, lost: &BTreeMap<String, u64>) -> Result<(), LogError> {
        if host_now().saturating_since(self.flushed) < FLUSH_INTERVAL {
            return Ok(());
        }
        self.flushed = host_now();
        let is_nearly_full = self.is_nearly_full();
        let Ok(file) = &mut self.file else {
            if host_now().saturating_since(self.tried) >= AGAIN {
                // As long as it cannot be, what is published is not recorded, which is said already.
                let _ = self.begin();
            }
            return Ok(());
        };
        let lost_so_far = lost.values().sum();
        if lost_so_far != std::mem::replace(&mut self.noted, lost_so_far) {
            file.note_lost(metadata(lost))?;
        }
        file.flush()?;
        self.unflushed = 0;
        let bytes = std::fs::metadata(&self.path).map_or(0, |metadata| metadata.len());
        let is_old = host_now().saturating_since(self.begun) >= Duration::from_secs_f64(self.config.file_s);
        if is_old || bytes >= self.config.file_mib * MIB || is_nearly_full {
            file.finish()?;
            self.begin()?;
        }
        Ok(())
    }

    fn is_nearly_full(&self) -> bool {
        let folder = self.first.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
        // A file system that does not say is written to until it refuses.
        rustix::fs::statvfs(folder).is_ok_and(|free| free.f_bavail * free.f_frsize < self.config.least_free_mib * MIB)
    }

    /// Writes the index and ends the recording.
    pub(crate) fn end(&mut self, lost: &BTreeMap<String, u64>) {
        // The log is readable without its end; there is nobody left to tell.
        let _ = self.file.as_mut().map(|file| file.note_lost(metadata(lost)).and_then(|()| file.finish()));
    }
}

/// The file of a recording that is called by its first: the second, and so on.
pub(crate) fn part(first: &Path, number: u32) -> PathBuf {
    first.with_extension(format!("part{number}.mcap"))
}

fn metadata(lost: &BTreeMap<String, u64>) -> BTreeMap<String, String> {
    lost.iter().map(|(topic, count)| (format!("lost {topic}"), count.to_string())).collect()
}
