//! The pure core: where the vehicle is against where it should be.

use crate::Config;
use ipc_types::frames::wrap_angle_rad;
use ipc_types::limits::Fence;
use ipc_types::messages::{PlanMode, SetpointMode, TrajectoryPoint, VehicleState};
use ipc_types::{FlightTime, Point, Vector, World};

/// A trajectory being tracked.
#[derive(Clone, Debug)]
pub struct Reference {
    /// Instant of the first point.
    pub start: FlightTime,
    /// When the planner published it: it goes stale from then on.
    pub published: FlightTime,
    /// Exposure of the newest image it rests on.
    pub image: FlightTime,
    /// What the planner is doing.
    pub mode: PlanMode,
    /// Samples in order of time.
    pub points: Vec<TrajectoryPoint>,
}

/// What the flight control unit is to do.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Command {
    /// World velocity.
    pub velocity: Vector<World>,
    /// Turn rate about z, rad/s.
    pub yaw_rate_radps: f64,
    /// Why.
    pub mode: SetpointMode,
}

/// Tracks trajectories. Keeps the last command, so that the next one follows smoothly, and the place to hover at.
#[derive(Clone, Debug)]
pub struct Tracker {
    config: Config,
    fence: Fence,
    command: Vector<World>,
    commanded_at: Option<FlightTime>,
    hover_at: Option<Point<World>>,
}

/// Speed below which braking has ended, m/s.
const AT_REST_MPS: f64 = 0.3;

impl Tracker {
    /// A tracker at rest.
    pub fn new(config: Config, fence: Fence) -> Self {
        Self { config, fence, command: Vector::ZERO, commanded_at: None, hover_at: None }
    }

    /// Goes on from what a predecessor asked for last: at which time, and which place it held.
    pub(crate) fn resume(&mut self, command: Vector<World>, at: FlightTime, hover_at: Option<Point<World>>) {
        (self.command, self.commanded_at, self.hover_at) = (command, Some(at), hover_at);
    }

    /// What was asked for last, when, and the place that is held.
    pub(crate) fn last(&self) -> (Vector<World>, Option<FlightTime>, Option<Point<World>>) {
        (self.command, self.commanded_at, self.hover_at)
    }

    /// The command at `now`. `state` and `reference` are the newest received, fresh or not.
    ///
    /// While a pilot flies it says what it would ask for, from where the vehicle is and as fast as it moves, so that nothing
    /// jumps when the pilot hands back.
    pub fn step(&mut self, now: FlightTime, state: Option<&VehicleState>, reference: Option<&Reference>) -> Command {
        let is_fresh = |state: &&VehicleState| {
            is_fresh(now, FlightTime::from_nanos(state.stamp.valid_ns), self.config.state_deadline_s)
                && state.world_from_body().is_some()
        };
        let state = state.filter(is_fresh);
        let Some(piloted) = state.filter(|state| state.piloted != 0) else {
            return self.fly(now, state, reference);
        };
        (self.command, self.hover_at) = (piloted.velocity(), None);
        Command { mode: SetpointMode::Shadow, ..self.fly(now, state, reference) }
    }

