//! The memory process: expanded images and states in, keyframe set and flown path out.
//!
//! Images lie in the store that outlives it, and so does a record of the graph: a successor goes on with all keyframes but,
//! at most, the one that was being taken.

use crate::Config;
use crate::frozen::{Frozen, digest};
use crate::graph::{DisparityGraph, GraphRule, Node};
use crate::record::{self, LastState, describe};
use ipc_types::messages::{ExpandedLayout, Keyframe, Order, PathPoint};
use ipc_types::pose_history::{PoseAt, PoseHistory};
use ipc_types::rig::CameraMount;
use ipc_types::topics::{Answers, Expanded, Keyframes, Path, State};
use ipc_types::wire::{Stamp, Text};
use ipc_types::{Body, FlightTime, Point, Pose, ProcessId, World};
use runtime::images::{ImageStore, checksum};
use runtime::{Connect, Message, Ports, Process, Report};
use std::io::ErrorKind;

/// Where its record lies, as the image store takes it.
const RECORD: u64 = ImageStore::estate(ProcessId::Memory);
/// States remembered: a minute of them at 100 Hz, so that later corrections find the keyframes they concern.
const STATES: usize = 6000;
/// Between two states the vehicle moves no more than this, m and m/s, however long that is: else the estimate has jumped.
const JUMP: (f64, f64) = (2.0, 60.0);
const LONGEST_S: f64 = 0.5;
/// What was asked for longer ago than this was heeded by a predecessor, s.
const ASKED_S: f64 = 1.0;
/// A late state that has turned by more than this is no correction, rad.
const TURN_RAD: f64 = 0.5;
/// Corrections that add up to this make the path flown another, m.
const CORRECTION_M: f64 = 0.05;
/// Nothing is so much newer than its publication or, of a predecessor's keyframes, than the newest state, s.
const AHEAD_S: f64 = 1.0;
/// Spacing of the flown path, m.
const PATH_SPACING_M: f64 = 0.25;
/// Places of the flown path kept.
const PATH_LENGTH: usize = 400;

/// Connects a [`DisparityGraph`] to its topics.
#[derive(Debug)]
pub struct MemoryProcess {
    graph: DisparityGraph,
    graph_rule: GraphRule,
    forget_s: f64,
    states: PoseHistory,
    state: LastState,
    mount: CameraMount,
    layout: ExpandedLayout,
    radius_m: f32,
    /// The newest image, whose exposure is still later than the newest state.
    pending: Option<(u64, FlightTime)>,
    /// What identifies it, and whether the camera is frozen.
    digest: Option<u64>,
    /// Keyframes were given up for want of room.
    is_shed: bool,
    frozen: Frozen,
    path: Vec<Point<World>>,
    swept_radius_m: f64,
    started: bool,
    /// Whether a predecessor's graph is still to be published.
    is_restored: bool,
    lost: Lost,
    record: Vec<u16>,
    /// Exposure of the newest node that was published.
    valid: FlightTime,
    /// How far late states have moved what was known, since the path was last cleared, m.
    corrected_m: f64,
    /// The last command to clear the map that was heeded: by whom, and its number.
    cleared: Option<(Text, u64)>,
    /// Images that are no nodes any more, to be removed once that is known.
    forgotten: Vec<u64>,
    report: Report,
}

/// What states have brought.
#[derive(Clone, Copy, Debug, Default)]
struct News {
    /// Something earlier was corrected.
    corrected: bool,
    /// The path flown is not known any more.
    cleared: bool,
    /// The map begins anew.
    jumped: bool,
}

/// What could not be used, by reason.
#[derive(Clone, Copy, Debug, Default)]
struct Lost {
    without_pose: u64,
    late: u64,
    misfits: u64,
    not_stored: u64,
    jumps: u64,
}

/// Whether a message claims to be of the future: all that comes after it would be late. By its publisher's clock, for this
/// process may have been stopped; a publisher that has not heard the flight's time yet has none.
fn is_of_the_future(stamp: &Stamp) -> bool {
    stamp.published_ns > 0
        && FlightTime::from_nanos(stamp.valid_ns).seconds_since(FlightTime::from_nanos(stamp.published_ns)) > AHEAD_S
}

