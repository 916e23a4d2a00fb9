//! When to be where on a path: within limits of speed, acceleration, jerk, and curvature (v ≤ √(a·r)).
//!
//! Speeds are limited along the path, from its end backwards by braking and from its start by accelerating. What
//! results has steps of acceleration; the mean over a window of time has none, and is nowhere faster.

use ipc_types::{Point, Vector, World};

/// Spacing at which a path is looked at, m.
const SPACING_M: f64 = 0.2;
/// Spacings over which a corner is rounded, to either side.
const ROUNDED: usize = 3;
/// Least speed on the way, m/s: a path that doubles back on itself is still flown.
const CREEP_MPS: f64 = 0.2;
/// An end is arrived at by this speed, m/s.
const LEAST_MPS: f64 = 0.05;
/// Time step, s.
const TICK_S: f64 = 0.01;
/// Places timed that there is room for: a minute in steps of a tenth of a second.
const MOST_TIMED: usize = 640;
/// Longest time that is worked out, s.
const MOST_S: f64 = 60.0;

/// What a path is flown within.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Highest speed, m/s.
    pub speed_mps: f64,
    /// Speeding up, m/s².
    pub acceleration_mps2: f64,
    /// Slowing down, m/s².
    pub braking_mps2: f64,
    /// Across the path, m/s².
    pub lateral_mps2: f64,
    /// Change of the acceleration along the path, m/s³.
    pub jerk_mps3: f64,
}

/// A place of a path, and when to be there.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Timed {
    /// Since the start, s.
    pub t_s: f64,
    /// Where.
    pub at: Point<World>,
    /// How fast, m/s.
    pub velocity: Vector<World>,
}

/// Times paths. Made once: what it works in is kept.
#[derive(Clone, Debug)]
pub struct Timing {
    at: Vec<Point<World>>,
    /// Highest speed at each, m/s.
    speed_mps: Vec<f64>,
    /// Distance flown at every tick, m, before the mean is taken.
    along_m: Vec<f64>,
    timed: Vec<Timed>,
}

impl Default for Timing {
    /// Room for what 100 m need.
    fn default() -> Self {
        let places = (100.0 / SPACING_M) as usize;
        Self {
            at: Vec::with_capacity(places),
            speed_mps: Vec::with_capacity(places),
            along_m: Vec::with_capacity((MOST_S / TICK_S) as usize + places),
            timed: Vec::with_capacity(MOST_TIMED),
        }
    }
}

impl Timing {
    /// Times at most `most_m` of a path, every `step_s`, beginning at `start_mps` and ending at rest. A start too fast
    /// for a bend brakes as hard as allowed; one too fast for the whole path stops at its end all the same, harder than
    /// that, and so does a path that takes longer than a minute. A path of no length has no times.
    pub fn time(
        &mut self,
        path: &[Point<World>],
        most_m: f64,
        start_mps: f64,
        limits: &Limits,
        step_s: f64,
    ) -> &[Timed] {
        self.timed.clear();
        self.resample(path, most_m);
        if self.at.len() < 2 {
            return &self.timed;
        }
        let window_s = (limits.acceleration_mps2 + limits.braking_mps2) / limits.jerk_mps3;
        let half = (window_s / 2.0 / TICK_S).ceil() as usize;
        self.limit(limits, half as f64 * TICK_S);
        self.fly(half, start_mps, limits);
        self.average(2 * half, step_s);
        &self.timed
    }

    /// What was timed last.
    pub fn timed(&self) -> &[Timed] {
        &self.timed
    }

    /// Places every [`SPACING_M`]; the last at the end.
    fn resample(&mut self, path: &[Point<World>], most_m: f64) {
        self.at.clear();
        self.at.extend(path.first());
        let (mut left_m, mut length_m) = (SPACING_M, 0.0);
        for leg in path.windows(2) {
            let leg_m = leg[0].distance(leg[1]);
            let mut along_m = left_m;
            while along_m < leg_m && length_m < most_m {
                self.at.push(leg[0].lerp(leg[1], along_m / leg_m));
                along_m += SPACING_M;
                length_m += SPACING_M;
            }
            left_m = along_m - leg_m;
        }
        if length_m < most_m
            && let (Some(&last), Some(&end)) = (self.at.last(), path.last())
            && last.distance(end) > 1e-3
        {
            self.at.push(end);
        }
    }

