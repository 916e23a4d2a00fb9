//! Injected faults of sensors and clock: what the camera delivers, where the estimate is, what the clock says.

use crate::camera::generator;
use ipc_types::disparity::NO_MATCH;
use ipc_types::{FlightTime, Vector, World};
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64Mcg;
use runtime::faults::{Fault, FaultKind};

/// What becomes of what the camera delivers, image by image.
#[derive(Debug)]
pub(crate) struct BadSight {
    random: Pcg64Mcg,
    /// The last sound image: a pair's pixels, or a disparity image.
    pair: Vec<u8>,
    disparity: Vec<u16>,
}

impl BadSight {
    /// Noise is drawn from a seed.
    pub(crate) fn new(seed: u64) -> Self {
        Self { random: generator(seed, 13), pair: Vec::new(), disparity: Vec::new() }
    }

    /// A pair of images.
    pub(crate) fn pair(&mut self, sight: Sight, pixels: &mut [u8]) {
        match sight {
            Sight::Sound => keep(&mut self.pair, pixels),
            Sight::Frozen if self.pair.len() == pixels.len() => pixels.copy_from_slice(&self.pair),
            Sight::Frozen => {}
            Sight::Blank => pixels.fill(GREY),
            Sight::Noisy(deviation) => {
                for pixel in pixels {
                    let noise: f64 = StandardNormal.sample(&mut self.random);
                    *pixel = (f64::from(*pixel) + deviation * noise).clamp(0.0, 255.0) as u8;
                }
            }
        }
    }

    /// A disparity image of a camera that matches by itself: of a blank or very noisy one it makes nothing.
    pub(crate) fn disparity(&mut self, sight: Sight, pixels: &mut [u16]) {
        match sight {
            Sight::Sound => keep(&mut self.disparity, pixels),
            Sight::Frozen if self.disparity.len() == pixels.len() => pixels.copy_from_slice(&self.disparity),
            Sight::Frozen => {}
            Sight::Blank | Sight::Noisy(_) => pixels.fill(NO_MATCH),
        }
    }
}

/// Without allocating after the first.
fn keep<T: Copy>(kept: &mut Vec<T>, pixels: &[T]) {
    kept.clear();
    kept.extend_from_slice(pixels);
}

/// What a blank camera delivers.
const GREY: u8 = 128;

/// What the camera delivers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Sight {
    /// What is there.
    Sound,
    /// The images before, again.
    Frozen,
    /// Grey.
    Blank,
    /// With noise of this standard deviation, grey levels.
    Noisy(f64),
}

/// The faults of a flight that concern sensors and clock.
#[derive(Clone, Debug)]
pub(crate) struct SensorFaults {
    faults: Vec<Fault>,
    /// Steps of the clock that have been taken.
    stepped: usize,
}

impl SensorFaults {
    pub(crate) fn new(faults: &[Fault]) -> Self {
        Self { faults: faults.to_vec(), stepped: 0 }
    }

    /// What the camera delivers at an exposure.
    pub(crate) fn sight(&self, exposure: FlightTime) -> Sight {
        let now_s = exposure.as_secs_f64();
        let mut sights = self.faults.iter().filter(|fault| fault.is_on(now_s)).map(|fault| match fault.fault {
            FaultKind::FreezeCamera { .. } => Sight::Frozen,
            FaultKind::BlankCamera { .. } => Sight::Blank,
            FaultKind::Noise { grey, .. } => Sight::Noisy(grey),
            _ => Sight::Sound,
        });
        sights.rfind(|sight| *sight != Sight::Sound).unwrap_or(Sight::Sound)
    }

    /// How far off the position estimate is.
    pub(crate) fn jump(&self, now: FlightTime) -> Vector<World> {
        let jumps = self.faults.iter().filter(|fault| fault.at_s <= now.as_secs_f64()).map(|fault| match fault.fault {
            FaultKind::Jump { by_m } => by_m,
            _ => 0.0,
        });
        Vector::new(0.0, jumps.sum(), 0.0)
    }

    /// By how much the next reading of the clock is wrong, ns. Every step is taken once.
    pub(crate) fn clock_step_ns(&mut self, now: FlightTime) -> i64 {
        let steps =
            self.faults.iter().filter(|fault| fault.at_s <= now.as_secs_f64()).filter_map(|fault| match fault.fault {
                FaultKind::StepClock { by_s } => Some(by_s),
                _ => None,
            });
        let steps: Vec<f64> = steps.collect();
        let step_s: f64 = steps.iter().skip(self.stepped).sum();
        self.stepped = steps.len();
        (step_s * 1e9) as i64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn t(seconds: f64) -> FlightTime {
        FlightTime::from_secs_f64(seconds)
    }

    #[test]
    fn a_bad_sight_shows_the_last_sound_image_grey_or_noise() {
        let mut bad = BadSight::new(3);
        let image = |seed: u8| (0..200_u8).map(|pixel| pixel.wrapping_mul(3).wrapping_add(seed)).collect::<Vec<u8>>();
        let mut show = |sight, seed: u8| {
            let mut pixels = image(seed);
            bad.pair(sight, &mut pixels);
            pixels
        };
        assert_eq!(show(Sight::Sound, 1), image(1));
        assert_eq!(show(Sight::Frozen, 2), image(1));
        assert_eq!(show(Sight::Blank, 3), vec![GREY; 200]);
        assert_ne!(show(Sight::Noisy(20.0), 4), image(4));
        let mut disparity = vec![640; 10];
        BadSight::new(3).disparity(Sight::Blank, &mut disparity);
        assert_eq!(disparity, vec![NO_MATCH; 10]);
    }

    #[test]
    fn each_fault_shows_while_it_lasts() {
        let fault = |at_s, fault| Fault { at_s, fault };
        let mut faults = SensorFaults::new(&[
            fault(1.0, FaultKind::FreezeCamera { for_s: 1.0 }),
            fault(3.0, FaultKind::BlankCamera { for_s: 1.0 }),
            fault(5.0, FaultKind::Noise { for_s: 1.0, grey: 20.0 }),
            fault(2.0, FaultKind::Jump { by_m: 1.5 }),
            fault(2.0, FaultKind::StepClock { by_s: -2.0 }),
        ]);
        let sights = [0.5, 1.5, 2.5, 3.5, 5.5, 6.5].map(|now| faults.sight(t(now)));
        assert_eq!(sights, [Sight::Sound, Sight::Frozen, Sight::Sound, Sight::Blank, Sight::Noisy(20.0), Sight::Sound]);
        assert_eq!([1.9, 2.0].map(|now| faults.jump(t(now)).y), [0.0, 1.5]);
        assert_eq!([1.9, 2.0, 2.1].map(|now| faults.clock_step_ns(t(now))), [0, -2_000_000_000, 0]);
    }
}