impl MemoryProcess {
    /// For a rig mounted on a vehicle, whose images are expanded so.
    pub fn new(layout: ExpandedLayout, radius_m: f32, mount: CameraMount, config: Config) -> Self {
        Self {
            graph: DisparityGraph::new(config.graph, config.forget_s),
            graph_rule: config.graph,
            forget_s: config.forget_s,
            states: PoseHistory::new(STATES),
            state: None,
            mount,
            layout,
            radius_m,
            pending: None,
            digest: None,
            is_shed: false,
            frozen: Frozen::default(),
            path: Vec::with_capacity(PATH_LENGTH),
            swept_radius_m: config.free_space.swept_radius_m,
            started: false,
            is_restored: false,
            lost: Lost::default(),
            record: Vec::new(),
            valid: FlightTime::from_nanos(0),
            corrected_m: 0.0,
            cleared: None,
            forgotten: Vec::new(),
            report: Report::waiting("waiting for expanded images"),
        }
    }

    /// Takes up what a predecessor held. Returns whether there was anything.
    fn restore(&mut self, ports: &mut impl Ports) -> bool {
        let record = ports.images().get(RECORD).and_then(|stored| record::read(&stored));
        if let Some(record) = record {
            let images = ports.images();
            let elements = self.layout.elements();
            // Reading an image checks that it is whole.
            let is_ahead = |at: FlightTime| record.state.is_none_or(|(last, _)| at.seconds_since(last) > AHEAD_S);
            let is_there = |node: &Node| {
                let is_sound = node.image_id == node.exposure.as_nanos() as u64 && !is_ahead(node.exposure);
                is_sound && images.get(node.image_id).is_some_and(|image| image.len() == elements)
            };
            let parts = (record.newest, &record.keyframes[..], &record.recent[..]);
            self.graph = DisparityGraph::restored(self.graph_rule, self.forget_s, parts, is_there);
            // What a camera that is frozen by now shows again.
            if let Some((newest, image)) = self.graph.newest().and_then(|node| Some((node, images.get(node.image_id)?)))
            {
                self.frozen =
                    Frozen::since(digest(&image, self.layout.cells(), checksum(&image)), newest.world_from_camera);
            }
            self.path.extend(record.path.into_iter().take(PATH_LENGTH));
            self.state = record.state;
        }
        let held: Vec<u64> = self.graph.nodes().map(|node| node.image_id).collect();
        ports.images().remove_unfinished();
        let ids = ports.images().ids();
        ids.into_iter().filter(|id| !held.contains(id)).for_each(|id| ports.images().remove(id));
        self.graph.newest().is_some()
    }

    /// Takes the states that have arrived.
    fn take_states(&mut self, ports: &mut impl Ports) -> News {
        let mut news = News::default();
        while let Some(state) = ports.receive::<State>() {
            let state = state.header();
            let Some(pose) = state.world_from_body() else {
                self.report.refuse("state is not finite");
                continue;
            };
            let (at, here) = (FlightTime::from_nanos(state.stamp.valid_ns), pose.origin());
            if is_of_the_future(&state.stamp) {
                self.lost.late += 1;
                self.report.refuse("a state claims to come from the future");
                continue;
            }
            match self.state {
                // The first state after a restart is the newest, whatever the record says.
                Some((last, _)) if at <= last && !self.states.is_empty() => self.correct(at, pose, &mut news),
                Some((last, there))
                    if there.distance(here) > JUMP.0 + JUMP.1 * at.seconds_since(last).clamp(0.0, LONGEST_S) =>
                {
                    self.begin_anew();
                    news.jumped = true;
                    self.remember(at, pose);
                }
                _ => self.remember(at, pose),
            }
        }
        news
    }

    /// Takes the newest state.
    fn remember(&mut self, at: FlightTime, pose: Pose<World, Body>) {
        let here = pose.origin();
        self.state = Some((at, here));
        self.states.push(at, pose);
        if self.path.last().is_none_or(|last| last.distance(here) >= PATH_SPACING_M.min(self.swept_radius_m)) {
            if self.path.len() == PATH_LENGTH {
                self.path.remove(0);
            }
            self.path.push(here);
        }
    }

