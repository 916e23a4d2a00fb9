//! The graph and the flown path as they outlive the process: in the image store, beside the images.
//!
//! Written whole and renamed whenever the graph changes, so that a successor finds what its predecessor last published.
//! What is not of this version, or does not hold together, is nothing.

use crate::graph::{DisparityGraph, GraphRule, Node, Place};
use ipc_types::messages::Keyframe;
use ipc_types::{FlightTime, Point, World};

/// Version of the record.
const VERSION: u64 = 2;
/// Whole numbers before the keyframes: version, and how many there are of each kind.
const HEAD: usize = 6;

/// The newest state that a process knew: when, and where the vehicle was.
pub(crate) type LastState = Option<(FlightTime, Point<World>)>;

/// What a record holds.
pub(crate) struct Record {
    pub(crate) state: LastState,
    pub(crate) newest: Option<Node>,
    pub(crate) keyframes: Vec<Place>,
    pub(crate) recent: Vec<Node>,
    pub(crate) path: Vec<Point<World>>,
}

/// A node as it is published.
pub(crate) fn describe(node: &Node) -> Keyframe {
    Keyframe {
        image_id: node.image_id,
        exposure_ns: node.exposure.as_nanos(),
        position_m: node.world_from_camera.origin().to_array(),
        orientation: node.world_from_camera.rotation.to_wxyz(),
    }
}

fn node(keyframe: &Keyframe) -> Option<Node> {
    let exposure = FlightTime::from_nanos(keyframe.exposure_ns);
    Some(Node { image_id: keyframe.image_id, exposure, world_from_camera: keyframe.world_from_camera()? })
}

/// Writes a record to `out`, as the image store takes it.
pub(crate) fn write(graph: &DisparityGraph, path: &[Point<World>], state: LastState, out: &mut Vec<u16>) {
    let (newest, keyframes, recent) = graph.parts();
    let counts = [newest.iter().count(), keyframes.len(), recent.len(), path.len(), state.iter().count()];
    out.clear();
    let mut push = |bytes: &[u8]| out.extend(bytes.chunks_exact(2).map(|pair| u16::from_le_bytes([pair[0], pair[1]])));
    push(&VERSION.to_le_bytes());
    counts.into_iter().for_each(|count| push(&(count as u64).to_le_bytes()));
    let anchors = keyframes.iter().map(|place| &place.anchor);
    let frames = keyframes.iter().map(|place| &place.frame);
    for node in newest.iter().chain(anchors).chain(frames).chain(recent) {
        push(bytemuck::bytes_of(&describe(node)));
    }
    path.iter().for_each(|place| push(bytemuck::bytes_of(&place.to_array())));
    if let Some((at, here)) = state {
        push(&at.as_nanos().to_le_bytes());
        push(bytemuck::bytes_of(&here.to_array()));
    }
}

