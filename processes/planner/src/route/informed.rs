//! Where a path of at most a given length can lead: a spheroid whose foci are start and goal (Gammell, Srinivasa and
//! Barfoot 2014).

use ipc_types::{Point, Vector, World};
use std::f64::consts::PI;

/// Spheroids around one start and goal.
#[derive(Clone, Copy, Debug)]
pub(super) struct Informed {
    pub(super) start: Point<World>,
    pub(super) goal: Point<World>,
    /// Along the axis, and two directions across it.
    axes: [Vector<World>; 3],
    /// The straight distance.
    pub(super) least_m: f64,
}

impl Informed {
    pub(super) fn new(start: Point<World>, goal: Point<World>) -> Self {
        let along = (goal - start).direction().unwrap_or(Vector::new(1.0, 0.0, 0.0));
        // Whichever axis of the world is more nearly across.
        let helper = if along.z.abs() < 0.7 { Vector::new(0.0, 0.0, 1.0) } else { Vector::new(1.0, 0.0, 0.0) };
        let across = along.cross(helper).direction().unwrap_or(Vector::new(0.0, 1.0, 0.0));
        Self { start, goal, axes: [along, across, along.cross(across)], least_m: start.distance(goal) }
    }

    /// Least length of a path through a place, m.
    pub(super) fn through_m(&self, place: Point<World>) -> f64 {
        self.start.distance(place) + place.distance(self.goal)
    }

    /// Half of the spheroid's length, and its radius across, m.
    fn halves_m(&self, most_m: f64) -> [f64; 2] {
        [most_m / 2.0, (most_m * most_m - self.least_m * self.least_m).max(0.0).sqrt() / 2.0]
    }

    /// Volume of the places through which a path of `most_m` can lead, m³.
    pub(super) fn volume_m3(&self, most_m: f64) -> f64 {
        let [along_m, across_m] = self.halves_m(most_m);
        4.0 / 3.0 * PI * along_m * across_m * across_m
    }

    /// Spreads a place of the unit ball over the spheroid.
    pub(super) fn place(&self, [x, y, z]: [f64; 3], most_m: f64) -> Point<World> {
        let [along_m, across_m] = self.halves_m(most_m);
        let [along, right, up] = self.axes;
        self.start.lerp(self.goal, 0.5) + along * (x * along_m) + right * (y * across_m) + up * (z * across_m)
    }
}

/// The Halton sequence: places that lie evenly, the same in every search.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Halton(u64);

impl Halton {
    /// The next place of the unit cube.
    pub(super) fn in_cube(&mut self) -> [f64; 3] {
        self.0 += 1;
        [2, 3, 5].map(|base| {
            let (mut left, mut share, mut value) = (self.0, 1.0, 0.0);
            while left > 0 {
                share /= base as f64;
                value += share * (left % base) as f64;
                left /= base;
            }
            value
        })
    }

    /// The next place of the unit ball.
    pub(super) fn in_ball(&mut self) -> [f64; 3] {
        let [radius, height, turn] = self.in_cube();
        let (radius, height, turn) = (radius.cbrt(), 2.0 * height - 1.0, 2.0 * PI * turn);
        let level = (1.0 - height * height).max(0.0).sqrt() * radius;
        [level * turn.cos(), level * turn.sin(), radius * height]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_spheroid_holds_what_a_path_can_reach_and_is_filled_evenly() {
        let foci = [Point::new(1.0, 2.0, 3.0), Point::new(9.0, -4.0, 5.0)];
        let informed = Informed::new(foci[0], foci[1]);
        let most_m = informed.least_m * 1.3;
        let mut halton = Halton::default();
        let (mut inner, all) = (0, 20_000);
        for _ in 0..all {
            let place = informed.place(halton.in_ball(), most_m);
            let through_m = informed.through_m(place);
            assert!(through_m <= most_m + 1e-9, "{place:?}");
            // A spheroid within it, whose share of the volume is known.
            inner += usize::from(through_m <= informed.least_m * 1.1);
        }
        let expected = informed.volume_m3(informed.least_m * 1.1) / informed.volume_m3(most_m);
        assert!((inner as f64 / all as f64 / expected - 1.0).abs() < 0.05, "{inner} of {all}, expected {expected}");
    }

    #[test]
    fn an_upright_way_and_none_at_all_have_axes() {
        for goal in [Point::new(0.0, 0.0, 5.0), Point::ZERO] {
            let informed = Informed::new(Point::ZERO, goal);
            assert!(informed.axes.iter().all(|axis| (axis.norm() - 1.0).abs() < 1e-9));
            assert!(informed.place([0.3, 0.2, 0.1], 7.0).is_finite());
        }
    }
}
