//! What a vehicle's cameras have seen, from above: cells with something in them.

use ipc_types::messages::VehicleState;
use ipc_types::pose_history::{PoseAt, PoseHistory};
use ipc_types::rig::CameraMount;
use ipc_types::{Body, Camera, FlightTime, Point, Pose, World};
use std::collections::{HashMap, VecDeque};
use std::time::{Duration, Instant};

/// Points that lie so far above or below the vehicle count, m.
const BAND_M: f64 = 1.0;
/// Those that are lower above the take-off place are the ground, m.
const GROUND_M: f64 = 0.3;
/// Of those that were seen from farther, stereo's error is no longer small, m.
const NEAR_M: f64 = 12.0;
/// So many points may be nearer than what counts as nearest: single false matches.
const OUTLIERS: usize = 3;
/// Seen so often, and something is there.
const SIGHTINGS: u32 = 2;
/// Cells, at most; beyond, it begins anew.
const MOST_CELLS: usize = 50_000;
/// Poses remembered: at 10 Hz more than a slow link is late.
const POSES: usize = 200;
/// Without clouds for longer, nobody knows what is near.
const FRESH: Duration = Duration::from_secs(2);
/// Clouds that wait for the pose they were seen from.
const MOST_WAITING: usize = 8;

/// Cells by how often something was seen in them, at the vehicle's height, from near.
#[derive(Clone, Debug, Default)]
pub struct ObstacleCells(HashMap<[i32; 2], u32>);

impl ObstacleCells {
    /// Side of a cell, m.
    pub const SIDE_M: f64 = 0.25;

    /// Takes points that were seen from a pose. Returns the distance of what is nearest, m, however far that is.
    pub fn see(&mut self, body: Pose<World, Body>, mount: &CameraMount, points: &[Point<Camera>]) -> Option<f64> {
        let world_from_camera = body * mount.body_from_camera();
        let mut distances_m = Vec::new();
        for point in points {
            let at = world_from_camera * *point;
            let off = at - body.origin();
            if off.z.abs() < BAND_M && at.z > GROUND_M {
                distances_m.push(off.norm());
                if off.norm() < NEAR_M {
                    *self.0.entry([at.x, at.y].map(|x| (x / Self::SIDE_M).floor() as i32)).or_default() += 1;
                }
            }
        }
        distances_m.sort_by(f64::total_cmp);
        distances_m.get(OUTLIERS).copied()
    }

    /// Distance of the nearest cell in which something was seen so often, along the ground, m; as far as anything is kept, if
    /// there is none nearer.
    pub fn nearest_m(&self, place: Point<World>, sightings: u32) -> f64 {
        let centre = |cell: i32| (f64::from(cell) + 0.5) * Self::SIDE_M;
        let distances = self.seen(sightings).map(|[x, y]| (centre(x) - place.x).hypot(centre(y) - place.y));
        distances.fold(NEAR_M, f64::min)
    }

    /// Cells in which something was seen so often: their lower corners (east, north), in sides.
    pub fn seen(&self, sightings: u32) -> impl Iterator<Item = [i32; 2]> {
        self.0.iter().filter(move |(_, seen)| **seen >= sightings).map(|(cell, _)| *cell)
    }
}

/// Cells of clouds and states that come in no order, and late.
#[derive(Debug)]
pub(crate) struct Obstacles {
    poses: PoseHistory,
    waiting: VecDeque<(FlightTime, Vec<Point<Camera>>)>,
    cells: ObstacleCells,
    /// When the last cloud came.
    heard: Option<Instant>,
}

impl Obstacles {
    pub(crate) fn new() -> Self {
        Self { poses: PoseHistory::new(POSES), waiting: VecDeque::new(), cells: ObstacleCells::default(), heard: None }
    }

    pub(crate) fn take_state(&mut self, state: &VehicleState, mount: &CameraMount) {
        if let Some(pose) = state.world_from_body() {
            self.poses.push(FlightTime::from_nanos(state.stamp.valid_ns), pose);
        }
        for (at, points) in std::mem::take(&mut self.waiting) {
            self.place(at, points, mount);
        }
    }

    /// Whether the bytes were a cloud.
    pub(crate) fn take_cloud(&mut self, bytes: &[u8], mount: &CameraMount) -> bool {
        let Some((at, points)) = encoding::points(bytes) else { return false };
        self.heard = Some(Instant::now());
        self.place(at, points, mount);
        true
    }

    fn place(&mut self, at: FlightTime, points: Vec<Point<Camera>>, mount: &CameraMount) {
        match self.poses.at(at) {
            PoseAt::Known(body) => {
                if self.cells.0.len() > MOST_CELLS {
                    self.cells = ObstacleCells::default();
                }
                self.cells.see(body, mount, &points);
            }
            PoseAt::Forgotten => {}
            PoseAt::NotYet => {
                self.waiting.push_back((at, points));
                if self.waiting.len() > MOST_WAITING {
                    self.waiting.pop_front();
                }
            }
        }
    }

    /// Distance of the nearest thing that was seen, m, at most as far as anything is kept; `None` while nothing is looked at.
    pub(crate) fn nearest_m(&self, place: Point<World>) -> Option<f64> {
        let is_fresh = self.heard.is_some_and(|heard| heard.elapsed() < FRESH);
        is_fresh.then(|| self.cells.nearest_m(place, SIGHTINGS))
    }

    /// Cells with something in them.
    pub(crate) fn cells(&self) -> impl Iterator<Item = [i32; 2]> {
        self.cells.seen(SIGHTINGS)
    }
}
