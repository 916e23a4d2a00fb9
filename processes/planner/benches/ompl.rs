//! BIT* against OMPL's planners on the same forests, in turns: time to the first path, and lengths after given times against the
//! shortest way there is.
//!
//! Needs a C++ compiler and OMPL 1.5 with its headers (Debian: `libompl-dev`), and skips, loudly, without. All check motions
//! exactly, by the same formula, on one thread. OMPL's planners are as they come; their paths are also given after OMPL's
//! shortcuts, whose time is not counted, and ours are pulled taut within the time.

#[path = "../tests/common/mod.rs"]
mod common;

use common::Poles;
use ipc_types::limits::Fence;
use ipc_types::{Point, World};
use planner::route::{BitStar, SearchConfig, length_m, shorten};
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::io::Write as _;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Instant;

const CONFIG: SearchConfig = SearchConfig { batch: 100, places: 2000, neighbours: 32 };
const FROM: Point<World> = Point::new(0.0, 0.0, 2.0);
const AREA: Fence = Fence { least_m: [-10.0, -30.0, 0.8], most_m: [120.0, 30.0, 6.0] };
const FORESTS: u64 = 20;
/// When lengths are taken, ms.
const TIMES_MS: [f64; 3] = [5.0, 20.0, 100.0];

/// What planners came to, one entry for every forest: time to the first path, ms, and lengths, as shares of the optimum.
type Results = BTreeMap<String, Vec<Vec<f64>>>;

fn main() {
    let program = Path::new(env!("CARGO_TARGET_TMPDIR")).join("ompl");
    let source = concat!(env!("CARGO_MANIFEST_DIR"), "/benches/ompl.cpp");
    let built = Command::new("c++")
        .args(["-O3", "-std=c++17", "-I/usr/include/ompl-1.5", "-I/usr/include/eigen3", source, "-lompl", "-o"])
        .arg(&program)
        .status();
    if !built.is_ok_and(|status| status.success()) {
        println!("SKIPPED: no C++ compiler, or no OMPL 1.5 with headers (libompl-dev)");
        return;
    }
    for distance_m in [40.0, 100.0] {
        let to = Point::new(distance_m, 0.0, 2.0);
        let mut results = Results::new();
        for seed in 100..100 + FORESTS {
            let mut poles = Poles::forest(seed, 0.05, 0.65, &AREA, [FROM, to]);
            let optimum_m = poles.optimum_m(&AREA, FROM, to);
            results.entry("ours".to_owned()).or_default().push(ours(&mut poles, to, optimum_m));
            theirs(&program, &poles, to, optimum_m, &mut results);
        }
        print(distance_m, &results);
    }
}

/// Time to the first path, and for every time the length of the path pulled taut.
fn ours(poles: &mut Poles, to: Point<World>, optimum_m: f64) -> Vec<f64> {
    let mut search = BitStar::new(CONFIG, AREA);
    let (begun, mut first_ms, mut found) = (Instant::now(), f64::INFINITY, Vec::new());
    let spent_ms = || begun.elapsed().as_secs_f64() * 1e3;
    search.begin(poles, FROM, to, &[]).expect("both ends are free");
    let mut taut = Vec::new();
    for until_ms in TIMES_MS {
        while spent_ms() < until_ms && search.improve(poles, 10) {
            if first_ms.is_infinite() && search.length_m().is_finite() {
                first_ms = spent_ms();
            }
        }
        taut.clear();
        taut.extend_from_slice(search.path());
        shorten(&mut taut, &mut Vec::new(), poles, 300);
        let length_m = if search.length_m().is_finite() { length_m(&taut) } else { f64::INFINITY };
        found.extend([search.length_m() / optimum_m, length_m / optimum_m]);
    }
    found.insert(0, first_ms);
    found
}

fn theirs(program: &Path, poles: &Poles, to: Point<World>, optimum_m: f64, results: &mut Results) {
    let mut forest = String::from("forest");
    for value in [FROM.to_array(), to.to_array(), AREA.least_m, AREA.most_m].concat() {
        let _ = write!(forest, " {value}");
    }
    let _ = writeln!(forest, " {}", poles.poles.len());
    for pole in &poles.poles {
        let _ = writeln!(forest, "{} {} {}", pole.at.x, pole.at.y, pole.radius_m);
    }
    let mut child = Command::new(program)
        .args(TIMES_MS.map(|time| time.to_string()))
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .expect("what was just built runs");
    child.stdin.take().expect("a pipe").write_all(forest.as_bytes()).expect("it reads");
    let output = child.wait_with_output().expect("it ends");
    assert!(output.status.success(), "{:?}", output.status);
    for line in String::from_utf8_lossy(&output.stdout).lines() {
        let mut words = line.split_whitespace();
        let name = words.next().expect("a name").to_owned();
        let mut values: Vec<f64> = words.map(|word| word.parse().expect("a number")).collect();
        assert_eq!(values.len(), 1 + 2 * TIMES_MS.len(), "{line}");
        values[1..].iter_mut().for_each(|length_m| *length_m /= optimum_m);
        results.entry(name).or_default().push(values);
    }
}

fn print(distance_m: f64, results: &Results) {
    println!(
        "{distance_m} m, {FORESTS} forests; median, worst. Lengths as shares of the shortest: as found; pulled taut or shortened"
    );
    for (name, forests) in results {
        let column = |index: usize| {
            let mut values: Vec<f64> = forests.iter().map(|forest| forest[index]).collect();
            values.sort_by(f64::total_cmp);
            format!("{:.3}, {:.3}", values[values.len() / 2], values[values.len() - 1])
        };
        print!("{name:12} first path {} ms", column(0));
        for (place, until_ms) in TIMES_MS.iter().enumerate() {
            print!("   {until_ms} ms: {}; {}", column(1 + 2 * place), column(2 + 2 * place));
        }
        println!();
    }
}