    /// Speeds that curvature allows; each holds as far ahead and behind as the mean reaches.
    fn limit(&mut self, limits: &Limits, half_s: f64) {
        let count = self.at.len();
        let reach = (limits.speed_mps * half_s / SPACING_M).ceil() as usize;
        self.speed_mps.clear();
        self.speed_mps.resize(count, limits.speed_mps);
        for index in 1..count - 1 {
            let arm = ROUNDED.min(index).min(count - 1 - index);
            let (before, here, after) = (self.at[index - arm], self.at[index], self.at[index + arm]);
            let (enter, leave) = (here - before, after - here);
            let turn_rad = enter.cross(leave).norm().atan2(enter.dot(leave));
            let radius_m = 0.5 * (enter.norm() + leave.norm()) / turn_rad.max(1e-9);
            let most = (limits.lateral_mps2 * radius_m).sqrt().max(CREEP_MPS);
            let held = index.saturating_sub(reach)..=(index + reach).min(count - 1);
            self.speed_mps[held].iter_mut().for_each(|speed| *speed = speed.min(most));
        }
    }

    /// What braking leaves of the speeds, then the distances: so long as the mean still rests on what was before the
    /// start, at the speed of the start.
    fn fly(&mut self, half: usize, start_mps: f64, limits: &Limits) {
        let last = self.at.len() - 1;
        self.speed_mps[last] = 0.0;
        for index in (0..last).rev() {
            let gain = 2.0 * limits.braking_mps2 * self.at[index].distance(self.at[index + 1]);
            let able = (self.speed_mps[index + 1].powi(2) + gain).sqrt();
            self.speed_mps[index] = self.speed_mps[index].min(able);
        }
        let length_m = self.length_m();
        self.along_m.clear();
        let (mut along_m, mut speed) = (-(half as f64) * TICK_S * start_mps, start_mps);
        for tick in 0..(MOST_S / TICK_S) as usize {
            self.along_m.push(along_m);
            if tick >= 2 * half {
                let most = speed + limits.acceleration_mps2 * TICK_S;
                let least = speed - limits.braking_mps2 * TICK_S;
                // Slower than this it would never get there.
                let allowed = self.allowed_mps(along_m + speed * TICK_S).max(LEAST_MPS);
                speed = allowed.min(most).max(least).max(0.0);
            }
            along_m += speed * TICK_S;
            if along_m >= length_m || (speed <= 0.0 && tick >= 2 * half) {
                along_m = along_m.min(length_m);
                break;
            }
        }
        self.along_m.extend(std::iter::repeat_n(along_m, 2 * half));
    }

    fn length_m(&self) -> f64 {
        let last = self.at.len() - 1;
        (last - 1) as f64 * SPACING_M + self.at[last - 1].distance(self.at[last])
    }

    /// Speed allowed at a distance, m/s: between two places its square is linear, as under constant deceleration.
    fn allowed_mps(&self, along_m: f64) -> f64 {
        let (from, share) = self.piece(along_m);
        let (enter, leave) = (self.speed_mps[from].powi(2), self.speed_mps[from + 1].powi(2));
        (enter + (leave - enter) * share).sqrt()
    }

    /// The piece of the path at a distance, and the share of it.
    fn piece(&self, along_m: f64) -> (usize, f64) {
        let from = ((along_m.max(0.0) / SPACING_M) as usize).min(self.at.len() - 2);
        let piece_m = self.at[from].distance(self.at[from + 1]).max(1e-9);
        (from, ((along_m - from as f64 * SPACING_M) / piece_m).clamp(0.0, 1.0))
    }

    /// The mean of the distance over the window is what is flown.
    fn average(&mut self, window: usize, step_s: f64) {
        let per_step = (step_s / TICK_S).round().max(1.0) as usize;
        let window = window.max(1);
        // Until the mean is at rest, whatever the steps.
        let end_m = self.along_m.last().copied().unwrap_or(0.0);
        self.along_m.extend(std::iter::repeat_n(end_m, per_step + 1));
        for (step, flown) in self.along_m.windows(window + 1).step_by(per_step).enumerate() {
            let along_m = flown[..window].iter().sum::<f64>() / window as f64;
            let speed = (flown[window] - flown[0]) / (window as f64 * TICK_S);
            let (from, share) = self.piece(along_m);
            let way = self.at[from + 1] - self.at[from];
            let velocity = way.direction().map_or(Vector::ZERO, |tangent| tangent * speed);
            let at = self.at[from] + way * share;
            self.timed.push(Timed { t_s: (step * per_step) as f64 * TICK_S, at, velocity });
        }
    }
}
