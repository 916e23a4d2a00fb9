//! The process graph as configured: which processes run, what their deaths mean, and how long their steps take in
//! lockstep.

use bridge::BridgeConfig;
use ipc_types::ProcessId;
use ipc_types::bounds::Bounds;
use recorder::RecorderConfig;
use runtime::Resources;
use runtime::lockstep::LatencyModel;
use serde::{Deserialize, Serialize};
use supervisor::{Criticality, LadderConfig, LinkConfig, Rule};

/// A process of the graph.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Member {
    /// Which.
    pub process: ProcessId,
    /// What it is worth, and how it is brought back.
    pub rule: Rule,
    /// What it may use of the machine.
    pub resources: Resources,
}

/// The process graph.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GraphConfig {
    /// The processes, in order of start.
    pub processes: Vec<Member>,
    /// How long a process lives on after its supervisor has died, s.
    pub lease_s: f64,
    /// How far a flight is scaled down for what does not work.
    pub ladder: LadderConfig,
    /// Who commands, and what follows when he is not heard any more.
    pub link: LinkConfig,
    /// Whom the vehicle talks to, and how much; nobody, and no bridge is started.
    pub bridge: BridgeConfig,
    /// How much is recorded into how many files.
    pub recorder: RecorderConfig,
    /// Latencies of the lockstep driver.
    pub latency: LatencyModel,
}

/// Without these nothing flies.
const NEEDED: [ProcessId; 6] = [
    ProcessId::Simulator,
    ProcessId::StereoIngest,
    ProcessId::Expansion,
    ProcessId::Memory,
    ProcessId::Planner,
    ProcessId::Controller,
];

impl GraphConfig {
    /// The processes that make something of a frame, whoever delivers it: without world and vehicle, and those who fly it.
    pub(crate) fn digesting(&self) -> impl Iterator<Item = Member> {
        use ProcessId::{Bridge, Controller, Planner, Simulator};
        let flies = |process| matches!(process, Simulator | Planner | Controller | Bridge);
        self.processes.iter().filter(move |member| !flies(member.process)).cloned()
    }

    /// A process that stands for the world: where it cannot go on, the run ends.
    pub(crate) fn in_place_of_the_world(&self, process: ProcessId) -> Option<Member> {
        let world = self.processes.iter().find(|member| member.process == ProcessId::Simulator);
        world.map(|world| Member { process, ..world.clone() })
    }

    /// The processes of a flight.
    pub(crate) fn flying(&self) -> impl Iterator<Item = &Member> {
        self.processes.iter().filter(|member| member.process != ProcessId::Bridge || self.bridge.is_on())
    }

    /// What a process may use of the machine; all of it for one that is no member.
    pub(crate) fn resources(&self, process: ProcessId) -> Resources {
        let member = self.processes.iter().find(|member| member.process == process);
        member.map(|member| member.resources.clone()).unwrap_or_default()
    }

    pub(crate) fn check(&self, bounds: &mut Bounds) {
        bounds.range("lease_s", self.lease_s, 0.0..=60.0);
        bounds.section("ladder", |bounds| self.ladder.check(bounds));
        bounds.section("link", |bounds| self.link.check(bounds));
        bounds.section("bridge", |bounds| self.bridge.check(bounds));
        bounds.section("recorder", |bounds| self.recorder.check(bounds));
        bounds.section("latency", |bounds| self.latency.check(bounds));
        bounds.section("processes", |bounds| {
            let times = |process| self.processes.iter().filter(|member| member.process == process).count();
            for process in NEEDED {
                bounds.require(times(process) > 0, process.name(), "is not listed, and nothing flies without it");
            }
            for member in &self.processes {
                let name = member.process.name();
                bounds.require(times(member.process) == 1, name, "is listed more than once");
                let is_child = !matches!(member.process, ProcessId::Supervisor | ProcessId::Player | ProcessId::Camera);
                bounds.require(is_child, name, "is not a process that a flight starts");
                // A world that begins anew under a vehicle in flight is another world.
                let is_world = member.process == ProcessId::Simulator;
                let is_called_world = member.rule.criticality == Criticality::World;
                let message =
                    "is the world if, and only if, it is the simulator: expected criticality world there alone";
                bounds.require(is_world == is_called_world, name, message);
                bounds.section(name, |bounds| {
                    bounds.section("rule", |bounds| member.rule.check(bounds));
                    bounds.section("resources", |bounds| member.resources.check(bounds));
                });
            }
        });
    }
}

#[cfg(test)]
mod tests {
    use crate::config::FlightConfig;
    use supervisor::Criticality;

    #[test]
    fn graphs_that_cannot_fly_are_named() {
        let config = FlightConfig::load(None, None).expect("loads");
        let complaint = |change: fn(&mut super::GraphConfig)| {
            let mut config = config.clone();
            change(&mut config.graph);
            config.check().expect_err("impossible").to_string()
        };
        assert!(
            complaint(|graph| graph.processes.retain(|member| member.process.name() != "memory")).contains("memory")
        );
        assert!(complaint(|graph| graph.processes.push(graph.processes[0].clone())).contains("more than once"));
        assert!(
            complaint(|graph| graph
                .processes
                .iter_mut()
                .for_each(|member| member.rule.criticality = Criticality::Flight))
            .contains("simulator")
        );
        assert!(complaint(|graph| graph.latency.0.push(graph.latency.0[0])).contains("more than once"));
    }
}
