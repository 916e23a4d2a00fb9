//! The pure core: situation in, plan out.

use crate::Config;
use crate::admission::{Admission, Tally};
use crate::choice::{Course, STEP_MPS};
use crate::deliberation::{Asked, Deliberation, NEAR_GOAL_M};
use crate::draft::Draft;
use crate::emergency;
use crate::gaze::{Gaze, StepBack};
use crate::pricing::Flown;
use crate::rollout::{Rollout, Sample, Target};
use crate::situation::Situation;
use crate::stuck::{Stage, Stuck};
use ipc_types::limits::Fence;
use ipc_types::messages::{PlanMode, Task, TrajectoryPoint};
use ipc_types::{FlightTime, Point, Vector, World};
use memory::{Occupancy, View};
use std::f64::consts::PI;

/// The climb that a flight begins with.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TakeOff {
    /// On the ground.
    pub from: Point<World>,
    /// Farther from its axis the vehicle is not taking off, m.
    pub radius_m: f64,
    /// How high it leads, above `from`, m: the height to fly at.
    pub height_m: f64,
}

/// A plan, apart from its points ([`Planner::points`]).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Plan {
    /// Instant of the first point.
    pub start: FlightTime,
    /// What it does.
    pub mode: PlanMode,
    /// What became of the candidates.
    pub tally: Tally,
}

/// Plans trajectories. Keeps the plan being flown, so that flicker does not change it.
#[derive(Clone, Debug)]
pub struct Planner {
    config: Config,
    fence: Fence,
    take_off: TakeOff,
    pub(crate) airborne: bool,
    arrived: bool,
    /// Whether it sinks where it is to land.
    landing: bool,
    pub(crate) goal: Option<(Point<World>, Task)>,
    pub(crate) flying: Option<Flown>,
    pub(crate) stuck: Stuck,
    gaze: Gaze,
    deliberation: Deliberation,
    pub(crate) replans: u64,
    draft: Draft,
    spare: Rollout,
    /// When a predecessor's plan was made, until this one's first.
    pub(crate) inherited: Option<FlightTime>,
}

/// Distance to the goal at which it counts as reached, m. The rest is closed slowly, as far as it is free.
const ARRIVED_M: f64 = 0.7;
/// So near to where it is to land it sinks, m; farther off it first comes nearer.
const LAND_WITHIN_M: f64 = 0.4;
/// Speed of sinking, m/s.
const SINK_MPS: f64 = 0.5;
/// So far below itself a sinking vehicle aims, m: far enough not to slow down for it.
const SINK_AHEAD_M: f64 = 2.0;
/// Speed of closing the last bit of the way, m/s.
const SETTLE_MPS: f64 = 0.6;
/// Speed of backing out, m/s.
const BACK_OUT_MPS: f64 = 1.0;
/// So far ahead of itself it asks about the way back, s.
const BACKING_OUT_S: f64 = 2.0;
/// Longest time that backing out may take, s.
const BACK_OUT_S: f64 = 20.0;
/// Faster than this the way to stop is chosen, m/s; slower it hardly matters.
const BEST_STOP_MPS: f64 = 0.5;
/// Later than this a refusal ends it, s: before, the map may still change its mind.
const REFUSED_S: f64 = 3.0;

impl Planner {
    /// For a vehicle on the ground that is to fly at a cruise speed.
    pub fn new(config: Config, fence: Fence, take_off: TakeOff, cruise_mps: f64) -> Self {
        Self {
            fence,
            take_off,
            airborne: false,
            arrived: false,
            landing: false,
            goal: None,
            flying: None,
            stuck: Stuck::new(),
            gaze: Gaze::new(),
            deliberation: Deliberation::new(&config, fence, cruise_mps),
            replans: 0,
            inherited: None,
            draft: Draft::new(),
            spare: Rollout::new(),
            config,
        }
    }

    /// Makes a part of what is made once and has not been asked for yet, so that no plan has to wait for it; whether there was
    /// one.
    pub fn prepare(&self) -> bool {
        self.deliberation.prepare()
    }

    /// Candidates of the library.
    pub(crate) fn library_size(&self) -> usize {
        self.deliberation.library_size()
    }

    /// Plans chosen anew rather than continued, so far.
    pub fn replans(&self) -> u64 {
        self.replans
    }

    /// Views older than this are to be disregarded: they wall in a vehicle whose way back, by which it came, they forbid. What
    /// it has seen since is what it goes by, and where it has not looked nothing is known.
    pub fn disregards_before(&self) -> FlightTime {
        self.stuck.disregards_before
    }

