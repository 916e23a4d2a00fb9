//! What to do when there is no way ahead: wait, look around, back out, try elsewhere, give up.

use crate::Config;
use ipc_types::{FlightTime, Point, World};

/// Progress that counts, m.
const PROGRESS_M: f64 = 1.0;
/// Radius within which a place where the vehicle was stuck repels, m.
const REPULSION_M: f64 = 5.0;
/// Staying within `DITHERING_M` for this long means dithering, s.
const DITHERING_S: f64 = 6.0;
/// See above, m.
const DITHERING_M: f64 = 2.0;
/// Most that one plan of looking defers dithering by, s: plans are that far apart.
const LOOK_CREDIT_S: f64 = 0.2;
/// Slower than this the vehicle dwells where it is, m/s.
const DWELLING_MPS: f64 = 0.5;
/// Radius within which a place where the vehicle dwelt repels, m.
const DWELT_M: f64 = 2.5;
/// Price of every second of it, m ...
const DWELT_M_PER_S: f64 = 1.5;
/// ... and of such a place at most, m.
const MOST_DWELT_M: f64 = 10.0;
/// Places where the vehicle dwelt that are remembered.
const DWELT_PLACES: usize = 32;
/// A place of the way back nearer than this is passed, m.
const PASSED_M: f64 = 0.4;
/// Within this a place to leave a margin to is looked for on the way back, m ...
const LEAVING_M: f64 = 1.5;
/// ... which must be straight up to there but for so much, m.
const STRAIGHT_M: f64 = 0.15;
/// Flying about without getting nearer for this long marks the place, s.
const DETOUR_S: f64 = 30.0;

/// Stage of being stuck.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Stage {
    /// On the way.
    Moving,
    /// Braking, or waiting for the next map.
    Waiting {
        /// Since when.
        since: FlightTime,
    },
    /// Turning through a whole turn.
    LookingAround {
        /// Since when.
        since: FlightTime,
    },
    /// Flying back to a place of the path flown.
    BackingOut {
        /// Since when.
        since: FlightTime,
    },
    /// Hovering for good.
    GivenUp,
}

/// Keeps track of progress and of where the vehicle was stuck.
#[derive(Clone, Debug)]
pub(crate) struct Stuck {
    pub(crate) stage: Stage,
    places: Vec<Point<World>>,
    /// Where the vehicle has dwelt, and for how long, s; the latest last.
    dwelt: Vec<(Point<World>, f64)>,
    /// When that was last noted.
    noted: Option<FlightTime>,
    nearest_m: f64,
    progressed: FlightTime,
    /// Where the vehicle was when it last left the neighbourhood, and when.
    anchor: Option<(FlightTime, Point<World>)>,
    /// When the vehicle last turned its camera on purpose.
    looked: FlightTime,
    /// The way back out: places of the path flown, the next one last.
    way_back: Vec<Point<World>>,
    /// Older views are disregarded.
    pub(crate) disregards_before: FlightTime,
}

impl Stuck {
    pub(crate) fn new() -> Self {
        Self {
            stage: Stage::Moving,
            places: Vec::new(),
            dwelt: Vec::with_capacity(DWELT_PLACES),
            noted: None,
            nearest_m: f64::INFINITY,
            progressed: FlightTime::ZERO,
            anchor: None,
            looked: FlightTime::ZERO,
            way_back: Vec::new(),
            disregards_before: FlightTime::ZERO,
        }
    }

    /// Where the vehicle was stuck, for 0 s, and where it dwelt, for how long, s.
    pub(crate) fn remembered(&self) -> impl Iterator<Item = (Point<World>, f64)> {
        self.places.iter().map(|&place| (place, 0.0)).chain(self.dwelt.iter().copied())
    }

    /// Takes up what a predecessor remembered.
    pub(crate) fn remember(&mut self, place: Point<World>, dwelt_s: f64) {
        if dwelt_s > 0.0 {
            if self.dwelt.len() < DWELT_PLACES {
                self.dwelt.push((place, dwelt_s));
            }
        } else {
            self.places.push(place);
        }
    }

