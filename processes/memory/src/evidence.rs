//! Free space that no image vouches for: the vehicle's own swept volume, and the home cylinder.

use ipc_types::bounds::Bounds;
use ipc_types::{Point, World};
use serde::{Deserialize, Serialize};

/// Evidence of free space beside measured surfaces.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FreeSpaceRule {
    /// Radius of the cylinder around the take-off place that the operator declares free, m.
    pub home_radius_m: f64,
    /// Its height above the take-off place, m.
    pub home_height_m: f64,
    /// Around where the vehicle's centre has been, free unless an image says otherwise, m. Must be less than the
    /// slowest plan commits to, or the vehicle could creep into what it has not seen.
    pub swept_radius_m: f64,
    /// Distance between two views that both see far background before it counts as free, m.
    pub background_parallax_m: f64,
}

impl FreeSpaceRule {
    pub(crate) fn check(&self, bounds: &mut Bounds) {
        bounds.range("home_radius_m", self.home_radius_m, 0.0..=20.0);
        bounds.range("home_height_m", self.home_height_m, 0.0..=50.0);
        bounds.range("swept_radius_m", self.swept_radius_m, 0.0..=3.0);
        bounds.range("background_parallax_m", self.background_parallax_m, 0.0..=5.0);
    }
}

/// The evidence gathered so far.
#[derive(Clone, Debug)]
pub struct FreeSpace {
    rule: FreeSpaceRule,
    home: Point<World>,
    path: Vec<Point<World>>,
}

impl FreeSpace {
    /// Around a take-off place.
    pub fn new(rule: FreeSpaceRule, home: Point<World>) -> Self {
        Self { rule, home, path: Vec::new() }
    }

    /// The rule.
    pub fn rule(&self) -> &FreeSpaceRule {
        &self.rule
    }

    /// The take-off place.
    pub fn home(&self) -> Point<World> {
        self.home
    }

    /// Replaces the path flown.
    pub fn set_path(&mut self, path: impl IntoIterator<Item = Point<World>>) {
        self.path.clear();
        self.path.extend(path);
    }

    /// The path flown, oldest first.
    pub fn path(&self) -> &[Point<World>] {
        &self.path
    }

    /// Whether the vehicle's centre has been near this point.
    pub(crate) fn is_swept(&self, point: Point<World>) -> bool {
        self.path.iter().any(|&place| place.distance(point) <= self.rule.swept_radius_m)
    }

    /// Whether the operator declared this point free.
    pub(crate) fn is_home(&self, point: Point<World>) -> bool {
        let offset = point - self.home;
        let height = -0.5..=self.rule.home_height_m;
        offset.horizontal_norm() <= self.rule.home_radius_m && height.contains(&offset.z)
    }
}
