//! The pose graph of expanded images (DROAN, Algorithm 2).
//!
//! The newest frame is always a node. It becomes a keyframe when the vehicle has moved `spacing_m` or turned
//! `spacing_deg` since the last one. Three rules are added:
//!
//! * Beyond `keyframes`, the farthest is forgotten, or where all are near, the one that sees most nearly what another one
//!   sees (Algorithm 2: the oldest). A vehicle that turns about at a place fills the graph with views from there; what lies
//!   around it, too near to be seen from there, it has seen on its way.
//! * A keyframe whose anchor (the pose that made it one) lies within half of the spacing and a tenth of the angle, so that
//!   both see nearly the same, takes the newer frame in place of its own, once a recent frame that sees the same is older
//!   than that by the time to forget. So it is improved until the next one is taken, by a vehicle that stays or comes back,
//!   and what it saw has been looked at again for as long as forgetting takes.
//! * The **recent** frames of the time to forget are nodes as well, all, or evenly spaced in time. Stereo
//!   misses a thin branch in most frames: what two of them see must not be gone with the next. And what moved is
//!   forgotten when it has been seen free again for long enough ([`crate::View`]), also by a vehicle that hovers and takes
//!   no keyframes.
//!
//! A correction of poses moves nodes; pixels stay as they are.

use ipc_types::bounds::Bounds;
use ipc_types::{Camera, FlightTime, Pose, World};
use serde::{Deserialize, Serialize};

/// Which frames become keyframes.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GraphRule {
    /// Keyframes kept, the newest frame included (N_graph). Recent frames come on top.
    pub keyframes: usize,
    /// Displacement between keyframes (γ_d), m.
    pub spacing_m: f64,
    /// Angle between keyframes (γ_ψ), degrees.
    pub spacing_deg: f64,
}

impl GraphRule {
    /// Most nodes that a message carries.
    pub const MOST: usize = 64;
    /// Most recent frames kept.
    pub const RECENT: usize = 24;
    /// At least so many are kept, however slowly they come: as many views must agree before something is forgotten.
    const AGREE: usize = 3;

    pub(crate) fn check(&self, bounds: &mut Bounds) {
        bounds.range("keyframes", self.keyframes, 2..=Self::MOST - Self::RECENT);
        bounds.range("spacing_m", self.spacing_m, 0.05..=20.0);
        bounds.range("spacing_deg", self.spacing_deg, 1.0..=180.0);
    }
}

/// Keyframes farther away than so many spacings are forgotten first.
const NEARBY_SPACINGS: f64 = 12.0;

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
pub struct Place {
    /// Where it was made.
    pub anchor: Node,
    /// What is seen from there.
    pub frame: Node,
}

/// The nodes.
#[derive(Clone, Debug)]
pub struct DisparityGraph {
    rule: GraphRule,
    /// What moved is forgotten after this time, s.
    forget_s: f64,
    newest: Option<Node>,
    /// From the newest to the oldest.
    keyframes: Vec<Place>,
    recent: Vec<Node>,
}

impl DisparityGraph {
    /// An empty graph. What moved is forgotten after `forget_s`.
    pub fn new(rule: GraphRule, forget_s: f64) -> Self {
        let (keyframes, recent) = (Vec::with_capacity(rule.keyframes + 1), Vec::with_capacity(GraphRule::RECENT + 1));
        Self { rule, forget_s, newest: None, keyframes, recent }
    }

    /// A graph of what another one held, as far as `is_there` says that the image still is.
    pub fn restored(
        rule: GraphRule,
        forget_s: f64,
        (newest, keyframes, recent): (Option<Node>, &[Place], &[Node]),
        is_there: impl Fn(&Node) -> bool,
    ) -> Self {
        let mut graph = Self::new(rule, forget_s);
        graph.keyframes.extend(keyframes.iter().filter(|place| is_there(&place.frame)));
        graph.keyframes.truncate(rule.keyframes - 1);
        graph.recent.extend(recent.iter().filter(|node| is_there(node)));
        graph.recent.truncate(GraphRule::RECENT);
        graph.newest = newest.filter(is_there).or_else(|| graph.nodes().max_by_key(|node| node.exposure).copied());
        graph
    }

