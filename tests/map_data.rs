//! Expansion and map on real images that nobody here made.

mod common;

use common::data;
use expansion::{BackgroundRule, Config, Expander, Reach};
use ipc_types::disparity::{NO_MATCH, SCALE, decode, encode, is_valid};
use ipc_types::messages::{ExpandedCells, ExpandedLayout, Layers, Seen};
use ipc_types::noise::NoiseModel;
use ipc_types::{Camera, FlightTime, Point, StereoRig, Vector};
use memory::{DisparityGraph, FreeSpace, FreeSpaceRule, GraphRule, Inference, MapModel, Node, Occupancy, View};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use sparrowhawk::posed_sequence::{depth_table, posed_frames};
use std::path::Path;
use std::process::Command;
use stereo_ingest::{Matcher, StereoPair, load_disparity};

const NOISE: NoiseModel =
    NoiseModel { sigma_px: 0.3, sigma_m: 0.0, lambda_near: 3.0, lambda_far: 1.0, near_px: 8.0, far_px: 3.0 };

/// A camera of about the usual angle of view; any will do, since the oracle has the same.
fn rig(width_px: u32, height_px: u32) -> StereoRig {
    let focal_px = 0.8 * f64::from(width_px);
    let (cx_px, cy_px) = (f64::from(width_px - 1) / 2.0, f64::from(height_px - 1) / 2.0);
    StereoRig { width_px, height_px, focal_px, cx_px, cy_px, baseline_m: 0.16, doffs_px: 0.0 }
}

struct Expanded {
    rig: StereoRig,
    layout: ExpandedLayout,
    elements: Vec<u16>,
    unknown_share: f32,
}

impl Expanded {
    fn of(rig: StereoRig, noise: &NoiseModel, reach: Reach, config: Config, image: &[u16]) -> Self {
        let mut expander = Expander::new(rig, noise, reach, config);
        let layout = expander.layout();
        let mut elements = vec![0; layout.elements()];
        let unknown_share = expander.step(image, &mut elements).expect("sizes agree").unknown_share;
        Self { rig, layout, elements, unknown_share }
    }

    fn ask(&self, point: Point<Camera>) -> Option<Seen> {
        let (u, v, d) = self.rig.project(point)?;
        let margin = f64::from(self.layout.margin_px);
        let (column, row) = ((u + margin).round(), (v + margin).round());
        let inside = column >= 0.0
            && row >= 0.0
            && column < f64::from(self.layout.width_px)
            && row < f64::from(self.layout.height_px);
        let cells = ExpandedCells::split(&self.elements, self.layout).expect("of the layout's length");
        let index = || row as usize * self.layout.width_px as usize + column as usize;
        inside.then(|| cells.at(index(), (d * f64::from(SCALE)) as f32))
    }
}

/// Measured disparities: true ones, and those of the matcher.
fn images(data: &Path) -> Vec<(String, u32, u32, Vec<u16>)> {
    let truth = |folder: &str, (width, height): (u32, u32)| {
        let path = data.join(folder).join("derived_gt_u16x256.png");
        let found = load_disparity(&path, width, height).expect("readable");
        (folder.to_owned(), width, height, found.iter().map(|d| d.map_or(NO_MATCH, encode)).collect())
    };
    let size = |path: &str| image::image_dimensions(data.join(path)).expect("an image");
    let mut found: Vec<_> = ["mid2003_cones", "mid2014_motorcycle_perfect_q", "eth3d_playground", "kitti2012_pair_gt"]
        .map(|folder| truth(folder, size(&format!("{folder}/derived_gt_u16x256.png"))))
        .into();
    for (left, right) in [
        ("mid2003_cones/im2.png", "mid2003_cones/im6.png"),
        ("kitti2012_pair_gt/kittiL.png", "kitti2012_pair_gt/kittiR.png"),
        ("eth3d_playground/im0.png", "eth3d_playground/im1.png"),
    ] {
        let pair = StereoPair::load(&data.join(left), &data.join(right)).expect("readable");
        let rig = rig(pair.width_px, pair.height_px);
        let mut matcher = Matcher::new(&rig, stereo_ingest::Config::dense(64));
        let mut disparity = vec![0; rig.pixels()];
        let (left_pixels, right_pixels) = pair.pixels.split_at(rig.pixels());
        matcher.step(left_pixels, right_pixels, &mut disparity).expect("sizes agree");
        found.push((format!("{left}, matched"), rig.width_px, rig.height_px, disparity));
    }
    found
}