    /// `state` is fresh, or there is none.
    fn fly(&mut self, now: FlightTime, state: Option<&VehicleState>, reference: Option<&Reference>) -> Command {
        let config = self.config;
        let Some(state) = state else {
            let mode = if self.commanded_at.is_none() { SetpointMode::Idle } else { SetpointMode::Brake };
            return self.slew(now, Vector::ZERO, config.braking_mps2, 0.0, mode);
        };
        match reference.filter(|r| !r.points.is_empty()) {
            None if self.commanded_at.is_none() => {
                Command { velocity: Vector::ZERO, yaw_rate_radps: 0.0, mode: SetpointMode::Idle }
            }
            // On the ground it stays there, unless it is told to fly.
            Some(reference)
                if state.landed != 0
                    && (reference.mode == PlanMode::Landed
                        || !is_fresh(now, reference.published, config.trajectory_deadline_s)) =>
            {
                (self.command, self.commanded_at) = (Vector::ZERO, Some(now));
                Command { velocity: Vector::ZERO, yaw_rate_radps: 0.0, mode: SetpointMode::Idle }
            }
            Some(reference) if is_fresh(now, reference.published, config.trajectory_deadline_s) => {
                self.hover_at = None;
                let (velocity, yaw_rad) = self.track(now, state, &reference.points, reference.start);
                let mut fence = self.fence;
                if reference.mode == PlanMode::Land {
                    // The ground lies below the lowest flight.
                    fence.least_m[2] = f64::NEG_INFINITY;
                }
                let velocity = fence.limit(state.position(), velocity, config.braking_mps2);
                let yaw_rate = self.yaw_rate(state, yaw_rad);
                self.slew(now, velocity, config.slew_mps2, yaw_rate, SetpointMode::Track)
            }
            _ => self.hold(now, state),
        }
    }

    /// Brakes; once at rest, holds the place.
    fn hold(&mut self, now: FlightTime, state: &VehicleState) -> Command {
        if self.hover_at.is_none() && state.velocity().norm() < AT_REST_MPS && self.command.norm() < AT_REST_MPS {
            self.hover_at = Some(state.position());
        }
        let (velocity, mode) = match self.hover_at {
            Some(place) => ((place - state.position()) * self.config.cross_track_gain_hz, SetpointMode::Hover),
            None => (Vector::ZERO, SetpointMode::Brake),
        };
        let velocity = self.fence.limit(state.position(), velocity.clamp_norm(1.0), self.config.braking_mps2);
        self.slew(now, velocity, self.config.braking_mps2, 0.0, mode)
    }

    /// Velocity and heading that track a trajectory: feed-forward along it, proportional across it.
    fn track(
        &self,
        now: FlightTime,
        state: &VehicleState,
        points: &[TrajectoryPoint],
        start: FlightTime,
    ) -> (Vector<World>, f64) {
        let elapsed_s = now.seconds_since(start);
        let at = Point::from_array;
        // The nearest point of the track tells the progress; the schedule only where to begin to look, so that a
        // track that crosses itself is not cut short.
        let near = points.iter().enumerate().filter(|(_, p)| (p.t_s - elapsed_s).abs() <= 1.0);
        let gap = |p: &TrajectoryPoint| at(p.position_m).distance(state.position());
        let nearest = near.min_by(|a, b| gap(a.1).total_cmp(&gap(b.1))).map_or(points.len() - 1, |(index, _)| index);
        let ahead_s = points[nearest].t_s + self.config.lead_s;
        let ahead = points.partition_point(|p| p.t_s < ahead_s).min(points.len() - 1);
        let planned = Vector::from_array(points[ahead].velocity_mps);
        let error = at(points[nearest].position_m) - state.position();
        let is_end = nearest + 1 >= points.len() || planned.norm() < AT_REST_MPS;
        let across = match planned.direction().filter(|_| !is_end) {
            Some(tangent) => error - tangent * error.dot(tangent),
            None => at(points[ahead].position_m) - state.position(),
        };
        let speed = planned.norm().min(self.curve_limit(points, ahead));
        let along = planned.direction().map_or(Vector::ZERO, |tangent| tangent * speed);
        (along + (across * self.config.cross_track_gain_hz).clamp_norm(2.0), points[ahead].yaw_rad)
    }

    /// v ≤ √(a_max·r), with the radius of the circle through the neighbours of a point.
    fn curve_limit(&self, points: &[TrajectoryPoint], index: usize) -> f64 {
        let (Some(before), Some(after)) = (index.checked_sub(2).and_then(|i| points.get(i)), points.get(index + 2))
        else {
            return f64::INFINITY;
        };
        let [a, b, c] = [before, &points[index], after].map(|p| Point::<World>::from_array(p.position_m));
        let (ab, bc, ac) = (b - a, c - b, c - a);
        let twice_area = ab.cross(bc).norm();
        if twice_area < 1e-6 {
            return f64::INFINITY;
        }
        let radius_m = ab.norm() * bc.norm() * ac.norm() / (2.0 * twice_area);
        (self.config.curve_mps2 * radius_m).sqrt()
    }

