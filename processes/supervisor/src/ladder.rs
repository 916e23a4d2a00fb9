//! How far a flight is scaled down for what does not work: the degradation ladder, as a pure function.
//!
//! | rung | trigger | action | way back |
//! |---|---|---|---|
//! | full | everything works | cruise speed | |
//! | single frame | memory cannot keep its keyframes, or has lost most of them | `single_frame_share` of the speed | keyframes kept for `recovered_s` |
//! | slower | images reach the map more slowly than the camera delivers them, or a flight process died | the share of the images that arrive, at least `slowest_share`; `restarting_share` | full rate for `recovered_s` |
//! | hover | a flight process has been away for `away_s`, or no map for so long | stay: brake and hover | all back for `recovered_s` |
//! | hand back | a flight process was given up, and the vehicle is at rest | the run ends; without setpoints the flight control unit does what it is configured to | none |
//!
//! Down at once, up one after the other: a rung is left only when its trigger has been gone for `recovered_s`.
//! It only ever asks for less than the planner would fly. What keeps the vehicle from what it cannot see does not depend on it.

use ipc_types::bounds::Bounds;
use ipc_types::messages::Rung;
use ipc_types::{FlightTime, ProcessId};
use serde::{Deserialize, Serialize};

/// The ladder's figures.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LadderConfig {
    /// Share of the speed with a map of hardly more than the newest frame, 0.1..1.
    pub single_frame_share: f64,
    /// Share of the speed while a flight process is being restarted, 0.1..1.
    pub restarting_share: f64,
    /// Least share of the speed when images come slowly, 0.1..1.
    pub slowest_share: f64,
    /// A flight process or the map may be away for so long before the vehicle is told to stay, s, 0.1..10.
    pub away_s: f64,
    /// So long must a trigger be gone before its rung is left, s, 0.1..60.
    pub recovered_s: f64,
    /// At rest for so long, without a process that was given up, and the vehicle is handed back, s, 0..3600.
    pub hand_back_s: f64,
}

impl LadderConfig {
    /// Reports values out of range.
    pub fn check(&self, bounds: &mut Bounds) {
        bounds.range("single_frame_share", self.single_frame_share, 0.1..=1.0);
        bounds.range("restarting_share", self.restarting_share, 0.1..=1.0);
        bounds.range("slowest_share", self.slowest_share, 0.1..=1.0);
        bounds.range("away_s", self.away_s, 0.1..=10.0);
        bounds.range("recovered_s", self.recovered_s, 0.1..=60.0);
        bounds.range("hand_back_s", self.hand_back_s, 0.0..=3600.0);
    }
}

/// What is known of the graph.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Observed {
    /// A flight process that does not run, and since when.
    pub away: Option<(ProcessId, FlightTime)>,
    /// A flight process that was given up.
    pub given_up: Option<ProcessId>,
    /// Whether the memory lost keyframes: could not store one, or came back without most of them.
    pub lost_keyframes: bool,
    /// Images that reached the map per image that the camera delivered, over the last second or so; 1 before there were any.
    pub arriving: f64,
    /// Age of the newest map, s; 0 before the first.
    pub map_age_s: f64,
    /// Whether the vehicle is in the air.
    pub airborne: bool,
    /// Whether it is at rest.
    pub at_rest: bool,
}

/// What the ladder asks for.
#[derive(Clone, Debug, PartialEq)]
pub struct Step {
    /// Where the flight stands.
    pub rung: Rung,
    /// Share of the cruise speed, 0..1; 0 is to stay.
    pub speed_share: f64,
    /// Why, for people; empty on the first rung.
    pub reason: String,
}

/// The ladder.
#[derive(Clone, Debug)]
pub struct Ladder {
    config: LadderConfig,
    step: Step,
    /// Since when the trigger of the present rung is gone.
    better_since: Option<FlightTime>,
    /// Since when the vehicle has been at rest without a process that was given up.
    resting_since: Option<FlightTime>,
}

/// Less than this share of the images is too few, and no accident of counting.
const FULL_RATE: f64 = 0.8;

