//! Straight lines and trajectories, of which no part is left out: nothing hides between two samples.
//!
//! A line in space is a line in a keyframe's image, along which disparity is linear. All cells that it crosses are asked
//! about all disparities that it has there. What a keyframe says of a piece is the worst that it says of any point of it,
//! so a piece that is called free is free in every point; one that is not is halved, down to [`FINEST_M`].

use crate::lanes::NEAREST_M;
use crate::view::{KeyView, Occupancy, View, threshold_votes, why};
use crate::votes::{Said, Votes, flag};
use ipc_types::disparity::SCALE;
use ipc_types::messages::{Layers, NEVER_OCCUPIED, UNKNOWN_FRONT};
use ipc_types::{Point, Vector, World};

/// Length of the pieces that a line is first cut into, m.
const COARSEST_M: f64 = 0.64;
/// Shorter pieces are not halved, m: as near before a hit as it is reported.
pub const FINEST_M: f64 = 0.02;
/// Longer lines are not walked, m.
const LONGEST_M: f64 = 1e5;
/// A point that is asked alone goes through single precision, relative to the view's anchor: coordinates are off by this
/// share of its distance, and what comes after adds a little, px and fixed point.
const SINGLE: f64 = 5e-7;
const SLACK_PX: f64 = 0.01;
const SLACK: f64 = 0.02;

/// How much a point that is asked alone may be off in the image, px, and in disparity, share.
#[derive(Clone, Copy)]
struct Slack {
    px: f64,
    share: f64,
}

/// What a line must be.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Demand {
    /// Known free.
    Free,
    /// Not occupied; unknown will do.
    NotOccupied,
}

/// Where a line does not meet the demand.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// From the line's start, m: at most [`FINEST_M`] before the first such point.
    pub distance_m: f64,
    /// What is there.
    pub occupancy: Occupancy,
}

/// Where and when a trajectory does not meet the demand.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TimedHit {
    /// Time of the trajectory, s.
    pub time_s: f64,
    /// The place.
    pub place: Point<World>,
    /// What is there.
    pub occupancy: Occupancy,
}

impl View {
    /// The first place on the way from one point to another that does not meet the demand, with `threshold` (γ) for
    /// occupied. Of a line that is not finite or longer than 100 km nothing is known.
    pub fn segment(&self, from: Point<World>, to: Point<World>, threshold: f32, demand: Demand) -> Option<Hit> {
        let length_m = from.distance(to);
        // Written so that what is not a number is refused, too.
        if !(0.0..=LONGEST_M).contains(&length_m) {
            return Some(Hit { distance_m: 0.0, occupancy: Occupancy::Unknown(crate::Unknown::OutOfView) });
        }
        let threshold = threshold_votes(threshold);
        let pieces = (length_m / COARSEST_M).ceil().max(1.0);
        let mut start = 0.0;
        while start < 1.0 {
            let end = (start + 1.0 / pieces).min(1.0);
            let end = if 1.0 - end < 1e-9 { 1.0 } else { end };
            if let Some(hit) = self.piece(from, to, [start, end], threshold, demand) {
                return Some(hit);
            }
            start = end;
        }
        None
    }

    /// Distance to the nearest obstacle along a ray, m; `None` where there is none up to `most_m`.
    pub fn obstacle_m(&self, from: Point<World>, direction: Vector<World>, most_m: f64, threshold: f32) -> Option<f64> {
        // Written so that what is not a number is refused by the segment.
        let most_m = if most_m < 0.0 { 0.0 } else { most_m };
        let to = from + direction * (most_m / direction.norm());
        self.segment(from, to, threshold, Demand::NotOccupied).map(|hit| hit.distance_m)
    }

    /// The first hit along a trajectory of times (s, rising) and places, flown in straight lines between them.
    pub fn trajectory(
        &self,
        samples: impl IntoIterator<Item = (f64, Point<World>)>,
        threshold: f32,
        demand: Demand,
    ) -> Option<TimedHit> {
        let mut samples = samples.into_iter();
        let (mut time_s, mut place) = samples.next()?;
        for (next_s, next) in samples {
            if let Some(hit) = self.segment(place, next, threshold, demand) {
                let share = hit.distance_m / place.distance(next).max(f64::MIN_POSITIVE);
                return Some(TimedHit {
                    time_s: time_s + (next_s - time_s) * share.min(1.0),
                    place: place.lerp(next, share.min(1.0)),
                    occupancy: hit.occupancy,
                });
            }
            (time_s, place) = (next_s, next);
        }
        None
    }

