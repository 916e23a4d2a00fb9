//! What the graph and the map remember together: an obstacle that is too near to be matched, a phantom before a vehicle
//! that hovers, and how much memory that takes.

use expansion::{BackgroundRule, Config, Expander, Reach};
use ipc_types::disparity::{NO_MATCH, encode};
use ipc_types::messages::{ExpandedLayout, Layers};
use ipc_types::noise::NoiseModel;
use ipc_types::{Body, FlightTime, Point, Pose, Rotation, StereoRig, Vector, World};
use memory::{DisparityGraph, FreeSpace, FreeSpaceRule, GraphRule, Inference, MapModel, Node, Occupancy, View};
use runtime::images::ImageStore;

/// Table 5.1's rig at the resolution that it flew.
const RIG: StereoRig = StereoRig {
    width_px: 320,
    height_px: 240,
    focal_px: 257.085,
    cx_px: 159.5,
    cy_px: 119.5,
    baseline_m: 0.35,
    doffs_px: 0.0,
};
const NOISE: NoiseModel =
    NoiseModel { sigma_px: 0.3, sigma_m: 0.0, lambda_near: 3.0, lambda_far: 1.0, near_px: 8.0, far_px: 3.0 };
const MOST_PX: f32 = 32.0;
const RULE: GraphRule = GraphRule { keyframes: 10, spacing_m: 1.5, spacing_deg: 30.0 };
const FORGET_S: f64 = 1.0;
const RATE_HZ: f64 = 12.5;
const GAMMA: f32 = 0.9;

/// A vehicle that flies along the x axis, and what it has seen.
struct Flight {
    expander: Expander,
    graph: DisparityGraph,
    images: ImageStore,
    tick: u64,
}

impl Flight {
    fn new() -> Self {
        let config = Config {
            body_radius_m: 0.25,
            body_half_height_m: 0.2,
            background: BackgroundRule { limit_m: 0.0, share: 0.0, textureless_share: 1.0 },
            ..Config::for_sphere(0.5)
        };
        Self {
            expander: Expander::new(RIG, &NOISE, Reach::Matched { most_px: MOST_PX }, config),
            graph: DisparityGraph::new(RULE, FORGET_S),
            images: ImageStore::in_memory(),
            tick: 0,
        }
    }

    /// Takes a frame at `x_m` of a wall at 25 m, before it poles of 0.3 m that stand at (x, y).
    fn look(&mut self, x_m: f64, poles: &[(f64, f64)]) {
        let column = |column: usize| {
            let slope = (column as f64 - RIG.cx_px) / RIG.focal_px;
            // Right in the image is -y in the world.
            let hits = |&&(x, y): &&(f64, f64)| x > x_m && ((x - x_m) * -slope - y).abs() < 0.15;
            let depth_m = poles.iter().filter(hits).map(|(x, _)| x - x_m).fold(25.0 - x_m, f64::min);
            let d = RIG.disparity_px(depth_m) as f32;
            if d > MOST_PX { NO_MATCH } else { encode(d) }
        };
        let line: Vec<u16> = (0..320).map(column).collect();
        let mut elements = vec![0; self.expander.layout().elements()];
        self.expander.step(&line.repeat(240), &mut elements).expect("sizes agree");
        self.images.put(self.tick, &elements).expect("kept");
        let rotation = Rotation::<World, Body>::IDENTITY * Rotation::camera_mount(0.0);
        let node = Node {
            image_id: self.tick,
            exposure: FlightTime::from_secs_f64(self.tick as f64 / RATE_HZ),
            world_from_camera: Pose { rotation, translation: Vector::new(x_m, 0.0, 2.0) },
        };
        let images = &mut self.images;
        self.graph.insert(node, |id| images.remove(id));
        self.tick += 1;
    }

    fn at(&self, x_m: f64, y_m: f64) -> Occupancy {
        let model = MapModel {
            rig: RIG,
            noise: NOISE,
            layout: self.expander.layout(),
            radius_m: 0.5,
            inference: Inference::Confidence,
            forget_s: FORGET_S,
        };
        let rule =
            FreeSpaceRule { home_radius_m: 0.0, home_height_m: 0.0, swept_radius_m: 0.0, background_parallax_m: 0.5 };
        let mut view = View::new(model, FreeSpace::new(rule, Point::new(0.0, 0.0, -1e6)));
        for node in self.graph.nodes() {
            let image = self.images.get(node.image_id).expect("kept");
            assert!(view.push(node.world_from_camera, node.exposure, image));
        }
        view.occupancy(Point::new(x_m, y_m, 2.0), GAMMA)
    }
}

/// Fig. 5.10(a): the trees are not in the disparity image any more, but in the graph.
#[test]
fn an_obstacle_is_remembered_once_it_is_nearer_than_the_largest_disparity() {
    let mut flight = Flight::new();
    let pole = [(10.0, 0.6)];
    let blind_m = RIG.depth_m(f64::from(MOST_PX));
    assert!(blind_m > 2.5);
    let mut last_m = 0.0;
    for step in 0..50 {
        last_m = f64::from(step) * 0.16;
        flight.look(last_m, &pole);
    }
    assert!(10.0 - last_m < blind_m, "it is too near to be matched");
    for (x_m, y_m) in [(10.0, 0.6), (9.7, 0.6), (10.0, 0.3)] {
        assert_eq!(flight.at(x_m, y_m), Occupancy::Occupied, "{x_m} {y_m}");
    }
    // And beside it the way is free, from where it was seen past.
    assert_eq!(flight.at(8.5, -1.5), Occupancy::Free);
}