#[test]
fn no_point_near_a_really_measured_surface_is_free() {
    let Some(data) = data() else { return };
    for (name, width, height, image) in images(&data) {
        let rig = rig(width, height);
        for (seed, layers, radius_m) in [(1, Layers::Two, 0.5_f32), (2, Layers::Four, 0.25)] {
            let config = Config {
                layers,
                margin_px: 16,
                body_radius_m: 0.5 * radius_m,
                body_half_height_m: 0.3 * radius_m,
                hole_px: 6,
                patch_px: 0,
                background: BackgroundRule { limit_m: 12.0, share: 0.7, textureless_share: 0.8 },
                ..Config::for_sphere(radius_m)
            };
            let expanded = Expanded::of(rig, &NOISE, Reach::Matched { most_px: 256.0 }, config, &image);
            let mut random = Pcg64Mcg::seed_from_u64(seed);
            let (mut asked, mut occupied) = (0, 0);
            while asked < 60_000 {
                let index = random.random_range(0..image.len());
                let Some(d) = decode(image[index]) else { continue };
                let (near, far) = NOISE.ends_px(d, rig.focal_baseline_px_m() as f32);
                let within = f64::from(far.max(0.1) + (near - far.max(0.1)) * random.random_range(0.0_f32..=1.0));
                let (u, v) = ((index % width as usize) as f64, (index / width as usize) as f64);
                let surface = rig.back_project(u, v, within);
                let direction = [0, 1, 2].map(|_| random.random_range(-1.0_f64..1.0));
                let norm = direction.iter().map(|c| c * c).sum::<f64>().sqrt().max(1e-3);
                let reach = f64::from(radius_m) * random.random_range(0.0_f64..0.999).powf(0.15) / norm;
                let point = surface + Vector::from_array(direction.map(|c| c * reach));
                let Some(seen) = expanded.ask(point) else { continue };
                assert!(!matches!(seen, Seen::Free | Seen::FarBackground), "{name}: {point:?} near {surface:?}");
                (asked, occupied) = (asked + 1, occupied + u32::from(seen == Seen::Occupied));
            }
            let invalid = image.iter().filter(|&&pixel| !is_valid(pixel)).count() as f64 / image.len() as f64;
            let excess = f64::from(expanded.unknown_share) - invalid;
            println!(
                "{name}, {} layers: {asked} asked, {occupied} occupied, none free; {:.1} % unmatched, unknown {:+.2} %",
                layers.count(),
                100.0 * invalid,
                100.0 * excess
            );
            // Laser returns of a car's roof are dots; what is dense stays so.
            assert!(excess < 0.02 || name.starts_with("kitti2012_pair_gt") && !name.contains("matched"), "{name}");
        }
    }
}

const KINECT: StereoRig = StereoRig {
    width_px: 640,
    height_px: 480,
    focal_px: 585.0,
    cx_px: 320.0,
    cy_px: 240.0,
    baseline_m: 0.075,
    doffs_px: 0.0,
};
const KINECT_NOISE: NoiseModel =
    NoiseModel { sigma_px: 0.1, sigma_m: 0.0, lambda_near: 3.0, lambda_far: 1.0, near_px: 20.0, far_px: 8.0 };
const REACH: Reach = Reach::Ranged { nearest_m: 0.4 };

/// Of what later frames call free or occupied: how much of what the map calls so is so, and how much of it the map finds.
#[derive(Default)]
struct Agreement {
    /// By what the map says (free, occupied, unknown), then by what the frame does (free, occupied).
    counts: [[u32; 2]; 3],
}

impl Agreement {
    fn figures(&self) -> [f64; 4] {
        let share = |part: u32, whole: u32| f64::from(part) / f64::from(whole.max(1));
        let [free, occupied, unknown] = self.counts;
        let all = |label: usize| free[label] + occupied[label] + unknown[label];
        [
            share(occupied[1], occupied[0] + occupied[1]),
            share(occupied[1], all(1)),
            share(free[0], free[0] + free[1]),
            share(free[0], all(0)),
        ]
    }
}

