//! Seeded worlds: forests of leaning trunks with branches and canopies, bushes, walls, uneven ground.

use crate::ground::Ground;
use crate::octomap::{Octomap, OctomapError};
use ipc_types::bounds::Bounds;
use ipc_types::{Point, Vector, World as WorldFrame};
use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, Poisson};
use rand_pcg::Pcg64Mcg;
use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;
use std::path::{Path, PathBuf};

/// A world's parameters. Ranges are (least, most), drawn uniformly.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WorldConfig {
    /// South-western corner, m.
    pub least_m: [f64; 2],
    /// North-eastern corner, m.
    pub most_m: [f64; 2],
    /// Height of the ground's waves above and below zero, m.
    pub ground_amplitude_m: f64,
    /// Their shortest wavelength, m.
    pub ground_wavelength_m: f64,
    /// Trees and bushes.
    pub forest: Forest,
    /// Walls.
    pub walls: Vec<Wall>,
    /// An OctoMap file (`.bt`) whose occupied voxels stand there too, its floor at height zero.
    pub octomap: Option<PathBuf>,
}

/// Why there is no world.
#[derive(Debug, thiserror::Error)]
#[error("{path}: {source}")]
pub struct WorldError {
    /// The OctoMap file.
    pub path: String,
    /// What is wrong with it.
    pub source: OctomapError,
}

/// A random forest.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Forest {
    /// Mean density of trees (Poisson), 1/m².
    pub trees_per_m2: f64,
    /// Radius of trunks, m.
    pub trunk_radius_m: (f64, f64),
    /// Height of trunks, m.
    pub height_m: (f64, f64),
    /// Largest lean from the vertical, degrees.
    pub lean_deg: f64,
    /// Share of trunks with hardly any texture.
    pub blank_share: f64,
    /// Branches a tree.
    pub branches: (u32, u32),
    /// Radius of branches, m.
    pub branch_radius_m: (f64, f64),
    /// Length of branches, m.
    pub branch_length_m: (f64, f64),
    /// Height of the lowest branches and canopies, m.
    pub branch_height_m: f64,
    /// Balls that make up a canopy.
    pub canopy_balls: (u32, u32),
    /// Radius of a canopy's balls, m.
    pub canopy_radius_m: (f64, f64),
    /// Mean density of bushes (Poisson), 1/m².
    pub bushes_per_m2: f64,
    /// Radius of a bush's balls, m.
    pub bush_radius_m: (f64, f64),
    /// Nothing grows closer than this to start and goal, m.
    pub clearing_m: f64,
}

/// An upright wall.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Wall {
    /// Centre on the ground, m.
    pub centre_m: [f64; 2],
    /// Length, thickness, height, m.
    pub size_m: [f64; 3],
    /// Direction of the length, degrees from east.
    pub heading_deg: f64,
    /// Whether it has no texture at all.
    pub blank: bool,
}

/// Thickness of the walls around a map, and their distance from it, m.
const WALL_M: f64 = 1.0;

impl WorldConfig {
    /// An OctoMap file on level ground within four walls: through the gaps of a map that ends, a camera would see the
    /// sky down to the horizon, which no forest shows.
    ///
    /// # Errors
    /// It is none.
    pub fn of_octomap(path: &Path) -> Result<Self, WorldError> {
        let refused = |source| WorldError { path: path.display().to_string(), source };
        let map = Octomap::read(path).map_err(refused)?;
        let [least, most] = map.bounds_m();
        let (size, middle) = (most - least, least.lerp(most, 0.5));
        let wall = |centre_m: [f64; 2], length_m: f64, heading_deg: f64| Wall {
            centre_m,
            size_m: [length_m + 2.0 * WALL_M, WALL_M, most.z - map.floor_m() + WALL_M],
            heading_deg,
            blank: false,
        };
        let walls = vec![
            wall([middle.x, least.y - WALL_M], size.x, 0.0),
            wall([middle.x, most.y + WALL_M], size.x, 0.0),
            wall([least.x - WALL_M, middle.y], size.y, 90.0),
            wall([most.x + WALL_M, middle.y], size.y, 90.0),
        ];
        Ok(Self {
            least_m: [least.x, least.y],
            most_m: [most.x, most.y],
            ground_amplitude_m: 0.0,
            ground_wavelength_m: 100.0,
            forest: Forest::BARE,
            walls,
            octomap: Some(path.to_owned()),
        })
    }

