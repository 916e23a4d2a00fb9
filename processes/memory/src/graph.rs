//! The pose graph of expanded images (DROAN, Algorithm 2).
//!
//! The newest frame is always a node. It becomes a keyframe when the vehicle has moved `spacing_m` or turned
//! `spacing_deg` since the last one; beyond `keyframes`, the oldest is forgotten. One rule is added: a keyframe whose
//! anchor (the pose that made it one) lies within half of both spacings takes the newer frame in place of its own.
//! So a vehicle that hovers before something that is not there loses the stale view within one frame, instead of
//! hovering for ever.

use ipc_types::bounds::Bounds;
use ipc_types::{Camera, FlightTime, Pose, World};
use serde::{Deserialize, Serialize};

/// Which frames become keyframes.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GraphRule {
    /// Nodes kept, the newest frame included (N_graph).
    pub keyframes: usize,
    /// Displacement between keyframes (γ_d), m.
    pub spacing_m: f64,
    /// Angle between keyframes (γ_ψ), degrees.
    pub spacing_deg: f64,
}

impl GraphRule {
    /// Most nodes that a message carries.
    pub const MOST: usize = 64;

    pub(crate) fn check(&self, bounds: &mut Bounds) {
        bounds.range("keyframes", self.keyframes, 2..=Self::MOST);
        bounds.range("spacing_m", self.spacing_m, 0.05..=20.0);
        bounds.range("spacing_deg", self.spacing_deg, 1.0..=180.0);
    }
}

/// One expanded image and where it was taken.
#[derive(Clone, Copy, Debug)]
pub struct Node {
    /// Name of the image in the run's store.
    pub image_id: u64,
    /// Instant of exposure.
    pub exposure: FlightTime,
    /// The camera at that instant.
    pub world_from_camera: Pose<World, Camera>,
}

impl Node {
    /// Distance in m and angle in degrees to another node's camera.
    fn apart(&self, other: &Self) -> (f64, f64) {
        let (here, there) = (self.world_from_camera, other.world_from_camera);
        (here.origin().distance(there.origin()), here.rotation.angle_to(there.rotation).to_degrees())
    }
}

/// A place of the graph: the frame that made it, and the newest frame taken there.
#[derive(Clone, Copy, Debug)]
struct Place {
    anchor: Node,
    frame: Node,
}

/// The nodes, newest first.
#[derive(Clone, Debug)]
pub struct DisparityGraph {
    rule: GraphRule,
    newest: Option<Node>,
    keyframes: Vec<Place>,
}

impl DisparityGraph {
    /// An empty graph.
    pub fn new(rule: GraphRule) -> Self {
        Self { rule, newest: None, keyframes: Vec::with_capacity(rule.keyframes) }
    }

    /// The newest frame, then the keyframes from the newest to the oldest.
    pub fn nodes(&self) -> impl Iterator<Item = &Node> {
        let others = |place: &&Place| self.newest.is_none_or(|newest| newest.image_id != place.frame.image_id);
        self.newest.iter().chain(self.keyframes.iter().filter(others).map(|place| &place.frame))
    }

    /// Adds a frame; calls `forget` with the id of every image that is no longer a node.
    /// Frames older than the newest are refused, and forgotten at once.
    pub fn insert(&mut self, frame: Node, mut forget: impl FnMut(u64)) {
        if self.newest.is_some_and(|newest| frame.exposure <= newest.exposure) {
            if self.nodes().all(|node| node.image_id != frame.image_id) {
                forget(frame.image_id);
            }
            return;
        }
        let before: Vec<u64> = self.nodes().map(|node| node.image_id).collect();
        let (half_m, half_deg) = (self.rule.spacing_m / 2.0, self.rule.spacing_deg / 2.0);
        let is_far = self.keyframes.first().is_none_or(|last| {
            let (distance_m, angle_deg) = frame.apart(&last.anchor);
            distance_m >= self.rule.spacing_m || angle_deg >= self.rule.spacing_deg
        });
        let near = self.keyframes.iter_mut().find(|place| {
            let (distance_m, angle_deg) = frame.apart(&place.anchor);
            distance_m < half_m && angle_deg < half_deg
        });
        match near {
            Some(place) => place.frame = frame,
            None if is_far => {
                self.keyframes.insert(0, Place { anchor: frame, frame });
                // One node is the newest frame, which moves on while the keyframes stay.
                self.keyframes.truncate(self.rule.keyframes - 1);
            }
            None => {}
        }
        self.newest = Some(frame);
        for id in before {
            if self.nodes().all(|node| node.image_id != id) {
                forget(id);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ipc_types::{Rotation, Vector};

    const RULE: GraphRule = GraphRule { keyframes: 4, spacing_m: 1.0, spacing_deg: 30.0 };

    fn frame(number: u64, x_m: f64, yaw_deg: f64) -> Node {
        Node {
            image_id: number,
            exposure: FlightTime::from_nanos(number as i64),
            world_from_camera: Pose {
                rotation: Rotation::from_roll_pitch_yaw(0.0, 0.0, yaw_deg.to_radians()),
                translation: Vector::new(x_m, 0.0, 0.0),
            },
        }
    }

    fn fly(frames: impl IntoIterator<Item = Node>) -> (Vec<u64>, Vec<u64>) {
        let mut graph = DisparityGraph::new(RULE);
        let mut forgotten = Vec::new();
        for frame in frames {
            graph.insert(frame, |id| forgotten.push(id));
            assert!(graph.nodes().count() <= RULE.keyframes);
            assert_eq!(graph.nodes().next().expect("a node").image_id, frame.image_id, "the newest is a node");
        }
        (graph.nodes().map(|node| node.image_id).collect(), forgotten)
    }

    #[test]
    fn keyframes_lie_a_spacing_apart_and_the_newest_frame_is_a_node() {
        let (nodes, mut forgotten) = fly((0..=34).map(|i| frame(i, i as f64 * 0.1, 0.0)));
        assert_eq!(nodes[0], 34);
        assert!(nodes.len() >= 3, "{nodes:?}");
        forgotten.sort_unstable();
        let mut all: Vec<u64> = forgotten.iter().chain(&nodes).copied().collect();
        all.sort_unstable();
        assert_eq!(all, (0..=34).collect::<Vec<_>>(), "every image is a node or was forgotten, once");
    }

    #[test]
    fn turning_makes_keyframes() {
        let (nodes, _) = fly([frame(1, 0.0, 0.0), frame(2, 0.0, 31.0), frame(3, 0.0, 62.0)]);
        assert_eq!(nodes, [3, 2, 1]);
    }

    #[test]
    fn a_hovering_vehicle_replaces_the_stale_view() {
        let (nodes, forgotten) = fly([frame(1, 0.0, 0.0), frame(2, 1.5, 0.0), frame(3, 1.6, 1.0)]);
        assert_eq!((nodes, forgotten), (vec![3, 1], vec![2]));
    }

    #[test]
    fn late_and_duplicate_frames_are_refused() {
        let (nodes, forgotten) = {
            let mut graph = DisparityGraph::new(RULE);
            let mut forgotten = Vec::new();
            for frame in [frame(5, 0.0, 0.0), frame(5, 0.0, 0.0), frame(4, 9.0, 0.0)] {
                graph.insert(frame, |id| forgotten.push(id));
            }
            (graph.nodes().map(|node| node.image_id).collect::<Vec<_>>(), forgotten)
        };
        assert_eq!((nodes, forgotten), (vec![5], vec![4]));
    }
}