/// Absorbing hover: votes that cannot be cleared leave a vehicle before nothing for ever.
#[test]
fn a_phantom_is_gone_after_a_stated_number_of_clear_frames_and_a_real_pole_is_not() {
    // Recent frames are half of the time to forget apart: with the newest, three span it after one and a half.
    let stated = (1.5 * FORGET_S * RATE_HZ).ceil() as u32 + 1;
    let obstacle = [(7.0, 0.0)];
    for hover_m in [2.0, 3.0, 3.6] {
        let approach = |flight: &mut Flight| {
            (0..10).for_each(|frame| flight.look(hover_m * f64::from(frame) / 10.0, &obstacle));
            assert_eq!(flight.at(7.0, 0.0), Occupancy::Occupied, "ten frames saw it");
        };
        let mut flight = Flight::new();
        approach(&mut flight);
        let mut frames = 0;
        while flight.at(7.0, 0.0) != Occupancy::Free {
            flight.look(hover_m, &[]);
            frames += 1;
            assert!(frames <= stated, "{hover_m} m: still there after {frames} clear frames");
        }
        println!("hovering {:.1} m before a phantom: gone after {frames} clear frames, {stated} stated", 7.0 - hover_m);
        // A real one, of which every other frame sees nothing.
        let mut flight = Flight::new();
        approach(&mut flight);
        for frame in 0..5 * stated {
            flight.look(hover_m, if frame % 2 == 0 { &[] } else { &obstacle });
            assert_eq!(flight.at(7.0, 0.0), Occupancy::Occupied, "{hover_m} m, frame {frame}");
        }
        // And one that is not looked at again is never forgotten: the vehicle looks elsewhere, from beyond it.
        for _ in 0..5 * stated {
            flight.look(12.0, &[]);
        }
        assert_eq!(flight.at(7.0, 0.0), Occupancy::Occupied);
    }
}

/// Blocks of 8 × 8 × 8 voxels that a sparse map allocates for ten frames of a forest, 1.5 m apart: all that a ray passes.
fn sparse_blocks(cell_m: f64) -> usize {
    let trunks: Vec<(f64, f64)> = (0..600)
        .map(|i| {
            // Spread evenly: multiples of the golden ratio's and the square root's fractions.
            let i = f64::from(i);
            ((i * 0.618_034).fract() * 130.0, (i * 0.414_214).fract() * 120.0 - 60.0)
        })
        .collect();
    let block_m = 8.0 * cell_m;
    let mut blocks = std::collections::HashSet::new();
    for frame in 0..10 {
        let x_m = 1.5 * f64::from(frame);
        for column in (0..RIG.width_px).step_by(2) {
            let slope = (f64::from(column) - RIG.cx_px) / RIG.focal_px;
            let hits = |(x, y): &&(f64, f64)| *x > x_m && ((x - x_m) * -slope - y).abs() < 0.15;
            let depth_m = trunks.iter().filter(hits).map(|(x, _)| x - x_m).fold(100.0, f64::min);
            for row in (0..RIG.height_px).step_by(2) {
                let up = (RIG.cy_px - f64::from(row)) / RIG.focal_px;
                for step in 0..=(depth_m / (0.5 * block_m)) as u32 {
                    let z = f64::from(step) * 0.5 * block_m;
                    blocks.insert([x_m + z, -slope * z, up * z].map(|at| (at / block_m).floor() as i64));
                }
            }
        }
    }
    blocks.len()
}

/// Section 5.4.1: 10 nodes over 15 m, seen up to 100 m. A grid of 1 m cells of 4 bytes over the same volume, and one of 0.5 m.
#[test]
fn the_memory_that_keyframes_take_against_grids_over_the_same_volume() {
    let (wide, high) = (f64::from(RIG.width_px) / RIG.focal_px, f64::from(RIG.height_px) / RIG.focal_px);
    let (far_m, moved_m) = (100.0_f64, 15.0);
    // One frustum, and what the far end sweeps as the vehicle moves.
    let volume_m3 = wide * high * (far_m.powi(3) / 3.0 + far_m * far_m * moved_m);
    let bytes = |layers: Layers| 10 * 2 * ExpandedLayout::new(&RIG, 0, layers).elements();
    let (two, four) = (bytes(Layers::Two) as f64, bytes(Layers::Four) as f64);
    let grid = |cell_m: f64| 4.0 * volume_m3 / cell_m.powi(3);
    let sparse = |cell_m: f64| sparse_blocks(cell_m) as f64 * 512.0 * 4.0;
    for (name, bytes) in [("two layers", two), ("four layers", four)] {
        println!(
            "10 keyframes of 320 x 240, {name}: {:.2} MB; {:.0} % of a 1 m grid, {:.0} % of a 0.5 m grid; \
             {:.0} % and {:.0} % of sparse maps of such cells",
            bytes / 1e6,
            100.0 * bytes / grid(1.0),
            100.0 * bytes / grid(0.5),
            100.0 * bytes / sparse(1.0),
            100.0 * bytes / sparse(0.5)
        );
    }
    // The thesis's two layers of one byte a pixel, without near and gap limits.
    let thesis = 10.0 * 2.0 * RIG.pixels() as f64;
    println!("two layers of one byte: {:.0} % of a 1 m grid", 100.0 * thesis / grid(1.0));
    assert!(two < 0.5 * grid(0.5) && four < grid(0.5), "{two} {four} {}", grid(0.5));
}
