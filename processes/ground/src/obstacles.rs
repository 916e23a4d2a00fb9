//! What a vehicle's cameras have seen, from above: cells with something in them.

use foxglove::messages::PointCloud;
use ipc_types::messages::VehicleState;
use ipc_types::pose_history::{PoseAt, PoseHistory};
use ipc_types::rig::CameraMount;
use ipc_types::{Camera, FlightTime, Point};
use prost::Message;
use std::collections::{HashMap, VecDeque};

/// Side of a cell, m.
pub(crate) const CELL_M: f64 = 0.25;
/// Points that lie so far above or below the vehicle count, m.
const BAND_M: f64 = 1.0;
/// Those that are lower above the take-off place are the ground, m.
const GROUND_M: f64 = 0.3;
/// Those that are nearer than this count, m.
const NEAR_M: f64 = 12.0;
/// Seen so often, and something is there.
const SIGHTINGS: u32 = 2;
/// Cells, at most; beyond, it begins anew.
const MOST_CELLS: usize = 50_000;
/// Poses remembered: at 10 Hz more than a slow link is late.
const POSES: usize = 200;
/// Clouds that wait for the pose they were seen from.
const MOST_WAITING: usize = 8;

/// Cells by how often something was seen in them.
#[derive(Debug)]
pub(crate) struct Obstacles {
    poses: PoseHistory,
    waiting: VecDeque<PointCloud>,
    cells: HashMap<[i32; 2], u32>,
}

impl Obstacles {
    pub(crate) fn new() -> Self {
        Self { poses: PoseHistory::new(POSES), waiting: VecDeque::new(), cells: HashMap::new() }
    }

    pub(crate) fn take_state(&mut self, state: &VehicleState, mount: &CameraMount) {
        if let Some(pose) = state.world_from_body() {
            self.poses.push(FlightTime::from_nanos(state.stamp.valid_ns), pose);
        }
        for cloud in std::mem::take(&mut self.waiting) {
            self.place(cloud, mount);
        }
    }

    /// Whether the bytes were a cloud.
    pub(crate) fn take_cloud(&mut self, bytes: &[u8], mount: &CameraMount) -> bool {
        let cloud = PointCloud::decode(bytes);
        cloud.map(|cloud| self.place(cloud, mount)).is_ok()
    }

    fn place(&mut self, cloud: PointCloud, mount: &CameraMount) {
        let at_ns = cloud.timestamp.unwrap_or_default().total_nanos() as i64;
        let body = match self.poses.at(FlightTime::from_nanos(at_ns)) {
            PoseAt::Known(body) => body,
            PoseAt::Forgotten => return,
            PoseAt::NotYet => {
                self.waiting.push_back(cloud);
                if self.waiting.len() > MOST_WAITING {
                    self.waiting.pop_front();
                }
                return;
            }
        };
        if self.cells.len() > MOST_CELLS {
            self.cells.clear();
        }
        let world_from_camera = body * mount.body_from_camera();
        let number = |bytes: &[u8; 4]| f64::from(f32::from_le_bytes(*bytes));
        for point in cloud.data.as_chunks::<12>().0 {
            let [x, y, z] = [0, 1, 2].map(|axis| point.as_chunks::<4>().0.get(axis).map_or(0.0, number));
            let world = world_from_camera * Point::<Camera>::new(x, y, z);
            let off = world - (Point::ZERO + body.translation);
            if off.z.abs() < BAND_M && world.z > GROUND_M && off.norm() < NEAR_M {
                *self.cells.entry([world.x, world.y].map(|x| (x / CELL_M).floor() as i32)).or_default() += 1;
            }
        }
    }

    /// Cells with something in them.
    pub(crate) fn cells(&self) -> impl Iterator<Item = [i32; 2]> {
        self.cells.iter().filter(|(_, sightings)| **sightings >= SIGHTINGS).map(|(cell, _)| *cell)
    }
}
