//! Ways through forests of poles, against the shortest there are.

mod common;

use common::Poles;
use ipc_types::limits::Fence;
use ipc_types::{Point, World};
use planner::route::{BitStar, Limits, Refused, SearchConfig, Space, Timing, length_m, shorten};

const CONFIG: SearchConfig = SearchConfig { batch: 100, places: 2000, neighbours: 32 };
const FROM: Point<World> = Point::new(0.0, 0.0, 2.0);
const AREA: Fence = Fence { least_m: [-10.0, -30.0, 0.8], most_m: [120.0, 30.0, 6.0] };

fn is_clear(poles: &Poles, path: &[Point<World>]) -> bool {
    path.windows(2).all(|leg| poles.is_clear(leg[0], leg[1]))
}

/// Searches, pulls taut, and returns the path.
fn path(search: &mut BitStar, poles: &mut Poles, to: Point<World>, segments: u32) -> Vec<Point<World>> {
    search.begin(poles, FROM, to, &[]).expect("both ends are free");
    search.improve(poles, segments);
    let mut path = search.path().to_vec();
    shorten(&mut path, &mut Vec::new(), poles, 1000);
    path
}

#[test]
fn forests_are_crossed_by_little_more_than_the_shortest_way() {
    for distance_m in [40.0, 100.0] {
        let to = Point::new(distance_m, 0.0, 2.0);
        let mut ratios = Vec::new();
        for seed in 0..12 {
            let mut poles = Poles::forest(seed, 0.05, 0.65, &AREA, [FROM, to]);
            let optimum_m = poles.optimum_m(&AREA, FROM, to);
            let found = path(&mut BitStar::new(CONFIG, AREA), &mut poles, to, 3000);
            assert!(!found.is_empty(), "{distance_m} m, seed {seed}: no path");
            assert!(is_clear(&poles, &found), "{distance_m} m, seed {seed}");
            let ratio = length_m(&found) / optimum_m;
            assert!(ratio > 0.996, "shorter than the shortest: {ratio}, {distance_m} m, seed {seed}");
            ratios.push(ratio);
        }
        ratios.sort_by(f64::total_cmp);
        println!("{distance_m} m: {:.4} to {:.4} of the shortest", ratios[0], ratios[ratios.len() - 1]);
        assert!(ratios[ratios.len() - 1] < 1.03, "{distance_m} m: {ratios:?}");
    }
}

#[test]
fn a_cul_de_sac_is_left_by_its_mouth_and_a_closed_ring_has_no_way_out() {
    let to = Point::new(30.0, 0.0, 2.0);
    let wall = |turn: usize| {
        let angle = turn as f64 * 0.12;
        ([8.0 * angle.cos(), 8.0 * angle.sin()], 0.7)
    };
    // Open towards the west.
    let pocket: Vec<_> = (0..52).filter(|turn| !(22..31).contains(turn)).map(wall).collect();
    let mut poles = Poles::of(&pocket);
    let found = path(&mut BitStar::new(CONFIG, AREA), &mut poles, to, 5000);
    assert!(is_clear(&poles, &found) && found.iter().any(|place| place.x < -5.0), "{found:?}");
    let ring: Vec<_> = (0..53).map(wall).collect();
    let mut poles = Poles::of(&ring);
    let mut search = BitStar::new(CONFIG, AREA);
    search.begin(&mut poles, FROM, to, &[]).expect("both ends are free");
    let mut rounds = 0;
    while search.improve(&mut poles, 500) {
        rounds += 1;
        assert!(rounds < 1000, "the search ends");
    }
    assert!(search.path().is_empty() && search.length_m().is_infinite());
}

/// Free right around two places alone.
struct Islands([Point<World>; 2]);

impl Space for Islands {
    fn is_free(&mut self, place: Point<World>) -> bool {
        self.0.iter().any(|island| island.distance(place) < 0.1)
    }