    fn yaw_rate(&self, state: &VehicleState, yaw_rad: f64) -> f64 {
        let heading = state.world_from_body().map_or(yaw_rad, |pose| pose.rotation.roll_pitch_yaw().2);
        let limit = self.config.yaw_rate_degps.to_radians();
        (wrap_angle_rad(yaw_rad - heading) * self.config.yaw_gain_hz).clamp(-limit, limit)
    }

    /// Moves the command towards `wanted` no faster than `slew_mps2`.
    fn slew(
        &mut self,
        now: FlightTime,
        wanted: Vector<World>,
        slew_mps2: f64,
        yaw_rate_radps: f64,
        mode: SetpointMode,
    ) -> Command {
        let wanted = if wanted.is_finite() { wanted } else { Vector::ZERO };
        let elapsed_s = self.commanded_at.map_or(0.0, |at| now.seconds_since(at).clamp(0.0, 0.2));
        self.command += (wanted - self.command).clamp_norm(slew_mps2 * elapsed_s);
        if mode != SetpointMode::Idle {
            self.commanded_at = Some(now);
        }
        let yaw_rate_radps = if yaw_rate_radps.is_finite() { yaw_rate_radps } else { 0.0 };
        Command { velocity: self.command, yaw_rate_radps, mode }
    }
}

/// Whether something is no older than its deadline. What claims to come from the future is as untrustworthy as what is late.
fn is_fresh(now: FlightTime, valid: FlightTime, deadline_s: f64) -> bool {
    (-0.1..=deadline_s).contains(&now.seconds_since(valid))
}

#[cfg(test)]
mod tests {
    use super::*;

    const CONFIG: Config = Config {
        cross_track_gain_hz: 1.5,
        lead_s: 0.25,
        curve_mps2: 4.0,
        slew_mps2: 8.0,
        braking_mps2: 4.0,
        yaw_gain_hz: 2.5,
        yaw_rate_degps: 90.0,
        rate_hz: 50.0,
        trajectory_deadline_s: 0.4,
        state_deadline_s: 0.15,
    };
    const FENCE: Fence = Fence { least_m: [-100.0, -100.0, 0.5], most_m: [100.0, 100.0, 6.0] };

    fn t(seconds: f64) -> FlightTime {
        FlightTime::from_secs_f64(seconds)
    }

    fn state(now: f64, position: Point<World>, velocity: Vector<World>) -> VehicleState {
        let mut state: VehicleState = at_origin();
        state.stamp.valid_ns = t(now).as_nanos();
        state.position_m = position.to_array();
        state.velocity_mps = velocity.to_array();
        state.orientation = [1.0, 0.0, 0.0, 0.0];
        state
    }

    fn at_origin() -> VehicleState {
        VehicleState {
            stamp: ipc_types::wire::Stamp { sequence: 0, valid_ns: 0, published_ns: 0, incarnation: 0, producer: 0 },
            position_m: [0.0; 3],
            velocity_mps: [0.0; 3],
            orientation: [1.0, 0.0, 0.0, 0.0],
            piloted: 0,
            landed: 0,
        }
    }

    /// Straight east at 4 m/s, 2 m up, for three seconds.
    fn straight(start: f64) -> Reference {
        let point = |i: usize| TrajectoryPoint {
            t_s: i as f64 * 0.1,
            position_m: [i as f64 * 0.4, 0.0, 2.0],
            velocity_mps: [4.0, 0.0, 0.0],
            yaw_rad: 0.0,
        };
        let points = (0..30).map(point).collect();
        Reference { start: t(start), published: t(start), image: t(start), mode: PlanMode::Cruise, points }
    }

