//! The memory process: expanded images and states in, keyframe set and flown path out.

use crate::graph::{DisparityGraph, Node};
use crate::{Config, FreeSpaceRule};
use ipc_types::messages::{Keyframe, PathPoint};
use ipc_types::pose_history::{PoseAt, PoseHistory};
use ipc_types::rig::CameraMount;
use ipc_types::topics::{Expanded, Keyframes, Path, State};
use ipc_types::{FlightTime, Point, ProcessId, StereoRig, World};
use runtime::{Connect, Message, Ports, Process, Report};

/// States remembered: four seconds of them at 100 Hz.
const STATES: usize = 400;
/// Spacing of the flown path, m.
const PATH_SPACING_M: f64 = 0.25;
/// Places of the flown path kept.
const PATH_LENGTH: usize = 400;

/// Connects a [`DisparityGraph`] to its topics.
#[derive(Debug)]
pub struct MemoryProcess {
    graph: DisparityGraph,
    states: PoseHistory,
    mount: CameraMount,
    pixels: usize,
    /// The newest image, whose exposure is still later than the newest state.
    pending: Option<(u64, FlightTime)>,
    path: Vec<Point<World>>,
    rule: FreeSpaceRule,
    started: bool,
    without_pose: u64,
    report: Report,
}

impl MemoryProcess {
    /// For a rig mounted on a vehicle.
    pub fn new(rig: StereoRig, mount: CameraMount, config: Config) -> Self {
        Self {
            graph: DisparityGraph::new(config.graph),
            states: PoseHistory::new(STATES),
            mount,
            pixels: rig.pixels(),
            pending: None,
            path: Vec::with_capacity(PATH_LENGTH),
            rule: config.free_space,
            started: false,
            without_pose: 0,
            report: Report::waiting("waiting for expanded images"),
        }
    }

    fn take_states(&mut self, ports: &mut impl Ports) {
        while let Some(state) = ports.receive::<State>() {
            let state = state.header();
            let Some(pose) = state.world_from_body() else {
                self.report.refuse("state is not finite");
                continue;
            };
            self.states.push(FlightTime::from_nanos(state.stamp.valid_ns), pose);
            let here = pose.origin();
            if self.path.last().is_none_or(|last| last.distance(here) >= PATH_SPACING_M.min(self.rule.swept_radius_m)) {
                if self.path.len() == PATH_LENGTH {
                    self.path.remove(0);
                }
                self.path.push(here);
            }
        }
    }

    /// Puts the newest expanded image into the store, where it waits for the pose of its exposure.
    fn take_image(&mut self, ports: &mut impl Ports) {
        let Some(image) = ports.latest::<Expanded>() else {
            return;
        };
        if image.elements().len() != 3 * self.pixels {
            self.report.refuse("expanded image is not of the rig's size");
            return;
        }
        let exposure = FlightTime::from_nanos(image.header().stamp.valid_ns);
        // Exposures are unique within a run and, unlike sequence numbers, across restarts.
        let id = image.header().stamp.valid_ns as u64;
        if let Some((superseded, _)) = self.pending.take().filter(|(pending, _)| *pending != id) {
            ports.images().remove(superseded);
            self.without_pose += 1;
        }
        match ports.images().put(id, image.elements()) {
            Ok(()) => self.pending = Some((id, exposure)),
            Err(_) => {
                self.report.refuse("cannot store a keyframe: shared memory is full");
            }
        }
    }

    fn publish(&mut self, ports: &mut impl Ports, exposure: FlightTime) {
        let nodes: Vec<Keyframe> = self.graph.nodes().map(describe).collect();
        let without_pose = self.without_pose;
        ports.publish::<Path>(exposure, self.path.len(), |_, points| {
            for (point, place) in points.iter_mut().zip(&self.path) {
                *point = PathPoint { position_m: place.to_array() };
            }
        });
        ports.publish::<Keyframes>(exposure, nodes.len(), |set, keyframes| {
            set.without_pose = without_pose;
            keyframes.copy_from_slice(&nodes);
        });
    }
}

fn describe(node: &Node) -> Keyframe {
    Keyframe {
        image_id: node.image_id,
        exposure_ns: node.exposure.as_nanos(),
        position_m: node.world_from_camera.origin().to_array(),
        orientation: node.world_from_camera.rotation.to_wxyz(),
    }
}

impl Process for MemoryProcess {
    const ID: ProcessId = ProcessId::Memory;

    fn connect(&self, connect: &mut impl Connect) {
        connect.reads::<State>();
        connect.reads::<Expanded>();
        connect.writes::<Keyframes>();
        connect.writes::<Path>();
    }

    fn step<P: Ports>(&mut self, ports: &mut P) -> Report {
        if !std::mem::replace(&mut self.started, true) {
            // What a predecessor left has lost its poses with it.
            ports.images().ids().into_iter().for_each(|id| ports.images().remove(id));
        }
        self.take_states(ports);
        self.take_image(ports);
        let Some((id, exposure)) = self.pending else {
            return self.report.idle();
        };
        match self.states.at(exposure) {
            PoseAt::NotYet => self.report.idle(),
            PoseAt::Forgotten => {
                ports.images().remove(id);
                (self.pending, self.without_pose) = (None, self.without_pose + 1);
                self.report.refuse("no state at the exposure of an image")
            }
            PoseAt::Known(world_from_body) => {
                self.pending = None;
                let world_from_camera = world_from_body * self.mount.body_from_camera();
                let node = Node { image_id: id, exposure, world_from_camera };
                self.graph.insert(node, |forgotten| ports.images().remove(forgotten));
                self.publish(ports, exposure);
                self.report.worked()
            }
        }
    }
}
