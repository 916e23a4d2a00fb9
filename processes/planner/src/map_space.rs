//! The map as a search sees it: what is not occupied may be flown through, known or not.
//!
//! Ways are asked about at places a fixed spacing apart, many at once. That is good enough to choose a way by: what is
//! flown is admitted by [`crate::admission`], which leaves nothing out.

use crate::route::Space;
use ipc_types::{Point, World};
use memory::{Occupancy, Points, Scratch, Unknown, View};

/// Places asked about at once.
const BLOCK: usize = 32;
/// Spacing of the places of a way, m: between two of them a way comes nearer to a ball of 0.5 m by 2 cm at most.
const SPACING_M: f64 = 0.25;

/// Longer ways are not asked about, pieces.
const MOST_PIECES: f64 = 1e5;

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
    pub(crate) questions: &'a mut Questions,
}

impl Space for MapSpace<'_> {
    fn is_free(&mut self, place: Point<World>) -> bool {
        self.view.occupancy(place, self.threshold) != Occupancy::Occupied
    }

    fn is_way_free(&mut self, from: Point<World>, to: Point<World>) -> bool {
        let pieces = (from.distance(to) / SPACING_M).ceil().max(1.0);
        // Written so that what is not a number is refused, too.
        if !(1.0..=MOST_PIECES).contains(&pieces) {
            return false;
        }
        let pieces = pieces as usize;
        let Questions { places: [x_m, y_m, z_m], answers, scratch } = &mut *self.questions;
        for first in (0..=pieces).step_by(BLOCK) {
            let count = BLOCK.min(pieces + 1 - first);
            for lane in 0..count {
                let place = from.lerp(to, (first + lane) as f64 / pieces as f64);
                (x_m[lane], y_m[lane], z_m[lane]) = (place.x, place.y, place.z);
            }
            let points = Points { x_m: &x_m[..count], y_m: &y_m[..count], z_m: &z_m[..count] };
            let answers = &mut answers[..count];
            let asked = self.view.occupancies(points, self.threshold, scratch, answers);
            if asked.is_err() || answers.contains(&Occupancy::Occupied) {
                return false;
            }
        }
        true
    }
}
