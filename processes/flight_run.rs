//! A flight over processes: starts or takes over the graph, and attends to it until the mission has ended.

use crate::config::FlightConfig;
use crate::crash;
use crate::display::{Display, why_not_ready};
use crate::graph_config::Member;
use crate::inject::Injector;
use crate::logging;
use crate::run_files::RunFiles;
use crate::run_record::{Account, Recordkeeper, RunRecord};
use crate::say::say;
use ipc_types::{HostTime, ProcessId};
use runtime::ipc::{IpcPorts, Services};
use runtime::run_dir::RunDir;
use runtime::{Ports, Process, host_now};
use sd_notify::NotifyState;
use std::error::Error;
use std::path::Path;
use std::time::Duration;
use supervisor::{
    ATTENTION, ChildCommand, ChildStatus, Criticality, DeathSummary, Happening, Mission, Outcome, Phase,
    ProcessSummary, RungSummary, SignalWatch, Summary, Supervision,
};

/// Between two signs of life to systemd: well below the unit's WatchdogSec.
const WATCHDOG_INTERVAL: Duration = Duration::from_millis(200);
/// Deaths that are remembered.
const MOST_DEATHS: usize = 10_000;

/// The command line of a child.
pub(crate) fn command(run: &RunDir, folder: &Path, member: &Member) -> std::io::Result<ChildCommand> {
    let process = member.process;
    let program = std::env::current_exe()?.display().to_string();
    let folder = folder.display().to_string();
    let own = std::process::id().to_string();
    let arguments =
        [program.as_str(), "process", process.name(), "--run", run.name(), "--run-dir", &folder, "--supervisor", &own];
    Ok(ChildCommand { process, arguments: arguments.map(str::to_owned).to_vec(), rule: member.rule })
}

/// A flight under way.
struct FlightRun<'a> {
    run: &'a RunDir,
    folder: &'a Path,
    mission: Mission,
    supervision: Supervision,
    record: Recordkeeper,
    injector: Injector,
    deaths: Vec<DeathSummary>,
    /// Under former supervisors.
    degradation: Vec<RungSummary>,
    is_ready: bool,
    notified: HostTime,
}

/// Flies; `before` is the record of a supervisor that died, whose run is taken over.
pub(crate) fn fly(
    config: &FlightConfig,
    run: &RunDir,
    files: &RunFiles,
    signals: SignalWatch,
    before: Option<&RunRecord>,
) -> Result<Summary, Box<dyn Error>> {
    // First of all: the children's lease runs.
    run.name_supervisor(std::process::id())?;
    let takeovers = before.map_or(0, |record| record.takeovers + 1);
    let _log = logging::begin(files.folder(), run.name(), ProcessId::Supervisor, takeovers);
    let services = Services::hold(run)?;
    let mut mission = Mission::new(config.mission.clone(), config.graph.ladder, config.graph.link);
    before.into_iter().for_each(|record| mission.resume(record.progress.clone(), record.step()));
    let mut ports = IpcPorts::open(run, ProcessId::Supervisor, takeovers, &config.vehicle.rig, |ports| {
        mission.connect(ports);
        ports.follow_flight_clock();
    })?;
    let commands = config.graph.flying().map(|member| command(run, files.folder(), member));
    let commands = commands.collect::<std::io::Result<Vec<_>>>()?;
    // A process of which no flight has one: it is to be refused for its version, not for being the second.
    let player = config.graph.processes.first().map(|member| Member { process: ProcessId::Player, ..member.clone() });
    let intruder = player.map(|player| command(run, files.folder(), &player)).transpose()?;
    let intruder = intruder.map_or(Vec::new(), |command| command.arguments);
    let from_s = before.map_or(f64::NEG_INFINITY, |record| record.flight_s);
    let account = before.map(|record| record.account.clone()).unwrap_or_default();
    let orphans = before.map_or(&[][..], |record| &record.orphans);
    let mut flight = FlightRun {
        run,
        folder: files.folder(),
        mission,
        supervision: Supervision::start(run, commands, signals, orphans),
        record: Recordkeeper::new(run, files.folder().to_owned(), takeovers),
        injector: Injector::new(run, &config.vehicle.rig, &config.faults, from_s, account.faults, intruder),
        deaths: account.deaths,
        degradation: account.degradation,
        is_ready: false,
        notified: HostTime::ZERO,
    };
    let mut display = Display::new(config.mission.goal());
    while flight.mission.outcome().is_none() {
        let children = flight.attend(&services, &mut ports);
        display.show(&flight.mission, &children);
    }
    display.clear();
    Ok(flight.end(&services))
}

