//! What viewers show of a flight without a plugin: Foxglove's messages, made of ours.
//!
//! Frames are `world` (east, north, up), `body` (forward, left, up) and `camera` (right, down, ahead), as transforms.

use crate::cloud::cloud;
use foxglove::messages::{
    CameraCalibration, Color, FrameTransform, FrameTransforms, LinePrimitive, Log, Point3, PointCloud, Pose,
    Quaternion, RawImage, SceneEntity, SceneUpdate, SpherePrimitive, Timestamp, Vector3, log,
};
use foxglove::{Encode, Schema};
use ipc_types::messages::{
    DepthFrame, DisparityImage, ExpandedImage, FlownPath, Goal, Health, HealthLevel, Keyframe, KeyframeSet, PathPoint,
    StereoFrame, Trajectory, TrajectoryPoint, VehicleState,
};
use ipc_types::rig::CameraMount;
use ipc_types::topics::Topic;
use ipc_types::wire::{Header, Stamp};
use ipc_types::{Body, Camera, ProcessId, StereoRig};
use prost::Message;
use std::any::Any;
use std::collections::HashMap;

/// One thing that a viewer shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum View {
    /// Where the vehicle and its camera are.
    Transforms,
    /// The rectified left camera.
    Calibration,
    /// Left image.
    Left,
    /// Right image.
    Right,
    /// Depth image, as the sensor delivers it.
    Depth,
    /// Disparity, 1/64 px; below 16: why there is none.
    Disparity,
    /// Expanded image: the front layer, 1/64 px.
    Expanded,
    /// What is seen: points in the camera's frame.
    Obstacles,
    /// What is to be flown next.
    Plan,
    /// What was flown.
    FlownPath,
    /// Where to.
    Goal,
    /// Where the images in memory were exposed.
    Keyframes,
    /// What processes complain of.
    Log,
}

impl View {
    /// All of them.
    pub const ALL: [Self; 13] = [
        Self::Transforms,
        Self::Calibration,
        Self::Left,
        Self::Right,
        Self::Depth,
        Self::Disparity,
        Self::Expanded,
        Self::Obstacles,
        Self::Plan,
        Self::FlownPath,
        Self::Goal,
        Self::Keyframes,
        Self::Log,
    ];

    /// Its topic in a file.
    pub const fn topic(self) -> &'static str {
        match self {
            Self::Transforms => "/tf",
            Self::Calibration => "/camera/calibration",
            Self::Left => "/camera/left",
            Self::Right => "/camera/right",
            Self::Depth => "/camera/depth",
            Self::Disparity => "/camera/disparity",
            Self::Expanded => "/camera/expanded",
            Self::Obstacles => "/obstacles",
            Self::Plan => "/plan",
            Self::FlownPath => "/flown_path",
            Self::Goal => "/goal",
            Self::Keyframes => "/keyframes",
            Self::Log => "/log",
        }
    }

    /// Whether it is pixels: large.
    pub const fn is_image(self) -> bool {
        matches!(self, Self::Left | Self::Right | Self::Depth | Self::Disparity | Self::Expanded)
    }

    /// Foxglove's schema: protobuf.
    pub fn schema(self) -> Option<Schema> {
        match self {
            Self::Transforms => FrameTransforms::get_schema(),
            Self::Calibration => CameraCalibration::get_schema(),
            Self::Obstacles => PointCloud::get_schema(),
            Self::Plan | Self::FlownPath | Self::Goal | Self::Keyframes => SceneUpdate::get_schema(),
            Self::Log => Log::get_schema(),
            Self::Left | Self::Right | Self::Depth | Self::Disparity | Self::Expanded => RawImage::get_schema(),
        }
    }
}

/// Calibrations and the camera's place are repeated after so many states: they are to be found wherever one begins to look.
const REPEATED: u64 = 100;
const LINE_M: f64 = 0.05;
const PLAN: Color = Color { r: 0.1, g: 0.5, b: 1.0, a: 1.0 };
const FLOWN: Color = Color { r: 0.2, g: 0.8, b: 0.3, a: 1.0 };
const GOAL: Color = Color { r: 1.0, g: 0.8, b: 0.0, a: 0.8 };
const KEYFRAME: Color = Color { r: 1.0, g: 0.3, b: 0.6, a: 1.0 };

/// Makes views of messages.
#[derive(Debug)]
pub struct Viewer {
    rig: StereoRig,
    mount: CameraMount,
    states: u64,
    complaints: HashMap<u32, String>,
}

impl Viewer {
    /// For a camera at its place on the vehicle.
    pub fn new(rig: StereoRig, mount: CameraMount) -> Self {
        Self { rig, mount, states: 0, complaints: HashMap::new() }
    }

