//! The noise-model camera against rendered pairs and the matcher, for the vehicles that ship: density, outliers, thin
//! things, and how long what is missed stays missed.

mod common;

use common::on_threads;
use ipc_types::disparity::{TEXTURED, TEXTURELESS, decode, is_valid};
use ipc_types::{Body, Camera, Pose, Rotation, Vector, World as WorldFrame};
use simulator::{Class, NoiseCamera, StereoCamera};
use sparrowhawk::config::FlightConfig;
use sparrowhawk::graph;
use std::sync::Arc;
use stereo_ingest::Matcher;

/// Worlds, and places in each.
const WORLDS: u64 = 12;
const PLACES: i32 = 18;
/// Off by more than this is wrong, px.
const WRONG_PX: f32 = 2.0;
/// The model may be off by this share of what it models.
const TOLERANCE: f64 = 0.2;

/// What one of the cameras delivers.
#[derive(Clone, Debug, Default)]
struct Tally {
    /// By class: pixels, measured, wrong, textureless, textured.
    classes: [[usize; 5]; Class::ALL.len()],
    squares: f64,
    right: usize,
    /// Rows of thin things, and those without a near enough measurement.
    thin: [usize; 2],
    /// Of places seen in two images of places near the vehicle: measured in neither, the second, the first, both.
    pairs: [usize; 4],
}

impl Tally {
    fn add(&mut self, truth: &[f32], classes: &[Class], found: &[u16], width: usize) {
        for ((&truth, &class), &found) in truth.iter().zip(classes).zip(found) {
            let error = decode(found).map(|found| found - truth);
            let wrong = error.is_some_and(|error| error.abs() > WRONG_PX);
            let counts = [true, is_valid(found), wrong, found == TEXTURELESS, found == TEXTURED];
            self.classes[class as usize].iter_mut().zip(counts).for_each(|(all, one)| *all += usize::from(one));
            if let Some(error) = error.filter(|_| !wrong && truth > 0.0) {
                self.squares += f64::from(error * error);
                self.right += 1;
            }
        }
        let rows = truth.chunks_exact(width).zip(classes.chunks_exact(width)).zip(found.chunks_exact(width));
        for ((truth, classes), found) in rows {
            self.add_thin(truth, classes, found);
        }
    }

    fn add_thin(&mut self, truth: &[f32], classes: &[Class], found: &[u16]) {
        let is_thin = |x: usize| matches!(classes[x], Class::Hair | Class::Thin) && truth[x] > 5.0;
        let mut x = 0;
        while x < truth.len() {
            let start = x;
            while x < truth.len() && is_thin(x) && (truth[x] - truth[start]).abs() < WRONG_PX {
                x += 1;
            }
            if x == start {
                x += 1;
                continue;
            }
            let around = start.saturating_sub(1)..(x + 1).min(truth.len());
            let is_near = |x: usize| decode(found[x]).is_some_and(|found| found > truth[start] - WRONG_PX);
            self.thin[0] += 1;
            self.thin[1] += usize::from(!around.clone().any(is_near));
        }
    }

    fn merge(&mut self, other: &Self) {
        for (mine, theirs) in self.classes.iter_mut().zip(other.classes) {
            mine.iter_mut().zip(theirs).for_each(|(mine, theirs)| *mine += theirs);
        }
        self.squares += other.squares;
        self.right += other.right;
        self.thin.iter_mut().zip(other.thin).for_each(|(mine, theirs)| *mine += theirs);
        self.pairs.iter_mut().zip(other.pairs).for_each(|(mine, theirs)| *mine += theirs);
    }

    /// Shares: measured of what is no sky, wrong of the measured, thin rows missed; correlation of being measured; of what
    /// is hidden, the part that is textured and unmatched; and of all else but the sky.
    fn figures(&self) -> [f64; 6] {
        let solid = self.classes.iter().skip(2);
        let sum = |which: usize| solid.clone().map(|class| class[which]).sum::<usize>() as f64;
        let [neither, second, first, both] = self.pairs.map(|count| count as f64);
        let all = (first + both) * (second + both) * (neither + second) * (neither + first);
        let lasting = (both * neither - first * second) / all.sqrt();
        let [hidden, _, _, _, textured] = self.classes[Class::Hidden as usize].map(|count| count as f64);
        let others = (sum(4) - textured) / (sum(0) - hidden);
        [
            sum(1) / sum(0),
            sum(2) / sum(1),
            self.thin[1] as f64 / self.thin[0] as f64,
            lasting,
            textured / hidden,
            others,
        ]
    }

    fn print(&self, name: &str) {
        let [density, wrong, missed, lasting, ..] = self.figures();
        println!(
            "{name}: density {:.1} %, bad2 {:.2} %, thin missed {:.1} % of {}, correlation {lasting:.3}, sigma {:.3} px",
            100.0 * density,
            100.0 * wrong,
            100.0 * missed,
            self.thin[0],
            (self.squares / self.right as f64).sqrt()
        );
        for (class, [all, measured, wrong, textureless, textured]) in Class::ALL.iter().zip(self.classes) {
            let share = |part: usize| part as f64 / all.max(1) as f64;
            println!(
                "  {:9} {all:9} px: measured {:.3}, beside {:.3}, textureless {:.3}, textured {:.3}",
                class.name(),
                share(measured - wrong),
                share(wrong),
                share(textureless),
                share(textured)
            );
        }
    }
}

