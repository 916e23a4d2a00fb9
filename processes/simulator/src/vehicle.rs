//! A quadrotor behind a velocity-command flight control unit.

use ipc_types::bounds::Bounds;
use ipc_types::frames::wrap_angle_rad;
use ipc_types::{Body, FlightTime, Point, Pose, Rotation, Vector, World};
use serde::{Deserialize, Serialize};

/// The vehicle's dynamics and those of its flight control unit.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct VehicleConfig {
    /// Radius of the hull, rotors included, m.
    pub hull_radius_m: f64,
    /// Height of the hull, m.
    pub hull_height_m: f64,
    /// Largest acceleration, m/s².
    pub acceleration_mps2: f64,
    /// Largest jerk, m/s³.
    pub jerk_mps3: f64,
    /// Acceleration per velocity error, 1/s.
    pub velocity_gain_hz: f64,
    /// Drag: deceleration per speed, 1/s.
    pub drag_hz: f64,
    /// Largest tilt, degrees.
    pub tilt_deg: f64,
    /// Without a setpoint for this long the flight control unit brakes, s.
    pub setpoint_timeout_s: f64,
}

impl VehicleConfig {
    /// Reports values out of range.
    pub fn check(&self, bounds: &mut Bounds) {
        bounds.range("hull_radius_m", self.hull_radius_m, 0.03..=3.0);
        bounds.range("hull_height_m", self.hull_height_m, 0.02..=2.0);
        bounds.range("acceleration_mps2", self.acceleration_mps2, 0.5..=40.0);
        bounds.range("jerk_mps3", self.jerk_mps3, 1.0..=1000.0);
        bounds.range("velocity_gain_hz", self.velocity_gain_hz, 0.2..=20.0);
        bounds.range("drag_hz", self.drag_hz, 0.0..=5.0);
        bounds.range("tilt_deg", self.tilt_deg, 5.0..=70.0);
        bounds.range("setpoint_timeout_s", self.setpoint_timeout_s, 0.05..=5.0);
    }
}

/// Meeting the ground slower than this, downwards and aside, is touching down, m/s.
const TOUCH_DOWN_MPS: f64 = 1.0;
const TOUCH_DOWN_ASIDE_MPS: f64 = 0.5;
/// Standard gravity, m/s².
pub(crate) const GRAVITY_MPS2: f64 = 9.80665;

/// The true vehicle.
#[derive(Clone, Debug)]
pub struct Vehicle {
    config: VehicleConfig,
    position: Point<World>,
    velocity: Vector<World>,
    acceleration: Vector<World>,
    yaw_rad: f64,
    setpoint: Option<(FlightTime, Vector<World>, f64)>,
    airborne: bool,
}

impl Vehicle {
    /// At rest on the ground.
    pub fn new(config: VehicleConfig, position: Point<World>, yaw_rad: f64) -> Self {
        Self {
            config,
            position,
            velocity: Vector::ZERO,
            acceleration: Vector::ZERO,
            yaw_rad,
            setpoint: None,
            airborne: false,
        }
    }

    /// Takes a setpoint: world velocity and turn rate. One that is not finite is refused, as a flight control unit would.
    pub fn command(&mut self, now: FlightTime, velocity: Vector<World>, yaw_rate_radps: f64) {
        if velocity.is_finite() && yaw_rate_radps.is_finite() {
            self.setpoint = Some((now, velocity, yaw_rate_radps));
        }
    }