    /// Flies the tracker against a first-order vehicle until `until`; the reference is renewed unless stale is wanted.
    fn fly(
        tracker: &mut Tracker,
        from: f64,
        until: f64,
        renew: bool,
        at: &mut Point<World>,
        velocity: &mut Vector<World>,
    ) -> Vec<Command> {
        let mut commands = Vec::new();
        let reference = straight(0.0);
        let mut now = from;
        while now < until {
            let mut reference = reference.clone();
            if renew {
                reference.published = t(now);
            }
            let command = tracker.step(t(now), Some(&state(now, *at, *velocity)), Some(&reference));
            *velocity += (command.velocity - *velocity) * (0.02 / 0.2);
            *at += *velocity * 0.02;
            commands.push(command);
            now += 0.02;
        }
        commands
    }

    #[test]
    fn closes_the_cross_track_error_and_matches_the_speed() {
        let mut tracker = Tracker::new(CONFIG, FENCE);
        let (mut at, mut velocity) = (Point::new(0.0, 0.8, 2.0), Vector::ZERO);
        fly(&mut tracker, 0.0, 2.5, true, &mut at, &mut velocity);
        assert!(at.y.abs() < 0.15, "{at:?}");
        assert!((velocity.x - 4.0).abs() < 0.2, "{velocity:?}");
    }

    #[test]
    fn a_stale_trajectory_brakes_then_hovers_in_place() {
        let mut tracker = Tracker::new(CONFIG, FENCE);
        let (mut at, mut velocity) = (Point::new(0.0, 0.0, 2.0), Vector::ZERO);
        fly(&mut tracker, 0.0, 1.5, true, &mut at, &mut velocity);
        let commands = fly(&mut tracker, 1.5, 8.0, false, &mut at, &mut velocity);
        assert_eq!(commands[0].mode, SetpointMode::Brake);
        assert_eq!(commands.last().expect("commands").mode, SetpointMode::Hover);
        assert!(velocity.norm() < 0.05, "{velocity:?}");
    }

    #[test]
    fn a_stale_state_brakes_without_knowing_where_it_is() {
        let mut tracker = Tracker::new(CONFIG, FENCE);
        let (mut at, mut velocity) = (Point::new(0.0, 0.0, 2.0), Vector::ZERO);
        fly(&mut tracker, 0.0, 1.5, true, &mut at, &mut velocity);
        let old = state(1.0, at, velocity);
        let mut command = tracker.step(t(1.5), Some(&old), None);
        for i in 0..150 {
            command = tracker.step(t(1.5 + 0.02 * f64::from(i)), Some(&old), Some(&straight(1.5)));
        }
        assert_eq!((command.mode, command.velocity.norm()), (SetpointMode::Brake, 0.0));
    }

    #[test]
    fn commands_are_smooth_and_stay_inside_the_fence() {
        let fence = Fence { most_m: [5.0, 100.0, 6.0], ..FENCE };
        let mut tracker = Tracker::new(CONFIG, fence);
        let (mut at, mut velocity) = (Point::new(0.0, 0.0, 2.0), Vector::ZERO);
        let commands = fly(&mut tracker, 0.0, 4.0, true, &mut at, &mut velocity);
        for pair in commands.windows(2) {
            assert!((pair[1].velocity - pair[0].velocity).norm() <= CONFIG.slew_mps2 * 0.0201);
        }
        assert!(at.x < 5.6, "{at:?}");
    }

