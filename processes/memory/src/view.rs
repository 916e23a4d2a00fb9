//! Three-valued occupancy: what the keyframes and the free-space evidence say about a point.

use crate::evidence::FreeSpace;
use crate::graph::GraphRule;
use crate::inference::{Inference, VOTE, Weights};
use crate::lanes::{Places, Projected, Transforms, halves};
use crate::simd::prefetch;
use crate::votes::{Said, Tally, Votes, flag};
use ipc_types::messages::{ExpandedLayout, Layers, UNKNOWN_FRONT};
use ipc_types::noise::NoiseModel;
use ipc_types::{Camera, FlightTime, Point, Pose, StereoRig, Vector, World};
use multiversion::multiversion;
use runtime::images::StoredImage;

/// Why a point is unknown.
#[derive(Clone, Copy, PartialEq, Eq, Debug, PartialOrd, Ord)]
pub enum Unknown {
    /// No keyframe's camera looked there.
    OutOfView,
    /// Looked at, but nothing was measured there, or the vehicle's body would reach what was not measured.
    NoReturn,
    /// Hidden behind something.
    Occluded,
}

/// What is known about a point.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Occupancy {
    /// The vehicle's centre may be there.
    Free,
    /// It may not.
    Occupied,
    /// Nobody vouches for it.
    Unknown(Unknown),
}

/// The sum of the votes on a point, before a threshold makes an answer of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Score {
    /// Eq. 3.11, with caps on both sides, and without what was superseded or overruled (`votes.rs`).
    pub sum: f32,
    /// Whether any view vouches for free space.
    pub vouched: bool,
    /// The most telling reason for which a view does not vouch.
    pub unknown: Unknown,
}

/// Camera, vehicle and rules that a map is made with.
#[derive(Clone, Copy, Debug)]
pub struct MapModel {
    /// The camera.
    pub rig: StereoRig,
    /// Its noise.
    pub noise: NoiseModel,
    /// Of the expanded images.
    pub layout: ExpandedLayout,
    /// Radius by which they are inflated, m.
    pub radius_m: f32,
    /// How votes are weighed.
    pub inference: Inference,
    /// After this time of being seen free again something is forgotten, s.
    pub forget_s: f64,
}

/// One keyframe, ready to be asked.
#[derive(Clone, Debug)]
pub(crate) struct KeyView {
    rotation: [[f32; 3]; 3],
    /// Camera from world, relative to the anchor ([`Transforms`]).
    pub(crate) transform: [f32; 12],
    pub(crate) origin: Point<World>,
    pub(crate) exposure: FlightTime,
    /// Exposure before that of the newest keyframe, ms.
    pub(crate) exposure_ms: i32,
    pub(crate) image: StoredImage,
}

impl KeyView {
    /// A point in the camera's frame, m.
    pub(crate) fn to_camera(&self, point: Point<World>, anchor: Point<World>) -> [f64; 3] {
        let offset = (point - anchor).to_array();
        let row = |row: usize| &self.transform[4 * row..4 * row + 4];
        [0, 1, 2].map(|axis| {
            let turned = row(axis).iter().zip(offset).map(|(&cell, offset)| f64::from(cell) * offset).sum::<f64>();
            turned + f64::from(row(axis)[3])
        })
    }

    /// The first four layers of its cells; with four layers there are more than those.
    #[inline(always)]
    pub(crate) fn cells(&self) -> &[[u16; 4]] {
        self.image.as_chunks().0
    }

    /// The next two.
    #[inline(always)]
    pub(crate) fn next_cell(&self, layout: ExpandedLayout, cell: u32) -> [u16; 2] {
        let from = self.image.get(4 * layout.cells() + 2 * cell as usize..);
        from.and_then(|cells| cells.first_chunk()).copied().unwrap_or([UNKNOWN_FRONT; 2])
    }
}

/// Keyframes that one place is looked up in at once.
const KEYS: usize = 16;

/// Some keyframes, a lane each.
#[derive(Clone, Debug)]
struct KeyGroup {
    first: usize,
    count: usize,
    transforms: Transforms<KEYS>,
}

