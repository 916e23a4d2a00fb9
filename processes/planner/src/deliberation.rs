//! All that a choice rests on, kept from one plan to the next: the library, the grid and the guide.

use crate::Config;
use crate::admission::{Admission, Tally};
use crate::choice::Course;
use crate::field::{Ask, Field};
use crate::gaze::Gaze;
use crate::guide::Guide;
use crate::library::{Aim, Library};
use crate::pricing::{Flown, Prices, Pricing};
use crate::rollout::{Rollout, STEP_S, Sample};
use crate::route::Timing;
use crate::situation::Situation;
use crate::stuck::Stuck;
use ipc_types::limits::Fence;
use ipc_types::{FlightTime, Point, Vector, World};
use memory::View;

/// Faster than this, turns are relative to where the vehicle flies, m/s, else to where the way to the goal leads.
const UNDER_WAY_MPS: f64 = 1.0;
/// So much of the grid's way is flown along, m: more than any candidate does.
const WAY_M: f64 = 40.0;
/// Nearer to the goal than this its height is the one to keep, m.
const DESCENT_M: f64 = 5.0;
/// Nearer than this, m, the goal is closed in on.
pub(crate) const NEAR_GOAL_M: f64 = 1.0;
/// Share of what the slowest manoeuvre commits to that every plan must: above that to which the swept volume is limited.
const LEAST_SHARE: f64 = 0.95;

/// What is asked at a plan.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Asked<'a> {
    pub(crate) config: &'a Config,
    pub(crate) situation: &'a Situation,
    /// When the plan takes effect, and where the vehicle is then.
    pub(crate) start: FlightTime,
    pub(crate) from: Sample,
    /// Height to keep on the way, m.
    pub(crate) height_m: f64,
    pub(crate) stuck: &'a Stuck,
    pub(crate) gaze: &'a Gaze,
    pub(crate) flying: Option<Flown>,
    pub(crate) half_view_rad: f64,
}

/// See the module's documentation.
#[derive(Clone, Debug)]
pub(crate) struct Deliberation {
    library: Library,
    field: Field,
    guide: Guide,
    /// The grid's way, and its timing.
    way: Vec<Point<World>>,
    timing: Timing,
    pricing: Pricing,
}

impl Deliberation {
    pub(crate) fn new(config: &Config, fence: Fence, cruise_mps: f64) -> Self {
        let library = Library::new(config, cruise_mps);
        Self {
            field: Field::new(config.field_reach_m, config.field_rise_m),
            guide: Guide::new(config, fence),
            way: Vec::with_capacity(256),
            timing: Timing::default(),
            pricing: Pricing::new(library.size(), config.threads as usize),
            library,
        }
    }

    /// Makes a part of the library that has not been asked for yet; whether there was one.
    pub(crate) fn prepare(&self) -> bool {
        self.library.prepare()
    }

    /// Candidates of the library.
    pub(crate) fn library_size(&self) -> usize {
        self.library.size()
    }

    /// The goal has changed.
    pub(crate) fn reset(&mut self) {
        self.guide.reset();
    }

    /// The path to the goal, from the vehicle on; empty without one.
    pub(crate) fn path(&self) -> &[Point<World>] {
        self.guide.path()
    }

    /// Brings grid, guide and ways up to date with the map.
    pub(crate) fn look(&mut self, asked: &Asked<'_>, view: &View, fence: &Fence) {
        let Asked { config, situation, from, .. } = *asked;
        let (goal, cruise_mps) = (situation.goal, situation.cruise_mps);
        let (unknown_price, clearance_price) = (config.unknown_price as f32, config.clearance_price as f32);
        let height_price = if is_near_goal(asked) { 0.0 } else { config.height_price };
        let height_m = keeps_m(asked);
        let ask = Ask { height_m, threshold: config.gamma_low, unknown_price, clearance_price, height_price };
        self.field.update(view, fence, from.position, goal, ask);
        self.guide.update(view, from.position, goal, config);
        let (limits, speed_mps) = (config.limits(cruise_mps), from.velocity.norm().min(cruise_mps));
        self.guide.time(speed_mps, &limits);
        self.field.way(from.position, WAY_M, &mut self.way);
        self.timing.time(&self.way, WAY_M, speed_mps, &limits, STEP_S);
    }

    /// Leaves the cheapest admissible candidate in `best`. The map was looked at.
    pub(crate) fn choose(
        &mut self,
        asked: &Asked<'_>,
        admission: &Admission<'_>,
        best: &mut Rollout,
        tally: &mut Tally,
    ) -> Course {
        self.with(asked, |prices, pricing| prices.choose(admission, pricing, best, tally))
    }

    /// Prices all candidates, and no more; returns how many. The map was looked at.
    pub(crate) fn price(&mut self, asked: &Asked<'_>) -> usize {
        self.with(asked, |prices, pricing| {
            prices.price_all(pricing);
            pricing.priced.len()
        })
    }

    fn with<T>(&mut self, asked: &Asked<'_>, act: impl FnOnce(&Prices<'_>, &mut Pricing) -> T) -> T {
        let Asked { config, situation, start, from, stuck, gaze, flying, half_view_rad, .. } = *asked;
        let Self { library, field, guide, timing, pricing, .. } = self;
        let ways = [guide.timed(), timing.timed()];
        let (goal, speed_mps, near_goal) = (situation.goal, situation.cruise_mps, is_near_goal(asked));
        let height_m = if near_goal { keeps_m(asked) } else { field.height_m(from.position) };
        let heading = |direction: Vector<World>| direction.y.atan2(direction.x);
        let heading_rad = if from.velocity.horizontal_norm() > UNDER_WAY_MPS {
            heading(from.velocity)
        } else {
            field.downhill(from.position).map_or(situation.goal_heading_rad(), heading)
        };
        let prices = Prices {
            config,
            library,
            aim: Aim { from, goal, speed_mps, height_m, heading_rad, ways },
            situation,
            start,
            field,
            guide,
            stuck,
            gaze,
            flying,
            near_goal,
            least_m: LEAST_SHARE * config.least_commitment_m(speed_mps),
            half_view_rad,
        };
        act(&prices, pricing)
    }
}

fn is_near_goal(asked: &Asked<'_>) -> bool {
    asked.from.position.distance(asked.situation.goal) < NEAR_GOAL_M
}

/// Height to keep, m: that of the way, at last the goal's.
fn keeps_m(asked: &Asked<'_>) -> f64 {
    let goal = asked.situation.goal;
    if asked.from.position.distance(goal) < DESCENT_M { goal.z } else { asked.height_m }
}
