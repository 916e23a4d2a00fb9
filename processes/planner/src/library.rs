//! The candidates: straight for the goal, and a fan of velocities around its direction.

use crate::Config;
use crate::rollout::Target;
use ipc_types::{Point, Vector, World};

/// How a candidate is named from one plan to the next: its place in the library.
pub(crate) type Index = usize;

/// Number of candidates.
pub(crate) fn size(config: &Config) -> usize {
    let both_sides = |angles: &[f64]| angles.iter().map(|&angle| if angle == 0.0 { 1 } else { 2 }).sum::<usize>();
    config.speed_shares.len() * (1 + both_sides(&config.headings_deg) * both_sides(&config.climbs_deg))
}

/// Calls `each` with every candidate, in a fixed order.
pub(crate) fn for_each(
    config: &Config,
    from: Point<World>,
    goal: Point<World>,
    speed_mps: f64,
    mut each: impl FnMut(Index, Target),
) {
    let offset = goal - from;
    let heading = offset.y.atan2(offset.x);
    let slope = offset.z.atan2(offset.horizontal_norm()).clamp(-0.6, 0.6);
    let mut index = 0;
    for share in &config.speed_shares {
        let speed = speed_mps * share;
        each(index, Target::Place(goal, speed));
        index += 1;
        for turn in both_sides(&config.headings_deg) {
            for climb in both_sides(&config.climbs_deg) {
                // Level candidates aim at the goal's height, slanted ones are relative to level flight.
                let pitch = if climb == 0.0 { slope } else { climb };
                let (azimuth, level) = (heading + turn, speed * pitch.cos());
                let velocity = Vector::new(level * azimuth.cos(), level * azimuth.sin(), speed * pitch.sin());
                each(index, Target::Velocity(velocity));
                index += 1;
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
    use crate::planner::tests::config;

    #[test]
    fn the_library_has_its_size_and_no_duplicates() {
        let config = config();
        let mut targets = Vec::new();
        for_each(&config, Point::ZERO, Point::new(50.0, 10.0, 0.0), 4.0, |index, target| {
            assert_eq!(index, targets.len());
            assert!(!targets.contains(&target), "{target:?} twice");
            targets.push(target);
        });
        assert_eq!(targets.len(), size(&config));
        assert!(targets.len() > 100);
    }
}