/// Of a block of places, for every keyframe: where they lie, and what is said of them.
#[derive(Clone, Debug)]
pub(crate) struct Looked<const N: usize> {
    seen: Vec<Projected<N>>,
    said: Vec<Said<N>>,
}

impl<const N: usize> Looked<N> {
    pub(crate) fn new() -> Self {
        Self { seen: vec![Projected::NOTHING; GraphRule::MOST], said: vec![Said::NOTHING; GraphRule::MOST] }
    }
}

/// Keyframes and evidence, to be asked about points.
#[derive(Clone, Debug)]
pub struct View {
    pub(crate) model: MapModel,
    pub(crate) weights: Weights,
    pub(crate) forget_ms: i32,
    /// From the newest to the oldest.
    pub(crate) keys: Vec<KeyView>,
    groups: Vec<KeyGroup>,
    /// What the f32 coordinates that are asked about are relative to.
    pub(crate) anchor: Point<World>,
    pub(crate) free_space: FreeSpace,
}

impl View {
    /// A view that knows nothing but `free_space`.
    pub fn new(model: MapModel, free_space: FreeSpace) -> Self {
        Self {
            weights: Weights::new(&model.rig, &model.noise, model.radius_m, model.inference),
            forget_ms: (model.forget_s * 1e3).min(1e9) as i32,
            model,
            keys: Vec::new(),
            groups: Vec::new(),
            anchor: Point::ZERO,
            free_space,
        }
    }

    /// Forgets all keyframes.
    pub fn clear(&mut self) {
        self.keys.clear();
        self.groups.clear();
    }

    /// Adds a keyframe: its camera, its exposure and its cells. Returns false, and adds nothing, when the image is not
    /// of the layout's size, the pose is not finite, or there are [`GraphRule::MOST`]. The order does not matter.
    pub fn push(&mut self, world_from_camera: Pose<World, Camera>, exposure: FlightTime, image: StoredImage) -> bool {
        let origin = world_from_camera.origin();
        if image.len() != self.model.layout.elements() || !origin.is_finite() || self.keys.len() == GraphRule::MOST {
            return false;
        }
        let rotation = world_from_camera.inverse().rotation.to_matrix().map(|row| row.map(|cell| cell as f32));
        // Ties are broken by the pose, so that the order of arrival cannot matter.
        let newer = |key: &KeyView| {
            (key.exposure, key.origin.to_array(), key.rotation) > (exposure, origin.to_array(), rotation)
        };
        let place = self.keys.partition_point(newer);
        let key = KeyView { rotation, transform: [0.0; 12], origin, exposure, exposure_ms: 0, image };
        self.keys.insert(place, key);
        self.anchor_keys();
        true
    }

    /// Relates all keyframes to the newest one.
    fn anchor_keys(&mut self) {
        let newest = self.keys[0].exposure;
        self.anchor = self.keys[0].origin;
        self.groups.clear();
        for (index, key) in self.keys.iter_mut().enumerate() {
            let offset = self.anchor - key.origin;
            let offset = [offset.x as f32, offset.y as f32, offset.z as f32];
            for (row, [x, y, z]) in key.rotation.into_iter().enumerate() {
                let at = x * offset[0] + y * offset[1] + z * offset[2];
                key.transform[4 * row..4 * row + 4].copy_from_slice(&[x, y, z, at]);
            }
            key.exposure_ms = (key.exposure.seconds_since(newest) * 1e3).clamp(-1e9, 0.0) as i32;
            if index % KEYS == 0 {
                self.groups.push(KeyGroup { first: index, count: 0, transforms: Transforms::NONE });
            }
            let group = &mut self.groups[index / KEYS];
            group.transforms.0.iter_mut().zip(key.transform).for_each(|(lanes, value)| lanes[index % KEYS] = value);
            group.count += 1;
        }
    }

    /// Half of the camera's horizontal field of view, rad.
    pub fn half_view_rad(&self) -> f64 {
        let rig = &self.model.rig;
        let half_px = rig.cx_px.min(f64::from(rig.width_px) - 1.0 - rig.cx_px);
        (half_px / rig.focal_px).atan()
    }