    /// Takes a state that comes late, or for the second time.
    fn correct(&mut self, at: FlightTime, pose: Pose<World, Body>, news: &mut News) {
        // What is older than all that is remembered concerns no keyframe whose pose is known any more.
        let PoseAt::Known(known) = self.states.at(at) else {
            self.lost.late += 1;
            self.report.refuse("a state is older than all that is remembered");
            return;
        };
        let off_m = known.origin().distance(pose.origin());
        if off_m > JUMP.0 || known.rotation.angle_to(pose.rotation) > TURN_RAD {
            self.lost.jumps += 1;
            self.report.refuse("a late state is far from where the vehicle was");
            return;
        }
        self.corrected_m += off_m;
        if self.corrected_m > CORRECTION_M {
            // Which of its places have moved is not known any more, and none may be called free where nobody was.
            self.path.clear();
            (self.corrected_m, news.cleared) = (0.0, true);
        }
        self.states.push(at, pose);
        news.corrected = true;
    }

    /// The estimate has jumped: where the keyframes were taken is not known any more.
    fn begin_anew(&mut self) {
        self.lost.jumps += 1;
        let forgotten = &mut self.forgotten;
        self.graph.clear(|id| forgotten.push(id));
        self.states = PoseHistory::new(STATES);
        self.path.clear();
        self.report.refuse("the estimate of the pose has jumped: the map begins anew");
    }

    /// Forgets what was seen, but for where the vehicle flew by, if an operator asks for that.
    fn clear_if_asked(&mut self, ports: &mut impl Ports) -> bool {
        let mut is_asked = false;
        while let Some(answer) = ports.receive::<Answers>() {
            let answer = *answer.header();
            let age_s = ports.now().seconds_since(FlightTime::from_nanos(answer.stamp.published_ns));
            let is_followed = answer.accepted == 1 && answer.order == Order::ClearMap as u32;
            if is_followed && age_s < ASKED_S {
                // A command that comes twice is answered twice.
                let command = (answer.operator, answer.number);
                is_asked |= self.cleared.replace(command) != Some(command);
            }
        }
        if is_asked {
            let forgotten = &mut self.forgotten;
            self.graph.clear(|id| forgotten.push(id));
        }
        is_asked
    }

    /// Puts the newest expanded image into the store, where it waits for the pose of its exposure.
    fn take_image(&mut self, ports: &mut impl Ports) {
        let Some(image) = ports.latest::<Expanded>() else {
            return;
        };
        let header = image.header();
        let fits = header.expanded_layout() == Some(self.layout)
            && header.radius_m == self.radius_m
            && image.elements().len() == self.layout.elements();
        if !fits {
            self.lost.misfits += 1;
            self.report.refuse("expanded image is not of the configured rig, margin, layers and radius");
            return;
        }
        let exposure = FlightTime::from_nanos(header.stamp.valid_ns);
        // Exposures are unique within a run and, unlike sequence numbers, across restarts.
        let id = header.stamp.valid_ns as u64;
        if is_of_the_future(&header.stamp) {
            self.lost.late += 1;
            self.report.refuse("an expanded image claims to come from the future");
            return;
        }
        let newest = self.pending.map(|(_, exposure)| exposure).max(self.graph.newest().map(|node| node.exposure));
        if newest.is_some_and(|newest| exposure <= newest) || header.stamp.valid_ns < 0 {
            self.lost.late += 1;
            self.report.refuse("expanded image is not newer than the one before");
            return;
        }
        if let Some((superseded, _)) = self.pending.take() {
            ports.images().remove(superseded);
            self.lost.without_pose += 1;
            self.report.refuse("no state at the exposure of an image");
        }
        match ports.images().put(id, image.elements()) {
            Ok(checksum) => {
                self.pending = Some((id, exposure));
                self.digest = digest(image.elements(), self.layout.cells(), checksum);
            }
            Err(error) if error.kind() != ErrorKind::StorageFull => {
                self.lost.not_stored += 1;
                self.report.refuse("cannot store a keyframe: its file cannot be written");
            }
            Err(_) => {
                self.lost.not_stored += 1;
                self.report.refuse("cannot store a keyframe: shared memory is full");
                // Rather a poor map of now than a rich one of then: the next one will find room, once whoever reads those
                // that go has learned of it.
                let forgotten = &mut self.forgotten;
                self.is_shed |= self.graph.shed(|id| forgotten.push(id));
            }
        }
    }

