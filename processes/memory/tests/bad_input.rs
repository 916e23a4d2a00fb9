//! The memory process on input that is wrong, late, repeated or out of order: counted, never believed, never "free".

use ipc_types::messages::{ExpandedLayout, Keyframe, KeyframeSet, Layers};
use ipc_types::rig::CameraMount;
use ipc_types::topics::{Expanded, Keyframes, State, Topic};
use ipc_types::wire::Header;
use ipc_types::{FlightTime, StereoRig};
use memory::{Config, FreeSpaceConfig, GraphRule, Inference, MemoryProcess};
use runtime::images::ImageStore;
use runtime::{Message, Ports, Process, Report};
use std::any::Any;
use std::collections::{HashMap, VecDeque};

const RIG: StereoRig =
    StereoRig { width_px: 32, height_px: 24, focal_px: 20.0, cx_px: 15.5, cy_px: 11.5, baseline_m: 0.3, doffs_px: 0.0 };
const LAYOUT: ExpandedLayout = ExpandedLayout::new(&RIG, 0, Layers::Two);
const RADIUS_M: f32 = 0.5;

struct Sent<T: Topic>(T::Header, Vec<T::Element>);

impl<T: Topic> Message<T> for Sent<T> {
    fn header(&self) -> &T::Header {
        &self.0
    }
    fn elements(&self) -> &[T::Element] {
        &self.1
    }
}

/// Queues of messages, in and out.
struct Queues {
    arriving: HashMap<&'static str, VecDeque<Box<dyn Any>>>,
    sent: HashMap<&'static str, Vec<Box<dyn Any>>>,
    images: ImageStore,
}

impl Queues {
    fn send<T: Topic>(&mut self, header: T::Header, elements: Vec<T::Element>) {
        self.arriving.entry(T::INFO.name).or_default().push_back(Box::new(Sent::<T>(header, elements)));
    }
}

impl Ports for Queues {
    type Message<T: Topic> = Sent<T>;

    fn now(&self) -> FlightTime {
        FlightTime::from_nanos(0)
    }
    fn receive<T: Topic>(&mut self) -> Option<Sent<T>> {
        self.arriving.get_mut(T::INFO.name)?.pop_front()?.downcast().ok().map(|sent| *sent)
    }
    fn publish<T: Topic>(
        &mut self,
        valid: FlightTime,
        elements: usize,
        fill: impl FnOnce(&mut T::Header, &mut [T::Element]),
    ) {
        let mut sent = Sent::<T>(bytemuck::Zeroable::zeroed(), vec![bytemuck::Zeroable::zeroed(); elements]);
        fill(&mut sent.0, &mut sent.1);
        sent.0.stamp_mut().valid_ns = valid.as_nanos();
        self.sent.entry(T::INFO.name).or_default().push(Box::new(sent));
    }
    fn images(&mut self) -> &mut ImageStore {
        &mut self.images
    }
}

struct Bench {
    process: MemoryProcess,
    queues: Queues,
    /// How long before what they claim messages are published, ms.
    early_ms: i64,
}

impl Bench {
    fn new(images: ImageStore) -> Self {
        let config = Config {
            graph: GraphRule { keyframes: 6, spacing_m: 1.0, spacing_deg: 30.0 },
            free_space: FreeSpaceConfig { swept_radius_m: 0.5, background_parallax_m: 0.5 },
            inference: Inference::Confidence,
            forget_s: 1.0,
        };
        let mount = CameraMount { position_m: [0.0; 3], pitch_up_deg: 0.0 };
        let queues = Queues { arriving: HashMap::new(), sent: HashMap::new(), images };
        Self { process: MemoryProcess::new(LAYOUT, RADIUS_M, mount, config), queues, early_ms: 0 }
    }

    fn state(&mut self, at_ms: i64, position_m: [f64; 3]) {
        let mut state: <State as Topic>::Header = bytemuck::Zeroable::zeroed();
        state.stamp.valid_ns = at_ms * 1_000_000;
        state.stamp.published_ns = (at_ms - self.early_ms) * 1_000_000;
        (state.position_m, state.orientation) = (position_m, [1.0, 0.0, 0.0, 0.0]);
        self.queues.send::<State>(state, Vec::new());
    }