    #[test]
    fn when_a_pilot_hands_back_commands_go_on_from_what_he_flew() {
        let mut tracker = Tracker::new(CONFIG, FENCE);
        let (mut at, mut velocity) = (Point::new(0.0, 0.0, 2.0), Vector::ZERO);
        fly(&mut tracker, 0.0, 1.0, true, &mut at, &mut velocity);
        let sticks = Vector::new(-2.0, 3.0, 0.5);
        let mut before = Vector::ZERO;
        for (tick, piloted) in (0..60).map(|tick| (tick, u32::from(tick < 50))) {
            let now = 1.0 + 0.02 * f64::from(tick);
            let reference = Reference { published: t(now), ..straight(0.0) };
            let at = at + sticks * (0.02 * f64::from(tick));
            let state = VehicleState { piloted, ..state(now, at, sticks) };
            let command = tracker.step(t(now), Some(&state), Some(&reference));
            let mode = if piloted != 0 { SetpointMode::Shadow } else { SetpointMode::Track };
            assert_eq!(command.mode, mode);
            // From how fast the pilot flies; once he has handed back, from the command before.
            let from = if piloted != 0 { sticks } else { before };
            assert!((command.velocity - from).norm() <= CONFIG.slew_mps2 * 0.0201, "{tick}: {command:?}");
            before = command.velocity;
        }
        let nowhere = VehicleState { piloted: 1, velocity_mps: [f64::NAN; 3], ..state(3.0, at, sticks) };
        assert!(tracker.step(t(3.0), Some(&nowhere), None).velocity.is_finite());
    }

    #[test]
    fn only_a_landing_goes_below_the_fence_and_what_has_landed_is_still() {
        // Below the fence, which begins at 0.5 m.
        let low = Point::new(0.0, 0.0, 0.45);
        let down = |mode, landed| {
            let mut reference = straight(0.0);
            reference.mode = mode;
            for (index, point) in reference.points.iter_mut().enumerate() {
                (point.position_m, point.velocity_mps) = ([0.0, 0.0, 0.45 - 0.05 * index as f64], [0.0, 0.0, -0.5]);
            }
            let mut tracker = Tracker::new(CONFIG, FENCE);
            let commands = (0..20).map(|tick| {
                let now = 0.02 * f64::from(tick);
                let state = VehicleState { landed, ..state(now, low, Vector::ZERO) };
                tracker.step(t(now), Some(&state), Some(&reference))
            });
            commands.last().expect("commands")
        };
        assert!(down(PlanMode::Land, 0).velocity.z < -0.4);
        assert!(down(PlanMode::Cruise, 0).velocity.z >= 0.0, "no deeper");
        let idle = Command { velocity: Vector::ZERO, yaw_rate_radps: 0.0, mode: SetpointMode::Idle };
        assert_eq!(down(PlanMode::Landed, 1), idle);
        assert_eq!(down(PlanMode::Landed, 0).mode, SetpointMode::Track, "in the air nothing is idle");
    }

    #[test]
    fn nothing_moves_before_the_first_trajectory() {
        let mut tracker = Tracker::new(CONFIG, FENCE);
        let ground = state(0.0, Point::ZERO, Vector::ZERO);
        for reference in [None, Some(Reference { points: Vec::new(), ..straight(0.0) })] {
            let command = tracker.step(t(0.0), Some(&ground), reference.as_ref());
            assert_eq!((command.mode, command.velocity), (SetpointMode::Idle, Vector::ZERO));
        }
    }

    #[test]
    fn hostile_trajectories_give_finite_commands() {
        let mut tracker = Tracker::new(CONFIG, FENCE);
        let mut reference = straight(0.0);
        for value in [f64::NAN, f64::INFINITY, -1e300] {
            reference.points[3].velocity_mps = [value; 3];
            reference.points[4].position_m = [value; 3];
            reference.points[4].yaw_rad = value;
            for i in 0..20 {
                let now = f64::from(i) * 0.02;
                let command =
                    tracker.step(t(now), Some(&state(now, Point::new(1.0, 0.0, 2.0), Vector::ZERO)), Some(&reference));
                assert!(command.velocity.is_finite() && command.yaw_rate_radps.is_finite());
            }
        }
    }
}
