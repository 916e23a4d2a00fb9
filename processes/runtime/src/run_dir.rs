//! Where a run keeps its shared state, isolated from every other run on the machine.
//!
//! ```text
//! /dev/shm/sparrowhawk-<uid>/<run>/lock     held by the supervisor for as long as it lives
//!                                 /alive    held, shared, by every process of the run
//!                                 /iox/     iceoryx2's root: node and service files, event sockets
//!                                 /claim-…  held by the one living process of a name: its number and incarnation
//!                                 /images/  keyframes, and what processes leave to their successors
//!                                 /boxes/   what every process received last
//!                                 /supervisor, /record   who supervises, and what its successor must know
//! /dev/shm/<prefix>…                        iceoryx2's shared-memory segments of this run
//! ```
//!
//! The folder and the segments lie on the same tmpfs, so that they vanish together.

use ipc_types::ProcessId;
use rustix::fs::{FlockOperation, flock};
use std::fs::{self, File, OpenOptions};
use std::io::{self, Write};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};
use xxhash_rust::xxh3::xxh3_64;

/// The file system that iceoryx2 puts its segments on.
const SHARED_MEMORY: &str = "/dev/shm";
/// What the kernel counts a file's room in, bytes.
const BLOCK_BYTES: u64 = 512;
/// Longest run name: with the user's number and iceoryx2's own names, event sockets stay below 108 bytes.
pub const MAX_RUN_NAME: usize = 24;
/// Runs that start at the same time wait for each other, at most so long.
const GATE_WITHIN: Duration = Duration::from_secs(1);
/// Whoever holds a claim has written who it is within this time.
const CLAIMED_WITHIN: Duration = Duration::from_millis(100);
/// Free shared memory a run needs, bytes. iceoryx2 ends in SIGBUS when it runs out later.
const NEEDED_BYTES: u64 = 256 << 20;

/// Why a run cannot start.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// The name cannot be part of a socket's path.
    #[error(
        "run name \"{name}\" must be 1 to {MAX_RUN_NAME} characters of a-z, A-Z, 0-9, '-' and '_' (it becomes part of socket paths)"
    )]
    BadName {
        /// As given.
        name: String,
    },
    /// The lock is held.
    #[error("run \"{name}\" is already running (its supervisor holds {lock}); choose another name with --run")]
    AlreadyRunning {
        /// As given.
        name: String,
        /// The lock file.
        lock: String,
    },
    /// The supervisor has died, and its children live.
    #[error(
        "run \"{name}\" has lost its supervisor, and its processes still run; take it over with --adopt, or wait until they have ended (lease_s)"
    )]
    Orphaned {
        /// As given.
        name: String,
    },
    /// Another incarnation of the process lives.
    #[error("{process} lives already, as process {number}: it lives once")]
    Claimed {
        /// Which.
        process: ProcessId,
        /// The number of the one that lives; 0 if it has only begun.
        number: u32,
    },
    /// The folder cannot be used.
    #[error("cannot use {path}: {source}; shared memory must be writable by this user")]
    Inaccessible {
        /// What was to be used.
        path: String,
        /// Why not.
        source: io::Error,
    },
    /// Too little shared memory.
    #[error("{SHARED_MEMORY} has {free_mib} MiB free, a run needs {} MiB", NEEDED_BYTES >> 20)]
    NoSpace {
        /// Free, MiB.
        free_mib: u64,
    },
}

/// A run's place in shared memory.
#[derive(Clone, Debug)]
pub struct RunDir {
    name: String,
    path: PathBuf,
}

/// Proof that this process is the run's supervisor. Sweeps the run's shared memory when dropped, but for a run that was taken
/// over: whatever goes wrong with that must not sweep what flies. There [`RunLock::end`] is to be called first.
#[derive(Debug)]
pub struct RunLock {
    run: RunDir,
    sweeps: bool,
    _lock: File,
}

impl RunLock {
    /// The run's processes have ended.
    pub fn end(&mut self) {
        self.sweeps = true;
    }
}

/// A process' hold on its run: while anyone holds on, nobody takes the run anew.
#[derive(Debug)]
pub struct RunMember {
    _alive: File,
    _claim: File,
}

impl RunDir {
    /// Names a run without touching anything.
    ///
    /// # Errors
    /// [`RunError::BadName`].
    pub fn named(name: &str) -> Result<Self, RunError> {
        let fits = (1..=MAX_RUN_NAME).contains(&name.len());
        let plain = name.bytes().all(|byte| byte.is_ascii_alphanumeric() || byte == b'-' || byte == b'_');
        if !fits || !plain {
            return Err(RunError::BadName { name: name.to_owned() });
        }
        let user = rustix::process::getuid().as_raw();
        let path = Path::new(SHARED_MEMORY).join(format!("sparrowhawk-{user}")).join(name);
        Ok(Self { name: name.to_owned(), path })
    }