    fn image_of(&mut self, at_ms: i64, layout: ExpandedLayout, radius_m: f32, elements: usize) {
        let mut image: <Expanded as Topic>::Header = bytemuck::Zeroable::zeroed();
        image.stamp.valid_ns = at_ms * 1_000_000;
        image.stamp.published_ns = (at_ms - self.early_ms) * 1_000_000;
        (image.width_px, image.height_px) = (layout.width_px, layout.height_px);
        (image.margin_px, image.layers, image.radius_m) = (layout.margin_px, layout.layers.count(), radius_m);
        self.queues.send::<Expanded>(image, vec![7; elements]);
    }

    fn image(&mut self, at_ms: i64) {
        self.image_of(at_ms, LAYOUT, RADIUS_M, LAYOUT.elements());
    }

    fn step(&mut self) -> Report {
        self.process.step(&mut self.queues)
    }

    /// A frame at a time and a place, well stated.
    fn frame(&mut self, at_ms: i64, position_m: [f64; 3]) -> Report {
        self.state(at_ms - 5, position_m);
        self.image(at_ms);
        self.state(at_ms + 5, position_m);
        self.step()
    }

    /// So many frames, 0.6 m apart.
    fn fly(&mut self, frames: i64) {
        for frame in 0..frames {
            self.frame(100 * frame, [0.6 * frame as f64, 0.0, 2.0]);
        }
    }

    /// The last set published, and how many there were.
    fn last(&self) -> (KeyframeSet, Vec<Keyframe>, usize) {
        let sets = &self.queues.sent["keyframe_set"];
        let set = sets.last().expect("a set").downcast_ref::<Sent<Keyframes>>().expect("of that topic");
        (set.0, set.1.clone(), sets.len())
    }
}

#[test]
fn what_is_wrong_is_counted_and_leaves_the_graph_as_it_was() {
    let mut bench = Bench::new(ImageStore::in_memory());
    for frame in 0..5 {
        assert_eq!(bench.frame(100 * frame, [0.6 * frame as f64, 0.0, 2.0]).dropped, 0);
    }
    let (_, keyframes, sets) = bench.last();
    let mut dropped = 0;
    let mut refused = |bench: &mut Bench, what: &str| {
        let report = bench.step();
        dropped += 1;
        assert_eq!(report.dropped, dropped, "{what}: {report:?}");
        assert_eq!(bench.last().2, sets, "{what}: nothing is published");
    };
    for position in [[f64::NAN, 0.0, 0.0], [0.0, f64::INFINITY, 0.0]] {
        bench.state(600, position);
        refused(&mut bench, "a position that is no number");
    }
    bench.image(400);
    refused(&mut bench, "a frame twice");
    bench.image(250);
    refused(&mut bench, "a frame out of order");
    bench.early_ms = 1001;
    bench.image(3_600_000);
    refused(&mut bench, "a frame of the future");
    bench.state(3_600_000, [2.4, 0.0, 2.0]);
    refused(&mut bench, "a state of the future");
    bench.early_ms = 0;
    bench.image(-40);
    refused(&mut bench, "a time before the flight");
    bench.image_of(600, ExpandedLayout::new(&RIG, 4, Layers::Two), RADIUS_M, LAYOUT.elements());
    refused(&mut bench, "another margin");
    bench.image_of(600, ExpandedLayout::new(&RIG, 0, Layers::Four), RADIUS_M, LAYOUT.elements());
    refused(&mut bench, "another number of layers");
    bench.image_of(600, LAYOUT, 0.7, LAYOUT.elements());
    refused(&mut bench, "another radius");
    bench.image_of(600, LAYOUT, RADIUS_M, LAYOUT.elements() - 1);
    refused(&mut bench, "an image that is too short");
    // All is well again, and the reasons are told apart.
    bench.frame(700, [3.6, 0.0, 2.0]);
    let (set, now, _) = bench.last();
    assert_eq!((set.late, set.misfits, set.jumps, set.without_pose), (5, 4, 0, 0));
    assert!(keyframes.iter().filter(|key| now.iter().any(|other| other.image_id == key.image_id)).count() >= 3);
}

#[test]
fn a_publisher_that_has_not_heard_the_flight_clock_is_believed() {
    let mut bench = Bench::new(ImageStore::in_memory());
    for (at_ms, is_image) in [(4995, false), (5000, true), (5005, false)] {
        bench.early_ms = at_ms;
        if is_image { bench.image(at_ms) } else { bench.state(at_ms, [0.0, 0.0, 2.0]) }
    }
    assert_eq!(bench.step().dropped, 0);
    assert_eq!(bench.last().1.len(), 1);
}