/// Reads a record; `None` where it is none.
pub(crate) fn read(stored: &[u16]) -> Option<Record> {
    let bytes: Vec<u8> = stored.iter().flat_map(|word| word.to_le_bytes()).collect();
    let (head, rest) = bytes.split_at_checked(8 * HEAD)?;
    let mut head = head.as_chunks::<8>().0.iter().map(|&number| u64::from_le_bytes(number));
    if head.next()? != VERSION {
        return None;
    }
    let [newest, keyframes, recent, places] = [head.next()?, head.next()?, head.next()?, head.next()?];
    let has_state = head.next()?;
    let most = GraphRule::MOST as u64;
    if newest > 1 || has_state > 1 || keyframes > most || recent > most || places > 1 << 16 {
        return None;
    }
    let (newest, keyframes) = (newest as usize, keyframes as usize);
    let nodes = newest + 2 * keyframes + recent as usize;
    let (nodes, rest) = rest.split_at_checked(nodes * size_of::<Keyframe>())?;
    let nodes = nodes.chunks_exact(size_of::<Keyframe>()).map(bytemuck::pod_read_unaligned::<Keyframe>);
    let nodes: Vec<Node> = nodes.map(|keyframe| node(&keyframe)).collect::<Option<_>>()?;
    let (places, rest) = rest.split_at_checked(places as usize * size_of::<[f64; 3]>())?;
    let places = places.chunks_exact(size_of::<[f64; 3]>()).map(bytemuck::pod_read_unaligned::<[f64; 3]>);
    let state = match has_state {
        0 if rest.is_empty() => None,
        0 => return None,
        _ => {
            let (at, here) = rest.split_first_chunk()?;
            let here = bytemuck::try_pod_read_unaligned(here).ok()?;
            Some((FlightTime::from_nanos(i64::from_le_bytes(*at)), Point::from_array(here)))
        }
    };
    let (first, nodes) = nodes.split_at(newest);
    let (anchors, nodes) = nodes.split_at(keyframes);
    let (frames, recent) = nodes.split_at(keyframes);
    Some(Record {
        state: state.filter(|(_, here)| here.is_finite()),
        newest: first.first().copied(),
        keyframes: anchors.iter().zip(frames).map(|(&anchor, &frame)| Place { anchor, frame }).collect(),
        recent: recent.to_vec(),
        path: places.map(Point::from_array).filter(|place| place.is_finite()).collect(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use ipc_types::{Pose, Rotation, Vector};

    fn graph() -> DisparityGraph {
        let mut graph = DisparityGraph::new(GraphRule { keyframes: 6, spacing_m: 1.0, spacing_deg: 30.0 }, 1.0);
        for tick in 0..50 {
            let translation = Vector::new(0.3 * tick as f64, 0.0, 2.0);
            let rotation = Rotation::from_roll_pitch_yaw(0.1, 0.0, 0.02 * tick as f64);
            let exposure = FlightTime::from_nanos(80_000_000 * tick);
            let node = Node { image_id: tick as u64, exposure, world_from_camera: Pose { rotation, translation } };
            graph.insert(node, |_| {});
        }
        graph
    }

    #[test]
    fn a_graph_is_read_back_as_it_was() {
        let (graph, path) = (graph(), [Point::new(1.0, 2.0, 3.0), Point::new(-4.0, 0.5, 1.0)]);
        let mut stored = Vec::new();
        let state = Some((FlightTime::from_nanos(77), Point::new(9.0, 8.0, 7.0)));
        write(&graph, &path, state, &mut stored);
        let record = read(&stored).expect("whole");
        assert_eq!((&record.path[..], record.state), (&path[..], state));
        let rule = GraphRule { keyframes: 6, spacing_m: 1.0, spacing_deg: 30.0 };
        let parts = (record.newest, &record.keyframes[..], &record.recent[..]);
        let restored = DisparityGraph::restored(rule, 1.0, parts, |_| true);
        let ids = |graph: &DisparityGraph| graph.nodes().map(|node| node.image_id).collect::<Vec<_>>();
        assert_eq!(ids(&restored), ids(&graph));
        // The newest image was not stored any more.
        let newest = graph.newest().expect("a node").image_id;
        let restored = DisparityGraph::restored(rule, 1.0, parts, |node| node.image_id != newest);
        assert_eq!(ids(&restored).len(), ids(&graph).len() - 1);
        assert!(ids(&restored).iter().all(|id| ids(&graph).contains(id)));
    }

    #[test]
    fn what_is_cut_or_of_another_version_is_nothing() {
        let mut stored = Vec::new();
        write(&graph(), &[Point::ZERO], Some((FlightTime::from_nanos(1), Point::ZERO)), &mut stored);
        for length in 0..stored.len() {
            assert!(read(&stored[..length]).is_none(), "{length}");
        }
        for word in 0..4 * HEAD {
            let mut changed = stored.clone();
            changed[word] ^= 0x8001;
            assert!(read(&changed).is_none_or(|record| record.keyframes.len() < 64), "{word}");
        }
        stored[0] = 1;
        assert!(read(&stored).is_none());
    }
}