    /// Where the keyframes were taken from, and along which direction their cameras looked; from the newest to the oldest.
    pub fn cameras(&self) -> impl Iterator<Item = (Point<World>, Vector<World>)> {
        self.keys.iter().map(|key| (key.origin, Vector::from_array(key.rotation[2].map(f64::from))))
    }

    /// Number of keyframes.
    pub fn keyframes(&self) -> usize {
        self.keys.len()
    }

    /// The free-space evidence.
    pub fn free_space(&self) -> &FreeSpace {
        &self.free_space
    }

    /// The free-space evidence, to be replaced.
    pub fn free_space_mut(&mut self) -> &mut FreeSpace {
        &mut self.free_space
    }

    /// Replaces the path flown: where the body's centre has been, world, m, oldest first, all finite. The keyframes of now say which
    /// of its new places are evidence of free space around them.
    pub fn set_path(&mut self, path: impl IntoIterator<Item = Point<World>>) {
        let nothing = FreeSpace::new(*self.free_space.rule(), self.free_space.home());
        let mut free_space = std::mem::replace(&mut self.free_space, nothing);
        free_space.set_path(path, |place| self.score(place).vouched);
        self.free_space = free_space;
    }

    /// What is known about a point: occupied from a score of `threshold` (γ) on.
    pub fn occupancy(&self, point: Point<World>, threshold: f32) -> Occupancy {
        let (sum, flags) = self.tally(point);
        self.judge(point, sum, flags, threshold_votes(threshold))
    }

    /// The sum of the keyframes' votes on a point (Table 3.1).
    pub fn score(&self, point: Point<World>) -> Score {
        let (sum, flags) = self.tally(point);
        Score { sum: sum as f32 / VOTE, vouched: flags & flag::FREE != 0, unknown: why(flags) }
    }

    fn tally(&self, point: Point<World>) -> (i32, i32) {
        let offset = point - self.anchor;
        let place = [offset.x as f32, offset.y as f32, offset.z as f32];
        let tally = ask_one(self, place);
        let has_parallax = tally.has_background(0) && self.background_has_parallax(place);
        tally.count(0, has_parallax)
    }

    /// An answer from a score and what was said.
    #[inline(always)]
    pub(crate) fn judge(&self, point: Point<World>, sum: i32, flags: i32, threshold: i32) -> Occupancy {
        if sum >= threshold {
            Occupancy::Occupied
        } else if flags & flag::FREE != 0 || self.free_space.is_declared(point) {
            Occupancy::Free
        } else {
            Occupancy::Unknown(why(flags))
        }
    }

    /// Whether any two views of far background at a place lie a parallax apart.
    pub(crate) fn background_has_parallax(&self, place: [f32; 3]) -> bool {
        let mut flags = [0; GraphRule::MOST];
        for (group, flags) in self.groups.iter().zip(flags.chunks_exact_mut(KEYS)) {
            flags.copy_from_slice(&self.look(group, place).flags);
        }
        self.lie_apart(&flags.map(|flags| flags == flag::FAR_BACKGROUND))
    }

    /// Whether any two of some keyframes lie a parallax apart.
    pub(crate) fn lie_apart(&self, which: &[bool; GraphRule::MOST]) -> bool {
        let least_m = self.free_space.rule().background_parallax_m;
        let mut views = self.keys.iter().zip(which).filter(|(_, is_one)| **is_one);
        while let Some((view, _)) = views.next() {
            if views.clone().any(|(other, _)| other.origin.distance(view.origin) >= least_m) {
                return true;
            }
        }
        false
    }

