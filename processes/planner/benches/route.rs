//! Time until BIT* has a path through forests, and its length after a given effort against the shortest there is.
//!
//! The space answers exactly and in about a microsecond, so this is the cost of the search itself.

#[path = "../tests/common/mod.rs"]
mod common;

use common::Poles;
use criterion::{BatchSize, BenchmarkId, Criterion, criterion_group, criterion_main};
use ipc_types::limits::Fence;
use ipc_types::{Point, World};
use planner::route::{BitStar, SearchConfig, length_m, shorten};

const CONFIG: SearchConfig = SearchConfig { batch: 100, places: 2000, neighbours: 32 };
const FROM: Point<World> = Point::new(0.0, 0.0, 2.0);
const AREA: Fence = Fence { least_m: [-10.0, -30.0, 0.8], most_m: [120.0, 30.0, 6.0] };
const FORESTS: u64 = 20;

fn forests(to: Point<World>) -> Vec<Poles> {
    (100..100 + FORESTS).map(|seed| Poles::forest(seed, 0.05, 0.65, &AREA, [FROM, to])).collect()
}

fn first_path(search: &mut BitStar, poles: &mut Poles, to: Point<World>) -> f64 {
    search.begin(poles, FROM, to, &[]).expect("both ends are free");
    while search.length_m().is_infinite() && search.improve(poles, 10) {}
    search.length_m()
}

/// Lengths after an effort, as shares of the optimum: median and worst.
fn report(to: Point<World>) {
    for segments in [0, 300, 1000, 3000] {
        let mut ratios: Vec<f64> = forests(to)
            .iter_mut()
            .map(|poles| {
                let optimum_m = poles.optimum_m(&AREA, FROM, to);
                let mut search = BitStar::new(CONFIG, AREA);
                first_path(&mut search, poles, to);
                search.improve(poles, segments);
                let mut path = search.path().to_vec();
                shorten(&mut path, &mut Vec::new(), poles, 300);
                length_m(&path) / optimum_m
            })
            .collect();
        ratios.sort_by(f64::total_cmp);
        let (median, worst) = (ratios[ratios.len() / 2], ratios[ratios.len() - 1]);
        println!(
            "{} m, first path and {segments} segments, pulled taut: median {median:.4}, worst {worst:.4} of the shortest",
            to.x
        );
    }
}

fn bench(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("route");
    for distance_m in [40.0, 100.0] {
        let to = Point::new(distance_m, 0.0, 2.0);
        report(to);
        let mut forests = forests(to);
        let mut search = BitStar::new(CONFIG, AREA);
        let mut next = 0;
        group.bench_function(BenchmarkId::new("first path", distance_m), |bencher| {
            bencher.iter(|| {
                next += 1;
                first_path(&mut search, &mut forests[next % FORESTS as usize], to)
            });
        });
        group.bench_function(BenchmarkId::new("1000 segments and pulled taut", distance_m), |bencher| {
            bencher.iter_batched(
                || Vec::with_capacity(200),
                |mut spare| {
                    next += 1;
                    let poles = &mut forests[next % FORESTS as usize];
                    search.begin(poles, FROM, to, &[]).expect("both ends are free");
                    search.improve(poles, 1000);
                    let mut path = search.path().to_vec();
                    shorten(&mut path, &mut spare, poles, 300);
                    length_m(&path)
                },
                BatchSize::SmallInput,
            );
        });
    }
    group.finish();
}

criterion_group!(benches, bench);
criterion_main!(benches);