    /// Prices all candidates by what the map showed at the last plan, and no more; returns how many. For measuring.
    pub fn price_candidates(&mut self, situation: &Situation, view: &View) -> usize {
        let (height_m, half_view_rad) = (self.top().z, view.half_view_rad());
        let from = Sample { position: situation.position, velocity: situation.velocity };
        let Self { config, deliberation, stuck, gaze, flying, .. } = self;
        let (start, flying) = (situation.now, *flying);
        deliberation.price(&Asked { config, situation, start, from, height_m, stuck, gaze, flying, half_view_rad })
    }

    /// The points of the last plan.
    pub fn points(&self) -> &[TrajectoryPoint] {
        &self.draft.points
    }

    /// The way to the goal that guides it, from the vehicle on; empty without one.
    pub fn way(&self) -> &[Point<World>] {
        self.deliberation.path()
    }

    /// Plans from a situation and a map.
    pub fn step(&mut self, situation: &Situation, view: &View) -> Plan {
        let start = situation.now + std::time::Duration::from_secs_f64(self.config.lead_s);
        self.lapse(situation.now);
        self.take_goal(situation);
        // Where the vehicle will be when the plan takes effect.
        let ahead_s = start.seconds_since(situation.state_valid).clamp(0.0, 0.5);
        let from = Sample { position: situation.position + situation.velocity * ahead_s, velocity: situation.velocity };
        let plan = |mode| Plan { start, mode, tally: Tally::default() };
        // Also when this process was restarted in mid-flight. From where it took off it may do so again.
        let is_take_off = self.is_take_off(situation.position);
        self.airborne = !is_take_off || (self.airborne && !situation.landed);
        if self.stuck.stage == Stage::GivenUp {
            self.brake(from, situation.yaw_rad);
            return plan(PlanMode::GivenUp);
        }
        if situation.is_stale(&self.config) {
            self.brake(from, situation.yaw_rad);
            return plan(PlanMode::Hold);
        }
        if situation.task == Task::Stay {
            // Told to stop, it stops as the map says is best; that it gets nowhere meanwhile is no fault of the place.
            self.stuck.stays(situation.now);
            self.stop(from, situation.yaw_rad, view);
            return plan(PlanMode::Hold);
        }
        if situation.task == Task::Land
            && let Some(mode) = self.land(situation, from)
        {
            return plan(mode);
        }
        if !self.airborne {
            let climb = Target::Place(self.top(), self.config.take_off_mps);
            self.draft.rollout.fill(from, climb, 3.0, &self.config);
            self.write_points(situation.yaw_rad, |_| situation.goal_heading_rad());
            return plan(PlanMode::TakeOff);
        }
        let to_goal_m = situation.position.distance(situation.goal);
        self.arrived = to_goal_m < if self.arrived { NEAR_GOAL_M } else { ARRIVED_M };
        if let Stage::BackingOut { since } = self.stuck.stage {
            return Plan { mode: self.back_out(situation, from, since, view), ..plan(PlanMode::BackOut) };
        }
        if self.arrived {
            let is_slow = situation.velocity.norm() < BEST_STOP_MPS;
            self.landing = situation.task == Task::Land && is_slow && aside_m(situation) < LAND_WITHIN_M;
            self.settle(situation, from, view);
            return plan(PlanMode::Arrived);
        }
        let path = self.way_flown(view);
        self.stuck.note_progress(situation.now, situation.position, to_goal_m, path, &self.config);
        self.stuck.note_dwelling(situation.now, situation.position, situation.velocity.norm());
        if matches!(self.stuck.stage, Stage::BackingOut { .. }) {
            self.gaze.reset();
            self.brake(from, situation.yaw_rad);
            return plan(PlanMode::Hold);
        }
        if let Some(step) = self.gaze.stepping(situation.now, situation.position) {
            self.stuck.looking(situation.now);
            if self.step_back(step, from, situation, view) {
                return plan(PlanMode::BackOut);
            }
        }
        if let Some(target_rad) = self.gaze.turning(situation.now, situation.yaw_rad) {
            self.stuck.looking(situation.now);
            self.turn(from, situation.yaw_rad, target_rad);
            return plan(PlanMode::LookAround);
        }
        self.go(start, from, situation, view)
    }

    /// Goes on towards the goal, or looks where it wants to go, or has no plan.
    fn go(&mut self, start: FlightTime, from: Sample, situation: &Situation, view: &View) -> Plan {
        let plan = |mode, tally| Plan { start, mode, tally };
        let (tally, course) = self.choose(start, from, situation, view);
        match course {
            Course::None => {
                let mode = self.no_plan(from, situation, view);
                return plan(mode, tally);
            }
            Course::Look(heading_rad) => {
                self.stuck.moving();
                self.gaze.look(heading_rad, situation.now, situation.position);
                self.turn(from, situation.yaw_rad, heading_rad);
                return plan(PlanMode::LookAround, tally);
            }
            Course::StepBack(step) => {
                self.stuck.moving();
                self.gaze.step_back(step, situation.now, situation.position);
                let mode = if self.step_back(step, from, situation, view) { PlanMode::BackOut } else { PlanMode::Hold };
                return plan(mode, tally);
            }
            Course::Go(_) => self.stuck.moving(),
        }
        let follows = self.config.gaze_follows_flight;
        let heading =
            |velocity| if follows { travel_heading(velocity, situation) } else { situation.goal_heading_rad() };
        self.write_points(situation.yaw_rad, heading);
        plan(PlanMode::Cruise, tally)
    }