    /// What [`DisparityGraph::restored`] takes.
    pub fn parts(&self) -> (Option<Node>, &[Place], &[Node]) {
        (self.newest, &self.keyframes, &self.recent)
    }

    /// The newest frame.
    pub fn newest(&self) -> Option<&Node> {
        self.newest.as_ref()
    }

    /// The newest frame, then the keyframes from the newest to the oldest, then what else is recent; every image once.
    pub fn nodes(&self) -> impl Iterator<Item = &Node> {
        let newest = self.newest.as_ref().map(|node| node.image_id);
        let is_keyframe = |node: &Node| self.keyframes.iter().any(|place| place.frame.image_id == node.image_id);
        let keyframes = self.keyframes.iter().map(|place| &place.frame);
        let recent = self.recent.iter().filter(move |node| !is_keyframe(node));
        self.newest.iter().chain(keyframes.chain(recent).filter(move |node| Some(node.image_id) != newest))
    }

    /// Moves nodes to corrected poses: those for which `pose_at` knows one. Returns how many moved.
    pub fn correct(&mut self, pose_at: impl Fn(FlightTime) -> Option<Pose<World, Camera>>) -> usize {
        let mut moved = 0;
        let mut correct = |node: &mut Node| {
            let of = |pose: Pose<World, Camera>| (pose.origin().to_array(), pose.rotation.to_wxyz());
            if let Some(pose) = pose_at(node.exposure).filter(|&pose| of(pose) != of(node.world_from_camera)) {
                node.world_from_camera = pose;
                moved += 1;
            }
        };
        self.newest.iter_mut().chain(&mut self.recent).for_each(&mut correct);
        for place in &mut self.keyframes {
            correct(&mut place.anchor);
            correct(&mut place.frame);
        }
        moved
    }

    /// Forgets all nodes; calls `forget` with the id of every image.
    pub fn clear(&mut self, forget: impl FnMut(u64)) {
        self.nodes().map(|node| node.image_id).for_each(forget);
        self.newest = None;
        self.keyframes.clear();
        self.recent.clear();
    }

    /// Does without the older half of the keyframes and of the recent frames, for want of room; calls `forget` with the id of
    /// every image that is no longer a node. Returns whether there was any. The newest frame stays.
    pub fn shed(&mut self, mut forget: impl FnMut(u64)) -> bool {
        let before: Vec<u64> = self.nodes().map(|node| node.image_id).collect();
        self.keyframes.truncate(self.keyframes.len() / 2);
        self.recent.truncate(self.recent.len() / 2);
        for id in &before {
            if self.nodes().all(|node| node.image_id != *id) {
                forget(*id);
            }
        }
        before.len() > self.nodes().count()
    }

    /// The keyframe to do without, never the newest one.
    fn least_useful(&self) -> usize {
        let oldest = self.keyframes.len() - 1;
        let here = &self.keyframes[0].anchor;
        let away_m = |index: &usize| self.keyframes[*index].anchor.apart(here).0;
        // Of equals the older one.
        let farthest = (1..=oldest).max_by(|a, b| away_m(a).total_cmp(&away_m(b))).unwrap_or(oldest);
        if away_m(&farthest) > NEARBY_SPACINGS * self.rule.spacing_m {
            return farthest;
        }
        // How nearly a newer one sees the same, in spacings; half as much where it only looks elsewhere: views overlap.
        let alike = |index: &usize| {
            let newer = self.keyframes[..*index].iter().map(|newer| {
                let (distance_m, angle_deg) = self.keyframes[*index].anchor.apart(&newer.anchor);
                (distance_m / self.rule.spacing_m).hypot(0.5 * angle_deg / self.rule.spacing_deg)
            });
            newer.fold(f64::INFINITY, f64::min)
        };
        (1..=oldest).rev().min_by(|a, b| alike(a).total_cmp(&alike(b))).unwrap_or(oldest)
    }