    fn piece(
        &self,
        from: Point<World>,
        to: Point<World>,
        [start, end]: [f64; 2],
        threshold: i32,
        demand: Demand,
    ) -> Option<Hit> {
        let (a, b) = (from.lerp(to, start), from.lerp(to, end));
        let occupancy = self.worst(a, b, threshold);
        let is_fine = match demand {
            Demand::Free => occupancy == Occupancy::Free,
            Demand::NotOccupied => occupancy != Occupancy::Occupied,
        };
        if is_fine {
            return None;
        }
        if a.distance(b) <= FINEST_M {
            return Some(Hit { distance_m: from.distance(a), occupancy });
        }
        let middle = 0.5 * (start + end);
        let first = self.piece(from, to, [start, middle], threshold, demand);
        first.or_else(|| self.piece(from, to, [middle, end], threshold, demand))
    }

    /// The worst that can be said of any point between two.
    fn worst(&self, a: Point<World>, b: Point<World>, threshold: i32) -> Occupancy {
        let mut votes = Votes::<1>::none();
        let mut background = [false; crate::GraphRule::MOST];
        for (key, background) in self.keys.iter().zip(&mut background) {
            let Some((said, depths_m)) = self.said_between(key, a, b) else { continue };
            let inverse_px = |depth_m: f64| (self.model.rig.focal_baseline_px_m() / depth_m) as f32;
            let (least, most) = self.weights.range(inverse_px(depths_m[1]), inverse_px(depths_m[0]));
            let (flag, weight) = match said {
                said if said & flag::OCCUPIED != 0 => (flag::OCCUPIED, most + 1),
                flag::FREE | flag::FAR_BACKGROUND => (said, (least - 1).max(0)),
                said if said & !(flag::FREE | flag::OCCLUDED) == 0 => (flag::OCCLUDED, (least - 1).max(0)),
                _ => (flag::UNMEASURED, 0),
            };
            *background = flag == flag::FAR_BACKGROUND;
            let said = Said { flags: [flag], weights: [weight], exposure_ms: key.exposure_ms };
            votes.cast(&said, self.forget_ms);
        }
        let tally = votes.tally();
        let has_parallax = tally.has_background(0) && self.lie_apart(&background);
        let (sum, flags) = tally.count(0, has_parallax);
        if sum >= threshold {
            Occupancy::Occupied
        } else if flags & flag::FREE != 0 || self.free_space.is_declared_between(a, b) {
            Occupancy::Free
        } else {
            Occupancy::Unknown(why(flags))
        }
    }

    /// All that a keyframe says of the points between two, and their least and largest depth; `None` where it sees none
    /// of them.
    fn said_between(&self, key: &KeyView, from: Point<World>, to: Point<World>) -> Option<(i32, [f64; 2])> {
        let (a, b) = (key.to_camera(from, self.anchor), key.to_camera(to, self.anchor));
        let (rig, layout) = (&self.model.rig, self.model.layout);
        let margin = f64::from(layout.margin_px);
        let (centre_u, centre_v) = (rig.cx_px + margin, rig.cy_px + margin);
        let (end_u, end_v) = (f64::from(layout.width_px) - 0.5, f64::from(layout.height_px) - 0.5);
        // Half-spaces that the view is bounded by: positive inside.
        let sides = |[x, y, z]: [f64; 3], slack_px: f64| {
            [
                z - f64::from(NEAREST_M),
                rig.focal_px * x + (centre_u + 0.5 + slack_px) * z,
                (end_u - centre_u + slack_px) * z - rig.focal_px * x,
                rig.focal_px * y + (centre_v + 0.5 + slack_px) * z,
                (end_v - centre_v + slack_px) * z - rig.focal_px * y,
            ]
        };
        let far_m =
            [from, to].iter().map(|end| end.distance(self.anchor)).fold(key.origin.distance(self.anchor), f64::max);
        let near_m = a[2].min(b[2]).max(f64::from(NEAREST_M));
        let share = SINGLE * (1.0 + far_m / near_m);
        let slack = Slack { px: SLACK_PX + 2.0 * rig.focal_px * share, share };
        let is_whole = [a, b].iter().all(|&end| sides(end, -slack.px).iter().all(|&side| side > 0.0));
        let (mut enter, mut leave) = (0.0_f64, 1.0_f64);
        for (from, to) in sides(a, slack.px).into_iter().zip(sides(b, slack.px)) {
            match (from >= 0.0, to >= 0.0) {
                (true, true) => {}
                (false, true) => enter = enter.max(from / (from - to)),
                (true, false) => leave = leave.min(from / (from - to)),
                _ => return None,
            }
        }
        if enter > leave {
            return None;
        }
        let at = |share: f64| [0, 1, 2].map(|axis| a[axis] + (b[axis] - a[axis]) * share);
        let image = |[x, y, z]: [f64; 3]| {
            let d = (rig.focal_baseline_px_m() / z - rig.doffs_px) * f64::from(SCALE);
            [centre_u + rig.focal_px * x / z, centre_v + rig.focal_px * y / z, d]
        };
        let (a, b) = (at(enter), at(leave));
        let partly = if is_whole { 0 } else { flag::UNMEASURED };
        let said = self.said_in_image(key, image(a), image(b), slack) | partly;
        Some((said, [a[2].min(b[2]) * (1.0 - share), a[2].max(b[2]) * (1.0 + share)]))
    }