    /// Advances by `step_s` over ground of the given height, through air that moves.
    pub fn step(&mut self, now: FlightTime, step_s: f64, ground_m: f64, wind: Vector<World>) {
        let config = self.config;
        let (velocity, yaw_rate) = match self.setpoint {
            Some((at, velocity, yaw_rate)) if now.seconds_since(at) <= config.setpoint_timeout_s => {
                (velocity, yaw_rate)
            }
            _ => (Vector::ZERO, 0.0),
        };
        if !self.airborne && velocity.z < 0.1 {
            return; // Resting on the ground.
        }
        self.airborne = true;
        let wanted = (velocity - self.velocity) * config.velocity_gain_hz;
        // What tilt and thrust allow, beyond holding against gravity and drag.
        let tilt_mps2 = GRAVITY_MPS2 * config.tilt_deg.to_radians().tan();
        let wanted = wanted.clamp_norm(config.acceleration_mps2.min(tilt_mps2));
        self.acceleration += (wanted - self.acceleration).clamp_norm(config.jerk_mps3 * step_s);
        let before = self.velocity;
        // Drag in still air is held against; what wind adds to it is a disturbance.
        self.velocity += (self.acceleration + wind * config.drag_hz) * step_s;
        self.position += (before + self.velocity) * (step_s / 2.0);
        self.yaw_rad = wrap_angle_rad(self.yaw_rad + yaw_rate * step_s);
        let resting_m = ground_m + config.hull_height_m / 2.0;
        if self.position.z < resting_m {
            self.position.z = resting_m;
            let comes_down = self.comes_down();
            self.velocity.z = self.velocity.z.max(0.0);
            // A flight control unit that is told to go on down, and has come down gently, cuts its motors.
            if velocity.z < 0.0 && comes_down {
                (self.airborne, self.velocity, self.acceleration) = (false, Vector::ZERO, Vector::ZERO);
            }
        }
    }

    /// Pose: the body's z axis along the thrust that acceleration, gravity and drag call for.
    pub fn world_from_body(&self) -> Pose<World, Body> {
        let thrust = self.acceleration + self.velocity * self.config.drag_hz + Vector::new(0.0, 0.0, GRAVITY_MPS2);
        let (sin, cos) = self.yaw_rad.sin_cos();
        let (forward, left) = (cos * thrust.x + sin * thrust.y, cos * thrust.y - sin * thrust.x);
        let pitch = forward.atan2(thrust.z);
        let roll = -left.atan2(forward.hypot(thrust.z));
        let level = !self.airborne;
        let rotation = Rotation::from_roll_pitch_yaw(
            if level { 0.0 } else { roll },
            if level { 0.0 } else { pitch },
            self.yaw_rad,
        );
        Pose { rotation, translation: self.position - Point::ZERO }
    }

    /// Whether it is told to go down and does so gently: meeting the ground is then no collision.
    pub(crate) fn comes_down(&self) -> bool {
        self.setpoint.is_some_and(|(_, velocity, _)| velocity.z < 0.0)
            && -self.velocity.z < TOUCH_DOWN_MPS
            && self.velocity.horizontal_norm() < TOUCH_DOWN_ASIDE_MPS
    }

    /// True velocity.
    pub fn velocity(&self) -> Vector<World> {
        self.velocity
    }

    /// True position.
    pub fn position(&self) -> Point<World> {
        self.position
    }