    /// A new goal, or another thing to do there, forgives everything; so does a pilot, who decides for himself.
    fn take_goal(&mut self, situation: &Situation) {
        let is_new = self.goal.is_none_or(|(goal, _)| goal.distance(situation.goal) > 0.05);
        if is_new {
            self.deliberation.reset();
            self.arrived = false;
        }
        // To stay for a while is nothing else to do there.
        let task = match self.goal {
            Some((_, before)) if situation.task == Task::Stay => before,
            _ => situation.task,
        };
        // Nor is to go on after it.
        let is_other = self.goal.is_none_or(|(_, before)| before != task && before != Task::Stay);
        if is_new || situation.piloted || is_other {
            self.stuck.reset();
            self.gaze.reset();
            // The library's candidates are named relative to the goal, and the vehicle is not where they would have led.
            self.flying = None;
            self.landing = false;
        }
        self.goal = Some((situation.goal, task));
    }

    /// On the ground where it is to land it stays there; a landing that has begun goes on, straight down above the goal, within
    /// the column that whoever commands a landing declares free.
    fn land(&mut self, situation: &Situation, from: Sample) -> Option<PlanMode> {
        let aside_m = aside_m(situation);
        if situation.landed && aside_m < self.take_off.radius_m {
            self.brake(from, situation.yaw_rad);
            return Some(PlanMode::Landed);
        }
        self.landing &= aside_m < self.take_off.radius_m;
        if !self.landing {
            return None;
        }
        let sink_m = if aside_m < LAND_WITHIN_M { SINK_AHEAD_M } else { 0.0 };
        let aim = Point::new(situation.goal.x, situation.goal.y, situation.position.z - sink_m);
        self.flying = None;
        self.draft.rollout.fill(from, Target::Place(aim, SINK_MPS), 1.0, &self.config);
        self.write_points(situation.yaw_rad, |_| situation.yaw_rad);
        Some(PlanMode::Land)
    }

    /// Where take-off ends.
    fn top(&self) -> Point<World> {
        self.take_off.from + Vector::new(0.0, 0.0, self.take_off.height_m)
    }

    /// Whether a place belongs to the climb of the take-off.
    fn is_take_off(&self, place: Point<World>) -> bool {
        let away_m = (place - self.take_off.from).horizontal_norm();
        place.z < self.top().z - 0.3 && away_m <= self.take_off.radius_m
    }

