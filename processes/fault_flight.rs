//! One flight of a fault campaign or a soak: flown as a user would, by the executable itself; what was left behind is counted.

use crate::fault_file::FaultFile;
use procfs::process::all_processes;
use runtime::faults::Fault;
use runtime::run_dir::RunDir;
use rustix::process::{Pid, Signal, kill_process};
use serde::{Deserialize, Serialize};
use std::error::Error;
use std::fs;
use std::os::unix::process::ExitStatusExt;
use std::path::PathBuf;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::Duration;
use supervisor::{Outcome, Summary};

/// A world that waited for anyone longer than this share makes a flight void.
const CLOCK_RATIO: f64 = 0.98;
/// Between two looks at whether a flight has ended, or is to end.
const INTERVAL: Duration = Duration::from_millis(200);
/// Supervisors that may die in a flight.
const MOST_TAKEOVERS: u32 = 50;

/// How a flight is flown.
#[derive(Clone, Debug)]
pub(crate) struct FaultFlight {
    /// Options of `sparrowhawk fly`: what to fly.
    pub(crate) options: Vec<String>,
    /// Where its files go.
    pub(crate) folder: PathBuf,
    /// Its name.
    pub(crate) name: String,
}

/// What a flight came to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Verdict {
    /// The goal was reached.
    Arrived,
    /// The vehicle hovered, or was handed back while it did.
    Hovered,
    /// Time ran out under way: nothing was touched.
    Late,
    /// It touched something, or the flight did not end as it should.
    Failed,
    /// The world waited: nothing is known.
    Void,
}

/// A flight that has ended.
#[derive(Clone, Debug)]
pub(crate) struct Flown {
    pub(crate) verdict: Verdict,
    /// Absent if it left none.
    pub(crate) summary: Option<Summary>,
    /// Files in shared memory, processes alive and zombies that it left behind.
    pub(crate) leaked: usize,
}

impl FaultFlight {
    /// Flies with these faults. Whether it is to go on is asked several times a second; if not, it is interrupted.
    ///
    /// # Errors
    /// It cannot be started.
    pub(crate) fn fly(&self, faults: &[Fault], mut goes_on: impl FnMut() -> bool) -> Result<Flown, Box<dyn Error>> {
        fs::create_dir_all(&self.folder)?;
        let file = self.folder.join(format!("{}.ron", self.name));
        fs::write(&file, FaultFile { faults: faults.to_vec() }.to_ron())?;
        let summary_file = self.folder.join(format!("{}.json", self.name));
        let program = std::env::current_exe()?;
        let log = fs::File::create(self.folder.join(format!("{}.log", self.name)))?;
        let command = |adopts: bool| -> Result<Command, Box<dyn Error>> {
            let mut command = Command::new(&program);
            command.args(["fly", "--run", &self.name]).args(&self.options);
            command.arg("--run-dir").arg(&self.folder).arg("--summary").arg(&summary_file);
            command.arg("--faults").arg(&file).stdin(Stdio::null()).stdout(Stdio::null()).stderr(log.try_clone()?);
            if adopts {
                command.arg("--adopt");
            }
            Ok(command)
        };
        let mut status = wait(command(false)?.spawn()?, &mut goes_on)?;
        let mut takeovers = 0;
        while status.signal() == Some(9) && takeovers < MOST_TAKEOVERS {
            takeovers += 1;
            status = wait(command(true)?.spawn()?, &mut goes_on)?;
        }
        // A flight that leaves no account has failed, whatever it flew.
        let text = fs::read_to_string(&summary_file).unwrap_or_default();
        let summary: Option<Summary> = serde_json::from_str(&text).ok();
        let verdict = summary.as_ref().map_or(Verdict::Failed, verdict);
        Ok(Flown { verdict, summary, leaked: leaked(&self.name)? })
    }

    /// The shortest list of faults that still fails, by leaving out ever smaller parts (delta debugging, Zeller 2002).
    /// Flights are not repeated to the bit: what fails only now and then may be shrunk to what does so less often.
    ///
    /// # Errors
    /// As for flying.
    pub(crate) fn shrink(&self, faults: &[Fault], mut tell: impl FnMut(usize)) -> Result<Vec<Fault>, Box<dyn Error>> {
        let (mut faults, mut parts, mut round) = (faults.to_vec(), 2, 0);
        while faults.len() > 1 {
            let size = faults.len().div_ceil(parts);
            let mut shorter = None;
            for start in (0..faults.len()).step_by(size) {
                let without = faults.iter().enumerate().filter(|(index, _)| !(start..start + size).contains(index));
                let without: Vec<Fault> = without.map(|(_, fault)| fault.clone()).collect();
                round += 1;
                let flight = Self { name: format!("{}-s{round}", self.name), ..self.clone() };
                if flight.fly(&without, || true)?.verdict == Verdict::Failed {
                    shorter = Some(without);
                    break;
                }
            }
            match shorter {
                Some(without) => (faults, parts) = (without, 2.max(parts - 1)),
                None if size == 1 => break,
                None => parts = (2 * parts).min(faults.len()),
            }
            tell(faults.len());
        }
        Ok(faults)
    }
}

/// Waits for a flight to end.
fn wait(mut child: Child, goes_on: &mut impl FnMut() -> bool) -> std::io::Result<ExitStatus> {
    loop {
        if let Some(status) = child.try_wait()? {
            return Ok(status);
        }
        if !goes_on() {
            if let Some(pid) = Pid::from_raw(child.id().cast_signed()) {
                // It may have ended in this moment.
                let _ = kill_process(pid, Signal::INT);
            }
            return child.wait();
        }
        std::thread::sleep(INTERVAL);
    }
}

fn verdict(summary: &Summary) -> Verdict {
    let waited = summary.faults.iter().filter_map(|fault| fault.clock_ratio).any(|ratio| ratio < CLOCK_RATIO);
    match summary.outcome {
        Outcome::Collided | Outcome::ProcessLost => Verdict::Failed,
        _ if waited => Verdict::Void,
        Outcome::Arrived => Verdict::Arrived,
        Outcome::HandedBack | Outcome::GaveUp => Verdict::Hovered,
        Outcome::TimedOut => Verdict::Late,
        Outcome::Interrupted => Verdict::Failed,
    }
}

/// Counts what a run that has ended left: shared memory, processes, zombies.
fn leaked(name: &str) -> Result<usize, Box<dyn Error>> {
    let (files, _) = RunDir::named(name)?.footprint();
    let own = std::process::id().cast_signed();
    let of_run = |process: &procfs::process::Process| {
        let is_zombie = process.stat().is_ok_and(|stat| stat.state == 'Z' && stat.ppid == own);
        let names_run = process.cmdline().is_ok_and(|line| line.iter().any(|argument| argument == name));
        process.pid() != own && (is_zombie || names_run)
    };
    let processes = all_processes()?.filter_map(Result::ok).filter(of_run).count();
    Ok(files as usize + processes)
}