    /// The vehicle was told to stay: neither progress nor patience is asked of it.
    pub(crate) fn stays(&mut self, now: FlightTime) {
        (self.anchor, self.progressed, self.noted) = (None, now, Some(now));
        if self.stage != Stage::GivenUp {
            self.stage = Stage::Moving;
        }
    }

    /// A new goal forgives everything, but what walled the vehicle in is no truer for it.
    pub(crate) fn reset(&mut self) {
        *self = Self { disregards_before: self.disregards_before, ..Self::new() };
    }

    /// Notes where the vehicle is. Dithering makes it back out, as being stuck does; a detour that leads nowhere
    /// marks the place.
    pub(crate) fn note_progress(
        &mut self,
        now: FlightTime,
        at: Point<World>,
        to_goal_m: f64,
        path: &[Point<World>],
        config: &Config,
    ) {
        if to_goal_m < self.nearest_m - PROGRESS_M {
            (self.nearest_m, self.progressed) = (to_goal_m, now);
        } else if now.seconds_since(self.progressed) > DETOUR_S {
            self.progressed = now;
            self.mark(at, config);
        }
        let (since, place) = *self.anchor.get_or_insert((now, at));
        if place.distance(at) > DITHERING_M || self.stage != Stage::Moving {
            self.anchor = Some((now, at));
        } else if now.seconds_since(since) > DITHERING_S {
            self.anchor = Some((now, at));
            self.retreat(now, at, path, config);
        }
    }

    /// Notes where a slow vehicle spends its time: what looked open from afar may have been closed there, and would
    /// look open again as soon as it has left (as the costs that LRTA* learns, Korf 1990).
    pub(crate) fn note_dwelling(&mut self, now: FlightTime, at: Point<World>, speed_mps: f64) {
        let passed_s = self.noted.map_or(0.0, |noted| now.seconds_since(noted).clamp(0.0, 0.5));
        self.noted = Some(now);
        if speed_mps >= DWELLING_MPS {
            return;
        }
        let near = |(place, _): &&mut (Point<World>, f64)| place.distance(at) < DWELT_M / 4.0;
        if let Some((_, dwelt_s)) = self.dwelt.iter_mut().find(near) {
            *dwelt_s += passed_s;
            return;
        }
        if self.dwelt.len() == DWELT_PLACES {
            self.dwelt.remove(0);
        }
        self.dwelt.push((at, passed_s));
    }

    /// The vehicle turns its camera on purpose: that is not dithering.
    pub(crate) fn looking(&mut self, now: FlightTime) {
        if let Some((since, _)) = &mut self.anchor {
            let credit_s = now.seconds_since(self.looked).clamp(0.0, LOOK_CREDIT_S);
            *since = *since + std::time::Duration::from_secs_f64(credit_s);
        }
        self.looked = now;
    }

    /// An admissible plan was found.
    pub(crate) fn moving(&mut self) {
        if self.stage != Stage::GivenUp {
            self.stage = Stage::Moving;
        }
    }

    /// No plan is admissible. `path` is the path flown, oldest first.
    pub(crate) fn no_plan(&mut self, now: FlightTime, at: Point<World>, path: &[Point<World>], config: &Config) {
        let turn_s = look_around_s(config);
        self.stage = match self.stage {
            Stage::Moving => Stage::Waiting { since: now },
            Stage::Waiting { since } if now.seconds_since(since) > config.patience_s => {
                Stage::LookingAround { since: now }
            }
            Stage::LookingAround { since } if now.seconds_since(since) > turn_s => {
                self.retreat(now, at, path, config);
                self.stage
            }
            same => same,
        };
    }

    /// Marks the place and backs out, farther every time; or gives up.
    fn retreat(&mut self, now: FlightTime, at: Point<World>, path: &[Point<World>], config: &Config) {
        self.mark(at, config);
        if self.stage != Stage::GivenUp {
            let distance_m = config.back_out_m * (1.0 + 0.5 * (self.places.len() - 1) as f64);
            self.stage = match back_along(path, at, distance_m) {
                // A copy: the path flown grows while backing out, by the very places passed.
                Some(to) => {
                    self.way_back = path[to..].to_vec();
                    Stage::BackingOut { since: now }
                }
                None => Stage::LookingAround { since: now },
            };
        }
    }

