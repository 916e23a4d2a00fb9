//! The pose at the instant of exposure, never at arrival.

use crate::frames::{Body, Pose, World};
use crate::time::FlightTime;
use std::collections::VecDeque;

/// The last poses by time of validity, interpolated on demand. Bounded; the oldest are forgotten.
#[derive(Debug)]
pub struct PoseHistory {
    poses: VecDeque<(FlightTime, Pose<World, Body>)>,
    capacity: usize,
}

/// Answer of [`PoseHistory::at`].
#[derive(Clone, Copy, Debug)]
pub enum PoseAt {
    /// The pose at that instant.
    Known(Pose<World, Body>),
    /// The instant is later than the newest pose: ask again when more have arrived.
    NotYet,
    /// The instant is older than everything remembered, or nothing is remembered.
    Forgotten,
}

impl PoseHistory {
    /// Remembers the last `capacity` poses (at least two).
    pub fn new(capacity: usize) -> Self {
        let capacity = capacity.max(2);
        Self { poses: VecDeque::with_capacity(capacity), capacity }
    }

    /// Whether nothing is remembered.
    pub fn is_empty(&self) -> bool {
        self.poses.is_empty()
    }

    /// Adds a pose. Poses that arrive late are put where they belong; a second pose for an instant replaces the first.
    pub fn push(&mut self, at: FlightTime, world_from_body: Pose<World, Body>) {
        let index = self.poses.partition_point(|(time, _)| *time < at);
        if let Some(same) = self.poses.get_mut(index).filter(|(time, _)| *time == at) {
            same.1 = world_from_body;
            return;
        }
        if self.poses.len() == self.capacity {
            if index == 0 {
                return;
            }
            self.poses.pop_front();
            self.poses.insert(index - 1, (at, world_from_body));
        } else {
            self.poses.insert(index, (at, world_from_body));
        }
    }

    /// The pose at `at`: interpolated between its neighbours.
    pub fn at(&self, at: FlightTime) -> PoseAt {
        let index = self.poses.partition_point(|(time, _)| *time < at);
        match (index.checked_sub(1).and_then(|i| self.poses.get(i)), self.poses.get(index)) {
            (_, Some((time, pose))) if *time == at => PoseAt::Known(*pose),
            (Some((before, from)), Some((after, to))) => {
                let share = at.seconds_since(*before) / after.seconds_since(*before);
                PoseAt::Known(from.interpolate(*to, share))
            }
            (_, None) if !self.poses.is_empty() => PoseAt::NotYet,
            _ => PoseAt::Forgotten,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frames::{Rotation, Vector};

    fn pose(x: f64) -> Pose<World, Body> {
        Pose { rotation: Rotation::IDENTITY, translation: Vector::new(x, 0.0, 0.0) }
    }
    fn t(seconds: f64) -> FlightTime {
        FlightTime::from_secs_f64(seconds)
    }
    fn x_at(history: &PoseHistory, seconds: f64) -> f64 {
        match history.at(t(seconds)) {
            PoseAt::Known(pose) => pose.translation.x,
            other => panic!("expected a pose at {seconds}, got {other:?}"),
        }
    }

    #[test]
    fn interpolates_and_accepts_reordered_and_duplicated_poses() {
        let mut history = PoseHistory::new(8);
        for (time, x) in [(1.0, 1.0), (3.0, 3.0), (2.0, 2.0), (2.0, 2.5)] {
            history.push(t(time), pose(x));
        }
        assert_eq!(x_at(&history, 2.0), 2.5);
        assert!((x_at(&history, 1.5) - 1.75).abs() < 1e-9);
        assert!(matches!(history.at(t(3.1)), PoseAt::NotYet));
        assert!(matches!(history.at(t(0.9)), PoseAt::Forgotten));
    }

    #[test]
    fn is_bounded_and_forgets_the_oldest() {
        let mut history = PoseHistory::new(3);
        assert!(matches!(history.at(t(0.0)), PoseAt::Forgotten));
        for i in 0..10 {
            history.push(t(f64::from(i)), pose(f64::from(i)));
        }
        history.push(t(0.5), pose(0.5));
        assert!(matches!(history.at(t(6.5)), PoseAt::Forgotten));
        assert!((x_at(&history, 7.5) - 7.5).abs() < 1e-9);
    }
}
