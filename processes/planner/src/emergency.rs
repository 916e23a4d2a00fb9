//! Ways to stop when nothing is admissible any more: straight, climbing, turning to either side.
//!
//! The straight stop lay in space known free when the last plan was made. What has been seen since may forbid it; another
//! way to stop may then be free, or meet what is there later. Once the vehicle stands, it looks around and retreats by the
//! way it came ([`crate::stuck`]).

use crate::Config;
use crate::admission::Admission;
use crate::rollout::{MOST_SAMPLES, Rollout, STEP_S, Sample, advance};
use ipc_types::{Vector, World};

/// A way to stop: how far the velocity turns to the left, rad, and climbs, rad.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Stop {
    turn_rad: f64,
    climb_rad: f64,
}

/// The straight one first: of equals the earlier one is flown.
const STOPS: [Stop; 7] = [
    Stop { turn_rad: 0.0, climb_rad: 0.0 },
    Stop { turn_rad: 0.35, climb_rad: 0.0 },
    Stop { turn_rad: -0.35, climb_rad: 0.0 },
    Stop { turn_rad: 0.8, climb_rad: 0.0 },
    Stop { turn_rad: -0.8, climb_rad: 0.0 },
    Stop { turn_rad: 0.0, climb_rad: 0.35 },
    Stop { turn_rad: 0.0, climb_rad: 0.7 },
];
/// Share of the hard braking that is left while turning at as much of the lateral acceleration as is left beside it.
const BRAKING: f64 = 0.8;
const TURNING: f64 = 0.6;

/// Leaves the best way to stop in `best`: the one that is occupied for least of its length, then unknown for least.
pub(crate) fn stop(
    from: Sample,
    admission: &Admission<'_>,
    config: &Config,
    scratch: &mut Rollout,
    best: &mut Rollout,
) {
    let mut least: Option<(f64, f64)> = None;
    for stop in STOPS {
        stop.roll_out(from, config, scratch);
        let risk = admission.risk(scratch, config.gamma_low);
        if least.is_none_or(|least| risk < least) {
            least = Some(risk);
            std::mem::swap(scratch, best);
        }
        if risk == (0.0, 0.0) {
            return;
        }
    }
}

impl Stop {
    fn roll_out(self, from: Sample, config: &Config, rollout: &mut Rollout) {
        let Some(ahead) = from.velocity.direction().filter(|_| self != STOPS[0]) else {
            return rollout.stop(from, config.hard_braking_mps2);
        };
        let (sin, cos) = self.turn_rad.sin_cos();
        let level = Vector::new(cos * ahead.x - sin * ahead.y, sin * ahead.x + cos * ahead.y, ahead.z);
        let towards = level * self.climb_rad.cos() + Vector::<World>::new(0.0, 0.0, self.climb_rad.sin());
        rollout.samples.clear();
        rollout.samples.push(from);
        rollout.braking = 1;
        let mut sample = from;
        for _ in 0..MOST_SAMPLES {
            let speed_mps = sample.velocity.norm();
            if speed_mps <= 0.0 {
                return;
            }
            let slower_mps = (speed_mps - BRAKING * config.hard_braking_mps2 * STEP_S).max(0.0);
            let ahead = sample.velocity * (1.0 / speed_mps);
            // The velocity turns as far as the acceleration across it allows.
            let change = (towards - ahead).clamp_norm(TURNING * config.lateral_mps2 * STEP_S / speed_mps);
            let turned = (ahead + change).direction().unwrap_or(ahead);
            sample = advance(sample, turned * slower_mps - sample.velocity);
            rollout.samples.push(sample);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::{FENCE, before_a_wall, config, home_only};
    use ipc_types::Point;
    use memory::View;

    fn stopped(view: &View, [x_m, y_m]: [f64; 2], speed_mps: f64) -> (Rollout, (f64, f64)) {
        let (config, mut scratch, mut best) = (config(), Rollout::new(), Rollout::new());
        let admission = Admission::new(view, &FENCE, &config);
        let from = Sample { position: Point::new(x_m, y_m, 2.0), velocity: Vector::new(speed_mps, 0.0, 0.0) };
        stop(from, &admission, &config, &mut scratch, &mut best);
        let risk = admission.risk(&best, config.gamma_low);
        (best, risk)
    }

    #[test]
    fn where_all_is_free_it_stops_straight_and_hard() {
        let (best, risk) = stopped(&home_only(200.0), [0.0; 2], 4.0);
        let end = best.samples.last().expect("samples");
        assert_eq!((risk, end.velocity, end.position.y), ((0.0, 0.0), Vector::ZERO, 0.0));
        assert!((end.position.x - 16.0 / 10.0).abs() < 0.1, "{end:?}");
    }

    #[test]
    fn before_what_it_cannot_stop_for_it_turns() {
        let view = before_a_wall();
        // The wall's margin begins at 4 m, and the image that shows it ends at 3.2 m to the left there; straight the vehicle
        // would end 0.2 m inside.
        let (best, (occupied_m, _)) = stopped(&view, [2.65, 3.22], 4.0);
        let end = best.samples.last().expect("samples");
        assert!(end.position.y > 3.4, "{end:?}");
        // Straight it would be that for 0.2 m.
        assert!(occupied_m < 0.11, "{occupied_m}");
        for pair in best.samples.windows(2) {
            let change = (pair[1].velocity - pair[0].velocity).norm() / STEP_S;
            assert!(change < 1.3 * config().hard_braking_mps2, "{change}");
        }
        assert_eq!(stopped(&view, [0.0; 2], 4.0).0.samples.last().expect("samples").position.y, 0.0);
    }

    #[test]
    fn whatever_it_meets_it_stops() {
        for (x_m, speed_mps) in [(4.5, 0.1), (3.9, 8.0), (5.0, 3.0), (0.0, 0.0)] {
            let (best, _) = stopped(&before_a_wall(), [x_m, 0.0], speed_mps);
            assert_eq!(best.samples.last().expect("samples").velocity, Vector::ZERO, "{x_m} {speed_mps}");
        }
    }
}
