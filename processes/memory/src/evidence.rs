//! Free space that no image vouches for: the vehicle's own swept volume, and the home cylinder.

use ipc_types::bounds::Bounds;
use ipc_types::{Point, World};
use serde::{Deserialize, Serialize};
use std::ops::Range;

/// Evidence of free space that the vehicle's flight gives.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FreeSpaceConfig {
    /// As [`FreeSpaceRule::swept_radius_m`].
    pub swept_radius_m: f64,
    /// As [`FreeSpaceRule::background_parallax_m`].
    pub background_parallax_m: f64,
}

impl FreeSpaceConfig {
    /// The rule of a flight that begins in a cylinder declared free; both are zero where there is none.
    pub fn with_home(self, home_radius_m: f64, home_height_m: f64) -> FreeSpaceRule {
        let Self { swept_radius_m, background_parallax_m } = self;
        FreeSpaceRule { home_radius_m, home_height_m, swept_radius_m, background_parallax_m }
    }

    pub(crate) fn check(&self, bounds: &mut Bounds) {
        bounds.range("swept_radius_m", self.swept_radius_m, 0.0..=3.0);
        bounds.range("background_parallax_m", self.background_parallax_m, 0.0..=5.0);
    }
}

/// Evidence of free space beside measured surfaces.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FreeSpaceRule {
    /// Radius of the cylinder around the take-off place that the operator declares free, m.
    pub home_radius_m: f64,
    /// Its height above the take-off place, m.
    pub home_height_m: f64,
    /// Around where the vehicle's centre has been, as far as an image had shown that free, free unless an image says otherwise, m.
    /// Must be less than the slowest plan commits to, or the vehicle could creep into what it has not seen.
    pub swept_radius_m: f64,
    /// Distance between two views that both see far background before it counts as free, m.
    pub background_parallax_m: f64,
}

/// Around where the vehicle's centre has been though no image had shown that free, m: it came through, as nearly as it follows
/// a path. Less than any plan commits to, and than a step back, so that only the way it came is open.
const CAME_THROUGH_M: f64 = 0.2;
/// Places of the path flown that share a box.
const PLACES: usize = 16;

/// The evidence gathered so far.
#[derive(Clone, Debug)]
pub struct FreeSpace {
    rule: FreeSpaceRule,
    home: Point<World>,
    path: Vec<Point<World>>,
    /// As it was before the last change.
    before: Vec<Point<World>>,
    /// Which of these places an image had shown free when they were flown through.
    is_seen: Vec<bool>,
    /// Of every [`PLACES`] places, the swept radius included.
    boxes: Vec<Extent>,
    /// Of all places and the home cylinder.
    whole: Extent,
}

/// Least and largest coordinates, m.
#[derive(Clone, Copy, Debug)]
struct Extent {
    least: [f64; 3],
    most: [f64; 3],
}

impl Extent {
    fn around(place: Point<World>, reach_m: [f64; 3]) -> Self {
        let at = place.to_array();
        Self { least: [0, 1, 2].map(|i| at[i] - reach_m[i]), most: [0, 1, 2].map(|i| at[i] + reach_m[i]) }
    }

    fn and(self, other: Self) -> Self {
        Self {
            least: [0, 1, 2].map(|i| self.least[i].min(other.least[i])),
            most: [0, 1, 2].map(|i| self.most[i].max(other.most[i])),
        }
    }

    #[inline(always)]
    fn contains(&self, point: Point<World>) -> bool {
        (point.x >= self.least[0])
            & (point.x <= self.most[0])
            & (point.y >= self.least[1])
            & (point.y <= self.most[1])
            & (point.z >= self.least[2])
            & (point.z <= self.most[2])
    }
}

impl FreeSpace {
    /// Around a take-off place.
    pub fn new(rule: FreeSpaceRule, home: Point<World>) -> Self {
        let whole = Extent::around(home, [rule.home_radius_m, rule.home_radius_m, rule.home_height_m.max(0.5)]);
        let (path, before) = (Vec::new(), Vec::new());
        Self { rule, home, path, before, is_seen: Vec::new(), boxes: Vec::new(), whole }
    }