    /// What a group of keyframes says of one place, a lane each.
    #[inline(always)]
    fn look(&self, group: &KeyGroup, [x, y, z]: [f32; 3]) -> Said<KEYS> {
        let places = Places { x: [x; KEYS], y: [y; KEYS], z: [z; KEYS] };
        let mut seen = Projected::locate(&self.model, &group.transforms, &places);
        let keys = &self.keys[group.first..][..group.count];
        for (lane, key) in keys.iter().enumerate() {
            seen.gathered[lane] = halves(key.cells()[seen.cell[lane] as usize]);
        }
        let (mut flags, past) = seen.classify();
        if self.model.layout.layers == Layers::Four {
            for (lane, key) in keys.iter().enumerate().filter(|(lane, _)| past[*lane] != 0) {
                flags[lane] = seen.next(lane, key.next_cell(self.model.layout, seen.cell[lane]));
            }
        }
        let mut weights = [0; KEYS];
        self.weights.fill(&seen.inverse_depth_px, &mut weights);
        Said { flags, weights, exposure_ms: 0 }
    }

    /// What the keyframes say of a block of places, those left out that see none of them. Returns how many say anything.
    #[inline(always)]
    fn look_at<const N: usize>(&self, places: &Places<N>, Looked { seen, said }: &mut Looked<N>) -> usize {
        let (mut views, layout) = (0, self.model.layout);
        // All places are found before any is looked at, so that the waiting for one keyframe's cells is the others'.
        for (key, seen) in self.keys.iter().zip(&mut *seen) {
            *seen = Projected::locate(&self.model, &Transforms::splat(&key.transform), places);
            let cells = key.cells();
            seen.cell.iter().for_each(|&cell| prefetch(cells, cell));
        }
        for (key, seen) in self.keys.iter().zip(seen) {
            if seen.is_nothing() {
                continue;
            }
            let cells = key.cells();
            for (gathered, &cell) in seen.gathered.iter_mut().zip(&seen.cell) {
                *gathered = halves(cells[cell as usize]);
            }
            let (mut flags, past) = seen.classify();
            if layout.layers == Layers::Four {
                for lane in (0..N).filter(|&lane| past[lane] != 0) {
                    flags[lane] = seen.next(lane, key.next_cell(layout, seen.cell[lane]));
                }
            }
            let said = &mut said[views];
            (said.flags, said.exposure_ms) = (flags, key.exposure_ms);
            self.weights.fill(&seen.inverse_depth_px, &mut said.weights);
            views += 1;
        }
        views
    }
}

/// The votes of all keyframes on one place.
#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512vl+avx512dq",
    "x86_64+avx2+fma",
    "x86_64+sse4.1",
    "aarch64+neon"
))]
fn ask_one(view: &View, place: [f32; 3]) -> Tally<1> {
    let mut said = [Said::NOTHING; GraphRule::MOST / KEYS];
    let said = &mut said[..view.groups.len()];
    for (said, group) in said.iter_mut().zip(&view.groups) {
        *said = view.look(group, place);
    }
    if !said.iter().any(Said::is_occupied_anywhere) {
        return Tally::unopposed_on_one(said);
    }
    let mut votes = Votes::none();
    for (key, lane) in view.keys.iter().zip(0..) {
        let said = &said[lane / KEYS];
        let (flags, weights) = ([said.flags[lane % KEYS]], [said.weights[lane % KEYS]]);
        votes.cast(&Said { flags, weights, exposure_ms: key.exposure_ms }, view.forget_ms);
    }
    votes.tally()
}

/// The votes of all keyframes on a block of places.
#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512vl+avx512dq",
    "x86_64+avx2+fma",
    "x86_64+sse4.1",
    "aarch64+neon"
))]
pub(crate) fn ask_block<const N: usize>(view: &View, places: &Places<N>, looked: &mut Looked<N>) -> Tally<N> {
    let views = view.look_at(places, looked);
    Tally::of(&looked.said[..views], view.forget_ms)
}

/// A threshold as a whole number of votes.
pub(crate) fn threshold_votes(threshold: f32) -> i32 {
    (threshold * VOTE).ceil() as i32
}

/// Why nobody vouches.
pub(crate) fn why(flags: i32) -> Unknown {
    if flags & flag::OCCLUDED != 0 {
        Unknown::Occluded
    } else if flags & (flag::UNMEASURED | flag::FAR_BACKGROUND) != 0 {
        Unknown::NoReturn
    } else {
        Unknown::OutOfView
    }
}
