//! What the whole-graph tests share: the executable, temporary run directories, summaries.
#![allow(dead_code, unreachable_pub)] // Each test binary uses its own part of this.

use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// A run of the executable in a folder of its own.
pub struct Run {
    pub folder: tempfile::TempDir,
    pub name: String,
}

/// The summary of a flight and how the executable ended.
pub struct Flown {
    pub summary: Value,
    pub output: Output,
}

impl Flown {
    pub fn outcome(&self) -> &str {
        self.summary["outcome"].as_str().expect("an outcome")
    }

    pub fn number(&self, key: &str) -> f64 {
        self.summary[key].as_f64().unwrap_or_else(|| panic!("no number {key} in {}", self.summary))
    }
}

impl Run {
    pub fn new(name: &str) -> Self {
        let folder = tempfile::tempdir().expect("temporary folder");
        Self { folder, name: format!("{name}-{}", std::process::id()) }
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    pub fn command(&self, arguments: &[&str]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_sparrowhawk"));
        command.args(arguments).current_dir(self.folder.path()).stdin(Stdio::null());
        command
    }

    fn flight(&self, arguments: &[&str]) -> Command {
        let mut command = self.command(&["fly", "--run", &self.name, "--summary", "summary.json"]);
        command.args(arguments).stdout(Stdio::piped()).stderr(Stdio::piped());
        command
    }

    /// Flies to the end.
    pub fn fly(&self, arguments: &[&str]) -> Flown {
        let output = self.flight(arguments).output().expect("the executable starts");
        self.flown(output)
    }

    /// Starts a flight.
    pub fn start(&self, arguments: &[&str]) -> Child {
        self.flight(arguments).spawn().expect("the executable starts")
    }

    /// The summary of a flight that has ended.
    pub fn flown(&self, output: Output) -> Flown {
        let text = std::fs::read_to_string(self.path("summary.json"))
            .unwrap_or_else(|_| panic!("no summary: {}", String::from_utf8_lossy(&output.stderr)));
        Flown { summary: serde_json::from_str(&text).expect("JSON"), output }
    }

    pub fn log(&self) -> PathBuf {
        self.path("runs").join(&self.name).join("log.mcap")
    }

    /// Nothing of this run may be left in shared memory, and no process.
    pub fn assert_nothing_left(&self) {
        for entry in walk(Path::new("/dev/shm")) {
            let text = entry.to_string_lossy();
            let prefix = runtime::run_dir::RunDir::named(&self.name).expect("a good name").prefix();
            assert!(!text.contains(&self.name) && !text.contains(&prefix), "left behind: {text}");
        }
        assert_eq!(self.processes(), Vec::<u32>::new(), "processes left behind");
    }

    /// Processes whose command line names this run.
    pub fn processes(&self) -> Vec<u32> {
        let mut found = Vec::new();
        for entry in std::fs::read_dir("/proc").expect("/proc").flatten() {
            let pid = entry.file_name().to_str().and_then(|name| name.parse().ok());
            let line = std::fs::read(entry.path().join("cmdline")).unwrap_or_default();
            let line = String::from_utf8_lossy(&line).into_owned();
            if let Some(pid) = pid
                && line.contains(&self.name)
            {
                found.push(pid);
            }
        }
        found
    }

    /// The shipped configuration, copied here as `config/`, with another graph file.
    pub fn configure(&self, change: impl Fn(&str) -> String) {
        copy(&Path::new(env!("CARGO_MANIFEST_DIR")).join("config"), &self.path("config"));
        let graph = self.path("config/graphs/droan.ron");
        let text = std::fs::read_to_string(&graph).expect("readable");
        std::fs::write(&graph, change(&text)).expect("writable");
    }

    /// The process of that name, once it exists.
    pub fn wait_for_process(&self, process: &str) -> u32 {
        let started = Instant::now();
        loop {
            let found = self.processes().into_iter().find(|pid| {
                let line = std::fs::read(format!("/proc/{pid}/cmdline")).unwrap_or_default();
                line.split(|&byte| byte == 0).any(|argument| argument == process.as_bytes())
            });
            if let Some(pid) = found {
                return pid;
            }
            assert!(started.elapsed() < Duration::from_secs(20), "{process} never started");
            std::thread::yield_now();
        }
    }
}

fn copy(from: &Path, to: &Path) {
    std::fs::create_dir_all(to).expect("writable");
    for entry in std::fs::read_dir(from).expect("readable").flatten() {
        let (path, copied) = (entry.path(), to.join(entry.file_name()));
        match path.is_dir() {
            true => copy(&path, &copied),
            false => drop(std::fs::copy(&path, &copied).expect("copied")),
        }
    }
}

fn walk(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
        found.push(entry.path());
        if entry.file_type().is_ok_and(|kind| kind.is_dir()) {
            found.extend(walk(&entry.path()));
        }
    }
    found
}

/// An endpoint on this machine that nobody listens at.
pub fn free_endpoint() -> String {
    let listener = std::net::TcpListener::bind("127.0.0.1:0").expect("a port");
    format!("tcp/{}", listener.local_addr().expect("an address"))
}

/// Real-time flights share two cores: one at a time.
pub fn real_time() -> MutexGuard<'static, ()> {
    static ONE: Mutex<()> = Mutex::new(());
    ONE.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Says that a test is skipped, past what holds back the output of tests that pass.
pub fn skipped(why: &str) {
    use std::io::Write;
    // Who has closed his standard error does not want to know.
    let _ = writeln!(std::io::stderr(), "SKIPPED: {why}");
}

/// The folder of third-party data, or a loud `None`.
pub fn data() -> Option<PathBuf> {
    let fallback = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../shared/data");
    let folder = std::env::var_os("SPARROWHAWK_DATA").map_or(fallback, PathBuf::from);
    if !folder.is_dir() {
        skipped(&format!("no test data in {}; set SPARROWHAWK_DATA", folder.display()));
        return None;
    }
    Some(folder)
}

/// Calls `work` for every item on so many threads, and returns the results in order.
pub fn on_threads<T: Send>(
    threads: usize,
    items: std::ops::RangeInclusive<u64>,
    work: impl Fn(u64) -> T + Sync,
) -> Vec<T> {
    let next = Mutex::new(items);
    let results = Mutex::new(Vec::new());
    std::thread::scope(|scope| {
        for _ in 0..threads {
            scope.spawn(|| {
                loop {
                    let Some(item) = next.lock().unwrap_or_else(PoisonError::into_inner).next() else { return };
                    let result = work(item);
                    results.lock().unwrap_or_else(PoisonError::into_inner).push((item, result));
                }
            });
        }
    });
    let mut results = results.into_inner().unwrap_or_else(PoisonError::into_inner);
    results.sort_by_key(|(item, _)| *item);
    results.into_iter().map(|(_, result)| result).collect()
}
