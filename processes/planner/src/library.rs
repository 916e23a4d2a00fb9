//! The candidates: straight for the goal, along the path to it, and a fan of velocities around its direction.

use crate::Config;
use crate::rollout::Target;
use crate::route::Timed;
use ipc_types::{Point, Vector, World};

/// How a candidate is named from one plan to the next: its place in the library.
pub(crate) type Index = usize;

/// Candidates of a speed that are no velocity: straight for the goal, and along the path.
const AIMED: usize = 2;

/// What candidates are relative to.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Aim<'a> {
    pub(crate) from: Point<World>,
    pub(crate) goal: Point<World>,
    /// Highest speed, m/s.
    pub(crate) speed_mps: f64,
    /// A timed path to the goal.
    pub(crate) path: &'a [Timed],
}

/// The library, made once.
#[derive(Clone, Debug)]
pub(crate) struct Library {
    speed_shares: Vec<f64>,
    /// Azimuth from the goal's direction and climb, rad; the climb is from level flight, or none for the goal's slope.
    directions: Vec<(f64, Option<f64>)>,
}

impl Library {
    pub(crate) fn new(config: &Config) -> Self {
        let climbs: Vec<_> = both_sides(&config.climbs_deg).map(|climb| (climb != 0.0).then_some(climb)).collect();
        let turns = both_sides(&config.headings_deg);
        let directions = turns.flat_map(|turn| climbs.iter().map(move |&climb| (turn, climb)).collect::<Vec<_>>());
        Self { speed_shares: config.speed_shares.clone(), directions: directions.collect() }
    }

    /// Number of candidates.
    pub(crate) fn size(&self) -> usize {
        self.speed_shares.len() * (AIMED + self.directions.len())
    }

    /// A candidate.
    pub(crate) fn target<'a>(&self, index: Index, aim: &Aim<'a>) -> Target<'a> {
        let of_speed = AIMED + self.directions.len();
        let speed = aim.speed_mps * self.speed_shares[index / of_speed];
        let offset = aim.goal - aim.from;
        match index % of_speed {
            0 => Target::Place(aim.goal, speed),
            1 => Target::Along(aim.path, speed),
            other => {
                let (turn, climb) = self.directions[other - AIMED];
                let slope = offset.z.atan2(offset.horizontal_norm()).clamp(-0.6, 0.6);
                let (azimuth, pitch) = (offset.y.atan2(offset.x) + turn, climb.unwrap_or(slope));
                let level = speed * pitch.cos();
                Target::Velocity(Vector::new(level * azimuth.cos(), level * azimuth.sin(), speed * pitch.sin()))
            }
        }
    }
}

/// The angles in radians: zero once, others on both sides.
fn both_sides(angles_deg: &[f64]) -> impl Iterator<Item = f64> {
    angles_deg.iter().flat_map(|angle| {
        let angle = angle.to_radians();
        [Some(angle), (angle != 0.0).then_some(-angle)].into_iter().flatten()
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::config;

    #[test]
    fn the_library_has_no_duplicates() {
        let library = Library::new(&config());
        let aim = Aim { from: Point::ZERO, goal: Point::new(50.0, 10.0, 0.0), speed_mps: 4.0, path: &[] };
        let mut targets = Vec::new();
        for index in 0..library.size() {
            let target = library.target(index, &aim);
            assert!(!targets.contains(&target), "{target:?} twice");
            targets.push(target);
        }
        assert!(targets.len() > 100);
    }
}
