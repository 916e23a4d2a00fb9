//! Candidates priced at a plan, by the size of the library and the threads: rolled out, compared with the grid, the cheapest
//! refined. Nothing is asked of the map.

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use ipc_types::limits::Fence;
use ipc_types::messages::{ExpandedLayout, Layers, Task};
use ipc_types::noise::NoiseModel;
use ipc_types::{FlightTime, Point, StereoRig, Vector, World};
use memory::{FreeSpace, FreeSpaceRule, Inference, MapModel, View};
use planner::route::SearchConfig;
use planner::{Config, LibraryConfig, Planner, RouteConfig, Situation, TakeOff};

const CRUISE_MPS: f64 = 10.0;

fn config(size: u32, threads: u32) -> Config {
    Config {
        gamma_low: 0.9,
        gamma_high: 1.8,
        library: LibraryConfig { size, turn_deg: 170.0, climb_deg: 15.0, slowest_share: 0.16 },
        horizon_s: 2.5,
        commit_s: 0.4,
        lead_s: 0.06,
        state_deadline_s: 0.2,
        image_deadline_s: 0.5,
        sample_m: 0.15,
        acceleration_mps2: 5.5,
        lateral_mps2: 8.0,
        braking_mps2: 8.0,
        jerk_mps3: 60.0,
        hard_braking_mps2: 9.0,
        escape_m: 0.3,
        least_view_up_deg: 10.0,
        take_off_mps: 1.2,
        yaw_rate_degps: 90.0,
        gaze_follows_flight: true,
        unknown_price: 0.4,
        clearance_price: 1.5,
        turning_price: 1.0,
        height_price: 1.5,
        hysteresis_m: 3.0,
        look_price_m: 4.0,
        step_back_price_m: 2.0,
        blind_m: 0.9,
        patience_s: 1.0,
        back_out_m: 3.0,
        attempts: 4,
        field_reach_m: 20.0,
        field_rise_m: 1.0,
        threads,
        route: RouteConfig { segments: 150, search: SearchConfig { batch: 60, places: 400, neighbours: 24 } },
    }
}

/// All is free.
fn view() -> View {
    let rig = StereoRig {
        width_px: 32,
        height_px: 24,
        focal_px: 20.0,
        cx_px: 15.5,
        cy_px: 11.5,
        baseline_m: 0.3,
        doffs_px: 0.0,
    };
    let noise =
        NoiseModel { sigma_px: 0.5, sigma_m: 0.0, lambda_near: 3.0, lambda_far: 1.0, near_px: 10.0, far_px: 4.0 };
    let layout = ExpandedLayout::new(&rig, 0, Layers::Two);
    let model = MapModel { rig, noise, layout, radius_m: 0.5, inference: Inference::Confidence, forget_s: 1.0 };
    let rule =
        FreeSpaceRule { home_radius_m: 500.0, home_height_m: 10.0, swept_radius_m: 0.5, background_parallax_m: 0.5 };
    View::new(model, FreeSpace::new(rule, Point::ZERO))
}

fn bench(criterion: &mut Criterion) {
    let view = view();
    let fence = Fence { least_m: [-50.0, -50.0, 0.5], most_m: [150.0, 50.0, 6.0] };
    let take_off = TakeOff { from: Point::ZERO, radius_m: 1.0, height_m: 2.0 };
    let now = FlightTime::from_secs_f64(10.0);
    let situation = Situation {
        now,
        state_valid: now,
        image_valid: now,
        position: Point::<World>::new(20.0, 3.0, 2.0),
        velocity: Vector::new(6.0, 2.0, 0.0),
        yaw_rad: 0.3,
        goal: Point::new(100.0, 0.0, 2.0),
        cruise_mps: CRUISE_MPS,
        task: Task::Hover,
        piloted: false,
        landed: false,
    };
    let mut group = criterion.benchmark_group("library");
    for size in [20, 100, 300, 500, 1000, 2000] {
        for threads in [1, 2] {
            let mut planner = Planner::new(config(size, threads), fence, take_off, CRUISE_MPS);
            planner.step(&situation, &view);
            let candidates = planner.price_candidates(&situation, &view);
            group.throughput(Throughput::Elements(candidates as u64));
            group.bench_function(BenchmarkId::new(format!("{threads} threads"), candidates), |bencher| {
                bencher.iter(|| planner.price_candidates(&situation, &view));
            });
        }
    }
    group.finish();
}

criterion_group!(benches, bench);
criterion_main!(benches);
