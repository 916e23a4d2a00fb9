//! Many points at once: blocks of them, whose coordinates lie apart (structure of arrays).

use crate::lanes::Places;
use crate::view::{Looked, Occupancy, View, ask_block, threshold_votes};
use ipc_types::{Point, World};

/// Points of a block.
const BLOCK: usize = 32;

/// Points as three slices of one length, m.
#[derive(Clone, Copy, Debug)]
pub struct Points<'a> {
    /// East.
    pub x_m: &'a [f64],
    /// North.
    pub y_m: &'a [f64],
    /// Up.
    pub z_m: &'a [f64],
}

/// What a batch is worked out in, for as many keyframes as there may be: made once, used again.
#[derive(Clone, Debug)]
pub struct Scratch(Looked<BLOCK>);

impl Default for Scratch {
    fn default() -> Self {
        Self(Looked::new())
    }
}

/// Why a batch was refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("coordinates and answers must be of one length, not {x}, {y}, {z} and {answers}")]
pub struct LengthsDiffer {
    /// Coordinates given.
    pub x: usize,
    /// Coordinates given.
    pub y: usize,
    /// Coordinates given.
    pub z: usize,
    /// Answers expected.
    pub answers: usize,
}

impl View {
    /// Answers for every point what [`View::occupancy`] does, to the bit.
    ///
    /// # Errors
    /// The slices are of different lengths; `answers` is then untouched.
    pub fn occupancies(
        &self,
        points: Points<'_>,
        threshold: f32,
        scratch: &mut Scratch,
        answers: &mut [Occupancy],
    ) -> Result<(), LengthsDiffer> {
        let Points { x_m, y_m, z_m } = points;
        let count = answers.len();
        if [x_m, y_m, z_m].iter().any(|values| values.len() != count) {
            return Err(LengthsDiffer { x: x_m.len(), y: y_m.len(), z: z_m.len(), answers: count });
        }
        let threshold = threshold_votes(threshold);
        for (block, answers) in answers.chunks_mut(BLOCK).enumerate() {
            let from = block * BLOCK;
            // What is missing in the last block is where the view is anchored, and not looked at.
            let mut places = Places::<BLOCK>::NONE;
            for lane in 0..answers.len() {
                places.x[lane] = (x_m[from + lane] - self.anchor.x) as f32;
                places.y[lane] = (y_m[from + lane] - self.anchor.y) as f32;
                places.z[lane] = (z_m[from + lane] - self.anchor.z) as f32;
            }
            let tally = ask_block(self, &places, &mut scratch.0);
            for (lane, answer) in answers.iter_mut().enumerate() {
                let place = [places.x[lane], places.y[lane], places.z[lane]];
                let has_parallax = tally.has_background(lane) && self.background_has_parallax(place);
                let (sum, flags) = tally.count(lane, has_parallax);
                let point = Point::<World>::new(x_m[from + lane], y_m[from + lane], z_m[from + lane]);
                *answer = self.judge(point, sum, flags, threshold);
            }
        }
        Ok(())
    }
}