    /// The run's name.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// iceoryx2's root folder.
    pub(crate) fn iceoryx_root(&self) -> PathBuf {
        self.path.join("iox")
    }

    /// Folder of the image store.
    pub fn images(&self) -> PathBuf {
        self.path.join("images")
    }

    /// What the names of this run's shared-memory segments begin with. Ends in a delimiter, so that no run's
    /// prefix begins another's.
    pub fn prefix(&self) -> String {
        format!("s{:08x}_", xxh3_64(self.path.as_os_str().as_encoded_bytes()) as u32)
    }

    /// Where a process notes what it received.
    pub(crate) fn black_box(&self, process: ProcessId) -> PathBuf {
        self.path.join("boxes").join(process.name())
    }

    /// Where a process says that it is dying, and writes down why.
    fn last_words(&self, process: ProcessId) -> PathBuf {
        self.path.join("boxes").join(format!("{}.dying", process.name()))
    }

    /// A process says that it is dying: it needs a moment to write down why.
    pub fn note_dying(&self, process: ProcessId) {
        // Where this cannot be written, the report is cut short.
        let _ = fs::write(self.last_words(process), []);
    }

    /// Whether a process has said that it is dying.
    pub fn is_dying(&self, process: ProcessId) -> bool {
        self.last_words(process).exists()
    }

    /// What a predecessor said does not concern its successor.
    pub(crate) fn forget_dying(&self, process: ProcessId) {
        let _ = fs::remove_file(self.last_words(process));
    }

    /// Says who supervises the run, for its processes.
    ///
    /// # Errors
    /// The run's folder cannot be written.
    pub fn name_supervisor(&self, number: u32) -> io::Result<()> {
        self.replace("supervisor", number.to_string().as_bytes())
    }

    /// Process number of the supervisor that was named last.
    pub(crate) fn supervisor(&self) -> Option<u32> {
        fs::read_to_string(self.path.join("supervisor")).ok()?.parse().ok()
    }

    /// Writes what a supervisor's successor, and whoever watches, must know.
    ///
    /// # Errors
    /// The run's folder cannot be written.
    pub fn write_record(&self, record: &[u8]) -> io::Result<()> {
        self.replace("record", record)
    }

    /// What [`write_record`](Self::write_record) wrote last.
    ///
    /// # Errors
    /// There is none.
    pub fn read_record(&self) -> io::Result<Vec<u8>> {
        fs::read(self.path.join("record"))
    }

    /// Whole or not at all.
    fn replace(&self, name: &str, bytes: &[u8]) -> io::Result<()> {
        let temporary = self.path.join(format!("{name}.tmp"));
        fs::write(&temporary, bytes)?;
        fs::rename(temporary, self.path.join(name))
    }

    /// Names of this user's runs, dead or alive.
    pub fn all() -> Vec<Self> {
        let Ok(any) = Self::named("any") else { return Vec::new() };
        let siblings = any.path.parent().map(fs::read_dir).and_then(Result::ok);
        let names = siblings.into_iter().flatten().flatten().map(|entry| entry.file_name());
        let mut runs: Vec<_> = names.filter_map(|name| Self::named(&name.to_string_lossy()).ok()).collect();
        runs.sort_by(|a, b| a.name.cmp(&b.name));
        runs
    }

    /// Takes over a run whose supervisor has died and whose processes live; `None` if there is nothing to take over.
    ///
    /// # Errors
    /// The run has a supervisor, or shared memory is not accessible.
    pub fn take_over(&self) -> Result<Option<RunLock>, RunError> {
        if !self.path.join("record").exists() {
            return Ok(None);
        }
        let (lock, alive) = self.locks()?;
        if !is_free(&lock) {
            return Err(self.already_running());
        }
        Ok((!is_free(&alive)).then(|| RunLock { run: self.clone(), sweeps: false, _lock: lock }))
    }

    /// Takes the run: locks it, clears what a dead predecessor left, here and in other dead runs, and makes its folders.
    ///
    /// # Errors
    /// The run is in use, or its processes are; shared memory is not writable, or too little of it is free.
    pub fn take(&self) -> Result<RunLock, RunError> {
        let _gate = self.gate()?;
        fs::create_dir_all(&self.path).map_err(inaccessible(&self.path))?;
        let (lock, alive) = self.locks()?;
        if !is_free(&lock) {
            return Err(self.already_running());
        }
        if !is_free(&alive) {
            return Err(RunError::Orphaned { name: self.name.clone() });
        }
        drop(alive); // It only told whether anyone lives.
        // From here on, whatever fails leaves nothing behind.
        let lock = RunLock { run: self.clone(), sweeps: true, _lock: lock };
        self.sweep();
        self.sweep_dead_siblings();
        let statistics =
            rustix::fs::statvfs(SHARED_MEMORY).map_err(|errno| inaccessible(Path::new(SHARED_MEMORY))(errno.into()))?;
        let free = statistics.f_bavail * statistics.f_frsize;
        if free < NEEDED_BYTES {
            return Err(RunError::NoSpace { free_mib: free >> 20 });
        }
        for folder in [self.iceoryx_root(), self.images()] {
            fs::create_dir_all(&folder).map_err(inaccessible(&folder))?;
        }
        Ok(lock)
    }

