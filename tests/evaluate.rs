//! Campaigns: a row for every flight, gone on with where they were.

mod common;

use common::{Run, real_time};
use std::process::{Output, Stdio};
use std::time::{Duration, Instant};

const OUT: &str = "table.csv";

fn evaluate(run: &Run, arguments: &[&str]) -> Output {
    let _alone = real_time();
    let mut all = vec!["evaluate", "--out", OUT];
    all.extend_from_slice(arguments);
    run.command(&all).output().expect("starts")
}

fn rows(run: &Run) -> Vec<Vec<String>> {
    let text = std::fs::read_to_string(run.path(OUT)).expect("a table");
    text.lines().map(|line| line.split(',').map(str::to_owned).collect()).collect()
}

fn column(rows: &[Vec<String>], name: &str) -> Vec<String> {
    let place = rows[0].iter().position(|column| column == name).unwrap_or_else(|| panic!("no column {name}"));
    rows[1..].iter().map(|row| row[place].clone()).collect()
}

#[test]
fn a_campaign_goes_on_where_it_was() {
    let run = Run::new("campaign");
    let first = evaluate(&run, &["--world", "field", "--seeds", "1..2", "--speed", "4"]);
    assert!(first.status.success(), "{}", String::from_utf8_lossy(&first.stderr));
    let two = rows(&run);
    assert_eq!((column(&two, "seed").len(), column(&two, "outcome")), (2, vec!["arrived".to_owned(); 2]));
    // The same flight as `fly --lockstep`, whose recorder is one more process.
    let alone = run.fly(&["--lockstep", "--world", "field", "--seed", "1", "--speed", "4"]);
    let of_first = column(&two, "seed").iter().position(|seed| seed == "1").expect("flown");
    for key in ["flight_time_s", "path_length_m", "max_speed_mps"] {
        assert_eq!(column(&two, key)[of_first].parse(), Ok(alone.number(key)), "{key}");
    }
    // Killed in the middle of a row, and widened; what is asked for twice is flown once.
    let mut text = std::fs::read_to_string(run.path(OUT)).expect("a table");
    text.push_str("default,field,4.0,tr");
    std::fs::write(run.path(OUT), text).expect("written");
    let wider = evaluate(&run, &["--world", "field", "--seeds", "1..3", "--speed", "4,4"]);
    assert!(wider.status.success(), "{}", String::from_utf8_lossy(&wider.stderr));
    assert!(String::from_utf8_lossy(&wider.stderr).contains("unfinished row"));
    let three = rows(&run);
    assert_eq!(three[..3], two[..], "what was flown is not flown again");
    assert_eq!(column(&three, "seed")[2], "3");
    let digest = String::from_utf8_lossy(&wider.stdout).into_owned();
    assert!(digest.contains("field") && digest.contains("100.0 %"), "{digest}");
}

#[test]
fn an_interrupted_campaign_keeps_what_was_flown_and_says_so() {
    let _alone = real_time();
    let run = Run::new("interrupted");
    let arguments = ["evaluate", "--out", OUT, "--world", "field", "--seeds", "1..500", "--speed", "4"];
    let child = run.command(&arguments).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("starts");
    let one_row = || std::fs::read_to_string(run.path(OUT)).is_ok_and(|text| text.lines().count() > 1);
    let started = Instant::now();
    while !one_row() {
        assert!(started.elapsed() < Duration::from_secs(120), "no row");
        std::thread::yield_now();
    }
    let pid = rustix::process::Pid::from_child(&child);
    rustix::process::kill_process(pid, rustix::process::Signal::INT).expect("it runs");
    let output = child.wait_with_output().expect("ends");
    assert!(!output.status.success());
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(message.contains("of 500 flights flown; the same command goes on"), "{message}");
    let flown = rows(&run);
    assert!((2..500).contains(&flown.len()), "{}", flown.len());
    assert!(column(&flown, "outcome").iter().all(|outcome| outcome != "interrupted"));
}

#[test]
fn what_was_flown_otherwise_is_not_mixed_in() {
    let run = Run::new("mixed");
    assert!(evaluate(&run, &["--world", "field", "--seeds", "1", "--speed", "4"]).status.success());
    let text = std::fs::read_to_string(run.path(OUT)).expect("a table");
    let configuration = column(&rows(&run), "configuration")[0].clone();
    std::fs::write(run.path(OUT), text.replace(&configuration, "0123456789abcdef")).expect("written");
    let refused = evaluate(&run, &["--world", "field", "--seeds", "1", "--speed", "4"]);
    assert!(!refused.status.success());
    let message = String::from_utf8_lossy(&refused.stderr).into_owned();
    for part in [OUT, "seed 1", "0123456789abcdef", "--out"] {
        assert!(message.contains(part), "no {part} in {message}");
    }
}

#[test]
fn parts_and_densities_are_varied_and_drawn() {
    let run = Run::new("varied");
    let plot = run.path("success.svg");
    let drawn = plot.display().to_string();
    let varied = ["--world", "forest", "--trees", "0,0.02", "--without", "layers", "--plot", &drawn];
    let flown = evaluate(&run, &[&["--seeds", "3", "--speed", "4", "--noise-camera"][..], &varied].concat());
    assert!(flown.status.success(), "{}", String::from_utf8_lossy(&flown.stderr));
    let table = rows(&run);
    let flights: Vec<_> = column(&table, "trees_per_m2").into_iter().zip(column(&table, "without")).collect();
    for flight in [("0.0", ""), ("0.02", ""), ("0.0", "layers"), ("0.02", "layers")] {
        assert!(flights.contains(&(flight.0.to_owned(), flight.1.to_owned())), "{flight:?} in {flights:?}");
    }
    let hashes: std::collections::HashSet<_> = column(&table, "log_hash").into_iter().collect();
    assert_eq!(hashes.len(), 4, "each flies differently");
    let picture = std::fs::read_to_string(&plot).expect("drawn");
    for part in ["by density of the forest", "without layers", "trees per m²"] {
        assert!(picture.contains(part), "no {part}");
    }
    assert!(String::from_utf8_lossy(&flown.stdout).contains("default without layers"));
}

#[test]
fn impossible_wishes_are_refused_before_anything_is_flown() {
    let run = Run::new("wishes");
    for (arguments, expected) in [
        (&["--seeds", "5..1"][..], "FIRST..LAST"),
        (&["--seeds", "few"], "FIRST..LAST"),
        (&["--seeds", "1..2000000000"], "flights"),
        (&["--speed", "300"], "cruise_speed_mps"),
        (&["--plot", "success.png"], ".svg"),
        (&["--trees", "7"], "trees_per_m2"),
        (&["--without", "wings"], "memory, noise, hysteresis, gaze, layers"),
        (&["--world", "nowhere.ron"], "nowhere.ron"),
        (&["--config", "nothing.ron"], "nothing.ron"),
    ] {
        let refused = evaluate(&run, arguments);
        assert!(!refused.status.success(), "{arguments:?}");
        let message = String::from_utf8_lossy(&refused.stderr).into_owned();
        assert!(message.contains(expected), "{arguments:?}: {message}");
        assert!(!run.path(OUT).exists(), "{arguments:?}");
    }
    std::fs::write(run.path(OUT), "not,a,campaign\n1,2,3\n").expect("written");
    let refused = evaluate(&run, &["--seeds", "1"]);
    let message = String::from_utf8_lossy(&refused.stderr).into_owned();
    assert!(!refused.status.success() && message.contains(OUT), "{message}");
}
