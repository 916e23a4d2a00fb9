//! After warm-up the cores that every image passes allocate nothing.

use expansion::Expander;
use ipc_types::disparity::{decode, encode};
use ipc_types::messages::Task;
use ipc_types::{Body, FlightTime, Point, Pose, Vector, World};
use memory::{FreeSpace, View};
use planner::{Planner, Situation, TakeOff};
use sparrowhawk::config::FlightConfig;
use stats_alloc::{INSTRUMENTED_SYSTEM, Region, StatsAlloc};
use std::alloc::System;
use std::sync::Mutex;
use stereo_ingest::{Matcher, PairCheck};

#[global_allocator]
static ALLOCATOR: &StatsAlloc<System> = &INSTRUMENTED_SYSTEM;

/// The allocator's counts belong to the whole program: one test at a time.
static ALONE: Mutex<()> = Mutex::new(());

/// The most that any of five steps allocates, but for one: the test harness, which has threads of its own, may do so
/// meanwhile when a test ends.
fn allocated(mut step: impl FnMut()) -> stats_alloc::Stats {
    let mut changes = [(); 5].map(|()| {
        let region = Region::new(ALLOCATOR);
        step();
        region.change()
    });
    changes.sort_by_key(|change| change.allocations + change.reallocations);
    changes[3]
}

#[test]
fn planning_allocates_nothing_but_the_queue_of_jobs_of_several_threads() {
    let _alone = ALONE.lock();
    // Above the height to keep the grids of all levels are asked.
    for (threads, height_m) in [(1, 2.0), (3, 2.0), (1, 2.6)] {
        let change = planning(threads, height_m);
        // A plan hands four jobs to the threads at most; rayon's queue takes a block of memory for every 31.
        let most = usize::from(threads > 1);
        assert!(change.allocations <= most && change.reallocations == 0, "{threads} threads: {change:?}");
    }
}

/// What a plan allocates at a height; the one to keep is 2 m.
fn planning(threads: u32, height_m: f64) -> stats_alloc::Stats {
    let config = FlightConfig::load(None, None).expect("loads");
    let vehicle = &config.vehicle;
    let rig = vehicle.rig;
    let mut view = View::new(
        sparrowhawk::graph::map_model(vehicle),
        FreeSpace::new(vehicle.memory.free_space.with_home(0.0, 0.0), Point::ZERO),
    );
    // A wall far ahead, seen from the way to where the vehicle is.
    let value = |depth_m: f64| encode(rig.disparity_px(depth_m) as f32);
    let layout = vehicle.expansion.layout(&rig);
    let cells = [value(0.5), value(25.0), value(30.0), 0].repeat(layout.cells());
    assert_eq!(cells.len(), layout.elements(), "two layers");
    for metre in 0..vehicle.memory.graph.keyframes {
        let body =
            Pose { translation: Vector::new(f64::from(metre as u32), 0.0, height_m), ..Pose::<World, Body>::IDENTITY };
        let exposure = FlightTime::from_nanos(80_000_000 * i64::from(metre as u32));
        assert!(view.push(body * vehicle.mount.body_from_camera(), exposure, cells.clone().into()));
    }
    let take_off = TakeOff { from: Point::ZERO, radius_m: 1.0, height_m: 2.0 };
    let cruise_mps = config.mission.cruise_speed_mps;
    let settings = planner::Config { threads, ..vehicle.planner.clone() };
    let mut planner = Planner::new(settings, config.mission.fence, take_off, cruise_mps);
    let mut step = |tick: i64| {
        let now = FlightTime::from_nanos(80_000_000 * tick);
        let position = Point::new(6.0 + 0.2 * tick as f64, 0.0, height_m);
        let velocity = Vector::new(2.5, 0.0, 0.0);
        let (goal, yaw_rad, cruise_mps) = (config.mission.goal(), 0.0, config.mission.cruise_speed_mps);
        let task = Task::Hover;
        let situation = Situation {
            now,
            state_valid: now,
            position,
            velocity,
            yaw_rad,
            goal,
            cruise_mps,
            task,
            piloted: false,
            landed: false,
            image_valid: now,
        };
        planner.step(&situation, &view)
    };
    let mut ticks = 0..;
    let mut plan = ticks.by_ref().take(3).map(&mut step).last().expect("three plans");
    let change = allocated(|| plan = step(ticks.next().expect("endless")));
    assert!(plan.tally.candidates > 100 && plan.tally.admissible > 0, "it does its work: {plan:?}");
    change
}

#[test]
fn matching_and_expanding_allocate_nothing() {
    let _alone = ALONE.lock();
    let vehicle = FlightConfig::load(None, None).expect("loads").vehicle;
    let rig = vehicle.rig;
    let (width, pixels) = (rig.width_px as usize, rig.pixels());
    let texture = |index: usize| (index.wrapping_mul(2_654_435_761) >> 7) as u8;
    let left: Vec<u8> = (0..pixels).map(texture).collect();
    let right: Vec<u8> =
        (0..pixels).map(|index| texture((index + 12).min(index / width * width + width - 1))).collect();
    let mut matcher = Matcher::new(&rig, vehicle.stereo);
    let mut expander = Expander::new(rig, &vehicle.noise, sparrowhawk::graph::reach(&vehicle), vehicle.expansion);
    let (mut disparity, mut elements) = (vec![0; pixels], vec![0; expander.layout().elements()]);
    let mut step = || {
        matcher.step(&left, &right, &mut disparity).expect("sizes agree");
        expander.step(&disparity, &mut elements).expect("sizes agree");
    };
    step();
    let change = allocated(&mut step);
    assert_eq!((change.allocations, change.reallocations), (0, 0), "{change:?}");
    let found = disparity.iter().filter_map(|&pixel| decode(pixel)).filter(|d| (d - 12.0).abs() < 0.5).count();
    assert!(found > pixels / 2, "it does its work: {found} of {pixels} pixels matched");
}

#[test]
fn matching_on_several_threads_allocates_no_more_than_the_queue_of_jobs() {
    const FRAMES: usize = 200;
    let _alone = ALONE.lock();
    let vehicle = FlightConfig::load(None, None).expect("loads").vehicle;
    let image: Vec<u8> = (0..vehicle.rig.pixels()).map(|i| (i.wrapping_mul(2_654_435_761) >> 7) as u8).collect();
    for threads in [1, 2, 3] {
        let mut matcher = Matcher::new(&vehicle.rig, stereo_ingest::Config { threads, ..vehicle.stereo });
        let mut check = PairCheck::new(&vehicle.rig, vehicle.stereo.max_disparity_px);
        let mut disparity = vec![0; image.len()];
        let mut step = || {
            let _ = check.step(&image, &image);
            matcher.step(&image, &image, &mut disparity).expect("sizes agree");
        };
        step();
        let change = allocated(|| (0..FRAMES).for_each(|_| step()));
        // A frame hands two jobs to the threads; rayon's queue takes a block of memory for every 31.
        let most = if threads == 1 { 0 } else { 2 * FRAMES / 31 + 1 };
        assert!(change.allocations <= most && change.reallocations == 0, "{threads} threads: {change:?}");
        assert!(change.bytes_allocated <= 2048 * most, "{threads} threads: {change:?}");
    }
}