impl Ladder {
    /// At the first rung.
    pub fn new(config: LadderConfig) -> Self {
        let step = Step { rung: Rung::Full, speed_share: 1.0, reason: String::new() };
        Self { config, step, better_since: None, resting_since: None }
    }

    /// Goes on from where a former supervisor's stood.
    pub fn resume(&mut self, step: Step) {
        self.step = step;
    }

    /// Where the flight stands.
    pub fn present(&self) -> &Step {
        &self.step
    }

    /// Where it is to stand.
    pub fn look(&mut self, now: FlightTime, seen: &Observed) -> &Step {
        let called_for = self.called_for(now, seen);
        let is_better = called_for.rung < self.step.rung
            || called_for.rung == self.step.rung && called_for.speed_share > self.step.speed_share;
        if !is_better {
            self.better_since = None;
            self.step = called_for;
        } else if self.step.rung != Rung::HandBack {
            let since = *self.better_since.get_or_insert(now);
            if now.seconds_since(since) >= self.config.recovered_s {
                self.better_since = None;
                self.step = called_for;
            }
        }
        &self.step
    }

    fn called_for(&mut self, now: FlightTime, seen: &Observed) -> Step {
        let config = self.config;
        let step = |rung, speed_share, reason| Step { rung, speed_share, reason };
        let rests = seen.given_up.is_some() && (seen.at_rest || !seen.airborne);
        self.resting_since = if rests { self.resting_since.or(Some(now)) } else { None };
        if let Some(process) = seen.given_up {
            let rested_s = self.resting_since.map_or(-1.0, |since| now.seconds_since(since));
            let rung = if rested_s >= config.hand_back_s { Rung::HandBack } else { Rung::Hover };
            return step(rung, 0.0, format!("{process} was given up"));
        }
        if let Some((process, since)) = seen.away.filter(|(_, since)| now.seconds_since(*since) > config.away_s) {
            return step(Rung::Hover, 0.0, format!("{process} has been away for {:.1} s", now.seconds_since(since)));
        }
        if seen.airborne && seen.map_age_s > config.away_s {
            return step(Rung::Hover, 0.0, format!("no map for {:.1} s", seen.map_age_s));
        }
        let limits = [
            (seen.arriving < FULL_RATE, seen.arriving.max(config.slowest_share)),
            (seen.away.is_some(), config.restarting_share),
            (seen.lost_keyframes, config.single_frame_share),
        ];
        let speed_share = limits.iter().filter(|(holds, _)| *holds).map(|(_, share)| *share).fold(1.0, f64::min);
        if seen.arriving < FULL_RATE {
            return step(
                Rung::Slower,
                speed_share,
                format!("{:.0} % of the images reach the map", 100.0 * seen.arriving),
            );
        }
        if let Some((process, _)) = seen.away {
            return step(Rung::Slower, speed_share, format!("{process} is being restarted"));
        }
        if seen.lost_keyframes {
            return step(Rung::SingleFrame, speed_share, "keyframes were lost".to_owned());
        }
        step(Rung::Full, 1.0, String::new())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CONFIG: LadderConfig = LadderConfig {
        single_frame_share: 0.6,
        restarting_share: 0.8,
        slowest_share: 0.3,
        away_s: 0.5,
        recovered_s: 1.0,
        hand_back_s: 2.0,
    };
    const WELL: Observed = Observed {
        away: None,
        given_up: None,
        lost_keyframes: false,
        arriving: 1.0,
        map_age_s: 0.1,
        airborne: true,
        at_rest: false,
    };

    fn t(seconds: f64) -> FlightTime {
        FlightTime::from_secs_f64(seconds)
    }

    /// Looks every 10 ms; the rungs with when they were reached.
    fn climb(ladder: &mut Ladder, from_s: f64, until_s: f64, seen: impl Fn(f64) -> Observed) -> Vec<(f64, Rung)> {
        let mut rungs = Vec::new();
        let mut now_s = from_s;
        while now_s < until_s {
            let rung = ladder.look(t(now_s), &seen(now_s)).rung;
            if rungs.last().is_none_or(|(_, last)| *last != rung) {
                rungs.push((now_s, rung));
            }
            now_s += 0.01;
        }
        rungs
    }

    /// Every rung: its trigger takes the flight there at once, its action is what the table says, and it is left when the
    /// trigger has been gone for `recovered_s`, not before.
    #[test]
    fn every_rung_has_its_trigger_its_action_and_its_way_back() {
        let cases: [(Rung, f64, Observed); 5] = [
            (Rung::SingleFrame, 0.6, Observed { lost_keyframes: true, ..WELL }),
            (Rung::Slower, 0.5, Observed { arriving: 0.5, ..WELL }),
            (Rung::Slower, 0.3, Observed { arriving: 0.0, ..WELL }),
            (Rung::Slower, 0.8, Observed { away: Some((ProcessId::Planner, t(4.9))), ..WELL }),
            (Rung::Hover, 0.0, Observed { map_age_s: 0.6, ..WELL }),
        ];
        for (rung, share, trouble) in cases {
            let mut ladder = Ladder::new(CONFIG);
            assert_eq!(climb(&mut ladder, 0.0, 5.0, |_| WELL).len(), 1);
            let step = ladder.look(t(5.0), &trouble).clone();
            assert_eq!((step.rung, step.speed_share), (rung, share), "{trouble:?}");
            assert!(!step.reason.is_empty());
            assert_eq!(ladder.look(t(5.1), &WELL).rung, rung, "not at once");
            let rungs = climb(&mut ladder, 5.1, 8.0, |_| WELL);
            assert_eq!(rungs.last().expect("rungs").1, Rung::Full);
            assert!((6.0..6.3).contains(&rungs[1].0), "{rungs:?}");
        }
    }

    #[test]
    fn a_process_that_stays_away_means_hovering_and_one_given_up_is_handed_back_at_rest() {
        let mut ladder = Ladder::new(CONFIG);
        let away = |now_s: f64| Observed { away: Some((ProcessId::Memory, t(1.0))), at_rest: now_s > 2.5, ..WELL };
        let rungs = climb(&mut ladder, 1.0, 3.0, away);
        assert_eq!(rungs.iter().map(|(_, rung)| *rung).collect::<Vec<_>>(), [Rung::Slower, Rung::Hover]);
        let given_up = |now_s: f64| Observed { given_up: Some(ProcessId::Memory), at_rest: now_s > 4.0, ..WELL };
        let rungs = climb(&mut ladder, 3.0, 8.0, given_up);
        assert_eq!(rungs.iter().map(|(_, rung)| *rung).collect::<Vec<_>>(), [Rung::Hover, Rung::HandBack]);
        assert!((6.0..6.1).contains(&rungs[1].0), "{rungs:?}");
        assert_eq!(climb(&mut ladder, 8.0, 12.0, |_| WELL), [(8.0, Rung::HandBack)], "there is no way back");
    }

    #[test]
    fn on_the_ground_nothing_is_missed() {
        let mut ladder = Ladder::new(CONFIG);
        let ground = Observed { airborne: false, map_age_s: 9.0, ..WELL };
        assert_eq!(climb(&mut ladder, 0.0, 3.0, |_| ground), [(0.0, Rung::Full)]);
    }

    #[test]
    fn speed_comes_back_as_late_as_a_rung_does() {
        let mut ladder = Ladder::new(CONFIG);
        let slow = |arriving| Observed { arriving, ..WELL };
        assert_eq!(ladder.look(t(0.0), &slow(0.5)).speed_share, 0.5);
        assert_eq!(ladder.look(t(0.5), &slow(0.7)).speed_share, 0.5);
        assert_eq!(ladder.look(t(1.0), &slow(0.4)).speed_share, 0.4);
        assert_eq!(ladder.look(t(1.1), &slow(0.7)).speed_share, 0.4);
        assert_eq!(ladder.look(t(2.2), &slow(0.7)).speed_share, 0.7);
    }

    #[test]
    fn flickering_triggers_do_not_make_it_climb() {
        let mut ladder = Ladder::new(CONFIG);
        let flicker = |now_s: f64| Observed { lost_keyframes: ((now_s * 2.0) as u64).is_multiple_of(2), ..WELL };
        assert_eq!(climb(&mut ladder, 0.0, 10.0, flicker), [(0.0, Rung::SingleFrame)]);
    }
}
