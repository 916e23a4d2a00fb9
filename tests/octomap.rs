//! Maps that others made: what is read of them, and ways through them.

mod common;

use common::{Run, data};
use ipc_types::limits::Fence;
use ipc_types::{Body, Point, Pose, Rotation, World as WorldFrame};
use planner::route::{BitStar, SearchConfig, Space, length_m, shorten};
use simulator::{Collider, Octomap, World, WorldConfig};
use std::path::{Path, PathBuf};

/// Start and goal of every trial of a forest.
fn trials(folder: &Path, map: usize) -> Vec<[Point<WorldFrame>; 2]> {
    let text = std::fs::read_to_string(folder.join("start_and_end.csv")).expect("the table");
    let rows = text.lines().filter(|line| !line.starts_with('#')).map(|line| {
        let values: Vec<f64> = line.split(',').map(|value| value.parse().expect("a number")).collect();
        let point = |from: usize| Point::new(values[from], values[from + 1], values[from + 2]);
        (values[1] as usize, [point(2), point(5)])
    });
    rows.filter(|(of, _)| *of == map).map(|(_, ends)| ends).collect()
}

fn forest(folder: &Path, map: usize) -> (PathBuf, WorldConfig) {
    let path = folder.join(format!("octomaps/forest{map}.bt"));
    let config = WorldConfig::of_octomap(&path).expect("a map");
    (path, config)
}

#[test]
fn a_real_corridor_has_the_leaves_and_the_size_that_its_makers_state() {
    let Some(data) = data() else { return };
    let map = Octomap::read(&data.join("octomap_freiburg/geb079.bt")).expect("a map");
    assert_eq!(map.leaves(), [143_729, 284_415]);
    let [least, most] = map.bounds_m();
    let expected = [Point::new(-8.0, -7.5, -0.3), Point::new(30.9, 7.4, 2.8)];
    assert!(least.distance(expected[0]) < 0.1 && most.distance(expected[1]) < 0.1, "{least:?} to {most:?}");
    let boxes = map.boxes().expect("it is small");
    let volume_m3: f64 =
        boxes.iter().map(|[least, most]| (most.x - least.x) * (most.y - least.y) * (most.z - least.z)).sum();
    assert!((volume_m3 - 95.0).abs() < 1.0, "{volume_m3} m³ in {} boxes", boxes.len());
}

/// A cylinder of the vehicle's size that may touch nothing.
struct Hull {
    collider: Collider,
}

impl Hull {
    fn pose(at: Point<WorldFrame>) -> Pose<WorldFrame, Body> {
        Pose { rotation: Rotation::IDENTITY, translation: at - Point::ZERO }
    }
}

impl Space for Hull {
    fn is_free(&mut self, place: Point<WorldFrame>) -> bool {
        self.collider.clearance(Self::pose(place)).obstacles_m > 0.0
    }

    fn is_way_free(&mut self, from: Point<WorldFrame>, to: Point<WorldFrame>) -> bool {
        // Rounding differs from one direction to the other; a way is asked about in either.
        let (from, to) = if from.to_array() < to.to_array() { (from, to) } else { (to, from) };
        self.is_free(from) && !self.collider.collides(Self::pose(from), Self::pose(to), false)
    }
}

#[test]
fn every_start_is_free_and_a_way_leads_from_it_to_its_goal() {
    let Some(data) = data() else { return };
    let folder = data.join("forest_gen_octomaps");
    let mut ratios = Vec::new();
    for map in 0..5 {
        let (path, config) = forest(&folder, map);
        let floor_m = Octomap::read(&path).expect("a map").floor_m();
        let world = World::grow(&config, 0, &[]).expect("a map");
        let mut hull = Hull { collider: Collider::new(&world, 0.45, 0.6) };
        let fence = Fence { least_m: [-4.5, -4.5, 0.4], most_m: [4.5, 4.5, 4.5] };
        let mut search = BitStar::new(SearchConfig { batch: 100, places: 1500, neighbours: 32 }, fence);
        let on_ground = |place: Point<WorldFrame>| Point::new(place.x, place.y, place.z - floor_m);
        let trials = trials(&folder, map);
        assert!(trials.len() >= 50, "forest {map}: {} trials", trials.len());
        for [start, goal] in trials.iter().map(|ends| ends.map(on_ground)) {
            assert!(hull.is_free(start) && hull.is_free(goal), "forest {map}: {start:?} to {goal:?}");
        }
        for [start, goal] in trials.iter().step_by(30).map(|ends| ends.map(on_ground)) {
            search.begin(&mut hull, start, goal, &[]).expect("both ends are free");
            while search.length_m().is_infinite() && search.improve(&mut hull, 20) {}
            search.improve(&mut hull, 40);
            let mut way = search.path().to_vec();
            assert!(!way.is_empty(), "forest {map}: no way from {start:?} to {goal:?}");
            shorten(&mut way, &mut Vec::new(), &mut hull, 60);
            assert!(way.windows(2).all(|leg| hull.is_way_free(leg[0], leg[1])));
            // Ends at the map's border are moved inside.
            let straight_m = way[0].distance(way[way.len() - 1]);
            ratios.push(length_m(&way) / straight_m.max(1.0));
        }
    }
    ratios.sort_by(f64::total_cmp);
    let (median, longest) = (ratios[ratios.len() / 2], ratios[ratios.len() - 1]);
    println!("{} ways: {median:.3} of the straight one in the median, {longest:.3} at most", ratios.len());
    assert!(median < 1.1, "{median}");
}

#[test]
fn what_is_no_map_and_what_is_no_table_of_trials_is_refused_by_name() {
    let run = Run::new("nomap");
    std::fs::write(run.path("torn.bt"), b"# Octomap OcTree binary file\nsize 9\nres 0.1\ndata\n\x03").expect("written");
    std::fs::write(run.path("trials.csv"), "trial,map,x,y,z,x,y,z\n0,0,1,1,1,2,nan,1\n").expect("written");
    std::fs::write(run.path("empty.csv"), "trial,map,x,y,z,x,y,z\n").expect("written");
    std::fs::write(run.path("short.csv"), "trial,map,x,y,z\n0,0,1,1\n").expect("written");
    let cases: [(&[&str], &[&str]); 7] = [
        (&["fly", "--world", "torn.bt"], &["torn.bt", "cut off"]),
        (&["fly", "--world", "absent.bt"], &["absent.bt", "No such file"]),
        (&["evaluate", "--trials", "trials.csv"], &["--maps"]),
        (
            &["evaluate", "--trials", "trials.csv", "--maps", "torn.bt", "--seeds", "0"],
            &["trials.csv", "trial 0", "finite"],
        ),
        (&["evaluate", "--trials", "short.csv", "--maps", "torn.bt", "--seeds", "0"], &["short.csv"]),
        (&["evaluate", "--trials", "empty.csv", "--maps", "torn.bt"], &["--trials", "none of 0"]),
        (&["evaluate", "--trials", "absent.csv", "--maps", "torn.bt"], &["absent.csv"]),
    ];
    for (arguments, expected) in cases {
        let output = run.command(arguments).output().expect("starts");
        let message = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(!output.status.success(), "{arguments:?}");
        assert!(expected.iter().all(|part| message.contains(part)), "{arguments:?}: {message}");
    }
}