    fn is_way_free(&mut self, from: Point<World>, to: Point<World>) -> bool {
        self.0.iter().any(|island| island.distance(from) < 0.1 && island.distance(to) < 0.1)
    }
}

#[test]
fn a_search_ends_where_nothing_more_can_be_drawn() {
    let to = Point::new(30.0, 0.0, 2.0);
    let mut search = BitStar::new(CONFIG, AREA);
    search.begin(&mut Islands([FROM, to]), FROM, to, &[]).expect("both ends are free");
    let mut rounds = 0;
    while search.improve(&mut Islands([FROM, to]), 100) {
        rounds += 1;
        assert!(rounds < 100, "the search ends");
    }
    assert!(search.path().is_empty());
}

#[test]
fn more_effort_never_makes_the_path_longer_and_the_budget_holds() {
    let to = Point::new(60.0, 5.0, 3.0);
    let mut poles = Poles::forest(3, 0.08, 0.65, &AREA, [FROM, to]);
    let mut search = BitStar::new(CONFIG, AREA);
    search.begin(&mut poles, FROM, to, &[]).expect("both ends are free");
    let mut lengths = vec![search.length_m()];
    for _ in 0..60 {
        let before = poles.asked;
        search.improve(&mut poles, 100);
        assert!(poles.asked - before <= 100 && search.asked() <= poles.asked);
        lengths.push(search.length_m());
        let path = search.path();
        assert!(path.is_empty() || (path[0] == FROM && path[path.len() - 1] == to));
        let path = path.to_vec();
        assert!(is_clear(&poles, &path));
        assert!(path.is_empty() || (length_m(&path) - search.length_m()).abs() < 1e-6);
    }
    assert!(lengths.windows(2).all(|pair| pair[1] <= pair[0] + 1e-9), "{lengths:?}");
    assert!(lengths[60].is_finite());
}

#[test]
fn equal_questions_have_equal_answers_whatever_came_before() {
    let to = Point::new(50.0, -8.0, 2.0);
    let mut poles = Poles::forest(7, 0.1, 0.5, &AREA, [FROM, to]);
    let mut fresh = BitStar::new(CONFIG, AREA);
    let first = path(&mut fresh, &mut poles, to, 2000);
    path(&mut fresh, &mut poles, Point::new(20.0, 9.0, 2.0), 700);
    assert_eq!(path(&mut fresh, &mut poles, to, 2000), first);
    // With a path that is known, places of it twice.
    let known: Vec<_> = first.iter().flat_map(|&place| [place, place]).collect();
    let mut again = |search: &mut BitStar| {
        search.begin(&mut poles, FROM, to, &known).expect("both ends are free");
        search.improve(&mut poles, 1000);
        search.path().to_vec()
    };
    assert_eq!(again(&mut fresh), again(&mut BitStar::new(CONFIG, AREA)));
}

#[test]
fn a_known_path_is_kept_where_it_is_free_and_mended_where_not() {
    let to = Point::new(100.0, 0.0, 2.0);
    let mut poles = Poles::forest(5, 0.05, 0.65, &AREA, [FROM, to]);
    let mut search = BitStar::new(CONFIG, AREA);
    let known = path(&mut search, &mut poles, to, 3000);
    search.begin(&mut poles, FROM, to, &known).expect("both ends are free");
    assert!((search.length_m() - length_m(&known)).abs() < 1e-6, "it is there before anything is searched for");
    assert!(search.asked() <= known.len() as u32 + 1);
    let middle = known[known.len() / 2];
    poles.poles.push(common::Pole { at: Point::new(middle.x, middle.y, 0.0), radius_m: 1.0 });
    search.begin(&mut poles, FROM, to, &known).expect("both ends are free");
    assert!(search.length_m().is_infinite());
    search.improve(&mut poles, 1500);
    let mended = search.path().to_vec();
    assert!(!mended.is_empty() && is_clear(&poles, &mended));
    // Hostile ones do no harm.
    let hostile = [Point::new(f64::NAN, 0.0, 2.0); 9000];
    search.begin(&mut poles, FROM, to, &hostile).expect("both ends are free");
    search.improve(&mut poles, 1500);
    assert!(search.length_m().is_finite());
}