    /// Whether it has left the ground.
    pub fn airborne(&self) -> bool {
        self.airborne
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    pub(crate) const CONFIG: VehicleConfig = VehicleConfig {
        hull_radius_m: 0.25,
        hull_height_m: 0.15,
        acceleration_mps2: 6.0,
        jerk_mps3: 60.0,
        velocity_gain_hz: 4.0,
        drag_hz: 0.15,
        tilt_deg: 35.0,
        setpoint_timeout_s: 0.3,
    };

    fn fly(vehicle: &mut Vehicle, from_s: f64, until_s: f64, command: Option<Vector<World>>) {
        let mut now_s = from_s;
        while now_s < until_s {
            let now = FlightTime::from_secs_f64(now_s);
            if let Some(velocity) = command {
                vehicle.command(now, velocity, 0.0);
            }
            let before = vehicle.acceleration;
            vehicle.step(now, 0.005, 0.0, Vector::ZERO);
            assert!((vehicle.acceleration - before).norm() <= CONFIG.jerk_mps3 * 0.005 + 1e-9);
            assert!(vehicle.acceleration.norm() <= CONFIG.acceleration_mps2 + 1e-9);
            now_s += 0.005;
        }
    }

    #[test]
    fn follows_velocity_and_brakes_by_itself_when_setpoints_stop() {
        let mut vehicle = Vehicle::new(CONFIG, Point::new(0.0, 0.0, 0.075), 0.0);
        fly(&mut vehicle, 0.0, 2.0, Some(Vector::new(0.0, 0.0, 1.0)));
        fly(&mut vehicle, 2.0, 5.0, Some(Vector::new(4.0, 0.0, 0.0)));
        assert!((vehicle.velocity().x - 4.0).abs() < 0.05, "{:?}", vehicle.velocity());
        let at = vehicle.position();
        fly(&mut vehicle, 5.0, 8.0, None);
        assert!(vehicle.velocity().norm() < 0.05);
        assert!(vehicle.position().distance(at) < 4.5, "{}", vehicle.position().distance(at));
    }

    #[test]
    fn tilts_forward_to_accelerate_forward() {
        let mut vehicle = Vehicle::new(CONFIG, Point::new(0.0, 0.0, 0.075), 0.7);
        fly(&mut vehicle, 0.0, 1.0, Some(Vector::new(0.0, 0.0, 1.0)));
        fly(&mut vehicle, 1.0, 1.3, Some(Vector::new(5.0, 1.0, 0.0)));
        let up = vehicle.world_from_body().rotation * Vector::new(0.0, 0.0, 1.0);
        assert!(up.dot(Vector::new(5.0, 1.0, 0.0)) > 0.5, "{up:?}");
    }

    #[test]
    fn told_to_go_on_down_at_the_ground_it_has_landed_and_may_take_off_again() {
        let mut vehicle = Vehicle::new(CONFIG, Point::new(0.0, 0.0, 0.075), 0.0);
        for round in 0..2 {
            let from_s = f64::from(round) * 10.0;
            fly(&mut vehicle, from_s, from_s + 2.0, Some(Vector::new(0.0, 0.0, 1.0)));
            assert!(vehicle.airborne() && vehicle.position().z > 1.0);
            for tick in 0..1000 {
                let now = FlightTime::from_secs_f64(from_s + 2.0 + f64::from(tick) * 0.005);
                vehicle.command(now, Vector::new(0.0, 0.0, -0.5), 0.0);
                vehicle.step(now, 0.005, 0.0, Vector::ZERO);
            }
            assert!(!vehicle.airborne() && vehicle.position().z == 0.075 && vehicle.velocity() == Vector::ZERO);
        }
    }

    #[test]
    fn what_comes_down_hard_or_sideways_has_not_landed() {
        for command in [Vector::new(0.0, 0.0, -3.0), Vector::new(2.0, 0.0, -0.4)] {
            let mut vehicle = Vehicle::new(CONFIG, Point::new(0.0, 0.0, 0.075), 0.0);
            fly(&mut vehicle, 0.0, 6.0, Some(Vector::new(0.0, 0.0, 1.0)));
            let mut now_s = 6.0;
            while vehicle.position().z > 0.075 {
                vehicle.command(FlightTime::from_secs_f64(now_s), command, 0.0);
                vehicle.step(FlightTime::from_secs_f64(now_s), 0.005, 0.0, Vector::ZERO);
                now_s += 0.005;
            }
            assert!(vehicle.airborne(), "{command:?}");
        }
    }

    #[test]
    fn stays_on_the_ground_until_told_to_climb_and_refuses_nonsense() {
        let mut vehicle = Vehicle::new(CONFIG, Point::new(0.0, 0.0, 0.075), 0.0);
        fly(&mut vehicle, 0.0, 1.0, Some(Vector::new(3.0, 0.0, 0.0)));
        assert_eq!(vehicle.position(), Point::new(0.0, 0.0, 0.075));
        vehicle.command(FlightTime::ZERO, Vector::new(f64::NAN, 0.0, 1.0), 0.0);
        fly(&mut vehicle, 1.0, 2.0, None);
        assert!(!vehicle.airborne() && vehicle.position().is_finite());
    }
}
