//! The map as a search sees it: what is not occupied may be flown through, known or not, but for what is near the vehicle
//! and was looked at in vain.
//!
//! Ways are asked about at places a fixed spacing apart, many at once. That is good enough to choose a way by: what is
//! flown is admitted by [`crate::admission`], which leaves nothing out.

use crate::route::Space;
use ipc_types::{Point, Vector, World};
use memory::{Occupancy, Points, Scratch, Unknown, View};

/// Places asked about at once.
const BLOCK: usize = 32;
/// Spacing of the places of a way, m.
const SPACING_M: f64 = 0.125;
/// A new way is free with so much around it, m: what follows it cuts corners, and is carried off.
pub(crate) const ROOM_M: f64 = 0.12;
/// The room grows by this share of the distance from the vehicle, which may be nearer to something.
const GROWTH: f64 = 0.3;
/// What is nearer to the vehicle than this and was looked at in vain is not flown through, m: something may fill the view.
const NEAR_M: f64 = 2.5;
/// Sides of a way that its places lie on in turn: it is asked about along a helix.
const TURNS: [(f64, f64); 4] = [(1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0)];

/// Longer ways are not asked about, m.
const LONGEST_M: f64 = 1e4;

/// What a [`MapSpace`] works in, made once.
#[derive(Clone, Debug)]
pub(crate) struct Questions {
    places: [[f64; BLOCK]; 3],
    answers: [Occupancy; BLOCK],
    scratch: Scratch,
}

impl Questions {
    pub(crate) fn new() -> Self {
        let answers = [Occupancy::Unknown(Unknown::OutOfView); BLOCK];
        Self { places: [[0.0; BLOCK]; 3], answers, scratch: Scratch::default() }
    }
}

/// A map, and the threshold (γ) it is asked with.
pub(crate) struct MapSpace<'a> {
    pub(crate) view: &'a View,
    pub(crate) threshold: f32,
    /// How much must be free around a way, m.
    pub(crate) room_m: f64,
    /// The vehicle's place.
    pub(crate) start: Point<World>,
    pub(crate) questions: &'a mut Questions,
}

impl MapSpace<'_> {
    /// Whether none of so many places, each of a number, is occupied.
    fn are_free(&mut self, count: usize, place: impl Fn(usize) -> Point<World>) -> bool {
        let start = self.start;
        let Questions { places: [x_m, y_m, z_m], answers, scratch } = &mut *self.questions;
        for first in (0..count).step_by(BLOCK) {
            let count = BLOCK.min(count - first);
            for lane in 0..count {
                let place = place(first + lane);
                (x_m[lane], y_m[lane], z_m[lane]) = (place.x, place.y, place.z);
            }
            let points = Points { x_m: &x_m[..count], y_m: &y_m[..count], z_m: &z_m[..count] };
            let answers = &mut answers[..count];
            let asked = self.view.occupancies(points, self.threshold, scratch, answers);
            if asked.is_err() || answers.contains(&Occupancy::Occupied) {
                return false;
            }
            let is_hidden = |(lane, &answer): (usize, &Occupancy)| {
                answer == Occupancy::Unknown(Unknown::NoReturn) && place(first + lane).distance(start) < NEAR_M
            };
            if answers.iter().enumerate().any(is_hidden) {
                return false;
            }
        }
        true
    }
}

impl Space for MapSpace<'_> {
    fn is_free(&mut self, place: Point<World>) -> bool {
        let room_m = self.room_m.min(GROWTH * place.distance(self.start));
        let sides = [
            [0.0; 3],
            [1.0, 0.0, 0.0],
            [-1.0, 0.0, 0.0],
            [0.0, 1.0, 0.0],
            [0.0, -1.0, 0.0],
            [0.0, 0.0, 1.0],
            [0.0, 0.0, -1.0],
        ];
        self.are_free(sides.len(), |side| place + Vector::from_array(sides[side]) * room_m)
    }

    fn is_way_free(&mut self, from: Point<World>, to: Point<World>) -> bool {
        let length_m = from.distance(to);
        // Written so that what is not a number is refused, too.
        if !(0.0..=LONGEST_M).contains(&length_m) {
            return false;
        }
        let pieces = (length_m / SPACING_M).ceil().max(1.0) as usize;
        // The same places, whichever way it is flown.
        let (from, to) = if from.to_array() < to.to_array() { (from, to) } else { (to, from) };
        let along = (to - from).direction().unwrap_or(Vector::ZERO);
        let level = Vector::new(-along.y, along.x, 0.0).direction().unwrap_or(Vector::new(1.0, 0.0, 0.0));
        let up = along.cross(level);
        let (room_m, start) = (self.room_m, self.start);
        self.are_free(pieces + 1, |piece| {
            let place = from.lerp(to, piece as f64 / pieces as f64);
            let (across, above) = TURNS[piece % TURNS.len()];
            place + (level * across + up * above) * room_m.min(GROWTH * place.distance(start))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::before_a_wall;

    #[test]
    fn ways_keep_a_little_room_and_the_vehicle_itself_needs_none() {
        let (view, mut questions) = (before_a_wall(), Questions::new());
        let mut free = |start_x_m: f64, from: [f64; 2], to: [f64; 2]| {
            let [start, from, to] = [[start_x_m, 0.0], from, to].map(|[x, y]| Point::new(x, y, 2.0));
            let mut space = MapSpace { view: &view, threshold: 0.9, room_m: ROOM_M, start, questions: &mut questions };
            assert_eq!(space.is_way_free(from, to), space.is_way_free(to, from), "either way");
            (space.is_free(from), space.is_way_free(from, to))
        };
        // The margin begins at 4 m.
        assert_eq!(free(0.0, [3.0, 0.0], [1.0, 0.3]), (true, true));
        assert_eq!(free(0.0, [3.94, -1.0], [3.94, 1.0]), (false, false), "too near to pass by");
        assert_eq!(free(3.94, [3.94, 0.0], [3.0, 0.3]), (true, true), "not too near to be there");
        assert!(!free(0.0, [3.0, 0.0], [5.0, 0.3]).1);
    }

    #[test]
    fn what_is_no_number_or_endless_is_refused() {
        let (view, mut questions) = (before_a_wall(), Questions::new());
        let mut space =
            MapSpace { view: &view, threshold: 0.9, room_m: 0.0, start: Point::ZERO, questions: &mut questions };
        for to in [Point::new(f64::NAN, 0.0, 2.0), Point::new(1e12, 0.0, 2.0)] {
            assert!(!space.is_way_free(Point::ZERO, to), "{to:?}");
        }
    }
}