    /// Begins anew, for somebody who has seen nothing yet: another file.
    pub fn begin(&mut self) {
        self.states = 0;
        self.complaints.clear();
    }

    /// Hands the views of a message to `take`, each encoded; of pixels only if asked for.
    pub fn views<T: Topic>(
        &mut self,
        header: &T::Header,
        elements: &[T::Element],
        pixels: bool,
        mut take: impl FnMut(View, Vec<u8>),
    ) {
        let (stamp, bytes) = (*header.stamp(), bytemuck::cast_slice::<_, u8>(elements));
        let header: &dyn Any = header;
        if let Some(state) = header.downcast_ref::<VehicleState>() {
            if self.states.is_multiple_of(REPEATED) {
                take(View::Calibration, self.calibration(&stamp).encode_to_vec());
            }
            let transforms = self.transforms(state);
            self.states += 1;
            take(View::Transforms, transforms.encode_to_vec());
        } else if let Some(frame) = header.downcast_ref::<StereoFrame>().filter(|_| pixels) {
            let (left, right) = bytes.split_at(bytes.len() / 2);
            take(View::Left, image(&stamp, frame.width_px, "mono8", left).encode_to_vec());
            take(View::Right, image(&stamp, frame.width_px, "mono8", right).encode_to_vec());
        } else if let Some(frame) = header.downcast_ref::<DepthFrame>().filter(|_| pixels) {
            take(View::Depth, image(&stamp, frame.width_px, "mono16", bytes).encode_to_vec());
        } else if let Some(found) = header.downcast_ref::<DisparityImage>() {
            take(View::Obstacles, cloud(&self.rig, &stamp, found, bytes).encode_to_vec());
            if pixels {
                take(View::Disparity, image(&stamp, found.width_px, "mono16", bytes).encode_to_vec());
            }
        } else if let Some(expanded) = header.downcast_ref::<ExpandedImage>().filter(|_| pixels) {
            // Near, front, back and gap of the nearest surfaces: the front is shown.
            let layout = expanded.expanded_layout().filter(|layout| layout.elements() * 2 == bytes.len());
            if let Some(layout) = layout {
                let cells = bytes.as_chunks::<8>().0.iter().take(layout.cells());
                let fronts: Vec<u8> = cells.flat_map(|cell| [cell[2], cell[3]]).collect();
                take(View::Expanded, image(&stamp, layout.width_px, "mono16", &fronts).encode_to_vec());
            }
        } else if header.is::<Trajectory>() {
            let points = elements_of::<TrajectoryPoint>(bytes).map(|point| point.position_m);
            take(View::Plan, scene(&stamp, "plan", line(points, PLAN)).encode_to_vec());
        } else if header.is::<FlownPath>() {
            let points = elements_of::<PathPoint>(bytes).map(|point| point.position_m);
            take(View::FlownPath, scene(&stamp, "flown path", line(points, FLOWN)).encode_to_vec());
        } else if header.is::<KeyframeSet>() {
            let spheres = elements_of::<Keyframe>(bytes).map(|keyframe| sphere(keyframe.position_m, 0.15, KEYFRAME));
            take(View::Keyframes, scene(&stamp, "keyframes", Drawn::Spheres(spheres.collect())).encode_to_vec());
        } else if let Some(goal) = header.downcast_ref::<Goal>() {
            let drawn = Drawn::Spheres(vec![sphere(goal.position_m, 1.0, GOAL)]);
            take(View::Goal, scene(&stamp, "goal", drawn).encode_to_vec());
        } else if let Some(log) = header.downcast_ref::<Health>().and_then(|health| self.log(health)) {
            take(View::Log, log.encode_to_vec());
        }
    }

    /// A line whenever a process' complaint changes, or ends.
    fn log(&mut self, health: &Health) -> Option<Log> {
        let level = HealthLevel::from_wire(health.level);
        let complaint = if level == HealthLevel::Ok { String::new() } else { health.note.to_string_lossy() };
        let before = self.complaints.insert(health.stamp.producer, complaint.clone()).unwrap_or_default();
        let log_level = match level {
            HealthLevel::Ok => log::Level::Info,
            HealthLevel::Degraded => log::Level::Warning,
            HealthLevel::Faulted => log::Level::Error,
        };
        (before != complaint).then(|| Log {
            timestamp: timestamp(health.stamp.published_ns),
            level: log_level.into(),
            message: if complaint.is_empty() { "well again".to_owned() } else { complaint },
            name: ProcessId::from_wire(health.stamp.producer).map_or("unknown", ProcessId::name).to_owned(),
            ..Log::default()
        })
    }