    /// Adds a frame; calls `forget` with the id of every image that is no longer a node. Frames that are not newer than
    /// the newest are refused, and forgotten at once. Returns whether it was taken.
    pub fn insert(&mut self, frame: Node, mut forget: impl FnMut(u64)) -> bool {
        if self.newest.is_some_and(|newest| frame.exposure <= newest.exposure) {
            if self.nodes().all(|node| node.image_id != frame.image_id) {
                forget(frame.image_id);
            }
            return false;
        }
        let before: Vec<u64> = self.nodes().map(|node| node.image_id).collect();
        let (half_m, tenth_deg) = (self.rule.spacing_m / 2.0, self.rule.spacing_deg / 10.0);
        let is_far = self.keyframes.first().is_none_or(|last| {
            let (distance_m, angle_deg) = frame.apart(&last.anchor);
            distance_m >= self.rule.spacing_m || angle_deg >= self.rule.spacing_deg
        });
        let near = |place: &Place, node: &Node, deg: f64| {
            let (distance_m, angle_deg) = node.apart(&place.anchor);
            distance_m < half_m && angle_deg < deg
        };
        // For as long as that, frames have seen what the keyframe sees.
        let is_due = |place: &Place| {
            let looked = |node: &&Node| {
                near(place, node, tenth_deg) && frame.exposure.seconds_since(node.exposure) >= self.forget_s
            };
            near(place, &frame, tenth_deg)
                && self.recent.iter().any(|node| looked(&node) && node.exposure >= place.frame.exposure)
        };
        let is_near = self.keyframes.iter().any(|place| near(place, &frame, self.rule.spacing_deg / 2.0));
        match self.keyframes.iter().position(is_due) {
            Some(index) => {
                let place = self.keyframes.remove(index);
                self.keyframes.insert(0, Place { frame, ..place });
            }
            None if is_far && !is_near => {
                self.keyframes.insert(0, Place { anchor: frame, frame });
                // One node is the newest frame, which moves on while the keyframes stay.
                if self.keyframes.len() > self.rule.keyframes - 1 {
                    self.keyframes.remove(self.least_useful());
                }
            }
            None => {}
        }
        let age_s = |node: &Node| frame.exposure.seconds_since(node.exposure);
        let gap_s = self.forget_s / (GraphRule::RECENT - 1) as f64;
        if self.recent.first().is_none_or(|last| age_s(last) >= gap_s) {
            self.recent.insert(0, frame);
            // They span the time to forget, and one more.
            let spanning = self.recent.partition_point(|node| age_s(node) < self.forget_s) + 1;
            self.recent.truncate(spanning.clamp(GraphRule::AGREE, GraphRule::RECENT));
        }
        self.newest = Some(frame);
        for id in before {
            if self.nodes().all(|node| node.image_id != id) {
                forget(id);
            }
        }
        true
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
        let mut graph = DisparityGraph::new(RULE, 1.0);
        let mut forgotten = Vec::new();
        for frame in frames {
            graph.insert(frame, |id| forgotten.push(id));
            assert!(graph.nodes().count() <= RULE.keyframes + GraphRule::RECENT);
            assert_eq!(graph.nodes().next().expect("a node").image_id, frame.image_id, "the newest is a node");
        }
        (graph.nodes().map(|node| node.image_id).collect(), forgotten)
    }