    /// The next place on the way back; `None` once its end is reached. Every place is passed, no corner is cut. From
    /// inside a margin it is the second open one, for the first lies at the margin's very edge, as far as the way there
    /// is straight.
    pub(crate) fn way_back(
        &mut self,
        at: Point<World>,
        is_open: impl Fn(Point<World>) -> bool,
    ) -> Option<Point<World>> {
        let nearby = self.way_back.iter().rev().take_while(|place| place.distance(at) < LEAVING_M).count();
        let first = self.way_back.len() - nearby;
        if let Some(passed) = self.way_back[first..].iter().position(|place| place.distance(at) < PASSED_M) {
            self.way_back.truncate(first + passed);
        }
        let mut next = *self.way_back.last()?;
        if is_open(at) {
            return Some(next);
        }
        let (mut open, nearby) = (0, &self.way_back[first.min(self.way_back.len())..]);
        for (index, &place) in nearby.iter().enumerate().rev() {
            let is_on_line = |skipped: &Point<World>| off_line_m(*skipped, at, place) < STRAIGHT_M;
            if open == 2 || !nearby[index..].iter().all(is_on_line) {
                break;
            }
            if is_open(place) {
                (next, open) = (place, open + 1);
            }
        }
        Some(next)
    }

    /// The map forbids the way back, too, though the vehicle came through: what walls it in was seen wrong, or has moved. From
    /// now on it goes by what it has seen since, and in the time of one turn before it began to back out.
    pub(crate) fn walled_in(&mut self, backing_out: FlightTime, config: &Config) {
        self.disregards_before = backing_out - std::time::Duration::from_secs_f64(look_around_s(config));
    }

    /// The place to back out to was reached, or was not within a reasonable time.
    pub(crate) fn backed_out(&mut self, now: FlightTime) {
        self.stage = Stage::LookingAround { since: now };
    }

    /// Price of ending at a point, m: high near where the vehicle was stuck.
    pub(crate) fn price(&self, point: Point<World>) -> f64 {
        let stuck = self.places.iter().map(|place| (REPULSION_M - place.distance(point)).max(0.0) * 1.5);
        let dwelt = self.dwelt.iter().map(|(place, dwelt_s)| {
            let share = (1.0 - place.distance(point) / DWELT_M).max(0.0);
            (DWELT_M_PER_S * dwelt_s).min(MOST_DWELT_M) * share
        });
        stuck.sum::<f64>() + dwelt.sum::<f64>()
    }

    fn mark(&mut self, at: Point<World>, config: &Config) {
        self.places.push(at);
        if self.places.len() > config.attempts as usize {
            self.stage = Stage::GivenUp;
        }
    }
}

/// Share of the vehicle's turn rate at which it looks around: slow enough for every direction to be seen sharply.
pub(crate) const LOOK_SHARE: f64 = 0.6;

/// Time of a whole turn, s.
pub(crate) fn look_around_s(config: &Config) -> f64 {
    360.0 / (LOOK_SHARE * config.yaw_rate_degps)
}

/// Distance of a point from the line between two others, m.
fn off_line_m(point: Point<World>, from: Point<World>, to: Point<World>) -> f64 {
    let way = to - from;
    let share = ((point - from).dot(way) / way.dot(way).max(1e-12)).clamp(0.0, 1.0);
    point.distance(from.lerp(to, share))
}