    fn transforms(&self, state: &VehicleState) -> FrameTransforms {
        let timestamp = timestamp(state.stamp.valid_ns);
        let world_from_body = FrameTransform {
            timestamp,
            parent_frame_id: "world".to_owned(),
            child_frame_id: "body".to_owned(),
            translation: Some(vector(state.position_m)),
            rotation: Some(quaternion(state.orientation)),
        };
        let mut transforms = vec![world_from_body];
        if self.states.is_multiple_of(REPEATED) {
            let mount: ipc_types::Pose<Body, Camera> = self.mount.body_from_camera();
            transforms.push(FrameTransform {
                timestamp,
                parent_frame_id: "body".to_owned(),
                child_frame_id: "camera".to_owned(),
                translation: Some(vector(self.mount.position_m)),
                rotation: Some(quaternion(mount.rotation.to_wxyz())),
            });
        }
        FrameTransforms { transforms }
    }

    fn calibration(&self, stamp: &Stamp) -> CameraCalibration {
        let StereoRig { width_px, height_px, focal_px, cx_px, cy_px, .. } = self.rig;
        CameraCalibration {
            timestamp: timestamp(stamp.valid_ns),
            frame_id: "camera".to_owned(),
            width: width_px,
            height: height_px,
            k: vec![focal_px, 0.0, cx_px, 0.0, focal_px, cy_px, 0.0, 0.0, 1.0],
            r: vec![1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
            p: vec![focal_px, 0.0, cx_px, 0.0, 0.0, focal_px, cy_px, 0.0, 0.0, 0.0, 1.0, 0.0],
            ..CameraCalibration::default()
        }
    }
}

/// Structs, copied out of bytes that may lie anywhere.
fn elements_of<E: bytemuck::Pod>(bytes: &[u8]) -> impl Iterator<Item = E> {
    bytes.chunks_exact(size_of::<E>()).map(bytemuck::pod_read_unaligned)
}

fn image(stamp: &Stamp, width_px: u32, encoding: &str, bytes: &[u8]) -> RawImage {
    let step = (width_px as usize).max(1) * if encoding == "mono8" { 1 } else { 2 };
    RawImage {
        timestamp: timestamp(stamp.valid_ns),
        frame_id: "camera".to_owned(),
        width: width_px,
        height: (bytes.len() / step) as u32,
        encoding: encoding.to_owned(),
        step: step as u32,
        data: bytes.to_vec().into(),
    }
}

/// What an entity of a scene is drawn as.
enum Drawn {
    Line(LinePrimitive),
    Spheres(Vec<SpherePrimitive>),
}

/// Replaces the entity of that name.
fn scene(stamp: &Stamp, id: &str, drawn: Drawn) -> SceneUpdate {
    let mut entity = SceneEntity {
        timestamp: timestamp(stamp.valid_ns),
        frame_id: "world".to_owned(),
        id: id.to_owned(),
        ..SceneEntity::default()
    };
    match drawn {
        Drawn::Line(line) => entity.lines.push(line),
        Drawn::Spheres(spheres) => entity.spheres = spheres,
    }
    SceneUpdate { deletions: Vec::new(), entities: vec![entity] }
}

fn line(points: impl Iterator<Item = [f64; 3]>, color: Color) -> Drawn {
    let points = points.map(|[x, y, z]| Point3 { x, y, z }).collect();
    Drawn::Line(LinePrimitive {
        pose: Some(pose([0.0; 3])),
        thickness: LINE_M,
        points,
        color: Some(color),
        ..LinePrimitive::default()
    })
}

fn sphere(at_m: [f64; 3], diameter_m: f64, color: Color) -> SpherePrimitive {
    SpherePrimitive { pose: Some(pose(at_m)), size: Some(vector([diameter_m; 3])), color: Some(color) }
}

pub(crate) fn pose(at_m: [f64; 3]) -> Pose {
    Pose { position: Some(vector(at_m)), orientation: Some(quaternion([1.0, 0.0, 0.0, 0.0])) }
}

fn vector([x, y, z]: [f64; 3]) -> Vector3 {
    Vector3 { x, y, z }
}

fn quaternion([w, x, y, z]: [f64; 4]) -> Quaternion {
    Quaternion { x, y, z, w }
}

/// Flight time begins at 0; nothing is older.
pub(crate) fn timestamp(nanoseconds: i64) -> Option<Timestamp> {
    let nanoseconds = nanoseconds.max(0) as u64;
    Timestamp::new_checked((nanoseconds / 1_000_000_000) as u32, (nanoseconds % 1_000_000_000) as u32)
}