    /// Holds on to a run as one of its processes, of which each lives once: the kernel lets go when it dies.
    ///
    /// # Errors
    /// The run does not exist, or another incarnation of the process lives.
    pub fn join(&self, process: ProcessId, incarnation: u32) -> Result<RunMember, RunError> {
        let path = self.path.join("alive");
        let alive = File::open(&path).map_err(inaccessible(&path))?;
        flock(&alive, FlockOperation::LockShared).map_err(|errno| inaccessible(&path)(errno.into()))?;
        let path = self.claim(process);
        let open = || OpenOptions::new().create(true).truncate(false).write(true).open(&path);
        let mut claim = open().map_err(inaccessible(&path))?;
        if !is_free(&claim) {
            let living = self.living(process).map_or(0, |(number, _)| number);
            return Err(RunError::Claimed { process, number: living });
        }
        let text = format!("{} {incarnation}\n", std::process::id());
        claim.set_len(0).and_then(|()| claim.write_all(text.as_bytes())).map_err(inaccessible(&path))?;
        Ok(RunMember { _alive: alive, _claim: claim })
    }

    fn claim(&self, process: ProcessId) -> PathBuf {
        self.path.join(format!("claim-{}", process.name()))
    }

    /// Number and incarnation of the process of that name that lives, whoever started it.
    pub fn living(&self, process: ProcessId) -> Option<(u32, u32)> {
        let path = self.claim(process);
        let file = File::open(&path).ok()?;
        let began = Instant::now();
        while flock(&file, FlockOperation::NonBlockingLockShared).is_err() {
            // Held, and written a moment later.
            if let Some((number, incarnation)) = self.last_claim(process) {
                return Some((number, incarnation));
            }
            if began.elapsed() > CLAIMED_WITHIN {
                return None;
            }
            std::thread::yield_now();
        }
        None // Nobody holds it.
    }

    /// Number and incarnation of the last process of that name, alive or dead.
    pub fn last_claim(&self, process: ProcessId) -> Option<(u32, u32)> {
        let text = fs::read_to_string(self.claim(process)).ok()?;
        let (number, incarnation) = text.strip_suffix('\n')?.split_once(' ')?;
        Some((number.parse().ok()?, incarnation.parse().ok()?))
    }

    fn already_running(&self) -> RunError {
        RunError::AlreadyRunning { name: self.name.clone(), lock: self.path.join("lock").display().to_string() }
    }

    /// Of those that start at the same time one after the other: else one would sweep, as dead, what another has just begun.
    fn gate(&self) -> Result<File, RunError> {
        let folder = self.path.parent().unwrap_or(Path::new(SHARED_MEMORY));
        fs::create_dir_all(folder).map_err(inaccessible(folder))?;
        let gate = File::open(folder).map_err(inaccessible(folder))?;
        let began = Instant::now();
        // One that was stopped in here is not waited for.
        while !is_free(&gate) && began.elapsed() < GATE_WITHIN {
            std::thread::sleep(Duration::from_millis(1));
        }
        Ok(gate)
    }

    /// The supervisor's lock, and that which every process shares.
    fn locks(&self) -> Result<(File, File), RunError> {
        let open = |name: &str| {
            let path = self.path.join(name);
            let file = OpenOptions::new().create(true).truncate(false).write(true).open(&path);
            file.map_err(inaccessible(&path))
        };
        Ok((open("lock")?, open("alive")?))
    }

    /// Clears runs of this user whose supervisors were killed and whose processes have ended since.
    fn sweep_dead_siblings(&self) {
        let siblings = self.path.parent().map(fs::read_dir).and_then(Result::ok);
        for entry in siblings.into_iter().flatten().flatten() {
            let name = entry.file_name().to_string_lossy().into_owned();
            let sibling = Self::named(&name).ok().filter(|sibling| sibling.path != self.path);
            if let Some(sibling) = sibling
                && let Ok((lock, alive)) = sibling.locks()
                && is_free(&lock)
                && is_free(&alive)
            {
                drop(RunLock { run: sibling, sweeps: true, _lock: lock });
            }
        }
    }