#[test]
fn ends_that_are_not_free_are_moved_and_impossible_ones_refused() {
    let mut poles = Poles::of(&[([0.0, 0.0], 1.5), ([40.0, 0.0], 2.0)]);
    let mut search = BitStar::new(CONFIG, AREA);
    let to = Point::new(40.5, 0.0, 2.0);
    search.begin(&mut poles, FROM, to, &[]).expect("there are free places near");
    search.improve(&mut poles, 500);
    let found = search.path().to_vec();
    assert_eq!(found[0], FROM, "the vehicle is where it is");
    assert!((1.5..2.1).contains(&found[1].distance(FROM)), "and leaves by a short way: {found:?}");
    let end = found[found.len() - 1];
    assert!((1.4..2.1).contains(&end.distance(to)) && is_clear(&poles, &[end, end]), "{end:?}");
    // Beyond the fence: the nearest place inside.
    search.begin(&mut poles, FROM, Point::new(500.0, 0.0, 50.0), &[]).expect("the fence's corner is free");
    search.improve(&mut poles, 500);
    assert_eq!(search.path().last(), Some(&Point::new(120.0, 0.0, 6.0)));
    let mut begin = |from, to| search.begin(&mut poles, from, to, &[]);
    assert_eq!(begin(FROM, Point::new(f64::NAN, 0.0, 2.0)), Err(Refused::NotFinite));
    assert_eq!(begin(Point::new(0.0, f64::INFINITY, 2.0), to), Err(Refused::NotFinite));
    assert!(search.path().is_empty());
    let mut deep = Poles::of(&[([0.0, 0.0], 12.0), ([40.0, 0.0], 12.0)]);
    assert_eq!(search.begin(&mut deep, FROM, Point::new(20.0, 0.0, 2.0), &[]), Err(Refused::NoStart));
    let middle = Point::new(20.0, 0.0, 2.0);
    assert_eq!(search.begin(&mut deep, middle, Point::new(40.0, 0.0, 2.0), &[]), Err(Refused::NoGoal));
    // At the goal already.
    search.begin(&mut deep, middle, middle, &[]).expect("free");
    assert!(!search.improve(&mut deep, 100), "nothing is to be searched for");
    assert_eq!(search.length_m(), 0.0);
}

#[test]
fn a_detour_is_pulled_taut_to_the_tangents_and_the_arc() {
    let mut poles = Poles::of(&[([10.0, 0.0], 2.0)]);
    let to = Point::new(20.0, 0.0, 2.0);
    let mut path = vec![FROM, Point::new(3.0, 7.0, 3.0), Point::new(9.0, 6.0, 1.0), Point::new(17.0, 5.0, 2.0), to];
    let asked = shorten(&mut path, &mut Vec::new(), &mut poles, 10_000);
    assert_eq!((asked, path[0], path[path.len() - 1]), (poles.asked, FROM, to));
    assert!(is_clear(&poles, &path), "{path:?}");
    // Two tangents of √96 m, and the arc between them.
    let optimum_m = 2.0 * 96.0_f64.sqrt() + 2.0 * 2.0 * (2.0_f64 / 10.0).asin();
    assert!((poles.optimum_m(&AREA, FROM, to) / optimum_m - 1.0).abs() < 0.003);
    let found_m = length_m(&path);
    assert!((optimum_m..optimum_m * 1.01).contains(&found_m), "{found_m}, optimum {optimum_m}");
}

#[test]
fn with_nothing_in_the_way_it_is_straight_and_without_effort_untouched() {
    let mut poles = Poles::default();
    let zigzag: Vec<_> = (0..40).map(|i| Point::new(f64::from(i), f64::from(i % 2), 2.0)).collect();
    let mut path = zigzag.clone();
    assert_eq!(shorten(&mut path, &mut Vec::new(), &mut poles, 0), 0);
    assert_eq!(path, zigzag);
    shorten(&mut path, &mut Vec::new(), &mut poles, 100);
    assert_eq!(path, [zigzag[0], zigzag[39]]);
    for few in 0..3 {
        let mut path = zigzag[..few].to_vec();
        shorten(&mut path, &mut Vec::new(), &mut poles, 100);
        assert_eq!(path, zigzag[..few]);
    }
}