#[test]
fn a_pose_that_jumps_begins_the_map_anew() {
    let mut bench = Bench::new(ImageStore::in_memory());
    bench.fly(5);
    assert!(bench.last().1.len() >= 3);
    bench.state(500, [103.0, 0.0, 2.0]);
    assert_eq!(bench.step().dropped, 1);
    let (set, keyframes, _) = bench.last();
    assert_eq!((set.jumps, keyframes.len()), (1, 0), "nobody goes on with the old map");
    assert_eq!(bench.queues.images.ids(), Vec::<u64>::new(), "nor finds its images");
    // A late state that is somewhere else is no correction.
    bench.state(490, [3.0, 0.0, 2.0]);
    bench.state(495, [103.0, 0.0, 2.0]);
    bench.state(510, [103.0, 0.0, 2.0]);
    bench.state(505, [203.0, 0.0, 2.0]);
    bench.step();
    bench.frame(600, [103.0, 0.0, 2.0]);
    let (set, keyframes, _) = bench.last();
    assert_eq!((set.jumps, keyframes.len()), (2, 1));
    assert!((keyframes[0].position_m[0] - 103.0).abs() < 1e-9);
    assert_eq!(bench.queues.images.ids().len(), 1, "the image of the one node");
}

#[test]
fn a_correction_moves_keyframes_and_not_their_pixels() {
    let mut bench = Bench::new(ImageStore::in_memory());
    bench.fly(5);
    let (_, before, _) = bench.last();
    let pixels = |bench: &Bench, id: u64| bench.queues.images.get(id).expect("kept").to_vec();
    let held: Vec<Vec<u16>> = before.iter().map(|key| pixels(&bench, key.image_id)).collect();
    // The states about the third frame come again, half a metre to the side.
    for at_ms in [195, 205] {
        bench.state(at_ms, [1.2, 0.5, 2.0]);
    }
    bench.step();
    let (_, after, _) = bench.last();
    assert_eq!(before.len(), after.len());
    for ((before, after), held) in before.iter().zip(&after).zip(held) {
        assert_eq!((before.image_id, pixels(&bench, after.image_id)), (after.image_id, held));
        let moved = (before.position_m[1] - after.position_m[1]).abs();
        assert!((moved - if before.exposure_ns == 200_000_000 { 0.5 } else { 0.0 }).abs() < 1e-9, "{moved}");
    }
    assert!(after.iter().any(|key| key.exposure_ns == 200_000_000), "it is a keyframe");
}

#[test]
fn a_successor_finds_what_its_predecessor_published() {
    let images = ImageStore::in_memory();
    let mut bench = Bench::new(images.clone());
    bench.fly(9);
    let (_, before, _) = bench.last();
    // Killed while an image waits for its pose, and with one image damaged.
    bench.image(900);
    bench.step();
    let mut images = images;
    images.put(before[1].image_id, &[1, 2, 3]).expect("kept");
    let mut successor = Bench::new(images);
    successor.state(895, [5.4, 0.0, 2.0]);
    successor.step();
    let (_, after, sets) = successor.last();
    assert_eq!(sets, 1, "at once");
    let ids = |keyframes: &[Keyframe]| keyframes.iter().map(|key| key.image_id).collect::<Vec<_>>();
    let expected: Vec<u64> = ids(&before).into_iter().filter(|&id| id != before[1].image_id).collect();
    assert_eq!(ids(&after), expected);
    assert_eq!(successor.queues.images.ids().len(), after.len(), "what is no node is removed");
    successor.frame(1000, [6.0, 0.0, 2.0]);
    assert!(successor.last().1.len() >= after.len());
}

#[test]
fn images_without_a_state_at_their_exposure_are_dropped() {
    let mut bench = Bench::new(ImageStore::in_memory());
    bench.state(500, [0.0; 3]);
    bench.step();
    bench.image(100);
    assert_eq!(bench.step().dropped, 1);
    // Waits for a state, and another comes first.
    bench.image(600);
    bench.step();
    bench.image(700);
    bench.state(710, [0.0; 3]);
    bench.step();
    let (set, keyframes, _) = bench.last();
    assert_eq!((set.without_pose, keyframes.len()), (2, 1));
}
