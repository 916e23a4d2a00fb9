//! The envelope of a flight: what planner and controller both keep to.

use crate::bounds::Bounds;
use crate::frames::{Point, Vector, World};
use serde::{Deserialize, Serialize};

/// Geofence and altitude limits, in world coordinates.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Fence {
    /// Western, southern and lowest limit (x, y, z), m.
    pub least_m: [f64; 3],
    /// Eastern, northern and highest limit (x, y, z), m.
    pub most_m: [f64; 3],
}

impl Fence {
    /// Reports values out of range.
    pub fn check(&self, bounds: &mut Bounds) {
        for (axis, name) in ["x", "y", "z"].into_iter().enumerate() {
            bounds.range(&format!("least_m.{name}"), self.least_m[axis], -1e5..=1e5);
            bounds.range(&format!("most_m.{name}"), self.most_m[axis], -1e5..=1e5);
            bounds.require(
                self.least_m[axis] < self.most_m[axis],
                &format!("most_m.{name}"),
                format_args!("is {}, must exceed least_m.{name} = {}", self.most_m[axis], self.least_m[axis]),
            );
        }
    }

    /// Whether a point lies inside.
    pub fn contains(&self, point: Point<World>) -> bool {
        let point = point.to_array();
        (0..3).all(|axis| (self.least_m[axis]..=self.most_m[axis]).contains(&point[axis]))
    }

    /// Removes what of a velocity would leave the fence within the stopping distance at `braking_mps2`.
    /// Outside, only the way back in is left.
    pub fn limit(&self, at: Point<World>, velocity: Vector<World>, braking_mps2: f64) -> Vector<World> {
        let (at, velocity) = (at.to_array(), velocity.to_array());
        Vector::from_array([0, 1, 2].map(|axis| {
            let room = |distance_m: f64| (2.0 * braking_mps2 * distance_m.max(0.0)).sqrt();
            let (down, up) = (room(at[axis] - self.least_m[axis]), room(self.most_m[axis] - at[axis]));
            // NaN passes through neither bound: it becomes the lower one.
            velocity[axis].max(-down).min(up)
        }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn velocity_fades_towards_the_fence() {
        let fence = Fence { least_m: [-10.0, -10.0, 1.0], most_m: [10.0, 10.0, 5.0] };
        let limit = |x: f64, vx: f64| fence.limit(Point::new(x, 0.0, 2.0), Vector::new(vx, 0.0, 0.0), 2.0).x;
        assert_eq!(limit(0.0, 5.0), 5.0);
        assert!((limit(9.0, 5.0) - 2.0).abs() < 1e-9);
        assert_eq!(limit(12.0, 5.0), 0.0);
        assert_eq!(limit(12.0, -3.0), -3.0);
        assert!(fence.contains(Point::new(0.0, 0.0, 1.0)) && !fence.contains(Point::new(0.0, 0.0, 0.9)));
        assert!(!fence.contains(Point::new(f64::NAN, 0.0, 2.0)));
    }
}
