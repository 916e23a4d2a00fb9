//! Start and goal where the vehicle may be: the nearest such places to the ones that were asked for.

use super::Space;
use ipc_types::limits::Fence;
use ipc_types::{Point, Vector, World};
use std::f64::consts::PI;

/// Spacing of the shells that are searched, m.
const SHELL_M: f64 = 0.25;
/// Shells searched.
const SHELLS: u32 = 32;
/// Radius of the last, m.
pub(super) const REACH_M: f64 = SHELL_M * SHELLS as f64;
/// Places searched on a shell.
const ON_SHELL: u32 = 64;
/// Turn from one place of a shell to the next: the golden angle, which spreads them evenly.
const GOLDEN_RAD: f64 = PI * (3.0 - 2.236_067_977_499_79);

/// The nearest free place inside the fence; `None` if there is none within eight metres.
pub(super) fn nearest_free(space: &mut impl Space, fence: &Fence, wanted: Point<World>) -> Option<Point<World>> {
    let wanted = into(fence, wanted);
    if space.is_free(wanted) {
        return Some(wanted);
    }
    for shell in 1..=SHELLS {
        for place in 0..ON_SHELL {
            let height = 1.0 - (f64::from(place) + 0.5) * 2.0 / f64::from(ON_SHELL);
            let (level, turn) = ((1.0 - height * height).sqrt(), GOLDEN_RAD * f64::from(place));
            let direction = Vector::new(level * turn.cos(), level * turn.sin(), height);
            let place = wanted + direction * (SHELL_M * f64::from(shell));
            if fence.contains(place) && space.is_free(place) {
                return Some(place);
            }
        }
    }
    None
}

/// The nearest place inside the fence.
fn into(fence: &Fence, place: Point<World>) -> Point<World> {
    let place = place.to_array();
    Point::from_array([0, 1, 2].map(|axis| place[axis].max(fence.least_m[axis]).min(fence.most_m[axis])))
}