#[test]
fn a_timed_path_keeps_to_its_limits_and_ends_at_rest() {
    let limits =
        Limits { speed_mps: 10.0, acceleration_mps2: 4.0, braking_mps2: 5.0, lateral_mps2: 6.0, jerk_mps3: 30.0 };
    let step_s = 0.02;
    let mut timing = Timing::default();
    for seed in 0..10 {
        let to = Point::new(80.0, 0.0, 2.0);
        let mut poles = Poles::forest(seed, 0.08, 0.65, &AREA, [FROM, to]);
        let path = path(&mut BitStar::new(CONFIG, AREA), &mut poles, to, 1000);
        for start_mps in [0.0, 0.05, 3.0, 9.0] {
            let timed = timing.time(&path, f64::INFINITY, start_mps, &limits, step_s).to_vec();
            let (first, last) = (timed[0], timed[timed.len() - 1]);
            assert!(first.at.distance(FROM) < 1e-9 && (first.velocity.norm() - start_mps).abs() < 1e-9);
            assert!(last.at.distance(to) < 2e-3 && last.velocity.norm() < 1e-9, "{last:?}");
            let speeds: Vec<f64> = timed.iter().map(|timed| timed.velocity.norm()).collect();
            assert!(speeds.iter().all(|&speed| speed < limits.speed_mps + 1e-9));
            let rates: Vec<f64> = speeds.windows(2).map(|pair| (pair[1] - pair[0]) / step_s).collect();
            let (least, most) =
                rates.iter().fold((0.0_f64, 0.0_f64), |(least, most), &rate| (least.min(rate), most.max(rate)));
            assert!(least > -5.0 - 1e-3 && most < 4.0 + 1e-3, "{least} to {most} m/s²");
            // The end comes at a walking pace, below which nothing brakes any more.
            let jerks = rates.windows(2).map(|pair| ((pair[1] - pair[0]) / step_s).abs());
            assert!(jerks.fold(0.0, f64::max) < 1.1 * limits.jerk_mps3, "seed {seed}, from {start_mps} m/s");
            // Across: the turn over the length in which corners are rounded.
            let length_m =
                |from: usize, to: usize| length_m(&timed[from..=to].iter().map(|t| t.at).collect::<Vec<_>>());
            // Before that a fast start could not slow down in time.
            let settled_m = start_mps * 0.3 + start_mps * start_mps / 10.0 + 1.0;
            let settled = (0..timed.len()).find(|&to| length_m(0, to) > settled_m).expect("it goes on");
            for (from, here) in timed.iter().enumerate().skip(settled).filter(|(_, here)| here.velocity.norm() > 1.0) {
                let Some(to) = (from..timed.len()).find(|&to| length_m(from, to) > 1.2) else { break };
                let there = timed[to].velocity;
                let turn_rad = here.velocity.cross(there).norm().atan2(here.velocity.dot(there));
                let across = here.velocity.norm() * there.norm() * turn_rad / length_m(from, to);
                assert!(across < 1.5 * limits.lateral_mps2, "{across} m/s² across at {:?}", here.at);
            }
        }
    }
    assert!(timing.time(&[FROM], 10.0, 1.0, &limits, step_s).is_empty());
    assert!(timing.time(&[FROM, FROM], 10.0, 1.0, &limits, step_s).is_empty());
    let cut = timing.time(&[FROM, Point::new(90.0, 0.0, 2.0)], 20.0, 4.0, &limits, step_s);
    assert!((19.0..21.0).contains(&cut[cut.len() - 1].at.x), "at rest where it is cut");
}