#[test]
fn what_a_depth_camera_has_seen_agrees_with_what_it_sees_later() {
    let Some(data) = data() else { return };
    let (frames, left_out) = posed_frames(&data.join("depth_7scenes_seq")).expect("a sequence");
    assert_eq!((frames.len(), left_out), (40, 0));
    let table = depth_table(&KINECT, 0.001, 0.4, 6.0).expect("a table");
    let config = Config {
        layers: Layers::Four,
        // Small, since the camera's images are full of holes that a larger body would reach.
        body_radius_m: 0.03,
        body_half_height_m: 0.03,
        hole_px: 12,
        patch_px: 0,
        ..Config::for_sphere(0.15)
    };
    let expanded: Vec<Expanded> = frames
        .iter()
        .map(|frame| {
            let image = frame.disparity(&KINECT, &table).expect("readable");
            Expanded::of(KINECT, &KINECT_NOISE, REACH, config, &image)
        })
        .collect();
    let rule = GraphRule { keyframes: 30, spacing_m: 0.1, spacing_deg: 5.0 };
    let free_space =
        FreeSpaceRule { home_radius_m: 0.0, home_height_m: 0.0, swept_radius_m: 0.0, background_parallax_m: 0.5 };
    for inference in [Inference::Confidence, Inference::LogOdds { prior: 0.1 }] {
        let model = MapModel {
            rig: KINECT,
            noise: KINECT_NOISE,
            layout: config.layout(&KINECT),
            radius_m: config.radius_m,
            inference,
            forget_s: 1.0,
        };
        let empty = || View::new(model, FreeSpace::new(free_space, Point::new(0.0, 0.0, -1e6)));
        let node = |index: usize| Node {
            image_id: index as u64,
            // Every fifth frame of 30 a second.
            exposure: FlightTime::from_secs_f64(index as f64 / 6.0),
            world_from_camera: frames[index].world_from_camera,
        };
        let push = |view: &mut View, node: &Node| {
            let image = expanded[node.image_id as usize].elements.clone();
            assert!(view.push(node.world_from_camera, node.exposure, image.into()));
        };
        let mut graph = DisparityGraph::new(rule, model.forget_s);
        (0..30).for_each(|index| assert!(graph.insert(node(index), |_| {})));
        let (mut fused, mut single) = (empty(), empty());
        graph.nodes().for_each(|node| push(&mut fused, node));
        push(&mut single, &node(29));
        let mut random = Pcg64Mcg::seed_from_u64(1);
        let (mut by_fused, mut by_single) = (Agreement::default(), Agreement::default());
        for index in 30..40 {
            for _ in 0..20_000 {
                let [u, v] = [640.0, 480.0].map(|size| random.random_range(0.0..size - 1.0));
                let point = KINECT.back_project(u, v, KINECT.disparity_px(random.random_range(0.5..5.0)));
                let label = match expanded[index].ask(point) {
                    Some(Seen::Free) => 0,
                    Some(Seen::Occupied) => 1,
                    _ => continue,
                };
                let world = frames[index].world_from_camera * point;
                for (view, agreement) in [(&fused, &mut by_fused), (&single, &mut by_single)] {
                    let said = match view.occupancy(world, 0.9) {
                        Occupancy::Free => 0,
                        Occupancy::Occupied => 1,
                        Occupancy::Unknown(_) => 2,
                    };
                    agreement.counts[said][label] += 1;
                }
            }
        }
        for (name, agreement) in [("30 frames fused", &by_fused), ("the 30th alone", &by_single)] {
            let [p_occupied, r_occupied, p_free, r_free] = agreement.figures().map(|share| 100.0 * share);
            println!(
                "{inference:?}, {name}, {} keyframes: occupied precision {p_occupied:.1} %, recall {r_occupied:.1} %; \
                 free precision {p_free:.1} %, recall {r_free:.1} %",
                if name.starts_with("30") { fused.keyframes() } else { 1 }
            );
        }
        let ([p_occupied, r_occupied, p_free, r_free], alone) = (by_fused.figures(), by_single.figures());
        assert!(p_free > 0.88 && p_occupied > 0.88, "{:?}", by_fused.figures());
        assert!(r_occupied > alone[1] && r_free > alone[3], "fusing finds more: {r_occupied} {r_free}, {alone:?}");
    }
}