    /// The run's files in shared memory, and what they take, bytes.
    pub fn footprint(&self) -> (u64, u64) {
        let (mut files, mut bytes) = (0, 0);
        let mut folders = vec![self.path.clone()];
        let mut take = |path: PathBuf| match fs::symlink_metadata(&path) {
            Ok(metadata) if metadata.is_dir() => Some(path),
            Ok(metadata) => {
                (files, bytes) = (files + 1, bytes + BLOCK_BYTES * metadata.blocks());
                None
            }
            Err(_) => None, // Gone meanwhile.
        };
        self.segments().for_each(|path| drop(take(path)));
        while let Some(folder) = folders.pop() {
            let entries = fs::read_dir(folder).into_iter().flatten().flatten();
            folders.extend(entries.filter_map(|entry| take(entry.path())));
        }
        (files, bytes)
    }

    /// The run's iceoryx2 segments.
    pub(crate) fn segments(&self) -> impl Iterator<Item = PathBuf> {
        let prefix = self.prefix();
        let entries = fs::read_dir(SHARED_MEMORY).into_iter().flatten().flatten();
        let its = entries.filter(move |entry| entry.file_name().as_encoded_bytes().starts_with(prefix.as_bytes()));
        its.map(|entry| entry.path())
    }

    /// Removes everything of this run but the lock.
    fn sweep(&self) {
        // Absent is as good as removed.
        let _ = fs::remove_dir_all(self.iceoryx_root());
        let _ = fs::remove_dir_all(self.images());
        let _ = fs::remove_dir_all(self.path.join("boxes"));
        ["supervisor", "record"].iter().for_each(|name| drop(fs::remove_file(self.path.join(name))));
        self.segments().for_each(|path| drop(fs::remove_file(path)));
    }
}

/// Whether nobody holds a lock; it is taken then.
fn is_free(file: &File) -> bool {
    flock(file, FlockOperation::NonBlockingLockExclusive).is_ok()
}

fn inaccessible(path: &Path) -> impl FnOnce(io::Error) -> RunError {
    let path = path.display().to_string();
    move |source| RunError::Inaccessible { path, source }
}

impl Drop for RunLock {
    fn drop(&mut self) {
        if !self.sweeps {
            return;
        }
        self.run.sweep();
        let _ = fs::remove_dir_all(&self.run.path);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_that_would_break_paths_are_refused() {
        for name in ["", "a/b", "..", "a b", "this-name-is-far-too-long-for-a-socket"] {
            assert!(matches!(RunDir::named(name), Err(RunError::BadName { .. })), "{name:?}");
        }
    }

    #[test]
    fn a_run_is_taken_once_and_leaves_nothing_behind() {
        let run = RunDir::named(&format!("lock-test-{}", std::process::id())).expect("a good name");
        let lock = run.take().expect("free");
        assert!(matches!(run.take(), Err(RunError::AlreadyRunning { .. })));
        let leftover = Path::new(SHARED_MEMORY).join(format!("{}leftover", run.prefix()));
        fs::write(&leftover, b"x").expect("writable");
        assert!(run.footprint().0 >= 3, "lock, alive and leftover: {:?}", run.footprint());
        let member = run.join(ProcessId::Memory, 3).expect("alive");
        assert_eq!(run.living(ProcessId::Memory), Some((std::process::id(), 3)));
        let second = run.join(ProcessId::Memory, 4);
        assert!(matches!(second, Err(RunError::Claimed { number, .. }) if number == std::process::id()), "{second:?}");
        assert_eq!(run.living(ProcessId::Planner), None);
        drop(lock);
        assert!(!run.path.exists() && !leftover.exists());
        assert_eq!(run.footprint(), (0, 0));
        drop(member);
        drop(run.take().expect("free again"));
    }

    #[test]
    fn a_run_whose_supervisor_died_is_taken_over_while_its_processes_live_and_not_taken_anew() {
        let run = RunDir::named(&format!("orphan-{}", std::process::id())).expect("a good name");
        assert!(run.take_over().expect("accessible").is_none(), "there is none");
        let lock = run.take().expect("free");
        run.write_record(b"as it was").expect("writable");
        let member = run.join(ProcessId::Memory, 0).expect("alive");
        assert!(matches!(run.take_over(), Err(RunError::AlreadyRunning { .. })));
        // A killed supervisor sweeps nothing.
        let RunLock { _lock: file, .. } = &lock;
        flock(file, FlockOperation::Unlock).expect("unlocked");
        assert!(matches!(run.take(), Err(RunError::Orphaned { .. })));
        let taken = run.take_over().expect("accessible").expect("orphaned");
        assert_eq!(run.read_record().expect("kept"), b"as it was");
        drop(taken);
        assert_eq!(run.read_record().expect("kept"), b"as it was", "a takeover that fails sweeps nothing");
        let mut taken = run.take_over().expect("accessible").expect("orphaned still");
        drop(member);
        taken.end();
        std::mem::forget(lock);
        drop(taken);
        assert!(!run.path.exists());
    }
}