    /// Reports values out of range.
    pub fn check(&self, bounds: &mut Bounds) {
        for axis in 0..2 {
            bounds.range("least_m", self.least_m[axis], -2000.0..=2000.0);
            bounds.range("most_m", self.most_m[axis], -2000.0..=2000.0);
            let side = self.most_m[axis] - self.least_m[axis];
            bounds.require(
                (1.0..=1000.0).contains(&side),
                "most_m",
                format_args!("spans {side} m, allowed are 1 to 1000 m"),
            );
        }
        bounds.range("ground_amplitude_m", self.ground_amplitude_m, 0.0..=5.0);
        bounds.range("ground_wavelength_m", self.ground_wavelength_m, 2.0..=1000.0);
        bounds.section("forest", |bounds| self.forest.check(bounds));
        for wall in &self.walls {
            bounds.section("walls", |bounds| {
                wall.size_m.iter().for_each(|&size| bounds.range("size_m", size, 0.01..=500.0));
                wall.centre_m.iter().for_each(|&centre| bounds.range("centre_m", centre, -2000.0..=2000.0));
                bounds.range("heading_deg", wall.heading_deg, -360.0..=360.0);
            });
        }
    }
}

impl Forest {
    /// Nothing grows.
    const BARE: Self = Self {
        trees_per_m2: 0.0,
        trunk_radius_m: (0.1, 0.1),
        height_m: (1.0, 1.0),
        lean_deg: 0.0,
        blank_share: 0.0,
        branches: (0, 0),
        branch_radius_m: (0.05, 0.05),
        branch_length_m: (0.0, 0.0),
        branch_height_m: 0.0,
        canopy_balls: (0, 0),
        canopy_radius_m: (0.1, 0.1),
        bushes_per_m2: 0.0,
        bush_radius_m: (0.1, 0.1),
        clearing_m: 0.0,
    };

    fn check(&self, bounds: &mut Bounds) {
        bounds.range("trees_per_m2", self.trees_per_m2, 0.0..=1.0);
        bounds.range("bushes_per_m2", self.bushes_per_m2, 0.0..=1.0);
        bounds.range("lean_deg", self.lean_deg, 0.0..=45.0);
        bounds.range("blank_share", self.blank_share, 0.0..=1.0);
        bounds.range("branch_height_m", self.branch_height_m, 0.0..=50.0);
        bounds.range("clearing_m", self.clearing_m, 0.0..=100.0);
        let ranges = [
            ("trunk_radius_m", self.trunk_radius_m, 0.01..=3.0),
            ("height_m", self.height_m, 0.5..=60.0),
            ("branch_radius_m", self.branch_radius_m, 0.005..=1.0),
            ("branch_length_m", self.branch_length_m, 0.0..=20.0),
            ("canopy_radius_m", self.canopy_radius_m, 0.05..=10.0),
            ("bush_radius_m", self.bush_radius_m, 0.05..=5.0),
        ];
        for (name, (least, most), allowed) in ranges {
            bounds.range(name, least, allowed.clone());
            bounds.range(name, most, allowed);
            bounds.require(
                least <= most,
                name,
                format_args!("is ({least}, {most}), the first must not exceed the second"),
            );
        }
        for (name, (least, most)) in [("branches", self.branches), ("canopy_balls", self.canopy_balls)] {
            bounds.range(name, most, least..=40);
        }
    }
}

/// A solid.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Shape {
    /// All points within `radius_m` of the segment from `from` to `to`; a ball when they coincide.
    Capsule {
        /// One end.
        from: Point<WorldFrame>,
        /// The other.
        to: Point<WorldFrame>,
        /// Radius, m.
        radius_m: f64,
    },
    /// An upright box.
    Cuboid {
        /// Centre.
        centre: Point<WorldFrame>,
        /// Half of length, thickness, height, m.
        half_m: [f64; 3],
        /// Direction of the length about z, rad.
        heading_rad: f64,
    },
}

impl Shape {
    /// Whether a point lies in it.
    pub fn contains(&self, point: Point<WorldFrame>) -> bool {
        match *self {
            Self::Capsule { from, to, radius_m } => {
                let way = to - from;
                let share = ((point - from).dot(way) / way.dot(way).max(1e-12)).clamp(0.0, 1.0);
                point.distance(from.lerp(to, share)) <= radius_m
            }
            Self::Cuboid { centre, half_m, heading_rad } => {
                let (offset, (sin, cos)) = (point - centre, heading_rad.sin_cos());
                let along = [offset.x * cos + offset.y * sin, offset.y * cos - offset.x * sin, offset.z];
                along.iter().zip(half_m).all(|(along, half)| along.abs() <= half)
            }
        }
    }
}

/// A solid and what it looks like.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Obstacle {
    /// Its shape.
    pub shape: Shape,
    /// Mean grey level.
    pub brightness: f32,
    /// Range of grey levels of its texture.
    pub contrast: f32,
}