    #[test]
    fn for_want_of_room_it_sheds_its_older_half_down_to_the_newest_frame() {
        let mut graph = DisparityGraph::new(GraphRule { keyframes: 9, ..RULE }, 1.0);
        for number in 1..=20 {
            graph.insert(frame(number, 1.5 * number as f64, 0.0), |_| {});
        }
        let mut sizes = vec![graph.nodes().count()];
        let mut forgotten = Vec::new();
        while graph.shed(|id| forgotten.push(id)) {
            sizes.push(graph.nodes().count());
            assert!(graph.nodes().all(|node| !forgotten.contains(&node.image_id)));
        }
        assert!(sizes.windows(2).all(|pair| pair[1] < pair[0]), "{sizes:?}");
        assert_eq!(graph.nodes().map(|node| node.image_id).collect::<Vec<_>>(), [20]);
        assert_eq!(forgotten.len() + 1, sizes[0]);
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
    fn turning_about_at_a_place_does_not_displace_what_was_seen_on_the_way() {
        let way = (0..6_u64).map(|i| frame(i + 1, i as f64, 0.0));
        let turns = (0..40_u64).map(|i| frame(i + 7, 5.0 + 0.1 * (i % 3) as f64, 35.0 * i as f64));
        let rule = GraphRule { keyframes: 12, ..RULE };
        let mut graph = DisparityGraph::new(rule, 1e-9);
        for frame in way.chain(turns) {
            graph.insert(frame, |_| {});
        }
        let seen_from = |x_m: f64| graph.nodes().any(|node| (node.world_from_camera.origin().x - x_m).abs() < 0.01);
        assert!(seen_from(4.0) && seen_from(3.0) && seen_from(2.0), "{:?}", graph.keyframes);
        // Flown on, the farthest goes first.
        for i in 0..40_u64 {
            graph.insert(frame(100 + i, 5.0 + i as f64, 0.0), |_| {});
        }
        assert!(graph.nodes().all(|node| node.world_from_camera.origin().x > 30.0), "{:?}", graph.keyframes);
    }

    #[test]
    fn turning_makes_keyframes() {
        let (nodes, _) = fly([frame(1, 0.0, 0.0), frame(2, 0.0, 31.0), frame(3, 0.0, 62.0)]);
        assert_eq!(nodes, [3, 2, 1]);
    }

    #[test]
    fn a_hovering_vehicle_replaces_its_view_in_time_and_only_by_one_that_sees_the_same() {
        let at = |seconds: f64, number: u64, yaw_deg: f64| Node {
            exposure: FlightTime::from_secs_f64(seconds),
            ..frame(number, 1.6, yaw_deg)
        };
        let held = |frames: &[Node]| {
            let mut graph = DisparityGraph::new(RULE, 1.0);
            frames.iter().for_each(|&frame| assert!(graph.insert(frame, |_| {})));
            graph.parts().1.iter().map(|place| place.frame.image_id).collect::<Vec<_>>()
        };
        let first = at(0.0, 1, 0.0);
        assert_eq!(held(&[first, at(0.5, 2, 1.0)]), [1]);
        assert_eq!(held(&[first, at(1.5, 2, 14.0)]), [1], "it does not see what the first does");
        assert_eq!(held(&[first, at(0.6, 2, 14.0), at(1.2, 3, 0.0)]), [3], "the first itself is a recent frame");
        assert_eq!(held(&[first, at(0.5, 2, 1.0), at(1.0, 3, 0.0)]), [3]);
        // The vehicle goes away and comes back: a single frame replaces nothing, frames for a second do, and what they
        // see is then the last to be forgotten.
        let away: Vec<Node> = (0..6)
            .map(|i| Node {
                exposure: FlightTime::from_secs_f64(0.1 + 0.6 * f64::from(i)),
                ..frame(10 + i as u64, 5.0, 0.0)
            })
            .collect();
        let back = [at(4.0, 20, 1.0), at(4.6, 21, 1.0), at(5.1, 22, 1.0)];
        let flown = |frames: &[Node]| held(&[&[first], &away[..], frames].concat());
        let (one, all) = (flown(&back[..1]), flown(&back));
        assert!(one.contains(&1) && !one.contains(&20), "{one:?}");
        assert_eq!((all[0], all.contains(&1)), (22, false), "{all:?}");
    }

    #[test]
    fn late_and_duplicate_frames_are_refused() {
        let (nodes, forgotten) = {
            let mut graph = DisparityGraph::new(RULE, 1.0);
            let mut forgotten = Vec::new();
            for frame in [frame(5, 0.0, 0.0), frame(5, 0.0, 0.0), frame(4, 9.0, 0.0)] {
                graph.insert(frame, |id| forgotten.push(id));
            }
            (graph.nodes().map(|node| node.image_id).collect::<Vec<_>>(), forgotten)
        };
        assert_eq!((nodes, forgotten), (vec![5], vec![4]));
    }

    #[test]
    fn a_correction_moves_nodes_and_nothing_else() {
        let mut graph = DisparityGraph::new(RULE, 1.0);
        (0..20).for_each(|i| assert!(graph.insert(frame(i, i as f64 * 0.3, 0.0), |_| {})));
        let before: Vec<Node> = graph.nodes().copied().collect();
        // All that was taken from the tenth frame on lies a metre to the side.
        let corrected = |at: FlightTime| (at.as_nanos() >= 10).then(|| frame(0, 0.0, 5.0).world_from_camera);
        assert!(graph.correct(corrected) > 0);
        for (now, before) in graph.nodes().zip(&before) {
            assert_eq!(now.image_id, before.image_id);
            let moved = now.world_from_camera.origin().distance(before.world_from_camera.origin()) > 0.0;
            assert_eq!(moved, before.exposure.as_nanos() >= 10, "{}", before.image_id);
        }
        assert_eq!(graph.correct(corrected), 0, "they lie there already");
    }

    #[test]
    fn every_frame_of_the_last_second_is_a_node_or_they_are_evenly_spaced() {
        for (rate_hz, kept) in [(1.0, 3), (12.5, 14), (20.0, 21), (30.0, 16), (60.0, 21)] {
            let mut graph = DisparityGraph::new(RULE, 1.0);
            for tick in 0..200 {
                let exposure = FlightTime::from_secs_f64(f64::from(tick) / rate_hz);
                let fast = Node { exposure, ..frame(tick as u64, f64::from(tick) * 0.2, 0.0) };
                assert!(graph.insert(fast, |_| {}));
            }
            let recent: Vec<_> = graph.parts().2.iter().map(|node| node.exposure).collect();
            assert_eq!(recent.len(), kept, "{rate_hz} Hz");
            let span_s = recent[0].seconds_since(recent[kept - 1]);
            assert!(span_s >= 0.99 && (rate_hz < 2.0 || span_s < 1.1), "{rate_hz} Hz: {span_s} s");
        }
    }

    #[test]
    fn a_hovering_vehicle_keeps_recent_frames_that_span_the_time_to_forget() {
        let mut graph = DisparityGraph::new(RULE, 1.0);
        let mut images = std::collections::HashSet::new();
        for tick in 0..100_i64 {
            let node = Node { exposure: FlightTime::from_nanos(tick * 80_000_000), ..frame(tick as u64, 0.0, 0.0) };
            images.insert(node.image_id);
            graph.insert(node, |id| assert!(images.remove(&id), "{id} was forgotten twice"));
            let mut held: Vec<u64> = graph.nodes().map(|node| node.image_id).collect();
            held.sort_unstable();
            held.dedup();
            assert_eq!(held.len(), images.len(), "every image is a node, or forgotten");
            let oldest = graph.nodes().map(|node| node.exposure).min().expect("a node");
            assert!(tick < 20 || node.exposure.seconds_since(oldest) >= 1.0);
        }
        assert!(graph.nodes().count() <= 1 + GraphRule::RECENT + 1);
        graph.clear(|id| assert!(images.remove(&id)));
        assert!(images.is_empty() && graph.nodes().next().is_none());
    }
}
