//! The planner process: keyframes, flown path, state and goal in, trajectory out.

use crate::{Config, Planner, Situation, TakeOff};
use ipc_types::estates::{EstatePlace, PlannerEstate};
use ipc_types::limits::Fence;
use ipc_types::messages::{Goal, Keyframe, PlanMode, Task, TrajectoryPoint, VehicleState};
use ipc_types::topics::{Goals, Keyframes, Path, Plan, State};
use ipc_types::{FlightTime, Point, ProcessId, World};
use memory::{FreeSpace, FreeSpaceRule, MapModel, View};
use runtime::estate::{inherit, leave};
use runtime::images::StoredImage;
use runtime::{Connect, Message, Ports, Process, Report};

/// Connects a [`Planner`] to its topics.
#[derive(Debug)]
pub struct PlannerProcess {
    planner: Planner,
    view: View,
    lead_s: f64,
    goal: Option<Goal>,
    state: Option<VehicleState>,
    /// Images of the current keyframes, mapped where they lie.
    images: Vec<(u64, StoredImage)>,
    /// Whether the keyframes are looked at. Flying blind shows what avoidance is worth.
    avoidance: bool,
    started: bool,
    /// What is left to a successor, and its bytes.
    places: Vec<EstatePlace>,
    estate: Vec<u16>,
    report: Report,
}

impl PlannerProcess {
    /// For a vehicle on the ground that is to fly at a cruise speed.
    pub fn new(
        model: MapModel,
        rule: FreeSpaceRule,
        config: Config,
        fence: Fence,
        take_off: TakeOff,
        cruise_mps: f64,
    ) -> Self {
        Self {
            view: View::new(model, FreeSpace::new(rule, take_off.from)),
            lead_s: config.lead_s,
            planner: Planner::new(config, fence, take_off, cruise_mps),
            goal: None,
            state: None,
            images: Vec::new(),
            avoidance: true,
            started: false,
            places: Vec::new(),
            estate: Vec::new(),
            report: Report::waiting("waiting for a map"),
        }
    }

    /// Flies without looking: everything counts as free. For comparisons in the simulator alone.
    pub fn without_avoidance(mut self) -> Self {
        let rule = self.view.free_space().rule();
        let everywhere = FreeSpaceRule { home_radius_m: f64::INFINITY, home_height_m: f64::INFINITY, ..*rule };
        let home = self.view.free_space().home();
        *self.view.free_space_mut() = FreeSpace::new(everywhere, home);
        self.avoidance = false;
        self
    }

    /// Makes beforehand what else is made when it is first needed: for comparing how long plans take.
    pub fn prepared(self) -> Self {
        while self.planner.prepare() {}
        self
    }

    /// The map as of the last plan.
    pub fn view(&self) -> &View {
        &self.view
    }

    /// The plan that was published last.
    pub fn points(&self) -> &[TrajectoryPoint] {
        self.planner.points()
    }

    /// The way to the goal that guides it; empty without one.
    pub fn way(&self) -> &[Point<World>] {
        self.planner.way()
    }

    /// Brings the view up to date with a keyframe set. Returns whether it is complete: a missing keyframe may be the one
    /// that sees an obstacle, and a map without any is none.
    fn look(&mut self, ports: &mut impl Ports, keyframes: &[Keyframe]) -> bool {
        let mut is_complete = !keyframes.is_empty();
        self.images.retain(|(id, _)| keyframes.iter().any(|keyframe| keyframe.image_id == *id));
        self.view.clear();
        let disregarded = self.planner.disregards_before().as_nanos();
        for keyframe in keyframes.iter().filter(|keyframe| keyframe.exposure_ns >= disregarded) {
            let held = self.images.iter().find(|(id, _)| *id == keyframe.image_id).map(|(_, image)| image.clone());
            let image = held.or_else(|| {
                let image = ports.images().get(keyframe.image_id)?;
                self.images.push((keyframe.image_id, image.clone()));
                Some(image)
            });
            let exposure = FlightTime::from_nanos(keyframe.exposure_ns);
            let usable = image
                .zip(keyframe.world_from_camera())
                .is_some_and(|(image, pose)| self.view.push(pose, exposure, image));
            is_complete &= usable;
        }
        if let Some(path) = ports.latest::<Path>() {
            let places = path.elements().iter().map(|point| Point::from_array(point.position_m));
            self.view.set_path(places.filter(|place| place.is_finite()));
        }
        is_complete
    }