/// A world: ground and obstacles.
#[derive(Clone, Debug)]
pub struct World {
    pub(crate) ground: Ground,
    obstacles: Vec<Obstacle>,
    trees: usize,
}

/// Draws from a (least, most) range.
fn draw(random: &mut Pcg64Mcg, range: (f64, f64)) -> f64 {
    range.0 + (range.1 - range.0) * random.random::<f64>()
}

fn draw_count(random: &mut Pcg64Mcg, range: (u32, u32)) -> u32 {
    random.random_range(range.0..=range.1)
}

impl World {
    /// Grows a world from a seed. `clear` are the places around which nothing grows.
    ///
    /// # Errors
    /// The OctoMap file is none.
    pub fn grow(config: &WorldConfig, seed: u64, clear: &[Point<WorldFrame>]) -> Result<Self, WorldError> {
        let mut random = Pcg64Mcg::seed_from_u64(seed);
        let ground = Ground::new(config, &mut random);
        let mut world = Self { ground, obstacles: Vec::new(), trees: 0 };
        let forest = &config.forest;
        for place in scatter(config, forest.trees_per_m2, forest, clear, &mut random) {
            world.plant_tree(place, forest, &mut random);
        }
        for place in scatter(config, forest.bushes_per_m2, forest, clear, &mut random) {
            world.plant_bush(place, forest, &mut random);
        }
        for wall in &config.walls {
            let [x, y] = wall.centre_m;
            let [length, thickness, height] = wall.size_m;
            // Deep enough to have no gap below where the ground falls away.
            let centre = Point::new(x, y, height / 2.0 - 1.0);
            world.obstacles.push(Obstacle {
                shape: Shape::Cuboid {
                    centre,
                    half_m: [length / 2.0, thickness / 2.0, height / 2.0 + 1.0],
                    heading_rad: wall.heading_deg.to_radians(),
                },
                brightness: 150.0,
                contrast: if wall.blank { 0.0 } else { 90.0 },
            });
        }
        if let Some(path) = &config.octomap {
            let refused = |source| WorldError { path: path.display().to_string(), source };
            world.build(&Octomap::read(path).map_err(refused)?).map_err(refused)?;
        }
        Ok(world)
    }

    /// Boxes where a map is occupied above its floor, which is the ground.
    fn build(&mut self, map: &Octomap) -> Result<(), OctomapError> {
        let floor = Vector::new(0.0, 0.0, map.floor_m());
        for [least, most] in map.boxes()?.into_iter().filter(|[_, most]| most.z > floor.z) {
            let least = Point::new(least.x, least.y, least.z.max(floor.z));
            let size = most - least;
            let shape = Shape::Cuboid {
                centre: least + size * 0.5 - floor,
                half_m: [size.x / 2.0, size.y / 2.0, size.z / 2.0],
                heading_rad: 0.0,
            };
            self.obstacles.push(Obstacle { shape, brightness: 110.0, contrast: 90.0 });
        }
        Ok(())
    }

    /// Everything solid but the ground.
    pub fn obstacles(&self) -> &[Obstacle] {
        &self.obstacles
    }

    /// Number of trees.
    pub fn trees(&self) -> usize {
        self.trees
    }

    /// Height of the ground, m.
    pub fn ground_height_m(&self, x_m: f64, y_m: f64) -> f64 {
        f64::from(self.ground.height(x_m as f32, y_m as f32))
    }

    fn plant_tree(&mut self, [x, y]: [f64; 2], forest: &Forest, random: &mut Pcg64Mcg) {
        self.trees += 1;
        let foot = Point::new(x, y, self.ground_height_m(x, y) - 0.2);
        let (lean, azimuth) = (draw(random, (0.0, forest.lean_deg)).to_radians(), draw(random, (0.0, TAU)));
        let height = draw(random, forest.height_m);
        let axis = Vector::new(lean.sin() * azimuth.cos(), lean.sin() * azimuth.sin(), lean.cos());
        let top = foot + axis * height;
        let brightness = draw(random, (50.0, 130.0)) as f32;
        let contrast = if random.random_bool(forest.blank_share) { 5.0 } else { draw(random, (30.0, 90.0)) as f32 };
        let radius_m = draw(random, forest.trunk_radius_m);
        self.capsule(foot, top, radius_m, brightness, contrast);
        let lowest = (forest.branch_height_m / height).min(0.9);
        for _ in 0..draw_count(random, forest.branches) {
            let from = foot.lerp(top, draw(random, (lowest, 0.95)));
            let (azimuth, rise) = (draw(random, (0.0, TAU)), draw(random, (-0.2, 0.6)));
            let along = Vector::new(azimuth.cos() * rise.cos(), azimuth.sin() * rise.cos(), rise.sin());
            let to = from + along * draw(random, forest.branch_length_m);
            let radius_m = draw(random, forest.branch_radius_m);
            self.capsule(from, to, radius_m, brightness, contrast);
        }
        for _ in 0..draw_count(random, forest.canopy_balls) {
            let radius_m = draw(random, forest.canopy_radius_m);
            let along = foot.lerp(top, draw(random, (0.6, 1.0)));
            let aside = [draw(random, (-1.2, 1.2)), draw(random, (-1.2, 1.2))];
            let lowest = foot.z + forest.branch_height_m + radius_m;
            let centre = Point::new(along.x + aside[0], along.y + aside[1], along.z.max(lowest));
            let brightness = draw(random, (60.0, 120.0)) as f32;
            self.capsule(centre, centre, radius_m, brightness, 110.0);
        }
    }