    /// The path flown since take-off, oldest first: what may be flown back.
    fn way_flown<'a>(&self, view: &'a View) -> &'a [Point<World>] {
        let path = view.free_space().path();
        let climb = path.iter().rposition(|&place| self.is_take_off(place));
        &path[climb.map_or(0, |last| last + 1)..]
    }

    /// Leaves the cheapest admissible candidate in the draft; returns what became of all, and which it is.
    ///
    /// A slow vehicle does not set out where its camera does not look: such a candidate is a wish to look there.
    fn choose(&mut self, start: FlightTime, from: Sample, situation: &Situation, view: &View) -> (Tally, Course) {
        let (height_m, half_view_rad) = (self.top().z, view.half_view_rad());
        let Self { config, fence, deliberation, draft, stuck, gaze, flying, .. } = self;
        let asked = Asked { config, situation, start, from, height_m, stuck, gaze, flying: *flying, half_view_rad };
        let (admission, mut tally) = (Admission::new(view, fence, config), Tally::default());
        deliberation.look(&asked, view, fence);
        let course = deliberation.choose(&asked, &admission, &mut draft.rollout, &mut tally);
        let flies = if let Course::Go(flown) = course { Some(flown) } else { None };
        if flies.is_some() && flies != self.flying {
            self.replans += 1;
        }
        self.flying = flies;
        (tally, course)
    }

    /// Nothing is admissible: brake, and let [`Stuck`] say what else.
    fn no_plan(&mut self, from: Sample, situation: &Situation, view: &View) -> PlanMode {
        let path = self.way_flown(view);
        self.stuck.no_plan(situation.now, situation.position, path, &self.config);
        match self.stuck.stage {
            Stage::LookingAround { .. } => {
                // Half a turn ahead of the heading, for ever: a whole turn.
                self.turn(from, situation.yaw_rad, situation.yaw_rad + 0.99 * PI);
                PlanMode::LookAround
            }
            Stage::GivenUp => {
                self.brake(from, situation.yaw_rad);
                PlanMode::GivenUp
            }
            _ => {
                self.stop(from, situation.yaw_rad, view);
                PlanMode::Hold
            }
        }
    }

    /// The stop that the map says is best; at rest, holding the place.
    fn stop(&mut self, from: Sample, yaw_rad: f64, view: &View) {
        if from.velocity.norm() < BEST_STOP_MPS {
            return self.brake(from, yaw_rad);
        }
        self.flying = None;
        let admission = Admission::new(view, &self.fence, &self.config);
        emergency::stop(from, &admission, &self.config, &mut self.spare, &mut self.draft.rollout);
        self.write_points(yaw_rad, |_| yaw_rad);
    }

    /// Flies back along the path flown, whose swept volume is free unless an image says otherwise.
    fn back_out(&mut self, situation: &Situation, from: Sample, since: FlightTime, view: &View) -> PlanMode {
        let late = situation.now.seconds_since(since) > BACK_OUT_S;
        let is_open = |place| view.occupancy(place, self.config.gamma_high) != Occupancy::Occupied;
        let next = self.stuck.way_back(situation.position, is_open).filter(|_| !late);
        let Some(next) = next else {
            self.stuck.backed_out(situation.now);
            self.brake(from, situation.yaw_rad);
            return PlanMode::Hold;
        };
        if situation.velocity.norm() > 1.5 * BACK_OUT_MPS {
            self.brake(from, situation.yaw_rad);
            return PlanMode::Hold;
        }
        self.flying = None;
        self.draft.rollout.fill(from, Target::Place(next, BACK_OUT_MPS), BACKING_OUT_S, &self.config);
        let admission = Admission::of_retreat(view, &self.fence, &self.config);
        if admission.admit(&self.draft.rollout, self.config.gamma_high).is_err() {
            if situation.now.seconds_since(since) > REFUSED_S {
                self.stuck.walled_in(since, &self.config);
                self.stuck.backed_out(situation.now);
            }
            self.brake(from, situation.yaw_rad);
            return PlanMode::Hold;
        }
        self.write_points(situation.yaw_rad, |_| situation.yaw_rad);
        PlanMode::BackOut
    }

    /// Steps back, looking where it wants to go; brakes and says no where that is not known free any more.
    fn step_back(&mut self, step: StepBack, from: Sample, situation: &Situation, view: &View) -> bool {
        self.flying = None;
        self.draft.rollout.fill(from, Target::Place(step.to, STEP_MPS), 1.5, &self.config);
        let admission = Admission::new(view, &self.fence, &self.config);
        let is_free = admission.admit(&self.draft.rollout, self.config.gamma_high).is_ok();
        if is_free {
            self.write_points(situation.yaw_rad, |_| step.heading_rad);
        } else {
            self.gaze.stay();
            self.turn(from, situation.yaw_rad, step.heading_rad);
        }
        is_free
    }

    /// At the goal: closes what is left of the way if all of it is known free, else looks there.
    fn settle(&mut self, situation: &Situation, from: Sample, view: &View) {
        let admission = Admission::new(view, &self.fence, &self.config);
        self.draft.rollout.fill(from, Target::Place(situation.goal, SETTLE_MPS), self.config.horizon_s, &self.config);
        let found = admission.admit(&self.draft.rollout, self.config.gamma_high);
        // So slowly the swept volume alone would admit it, plan by plan, into what was not seen.
        if found.is_err() || !admission.knows(&self.draft.rollout, self.config.gamma_high, f64::INFINITY) {
            return self.turn(from, situation.yaw_rad, situation.goal_heading_rad());
        }
        self.flying = None;
        self.write_points(situation.yaw_rad, |_| situation.yaw_rad);
    }

    /// A straight stop along the velocity, or holding the place at rest: always allowed.
    fn brake(&mut self, from: Sample, yaw_rad: f64) {
        self.flying = None;
        self.draft.stop(from, yaw_rad, &self.config);
    }

    /// Brakes, and turns towards a heading.
    fn turn(&mut self, from: Sample, yaw_rad: f64, target_rad: f64) {
        self.flying = None;
        self.draft.turn(from, yaw_rad, target_rad, &self.config);
    }

    fn write_points(&mut self, yaw_rad: f64, heading: impl Fn(Vector<World>) -> f64) {
        self.draft.write(yaw_rad, &self.config, heading);
    }
}

/// How far the vehicle is from above its goal, m.
fn aside_m(situation: &Situation) -> f64 {
    (situation.goal - situation.position).horizontal_norm()
}

/// The direction of travel, or of the goal while hardly moving.
fn travel_heading(velocity: Vector<World>, situation: &Situation) -> f64 {
    if velocity.horizontal_norm() > 0.3 { velocity.y.atan2(velocity.x) } else { situation.goal_heading_rad() }
}
