//! The record of a run, in shared memory: what `status` shows, and what the next supervisor must know if this one dies.

use crate::inject::Injected;
use ipc_types::messages::{HealthLevel, Rung};
use ipc_types::{HostTime, ProcessId};
use runtime::host_now;
use runtime::run_dir::RunDir;
use serde::{Deserialize, Serialize};
use std::collections::HashMap;
use std::path::PathBuf;
use supervisor::{
    ChildStatus, DeathSummary, LatencySummary, Mission, Orphan, Phase, Progress, RungSummary, Step, Supervision, Usage,
};

/// A process as the record has it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct ProcessRecord {
    pub(crate) process: String,
    pub(crate) pid: Option<u32>,
    pub(crate) state: String,
    pub(crate) incarnation: u32,
    pub(crate) restarts: u32,
    /// Host time of the last heartbeat, ns.
    pub(crate) beat_ns: Option<i64>,
    /// Outputs a second, over the last second or so.
    pub(crate) rate_hz: f64,
    /// From input to output.
    pub(crate) latency: LatencySummary,
    pub(crate) missed: u64,
    pub(crate) refused: u64,
    pub(crate) usage: Option<Usage>,
    pub(crate) health: String,
    pub(crate) note: String,
}

/// What happened so far, for whoever takes over.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct Account {
    pub(crate) faults: Vec<Injected>,
    pub(crate) deaths: Vec<DeathSummary>,
    pub(crate) degradation: Vec<RungSummary>,
}

/// See the module's documentation.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct RunRecord {
    pub(crate) run: String,
    /// The run directory.
    pub(crate) folder: PathBuf,
    pub(crate) supervisor: u32,
    pub(crate) takeovers: u32,
    /// Host time of this record, ns.
    pub(crate) written_ns: i64,
    pub(crate) flight_s: f64,
    pub(crate) progress: Progress,
    pub(crate) rung: String,
    pub(crate) speed_share: f64,
    pub(crate) reason: String,
    pub(crate) mode: String,
    pub(crate) orphans: Vec<Orphan>,
    /// The account so far: what was injected, who died, where the flight stood.
    pub(crate) account: Account,
    pub(crate) processes: Vec<ProcessRecord>,
}

impl RunRecord {
    /// Reads a run's record.
    ///
    /// # Errors
    /// There is none, or it is of another version.
    pub(crate) fn read(run: &RunDir) -> Result<Self, String> {
        let text = run.read_record().map_err(|error| format!("run \"{}\": no record: {error}", run.name()))?;
        serde_json::from_slice(&text)
            .map_err(|error| format!("run \"{}\": record of another version: {error}", run.name()))
    }

    /// Where the flight stood on the ladder.
    pub(crate) fn step(&self) -> Step {
        Step {
            rung: Rung::from_name(&self.rung).unwrap_or(Rung::Hover),
            speed_share: self.speed_share,
            reason: self.reason.clone(),
        }
    }

    /// Age of the record, s.
    pub(crate) fn age_s(&self) -> f64 {
        host_now().seconds_since(HostTime::from_nanos(self.written_ns))
    }
}

/// Writes the record of a run, often enough to be watched.
#[derive(Debug)]
pub(crate) struct Recordkeeper {
    run: RunDir,
    folder: PathBuf,
    takeovers: u32,
    written: HostTime,
    /// Outputs counted by process since then.
    counted: HashMap<u32, u64>,
    counting_since: HostTime,
    rates: HashMap<u32, f64>,
    /// What the supervisor itself uses, when that was asked for, and its processor time then.
    own: Option<Usage>,
    own_at: HostTime,
    own_ticks: u64,
    /// Whether the last record could not be written.
    has_failed: bool,
}

/// Host time between records, s.
const INTERVAL_S: f64 = 0.2;
/// Host time over which rates are counted, s.
const RATE_S: f64 = 1.0;

impl Recordkeeper {
    pub(crate) fn new(run: &RunDir, folder: PathBuf, takeovers: u32) -> Self {
        let now = host_now();
        Self {
            run: run.clone(),
            folder,
            takeovers,
            written: HostTime::ZERO,
            counted: HashMap::new(),
            counting_since: now,
            rates: HashMap::new(),
            own: None,
            own_at: HostTime::ZERO,
            own_ticks: 0,
            has_failed: false,
        }
    }