#[test]
fn the_commands_write_what_they_say() {
    let Some(data) = data() else { return };
    let scratch = tempfile::tempdir().expect("writable");
    let text = |path: &Path| path.display().to_string();
    let run = |arguments: &[&str]| {
        let output = Command::new(env!("CARGO_BIN_EXE_sparrowhawk")).args(arguments).output().expect("runs");
        (
            output.status.success(),
            String::from_utf8_lossy(&output.stdout).into_owned() + &String::from_utf8_lossy(&output.stderr),
        )
    };
    let rig_file = scratch.path().join("rig.ron");
    std::fs::write(
        &rig_file,
        "(width_px: 450, height_px: 375, focal_px: 375.0, cx_px: 224.5, cy_px: 187.0, baseline_m: 0.16, doffs_px: 0.0)",
    )
    .expect("written");
    let cones = text(&data.join("mid2003_cones/derived_gt_u16x256.png"));
    let (rig_text, prefix) = (text(&rig_file), text(&scratch.path().join("cones")));
    let base = ["expand", &cones, "--rig", &rig_text, "--radius", "0.2", "--out-prefix", &prefix];
    let (done, said) = run(&[&base[..], &["--layers", "4", "--margin", "20"]].concat());
    assert!(done && said.contains("490 x 415 px, 4 layers"), "{said}");
    for layer in ["front", "back", "front2", "back2"] {
        let path = scratch.path().join(format!("cones-{layer}.pfm"));
        let values = load_disparity(&path, 490, 415).expect("a PFM of that size");
        assert!(values.iter().flatten().count() > 50_000, "{layer}");
        assert_eq!(image::image_dimensions(path.with_extension("png")).expect("a picture"), (490, 415));
    }
    for (wrong, expected) in [
        (["--radius", "0"], "radius_m"),
        (["--margin", "7"], "even"),
        (["--layers", "3"], "2, 4"),
        (["--rig", "/nonexistent.ron"], "/nonexistent.ron"),
    ] {
        let arguments: Vec<&str> = base.iter().copied().filter(|word| *word != wrong[0]).collect();
        let cut = match base.iter().position(|word| *word == wrong[0]) {
            Some(at) => [&base[..at], &base[at + 2..]].concat(),
            None => arguments,
        };
        let (done, said) = run(&[&cut[..], &wrong].concat());
        assert!(!done && said.contains(expected), "{wrong:?}: {said}");
    }
    let kinect = scratch.path().join("kinect.ron");
    std::fs::write(
        &kinect,
        "(width_px: 640, height_px: 480, focal_px: 585.0, cx_px: 320.0, cy_px: 240.0, baseline_m: 0.075, doffs_px: 0.0)",
    )
    .expect("written");
    let (folder, kinect, prefix) =
        (text(&data.join("depth_7scenes_seq")), text(&kinect), text(&scratch.path().join("kitchen")));
    let size = ["--size", "6", "6", "3", "--voxel", "0.05"];
    let (done, said) = run(&[&["map", &folder, "--rig", &kinect, "--out-prefix", &prefix], &size[..]].concat());
    assert!(done && said.contains("864000 of 0.05 m"), "{said}");
    println!("{said}");
    for picture in ["kitchen-top.png", "kitchen-oblique.png"] {
        let picture = image::open(scratch.path().join(picture)).expect("a picture").to_rgb8();
        let colours: std::collections::HashSet<_> = picture.pixels().map(|pixel| pixel.0).collect();
        assert!(colours.len() > 20, "{} colours", colours.len());
    }
    let points = std::fs::read_to_string(scratch.path().join("kitchen.ply")).expect("written");
    let (head, points) = points.split_once("end_header\n").expect("a header");
    assert!(head.contains(&format!("element vertex {}\n", points.lines().count())) && points.lines().count() > 1000);
}

/// Figs 3.13 and 3.14 for Table 5.1's rig: 50 m and 5 m are 3.60 px and 35.99 px.
#[test]
fn the_curves_of_the_thesis_are_drawn() {
    let scratch = tempfile::tempdir().expect("writable");
    let (rig, out) = (scratch.path().join("rig.ron"), scratch.path().join("curves.svg"));
    let thesis = "(width_px: 640, height_px: 480, focal_px: 514.17, cx_px: 319.5, cy_px: 239.5, baseline_m: 0.35, doffs_px: 0.0)";
    std::fs::write(&rig, thesis).expect("written");
    let mut command = Command::new(env!("CARGO_BIN_EXE_sparrowhawk"));
    command.arg("curves").arg("--rig").arg(&rig).args(["--radius", "0.5", "--sigma", "0.5", "--out"]).arg(&out);
    let output = command.output().expect("runs");
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    println!("{said}");
    assert!(
        said.contains("3.60 px: mass 0.0574, confidence 0.8611") && said.contains("35.99 px: mass 1.0000"),
        "{said}"
    );
    let drawn = std::fs::read_to_string(&out).expect("written");
    assert!(drawn.contains("50 m: 3.60 px") && drawn.contains("5 m: 35.99 px") && drawn.contains("probability mass"));
}