    /// The rule.
    pub fn rule(&self) -> &FreeSpaceRule {
        &self.rule
    }

    /// The take-off place.
    pub fn home(&self) -> Point<World> {
        self.home
    }

    /// Replaces the path flown. `is_seen` is asked of each of its places that is new: whether an image shows it free.
    ///
    /// The rest is a way back, and evidence of hardly more than itself: else what it grants would let the vehicle move on, which
    /// would grant more, until it has crept to where no image has ever looked. That holds at home, too: its rim is its rim.
    pub fn set_path(
        &mut self,
        path: impl IntoIterator<Item = Point<World>>,
        mut is_seen: impl FnMut(Point<World>) -> bool,
    ) {
        std::mem::swap(&mut self.path, &mut self.before);
        self.path.clear();
        self.path.extend(path);
        let before = &self.before;
        // It grows at its end, and its oldest places may be gone.
        let kept = self.path.first().and_then(|first| before.iter().position(|place| place == first));
        let kept = kept.filter(|&from| self.path.starts_with(&before[from..]));
        self.is_seen.drain(..kept.unwrap_or(before.len()));
        for &place in &self.path[self.is_seen.len()..] {
            self.is_seen.push(is_seen(place));
        }
        let reach_m = [self.rule.swept_radius_m; 3];
        self.boxes.clear();
        self.boxes.extend(self.path.chunks(PLACES).map(|places| {
            let first = Extent::around(places[0], reach_m);
            places.iter().fold(first, |all, &place| all.and(Extent::around(place, reach_m)))
        }));
        let home = Self::new(self.rule, self.home).whole;
        self.whole = self.boxes.iter().fold(home, |all, &part| all.and(part));
    }

    /// The path flown, oldest first.
    pub fn path(&self) -> &[Point<World>] {
        &self.path
    }

    /// Whether a point is free without any image.
    #[inline(always)]
    pub(crate) fn is_declared(&self, point: Point<World>) -> bool {
        self.whole.contains(point) && (self.is_home(point) || self.is_swept(point))
    }

    /// Whether all points between two are free without any image: in one ball or in the cylinder, which are convex.
    pub(crate) fn is_declared_between(&self, a: Point<World>, b: Point<World>) -> bool {
        let holds_both =
            |(place, reach_m): (Point<World>, f64)| place.distance(a) <= reach_m && place.distance(b) <= reach_m;
        self.is_home(a) && self.is_home(b)
            || self.is_declared(a) && self.is_declared(b) && self.balls(0..self.path.len()).any(holds_both)
    }

    /// Whether the vehicle's centre has been near this point.
    fn is_swept(&self, point: Point<World>) -> bool {
        let near = self.boxes.iter().enumerate().filter(|(_, extent)| extent.contains(point));
        near.flat_map(|(index, _)| self.balls(index * PLACES..((index + 1) * PLACES).min(self.path.len())))
            .any(|(place, reach_m)| place.distance(point) <= reach_m)
    }

    /// Some places of the path flown, and how far around them is free, m.
    fn balls(&self, range: Range<usize>) -> impl Iterator<Item = (Point<World>, f64)> {
        let [seen_m, unseen_m] = [self.rule.swept_radius_m, self.rule.swept_radius_m.min(CAME_THROUGH_M)];
        let places = self.path[range.clone()].iter().zip(&self.is_seen[range]);
        places.map(move |(&place, &is_seen)| (place, if is_seen { seen_m } else { unseen_m }))
    }

    /// Whether the operator declared this point free.
    fn is_home(&self, point: Point<World>) -> bool {
        let offset = point - self.home;
        let height = -0.5..=self.rule.home_height_m;
        let out_m2 = offset.x * offset.x + offset.y * offset.y;
        out_m2 <= self.rule.home_radius_m * self.rule.home_radius_m && height.contains(&offset.z)
    }
}