    pub(crate) fn takeovers(&self) -> u32 {
        self.takeovers
    }

    /// Counts an output.
    pub(crate) fn count(&mut self, producer: u32) {
        *self.counted.entry(producer).or_default() += 1;
    }

    /// Writes a record if one is due, or `is_urgent`: something has happened that a successor must know.
    pub(crate) fn keep(
        &mut self,
        mission: &Mission,
        supervision: &Supervision,
        account: impl FnOnce() -> Account,
        is_urgent: bool,
    ) {
        let now = host_now();
        let since_s = now.seconds_since(self.counting_since);
        if since_s >= RATE_S {
            self.rates = self.counted.drain().map(|(producer, count)| (producer, count as f64 / since_s)).collect();
            self.counting_since = now;
        }
        let sampled = now.saturating_since(self.own_at);
        if sampled.as_secs_f64() >= RATE_S {
            (self.own, self.own_at) = (Usage::own(&mut self.own_ticks, sampled), now);
        }
        if !is_urgent && now.seconds_since(self.written) < INTERVAL_S {
            return;
        }
        self.written = now;
        let process = |child: &ChildStatus| self.process(mission, child);
        let record = RunRecord {
            run: self.run.name().to_owned(),
            folder: self.folder.clone(),
            supervisor: std::process::id(),
            takeovers: self.takeovers,
            written_ns: now.as_nanos(),
            flight_s: mission.now().as_secs_f64(),
            progress: mission.progress(),
            rung: mission.rung().rung.name().to_owned(),
            speed_share: mission.rung().speed_share,
            reason: mission.rung().reason.clone(),
            mode: mission.plan_mode().to_string(),
            orphans: supervision.orphans(),
            account: account(),
            processes: supervision.status().iter().map(process).chain([self.supervisor()]).collect(),
        };
        let written =
            serde_json::to_vec(&record).map_err(std::io::Error::from).and_then(|json| self.run.write_record(&json));
        if let Err(error) = &written
            && !self.has_failed
        {
            // The flight goes on; but whoever would take it over has an older record.
            tracing::warn!(%error, "no record of the run");
        }
        self.has_failed = written.is_err();
    }

    /// The supervisor's own line.
    fn supervisor(&self) -> ProcessRecord {
        ProcessRecord {
            process: ProcessId::Supervisor.name().to_owned(),
            pid: Some(std::process::id()),
            state: "running".to_owned(),
            incarnation: self.takeovers,
            restarts: self.takeovers,
            beat_ns: Some(self.written.as_nanos()),
            rate_hz: 0.0,
            latency: LatencySummary::default(),
            missed: 0,
            refused: 0,
            usage: self.own,
            health: "ok".to_owned(),
            note: String::new(),
        }
    }

    fn process(&self, mission: &Mission, child: &ChildStatus) -> ProcessRecord {
        let health = child.health;
        ProcessRecord {
            process: child.process.name().to_owned(),
            pid: child.pid,
            state: match &child.phase {
                Phase::Stopped => "stopped".to_owned(),
                Phase::Starting => "starting".to_owned(),
                Phase::Running => "running".to_owned(),
                Phase::Ending { .. } => "ending".to_owned(),
                Phase::BackingOff(_) => "backing off".to_owned(),
                Phase::GivenUp(why) => format!("given up: {why}"),
            },
            incarnation: child.incarnation,
            restarts: child.restarts,
            beat_ns: child.beat_at.map(|at| at.as_nanos()),
            rate_hz: self.rates.get(&(child.process as u32)).copied().unwrap_or_default(),
            latency: mission.recorder().stage(child.process.name()),
            missed: health.map_or(0, |health| health.missed),
            refused: health.map_or(0, |health| health.dropped),
            usage: child.usage,
            health: match health.map(|health| HealthLevel::from_wire(health.level)) {
                None => "-",
                Some(HealthLevel::Ok) => "ok",
                Some(HealthLevel::Degraded) => "degraded",
                Some(HealthLevel::Faulted) => "faulted",
            }
            .to_owned(),
            note: health.map(|health| health.note.to_string_lossy()).unwrap_or_default(),
        }
    }
}
