//! Ill-behaved neighbours, for injected faults: a reader that takes messages and holds them, and memory that is full.

use super::{IpcError, IpcPorts};
use crate::ports::{Connect, Ports};
use crate::run_dir::RunDir;
use ipc_types::topics::{self, Topic};
use ipc_types::{ProcessId, StereoRig, for_each_topic};
use rustix::fs::{FallocateFlags, fallocate, statvfs};
use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Subscribes to a topic, takes as many messages as it may, and lets go of none for so long.
///
/// # Errors
/// The run does not exist, or there is no such topic.
pub fn hold_messages(run: &RunDir, rig: &StereoRig, topic: &str, time: Duration) -> Result<(), IpcError> {
    macro_rules! hold {
        ($($topic:ident),*) => {$(
            if topics::$topic::INFO.name == topic {
                return hold::<topics::$topic>(run, rig, time);
            }
        )*};
    }
    for_each_topic!(hold);
    Err(IpcError::new(format!("subscribe to {topic}"))(&"there is no such topic"))
}

fn hold<T: Topic>(run: &RunDir, rig: &StereoRig, time: Duration) -> Result<(), IpcError> {
    let mut ports = IpcPorts::open(run, ProcessId::Supervisor, u32::MAX, rig, |ports| ports.reads::<T>())?;
    let until = std::time::Instant::now() + time;
    let mut held = Vec::new();
    while std::time::Instant::now() < until {
        held.extend(ports.receive::<T>());
        // A reader that does not even read: it looks twice a second.
        std::thread::sleep(Duration::from_millis(500).min(until.saturating_duration_since(std::time::Instant::now())));
    }
    Ok(())
}

/// The most that is filled up: more would take the machine's memory rather than a file system's.
const MOST_BYTES: u64 = 2 << 30;
const FOLDER: &str = "/dev/shm";

/// A file that takes all that is free in `/dev/shm`. Removed when dropped.
#[derive(Debug)]
pub struct Ballast(PathBuf);

impl Ballast {
    /// Fills it up.
    ///
    /// # Errors
    /// There is more than 2 GiB to fill, or it cannot be filled.
    pub fn fill() -> io::Result<Self> {
        let statistics = statvfs(FOLDER)?;
        let free = statistics.f_bavail * statistics.f_frsize;
        if free > MOST_BYTES {
            let advice = format!(
                "{FOLDER} has {} MiB free, and at most {} are filled; try with a small one: \
                 unshare --user --map-root-user --mount, then mount -t tmpfs -o size=512m tmpfs {FOLDER}",
                free >> 20,
                MOST_BYTES >> 20
            );
            return Err(io::Error::new(io::ErrorKind::InvalidInput, advice));
        }
        let path = Path::new(FOLDER).join(format!("sparrowhawk-ballast-{}", std::process::id()));
        let ballast = Self(path);
        let file = File::create(&ballast.0)?;
        // Page by page at the end: others take and give back meanwhile.
        let mut length = 0;
        for step in [16 << 20, 1 << 20, 1 << 16, 1 << 12] {
            while fallocate(&file, FallocateFlags::empty(), length, step).is_ok() {
                length += step;
            }
        }
        Ok(ballast)
    }
}

impl Drop for Ballast {
    fn drop(&mut self) {
        // Absent is as good as removed.
        let _ = fs::remove_file(&self.0);
    }
}