    /// What the cells between two places of the image say, columns and rows with slack.
    fn said_in_image(&self, key: &KeyView, a: [f64; 3], b: [f64; 3], slack: Slack) -> i32 {
        let layout = self.model.layout;
        // Along the axis on which it is longer, so that there are few cells across.
        let (along, across) = if (b[0] - a[0]).abs() >= (b[1] - a[1]).abs() { (0, 1) } else { (1, 0) };
        let (a, b) = if a[along] <= b[along] { (a, b) } else { (b, a) };
        let ends = [layout.width_px, layout.height_px].map(|size| f64::from(size) - 1.0);
        let pixel = |value: f64, axis: usize| value.round().clamp(0.0, ends[axis]) as u32;
        let length = b[along] - a[along];
        let mut said = 0;
        for step in pixel(a[along] - slack.px, along)..=pixel(b[along] + slack.px, along) {
            let share = |side: f64| {
                let share = (f64::from(step) + side * (0.5 + slack.px) - a[along]) / length;
                if length > 1e-9 { share.clamp(0.0, 1.0) } else { side.max(0.0) }
            };
            let at = |axis: usize, side: f64| a[axis] + (b[axis] - a[axis]) * share(side);
            let ordered = |axis: usize| {
                let (one, other) = (at(axis, -1.0), at(axis, 1.0));
                (one.min(other), one.max(other))
            };
            let ((low, high), (d_low, d_high)) = (ordered(across), ordered(2));
            // What is rounded is f·b/z, before the principal points' difference is taken off.
            let doffs = self.model.rig.doffs_px * f64::from(SCALE);
            let off = |d: f64| (slack.share + SINGLE) * (d + doffs).abs() + SLACK;
            let d = [d_low - off(d_low), d_high + off(d_high)].map(|d| d as f32);
            for other in pixel(low - slack.px, across)..=pixel(high + slack.px, across) {
                let (column, row) = if along == 0 { (step, other) } else { (other, step) };
                said |= self.said_by_cell(key, row * layout.width_px + column, d);
            }
        }
        said
    }

    /// All that a cell says of the disparities from one to another ([`ipc_types::messages::ExpandedCells::at`]).
    fn said_by_cell(&self, key: &KeyView, cell: u32, [low, high]: [f32; 2]) -> i32 {
        let parts = key.cells()[cell as usize];
        let part = |number: usize| parts[number];
        let (near, front, back) = (f32::from(part(0)), f32::from(part(1)), f32::from(part(2)));
        if part(1) == UNKNOWN_FRONT {
            return flag::UNMEASURED;
        }
        // Whether any of them is above one value and not above another.
        let any = |above: f32, most: f32| high > above && low <= most && most > above;
        let is = |condition: bool, flag: i32| if condition { flag } else { 0 };
        let free = |is_endless: bool| if is_endless { flag::FAR_BACKGROUND } else { flag::FREE };
        let is_endless = part(2) == NEVER_OCCUPIED;
        let end = if is_endless { front } else { back };
        let said = is(any(front, near), free(is_endless))
            | is(high > front.max(near), flag::UNMEASURED)
            | is(any(end, front), flag::OCCUPIED);
        if self.model.layout.layers == Layers::Two {
            return said | is(low <= end, flag::OCCLUDED);
        }
        let most = f32::from(part(3)).min(end);
        let said = said | is(any(most, end), flag::OCCLUDED);
        let [front, back] = key.next_cell(self.model.layout, cell);
        if front == UNKNOWN_FRONT {
            return said | is(low <= most, flag::OCCLUDED);
        }
        let is_endless = back == NEVER_OCCUPIED;
        let (front, end) = (f32::from(front), f32::from(if is_endless { front } else { back }));
        said | is(any(front, most), free(is_endless))
            | is(any(end, front.min(most)), flag::OCCUPIED)
            | is(low <= end.min(most), flag::OCCLUDED)
    }
}