    /// Adds the pending image to the graph, if its pose is known. Returns whether the graph has changed.
    fn place_image(&mut self, ports: &mut impl Ports) -> bool {
        let Some((id, exposure)) = self.pending else { return false };
        match self.states.at(exposure) {
            PoseAt::NotYet => false,
            PoseAt::Forgotten => {
                ports.images().remove(id);
                self.pending = None;
                self.lost.without_pose += 1;
                self.report.refuse("no state at the exposure of an image");
                false
            }
            PoseAt::Known(body) if self.frozen.is_frozen(self.digest, body * self.mount.body_from_camera()) => {
                ports.images().remove(id);
                self.pending = None;
                self.report.refuse("the camera is frozen: the same image from elsewhere");
                false
            }
            PoseAt::Known(world_from_body) => {
                self.pending = None;
                let world_from_camera = world_from_body * self.mount.body_from_camera();
                let node = Node { image_id: id, exposure, world_from_camera };
                let forgotten = &mut self.forgotten;
                self.graph.insert(node, |id| forgotten.push(id))
            }
        }
    }

    fn publish(&mut self, ports: &mut impl Ports) {
        // Without a node it is as old as the last one.
        self.valid = self.graph.newest().map_or(self.valid, |node| node.exposure);
        let valid = self.valid;
        // First of all, so that a successor knows what was published; what is no node any more goes last.
        record::write(&self.graph, &self.path, self.state, &mut self.record);
        if ports.images().put(RECORD, &self.record).is_err() {
            self.lost.not_stored += 1;
        }
        let nodes: Vec<Keyframe> = self.graph.nodes().map(describe).collect();
        let lost = self.lost;
        ports.publish::<Path>(valid, self.path.len(), |_, points| {
            for (point, place) in points.iter_mut().zip(&self.path) {
                *point = PathPoint { position_m: place.to_array() };
            }
        });
        ports.publish::<Keyframes>(valid, nodes.len(), |set, keyframes| {
            (set.without_pose, set.late, set.misfits) = (lost.without_pose, lost.late, lost.misfits);
            (set.not_stored, set.jumps) = (lost.not_stored, lost.jumps);
            keyframes.copy_from_slice(&nodes);
        });
        self.forgotten.drain(..).for_each(|id| ports.images().remove(id));
    }
}

impl Process for MemoryProcess {
    const ID: ProcessId = ProcessId::Memory;

    fn connect(&self, connect: &mut impl Connect) {
        connect.reads::<State>();
        connect.reads::<Expanded>();
        connect.reads::<Answers>();
        connect.writes::<Keyframes>();
        connect.writes::<Path>();
    }

    fn step<P: Ports>(&mut self, ports: &mut P) -> Report {
        if !std::mem::replace(&mut self.started, true) {
            self.is_restored = self.restore(ports);
        }
        let news = self.take_states(ports);
        // An empty map is published once, so that nobody goes on with the old one; it is as old as what it says.
        let mut changed = news.jumped || news.cleared && self.graph.newest().is_some();
        changed |= self.clear_if_asked(ports);
        if news.corrected {
            let (states, mount) = (&self.states, self.mount.body_from_camera());
            let pose_at = |exposure| match states.at(exposure) {
                PoseAt::Known(world_from_body) => Some(world_from_body * mount),
                PoseAt::NotYet | PoseAt::Forgotten => None,
            };
            changed |= self.graph.correct(pose_at) > 0;
        }
        // With the first state the flight's time is known, too.
        changed |= !self.states.is_empty() && std::mem::take(&mut self.is_restored);
        self.take_image(ports);
        changed |= std::mem::take(&mut self.is_shed);
        changed |= self.place_image(ports);
        if !changed {
            return self.report.idle();
        }
        self.publish(ports);
        self.report.worked()
    }
}