    /// Leaves to a successor what it needs. Where that cannot be stored, a successor begins anew.
    fn leave(&mut self, ports: &mut impl Ports, situation: &Situation) {
        let Some(goal) = self.goal else { return };
        let estate = self.planner.estate(goal, situation.now, &mut self.places);
        let _ = leave(ports.images(), Self::ID, &estate, &self.places[..], &mut self.estate);
    }

    fn situation(&self, now: FlightTime, image_valid: FlightTime) -> Option<Situation> {
        let (state, goal) = (self.state.as_ref()?, self.goal.as_ref()?);
        let pose = state.world_from_body()?;
        Some(Situation {
            now,
            state_valid: FlightTime::from_nanos(state.stamp.valid_ns),
            position: state.position(),
            velocity: state.velocity(),
            yaw_rad: pose.rotation.roll_pitch_yaw().2,
            goal: Point::from_array(goal.position_m),
            cruise_mps: goal.cruise_speed_mps,
            task: Task::from_wire(goal.task),
            piloted: state.piloted != 0,
            landed: state.landed != 0,
            image_valid,
        })
    }
}

fn is_sane(goal: &Goal) -> bool {
    Point::<World>::from_array(goal.position_m).is_finite()
        && (f64::MIN_POSITIVE..=f64::MAX).contains(&goal.cruise_speed_mps)
}

impl Process for PlannerProcess {
    const ID: ProcessId = ProcessId::Planner;

    fn connect(&self, connect: &mut impl Connect) {
        connect.reads::<State>();
        connect.reads::<Goals>();
        connect.reads::<Keyframes>();
        connect.reads::<Path>();
        connect.writes::<Plan>();
    }

    fn step<P: Ports>(&mut self, ports: &mut P) -> Report {
        if !std::mem::replace(&mut self.started, true)
            && let Some((estate, places)) = inherit::<PlannerEstate, EstatePlace>(ports.images(), Self::ID)
        {
            self.goal = Some(estate.goal).filter(is_sane);
            self.planner.inherit(&estate, &places);
        }
        if let Some(state) = ports.latest::<State>() {
            self.state = Some(*state.header());
        }
        if let Some(goal) = ports.latest::<Goals>() {
            let goal = *goal.header();
            if is_sane(&goal) {
                self.goal = Some(goal);
            } else {
                self.report.refuse("goal is not finite, or its speed is not positive");
            }
        }
        let Some(set) = ports.latest::<Keyframes>() else {
            return self.report.idle();
        };
        if self.avoidance && !self.look(ports, set.elements()) {
            // The plan being flown ends at rest, and without a next one the controller brakes in time.
            return self.report.refuse("the map is empty, or a keyframe is missing or damaged");
        }
        let Some(situation) = self.situation(ports.now(), FlightTime::from_nanos(set.header().stamp.valid_ns)) else {
            return self.report.degraded(if self.goal.is_none() {
                "waiting for a goal"
            } else {
                "waiting for a state"
            });
        };
        let plan = self.planner.step(&situation, &self.view);
        let holds = plan.mode == PlanMode::Hold;
        let (planner, lead_s) = (&self.planner, self.lead_s);
        ports.publish::<Plan>(plan.start, planner.points().len(), |out, points| {
            out.image_valid_ns = set.header().stamp.valid_ns;
            out.replans = planner.replans();
            out.mode = plan.mode as u32;
            (out.candidates, out.admissible) = (plan.tally.candidates, plan.tally.admissible);
            (out.occupied, out.unknown, out.outside) = (plan.tally.occupied, plan.tally.unknown, plan.tally.outside);
            out.lead_s = lead_s;
            points.copy_from_slice(planner.points());
        });
        self.leave(ports, &situation);
        match holds {
            true => self.report.degraded("holding: nothing is admissible, or state or map is stale"),
            false => self.report.worked(),
        }
    }

    fn housekeep(&mut self) {
        self.planner.prepare();
    }
}
