//! What the tests of several modules share: a configuration, a map, a situation.

use crate::route::SearchConfig;
use crate::{Config, LibraryConfig, RouteConfig, Situation, TakeOff};
use ipc_types::limits::Fence;
use ipc_types::messages::{ExpandedLayout, Layers, Task};
use ipc_types::noise::NoiseModel;
use ipc_types::{Body, FlightTime, Point, Pose, Rotation, StereoRig, Vector, World};
use memory::{FreeSpace, FreeSpaceRule, Inference, MapModel, View};

pub(crate) fn config() -> Config {
    Config {
        gamma_low: 0.9,
        gamma_high: 1.8,
        library: LibraryConfig { size: 120, turn_deg: 170.0, climb_deg: 15.0, slowest_share: 0.3 },
        horizon_s: 1.8,
        commit_s: 0.5,
        lead_s: 0.06,
        state_deadline_s: 0.2,
        image_deadline_s: 0.5,
        sample_m: 0.15,
        acceleration_mps2: 3.5,
        lateral_mps2: 3.5,
        braking_mps2: 3.5,
        jerk_mps3: 30.0,
        hard_braking_mps2: 5.0,
        escape_m: 0.3,
        least_view_up_deg: 10.0,
        take_off_mps: 1.2,
        yaw_rate_degps: 90.0,
        gaze_follows_flight: true,
        unknown_price: 0.3,
        clearance_price: 1.0,
        turning_price: 1.0,
        height_price: 0.5,
        hysteresis_m: 0.6,
        look_price_m: 0.5,
        step_back_price_m: 2.0,
        blind_m: 0.9,
        patience_s: 1.0,
        back_out_m: 3.0,
        attempts: 4,
        field_reach_m: 10.0,
        field_rise_m: 1.0,
        threads: 1,
        route: RouteConfig { segments: 500, search: SearchConfig { batch: 60, places: 600, neighbours: 24 } },
    }
}

pub(crate) const FENCE: Fence = Fence { least_m: [-20.0, -50.0, 0.5], most_m: [100.0, 50.0, 6.0] };

pub(crate) const TAKE_OFF: TakeOff = TakeOff { from: Point::ZERO, radius_m: 1.0, height_m: 2.0 };

pub(crate) const RIG: StereoRig =
    StereoRig { width_px: 32, height_px: 24, focal_px: 20.0, cx_px: 15.5, cy_px: 11.5, baseline_m: 0.3, doffs_px: 0.0 };

/// A map that knows nothing beyond a home cylinder of the given radius.
pub(crate) fn home_only(radius_m: f64) -> View {
    let rule =
        FreeSpaceRule { home_radius_m: radius_m, home_height_m: 10.0, swept_radius_m: 0.5, background_parallax_m: 0.5 };
    let noise =
        NoiseModel { sigma_px: 0.5, sigma_m: 0.0, lambda_near: 3.0, lambda_far: 1.0, near_px: 10.0, far_px: 4.0 };
    let layout = ExpandedLayout::new(&RIG, 0, Layers::Two);
    let inference = Inference::Confidence;
    let model = MapModel { rig: RIG, noise, layout, radius_m: 0.5, inference, forget_s: 1.0 };
    View::new(model, FreeSpace::new(rule, Point::ZERO))
}

/// All is free, but for what one image sees from 2 m above the origin, towards the east: by column and row, where something
/// begins and ends, m.
pub(crate) fn before(depths_m: impl Fn(usize, usize) -> [f64; 2]) -> View {
    let mut view = home_only(200.0);
    let value = |depth_m: f64| (RIG.disparity_px(depth_m) * 64.0) as u16;
    let width = RIG.width_px as usize;
    let cells = (0..RIG.pixels()).flat_map(|pixel| {
        let [front_m, back_m] = depths_m(pixel % width, pixel / width);
        [value(0.3), value(front_m), value(back_m), 0]
    });
    let rotation = Rotation::<World, Body>::IDENTITY * Rotation::camera_mount(0.0);
    let pose = Pose { rotation, translation: Vector::new(0.0, 0.0, 2.0) };
    assert!(view.push(pose, FlightTime::from_nanos(0), cells.collect::<Vec<u16>>().into()));
    view
}

/// All is free, but for a wall across the x axis whose margin begins at 4 m, as two images see it.
pub(crate) fn before_a_wall() -> View {
    let mut view = home_only(200.0);
    let value = |depth_m: f64| (RIG.disparity_px(depth_m) * 64.0) as u16;
    let cells = [value(0.3), value(4.0), value(6.0), 0].repeat(RIG.pixels());
    let rotation = Rotation::<World, Body>::IDENTITY * Rotation::camera_mount(0.0);
    let pose = Pose { rotation, translation: Vector::new(0.0, 0.0, 2.0) };
    for seconds in [0.0, 0.1] {
        assert!(view.push(pose, FlightTime::from_secs_f64(seconds), cells.clone().into()));
    }
    view
}

pub(crate) fn situation(now: f64, position: Point<World>, velocity: Vector<World>) -> Situation {
    let now = FlightTime::from_secs_f64(now);
    let goal = Point::new(60.0, 0.0, 2.0);
    Situation {
        now,
        state_valid: now,
        position,
        velocity,
        yaw_rad: 0.0,
        goal,
        cruise_mps: 4.0,
        task: Task::Hover,
        piloted: false,
        landed: false,
        image_valid: now,
    }
}
