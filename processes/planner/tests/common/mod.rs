//! Forests of upright cylinders, asked about exactly, and the shortest ways through them.
#![allow(dead_code, unreachable_pub)] // Each test binary uses its own part of this.

use ipc_types::limits::Fence;
use ipc_types::{Point, Vector, World};
use planner::route::Space;
use rand::{RngExt, SeedableRng};
use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::f64::consts::TAU;

/// An upright cylinder without end.
#[derive(Clone, Copy, Debug)]
pub struct Pole {
    pub at: Point<World>,
    pub radius_m: f64,
}

/// Poles, and how often they were asked about.
#[derive(Clone, Debug, Default)]
pub struct Poles {
    pub poles: Vec<Pole>,
    pub asked: u32,
}

/// Corners of the polygon that stands for a pole.
const CORNERS: usize = 32;

impl Poles {
    pub fn of(poles: &[([f64; 2], f64)]) -> Self {
        let pole = |&([x, y], radius_m): &([f64; 2], f64)| Pole { at: Point::new(x, y, 0.0), radius_m };
        Self { poles: poles.iter().map(pole).collect(), asked: 0 }
    }

    /// A Poisson forest of trunks of 0.1 to 0.25 m, inflated by `inflation_m`; nothing stands at either end.
    pub fn forest(seed: u64, trees_per_m2: f64, inflation_m: f64, fence: &Fence, ends: [Point<World>; 2]) -> Self {
        let mut random = rand_pcg::Pcg64Mcg::seed_from_u64(seed);
        let [width, depth] = [0, 1].map(|axis| fence.most_m[axis] - fence.least_m[axis]);
        let mut poles = Vec::new();
        for _ in 0..(trees_per_m2 * width * depth).round() as usize {
            let x = fence.least_m[0] + width * random.random::<f64>();
            let y = fence.least_m[1] + depth * random.random::<f64>();
            let radius_m = random.random_range(0.1..0.25) + inflation_m;
            let at = Point::new(x, y, 0.0);
            if ends.iter().all(|end| (*end - at).horizontal_norm() > radius_m + 0.5) {
                poles.push(Pole { at, radius_m });
            }
        }
        Self { poles, asked: 0 }
    }

    pub fn is_clear(&self, from: Point<World>, to: Point<World>) -> bool {
        let level = |offset: Vector<World>| Vector::<World>::new(offset.x, offset.y, 0.0);
        let way = level(to - from);
        self.poles.iter().all(|pole| {
            let offset = level(pole.at - from);
            let share = (offset.dot(way) / way.dot(way).max(1e-12)).clamp(0.0, 1.0);
            (offset - way * share).norm() >= pole.radius_m
        })
    }

    /// Length of the shortest way between two places of one height, m, to within 0.3 %: over the visibility graph of
    /// polygons around the poles.
    pub fn optimum_m(&self, fence: &Fence, from: Point<World>, to: Point<World>) -> f64 {
        let mut nodes = vec![from, to];
        for pole in &self.poles {
            for corner in 0..CORNERS {
                let (turn, reach_m) =
                    (TAU * corner as f64 / CORNERS as f64, pole.radius_m / (TAU / 2.0 / CORNERS as f64).cos() + 1e-9);
                let at = Point::new(pole.at.x + reach_m * turn.cos(), pole.at.y + reach_m * turn.sin(), from.z);
                if fence.contains(at) && self.is_clear(at, at) {
                    nodes.push(at);
                }
            }
        }
        let mut to_come = vec![f64::INFINITY; nodes.len()];
        let mut done = vec![false; nodes.len()];
        let mut queue = BinaryHeap::from([Reverse((0_u64, 0_usize))]);
        to_come[0] = 0.0;
        while let Some(Reverse((_, index))) = queue.pop() {
            if index == 1 {
                break;
            }
            if std::mem::replace(&mut done[index], true) {
                continue;
            }
            for next in 0..nodes.len() {
                let come_m = to_come[index] + nodes[index].distance(nodes[next]);
                if come_m < to_come[next] && self.is_clear(nodes[index], nodes[next]) {
                    to_come[next] = come_m;
                    queue.push(Reverse(((come_m + nodes[next].distance(to)).to_bits(), next)));
                }
            }
        }
        to_come[1]
    }
}

impl Space for Poles {
    fn is_free(&mut self, place: Point<World>) -> bool {
        self.is_clear(place, place)
    }

    fn is_way_free(&mut self, from: Point<World>, to: Point<World>) -> bool {
        self.asked += 1;
        self.is_clear(from, to)
    }
}