impl FlightRun<'_> {
    /// One round: what was heard, what happened, what is due. Returns the children after it.
    fn attend(&mut self, services: &Services, ports: &mut IpcPorts) -> Vec<ChildStatus> {
        ports.refresh();
        self.mission.step(ports);
        ports.serve_late_subscribers();
        self.mission.take_heartbeats().iter().for_each(|health| self.supervision.heard(health));
        for stamp in self.mission.take_outputs() {
            self.record.count(stamp.producer);
            self.supervision.saw_output(&stamp);
        }
        let before = self.supervision.status();
        let happenings = self.supervision.attend(services, ATTENTION);
        happenings.iter().for_each(|happening| self.tell(happening, &before));
        let children = self.supervision.status();
        self.mission.see_processes(&children);
        let is_urgent = self.mission.take_news() || !happenings.is_empty() || self.injector.is_last_round();
        let (injector, deaths) = (&self.injector, &self.deaths);
        let degradation = || self.degradation.iter().chain(self.mission.recorder().degradation()).cloned().collect();
        let account = || Account { faults: injector.injected(), deaths: deaths.clone(), degradation: degradation() };
        self.record.keep(&self.mission, &self.supervision, account, is_urgent);
        self.injector.inject(&self.mission, &children);
        self.notify_systemd(&children);
        if ports.now().as_secs_f64() > 0.0 && self.mission.outcome().is_some() {
            tracing::info!(flight_s = ports.now().as_secs_f64(), outcome = ?self.mission.outcome(), "the mission has ended");
        }
        children
    }

    /// Says what happened: to whoever watches, in the run's log, and in a crash report.
    fn tell(&mut self, happening: &Happening, before: &[ChildStatus]) {
        let flight_s = self.mission.now().as_secs_f64();
        match happening {
            Happening::Started(child, incarnation) => {
                tracing::info!(flight_s, child = child.name(), incarnation, "started");
            }
            Happening::Died(child, how, wait) => {
                say(format_args!("{child} {how}: restarting it"));
                tracing::warn!(flight_s, child = child.name(), how, wait_ms = wait.as_millis() as u64, "died");
                self.report(*child, how, before);
                self.note_death(*child, how);
            }
            Happening::Recovered(child, after) => {
                let after_ms = 1e3 * after.as_secs_f64();
                tracing::info!(flight_s, child = child.name(), after_ms, "recovered");
                self.note_recovery(*child, after_ms);
            }
            Happening::Ended(child, why) => {
                tracing::warn!(flight_s, child = child.name(), why, "killed");
            }
            Happening::GaveUp(child, why) => {
                say(format_args!("{child} {why}: given up"));
                tracing::error!(flight_s, child = child.name(), why, "given up");
                self.note_death(*child, why);
                self.report(*child, why, before);
            }
            Happening::RunEnded(child, how) => {
                say(format_args!("{child} {how}: the run is over"));
                tracing::error!(flight_s, child = child.name(), how, "the run is over");
                self.report(*child, how, before);
                self.mission.end(Outcome::ProcessLost);
            }
            Happening::Signal(number) => {
                tracing::info!(flight_s, number, "signal");
                self.mission.end(Outcome::Interrupted);
            }
        }
    }

    fn note_death(&mut self, process: ProcessId, how: &str) {
        if self.deaths.len() < MOST_DEATHS {
            self.deaths.push(DeathSummary {
                at_s: self.mission.now().as_secs_f64(),
                process: process.name().to_owned(),
                how: how.to_owned(),
                recovered_ms: None,
            });
        }
    }

    /// Who died again before it had made anything recovered once.
    fn note_recovery(&mut self, process: ProcessId, after_ms: f64) {
        let unrecovered = |death: &&mut DeathSummary| death.process == process.name() && death.recovered_ms.is_none();
        if let Some(death) = self.deaths.iter_mut().rfind(unrecovered) {
            death.recovered_ms = Some(after_ms);
        }
    }

    fn report(&self, process: ProcessId, how: &str, before: &[ChildStatus]) {
        let flight_s = self.mission.now().as_secs_f64();
        let died = before.iter().find(|child| child.process == process);
        let written = died.map(|died| crash::report_death(self.run, self.folder, died, how, flight_s));
        if let Some(Err(error)) = written {
            tracing::warn!(flight_s, %error, "no crash report");
        }
    }

    /// Readiness once every process has been heard, and that this loop goes round.
    fn notify_systemd(&mut self, children: &[ChildStatus]) {
        let is_up = |child: &ChildStatus| {
            let is_spared = child.criticality == Criticality::Spare && matches!(child.phase, Phase::GivenUp(_));
            child.phase == Phase::Running || is_spared
        };
        if !self.is_ready && children.iter().all(is_up) {
            self.is_ready = true;
            // Without systemd there is nobody to tell.
            let _ = sd_notify::notify(&[NotifyState::Ready, NotifyState::Status("flying")]);
        }
        let now = host_now();
        if now.saturating_since(self.notified) >= WATCHDOG_INTERVAL {
            self.notified = now;
            let _ = sd_notify::notify(&[NotifyState::Watchdog]);
        }
    }

    fn end(mut self, services: &Services) -> Summary {
        if self.mission.truth().is_none_or(|truth| truth.airborne == 0) {
            say(format_args!("never took off: {}", why_not_ready(&self.supervision.status())));
        }
        let _ = sd_notify::notify(&[NotifyState::Stopping]);
        let children = self.supervision.stop(services);
        let mut summary = self.mission.summary();
        summary.processes = children.iter().map(|child| ProcessSummary::of(child, &self.deaths)).collect();
        summary.restarts = children.iter().map(|child| child.restarts).sum();
        summary.takeovers = self.record.takeovers();
        summary.degradation.splice(0..0, std::mem::take(&mut self.degradation));
        summary.deaths = std::mem::take(&mut self.deaths);
        summary.faults = self.injector.summary();
        summary.processes.push(ProcessSummary::supervisor());
        summary
    }
}