/// Index of the place on the path that lies `distance_m` back along it from `at`.
fn back_along(path: &[Point<World>], at: Point<World>, distance_m: f64) -> Option<usize> {
    let (mut length, mut from) = (0.0, at);
    for (index, &place) in path.iter().enumerate().rev() {
        length += from.distance(place);
        from = place;
        if length >= distance_m {
            return Some(index);
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::config;

    #[test]
    fn waits_looks_around_backs_out_and_finally_gives_up() {
        let config = config();
        let path: Vec<_> = (0..80).map(|i| Point::new(f64::from(i) * 0.25, 0.0, 2.0)).collect();
        let mut stuck = Stuck::new();
        let mut stages = Vec::new();
        let at = path[79];
        for tick in 0..3000 {
            let now = FlightTime::from_secs_f64(f64::from(tick) * 0.1);
            if let Stage::BackingOut { .. } = stuck.stage {
                let end = stuck.way_back.first().expect("a way back");
                assert!(end.distance(at) > config.back_out_m - 0.3);
                assert!(stuck.way_back(at, |_| true).is_some_and(|next| next.distance(at) < 1.0), "it begins here");
                stuck.backed_out(now);
            } else {
                stuck.no_plan(now, at, &path, &config);
            }
            if stages.last() != Some(&std::mem::discriminant(&stuck.stage)) {
                stages.push(std::mem::discriminant(&stuck.stage));
            }
        }
        assert_eq!(stuck.stage, Stage::GivenUp);
        let rounds = config.attempts as usize;
        assert_eq!(stages.len(), 2 + 2 * rounds + 1, "waiting, then rounds of looking and backing, then the end");
    }

    #[test]
    fn the_way_out_of_a_margin_skips_what_is_not_open_and_cuts_no_corner() {
        let way = |bend: f64| {
            let mut stuck = Stuck::new();
            // The vehicle came along x and, from 1 m on, perhaps at an angle.
            let flown = |i: i32| Point::new(0.25 * f64::from(i), bend * (0.25 * f64::from(i) - 1.0).max(0.0), 2.0);
            stuck.way_back = (0..=8).map(flown).collect();
            (stuck, flown(8))
        };
        let (mut straight, at) = way(0.0);
        assert_eq!(straight.way_back(at, |_| true).map(|next| next.x), Some(1.5), "not nearer than what is passed");
        let (mut straight, at) = way(0.0);
        assert_eq!(straight.way_back(at, |place| place.x < 1.2).map(|next| next.x), Some(0.75), "the second open one");
        assert_eq!(straight.way_back(at, |place| place.x < 0.9).map(|next| next.x), Some(0.75), "the only one nearby");
        let (mut bent, at) = way(1.0);
        let next = bent.way_back(at, |place| place.x < 0.9).expect("a way");
        assert!(off_line_m(Point::new(1.0, 0.0, 2.0), at, next) < STRAIGHT_M || next.x >= 1.0, "{next:?}");
        // Passed at a little distance, a place is passed all the same.
        let beside = Point::new(1.0, 0.3, 2.0);
        assert!(straight.way_back(beside, |_| true).is_some_and(|next| next.x < 1.0));
        assert_eq!(straight.way_back(Point::new(0.1, 0.0, 2.0), |_| true), None);
    }

    #[test]
    fn where_it_dwells_gets_dearer_and_where_it_flies_does_not() {
        let (mut stuck, here, on) = (Stuck::new(), Point::ZERO, Point::new(2.0, 0.0, 0.0));
        for tick in 0..40 {
            let now = FlightTime::from_secs_f64(f64::from(tick) * 0.1);
            stuck.note_dwelling(now, if tick < 20 { here } else { on }, if tick < 20 { 0.1 } else { 3.0 });
        }
        assert!((stuck.price(here) - DWELT_M_PER_S * 1.9).abs() < 1e-6);
        assert!(stuck.price(on) < 0.3 * stuck.price(here));
        for tick in 40..4000 {
            let at = Point::new(0.0, f64::from(tick), 0.0);
            stuck.note_dwelling(FlightTime::from_secs_f64(f64::from(tick) * 0.1), at, 0.0);
        }
        assert!(stuck.dwelt.len() <= DWELT_PLACES && stuck.price(here) == 0.0, "the oldest are forgotten");
    }

    #[test]
    fn places_repel_within_their_radius() {
        let mut stuck = Stuck::new();
        stuck.mark(Point::ZERO, &config());
        assert!(stuck.price(Point::new(1.0, 0.0, 0.0)) > stuck.price(Point::new(3.0, 0.0, 0.0)));
        assert_eq!(stuck.price(Point::new(6.0, 0.0, 0.0)), 0.0);
    }
}