/// Which of the places that a first image sees, every few pixels, are measured there and in a second image.
fn add_pairs(
    tally: &mut Tally,
    config: &FlightConfig,
    poses: [Pose<WorldFrame, Camera>; 2],
    truths: [&[f32]; 2],
    found: [&[u16]; 2],
) {
    let rig = config.vehicle.rig;
    let width = rig.width_px as usize;
    for pixel in (0..rig.pixels()).step_by(7).filter(|&pixel| truths[0][pixel] > 0.0) {
        let (u_px, v_px) = ((pixel % width) as f64, (pixel / width) as f64);
        let place = poses[0] * rig.back_project(u_px, v_px, f64::from(truths[0][pixel]));
        let Some((u_px, v_px, disparity_px)) = rig.project(poses[1].inverse() * place) else { continue };
        let (column, row) = (u_px.round(), v_px.round());
        if !(0.0..width as f64).contains(&column) || !(0.0..f64::from(rig.height_px)).contains(&row) {
            continue;
        }
        let other = row as usize * width + column as usize;
        if (f64::from(truths[1][other]) - disparity_px).abs() < 0.5 {
            let which = 2 * usize::from(is_valid(found[0][pixel])) + usize::from(is_valid(found[1][other]));
            tally.pairs[which] += 1;
        }
    }
}

/// Both cameras at every place of a world, and a step of a tenth of a second farther at 4 m/s.
fn look(config: &FlightConfig, seed: u64) -> [Tally; 2] {
    let (rig, vehicle) = (config.vehicle.rig, &config.vehicle);
    let config = FlightConfig { seed, ..config.clone() };
    let world = Arc::new(graph::world(&config).expect("no file"));
    let mut rendered = StereoCamera::new(Arc::clone(&world), rig, vehicle.simulator.camera, seed);
    let mut modelled = NoiseCamera::new(world, rig, vehicle.simulator.noise_camera, seed);
    let mut matcher = Matcher::new(&rig, vehicle.stereo);
    let (mut pixels, mut tallies) = (vec![0; 2 * rig.pixels()], [Tally::default(), Tally::default()]);
    for place in 0..PLACES {
        let yaw_rad = f64::from(place) * 0.7 + seed as f64;
        let at = |step_m: f64| -> Pose<WorldFrame, Camera> {
            let ahead = Vector::new(yaw_rad.cos(), yaw_rad.sin(), 0.0) * step_m;
            let body = Pose::<WorldFrame, Body> {
                rotation: Rotation::from_roll_pitch_yaw(0.03, 0.05, yaw_rad),
                translation: Vector::new(f64::from(place) * 5.0, f64::from(place % 3) * 4.0 - 4.0, 1.8) + ahead,
            };
            body * vehicle.mount.body_from_camera()
        };
        let poses = [at(0.0), at(0.4)];
        let images = poses.map(|pose| {
            let (truth, classes) = modelled.look(pose);
            let (truth, classes) = (truth.to_vec(), classes.to_vec());
            let (mut matched, mut made) = (vec![0; rig.pixels()], vec![0; rig.pixels()]);
            rendered.expose(pose, &mut pixels);
            let (left, right) = pixels.split_at(rig.pixels());
            matcher.step(left, right, &mut matched).expect("sizes agree");
            modelled.expose(pose, &mut made);
            (truth, classes, [matched, made])
        });
        for (which, tally) in tallies.iter_mut().enumerate() {
            for (truth, classes, found) in &images {
                tally.add(truth, classes, &found[which], rig.width_px as usize);
            }
            let [(first, _, in_first), (second, _, in_second)] = &images;
            add_pairs(tally, &config, poses, [first, second], [&in_first[which], &in_second[which]]);
        }
    }
    tallies
}

fn compare(flight: Option<&str>) {
    let config = FlightConfig::load(flight.map(str::as_ref), None).expect("loads");
    let worlds = on_threads(2, 301..=300 + WORLDS, |seed| look(&config, seed));
    let mut tallies = [Tally::default(), Tally::default()];
    worlds.iter().for_each(|world| tallies.iter_mut().zip(world).for_each(|(all, one)| all.merge(one)));
    tallies.iter().zip(["rendered", "modelled"]).for_each(|(tally, name)| tally.print(name));
    let [rendered, modelled] = tallies.map(|tally| tally.figures());
    let names = ["density", "bad2", "thin things missed", "correlation", "hidden and textured", "others textured"];
    for ((name, rendered), modelled) in names.iter().zip(rendered).zip(modelled) {
        let share = modelled / rendered;
        assert!((share - 1.0).abs() < TOLERANCE, "{name}: {modelled:.4}, rendered {rendered:.4}");
    }
}

#[test]
fn the_default_vehicle_is_modelled_as_it_sees() {
    compare(None);
}

#[test]
fn the_fast_vehicle_is_modelled_as_it_sees() {
    compare(Some("fast"));
}