    fn plant_bush(&mut self, [x, y]: [f64; 2], forest: &Forest, random: &mut Pcg64Mcg) {
        for _ in 0..3 {
            let radius_m = draw(random, forest.bush_radius_m);
            let (dx, dy) = (draw(random, (-0.4, 0.4)), draw(random, (-0.4, 0.4)));
            let z = self.ground_height_m(x + dx, y + dy) + 0.6 * radius_m;
            let centre = Point::new(x + dx, y + dy, z);
            let brightness = draw(random, (70.0, 130.0)) as f32;
            self.capsule(centre, centre, radius_m, brightness, 100.0);
        }
    }

    fn capsule(
        &mut self,
        from: Point<WorldFrame>,
        to: Point<WorldFrame>,
        radius_m: f64,
        brightness: f32,
        contrast: f32,
    ) {
        self.obstacles.push(Obstacle { shape: Shape::Capsule { from, to, radius_m }, brightness, contrast });
    }
}

/// Places of a Poisson process over the world, without the clearings.
fn scatter(
    config: &WorldConfig,
    per_m2: f64,
    forest: &Forest,
    clear: &[Point<WorldFrame>],
    random: &mut Pcg64Mcg,
) -> Vec<[f64; 2]> {
    let (least, most) = (config.least_m, config.most_m);
    let mean = per_m2 * (most[0] - least[0]) * (most[1] - least[1]);
    // The distribution refuses a mean of zero.
    let count = Poisson::new(mean).map_or(0, |poisson| poisson.sample(random) as usize);
    let mut places = Vec::with_capacity(count);
    for _ in 0..count {
        let place = [draw(random, (least[0], most[0])), draw(random, (least[1], most[1]))];
        let is_clear = |point: &Point<WorldFrame>| (place[0] - point.x).hypot(place[1] - point.y) < forest.clearing_m;
        if !clear.iter().any(is_clear) {
            places.push(place);
        }
    }
    places
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    pub(crate) fn config() -> WorldConfig {
        WorldConfig {
            least_m: [-25.0, -80.0],
            most_m: [105.0, 80.0],
            ground_amplitude_m: 0.25,
            ground_wavelength_m: 14.0,
            forest: Forest {
                trees_per_m2: 0.05,
                trunk_radius_m: (0.1, 0.25),
                height_m: (6.0, 14.0),
                lean_deg: 6.0,
                blank_share: 0.1,
                branches: (0, 4),
                branch_radius_m: (0.03, 0.06),
                branch_length_m: (0.5, 1.5),
                branch_height_m: 1.8,
                canopy_balls: (1, 4),
                canopy_radius_m: (0.8, 1.8),
                bushes_per_m2: 0.01,
                bush_radius_m: (0.25, 0.6),
                clearing_m: 3.0,
            },
            walls: Vec::new(),
            octomap: None,
        }
    }

    #[test]
    fn the_same_seed_grows_the_same_world_and_another_does_not() {
        let grow = |seed| World::grow(&config(), seed, &[]).expect("no file").obstacles;
        assert_eq!(grow(3), grow(3));
        assert_ne!(grow(3), grow(4));
    }

    #[test]
    fn density_is_as_asked_and_clearings_are_clear() {
        let clear = Point::new(60.0, 0.0, 2.0);
        let trees: usize = (0..20).map(|seed| World::grow(&config(), seed, &[clear]).expect("no file").trees()).sum();
        let expected = 20.0 * 0.05 * 130.0 * 160.0;
        assert!((trees as f64 / expected - 1.0).abs() < 0.03, "{trees} trees, expected {expected}");
        for obstacle in World::grow(&config(), 1, &[clear]).expect("no file").obstacles() {
            if let Shape::Capsule { from, radius_m, .. } = obstacle.shape {
                let near = (from.x - clear.x).hypot(from.y - clear.y) - radius_m;
                assert!(near > 0.0 || from.z > 2.5, "{obstacle:?}");
            }
        }
    }
}
