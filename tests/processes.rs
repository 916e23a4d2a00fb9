//! Flights of real processes over real shared memory, in real time, with real kills.

mod common;

use common::{Run, real_time};
use rustix::fs::inotify::{self, CreateFlags, ReadFlags, WatchFlags};
use rustix::process::{Pid, Signal, kill_process};
use serde_json::Value;
use std::collections::HashSet;
use std::mem::MaybeUninit;

fn kill(pid: u32, signal: Signal) {
    kill_process(Pid::from_raw(pid as i32).expect("a process number"), signal).expect("killed");
}

/// Every message of a topic in a run's log, or in what was written of it so far.
fn logged(run: &Run, topic: &str) -> Vec<Value> {
    // There may be no file yet, or only its beginning.
    recorder::Log::open(&run.log()).and_then(|log| log.json(topic)).unwrap_or_default()
}

/// Waits until the vehicle is that far on its way: asked whenever the log grows, which it does twice a second.
fn let_it_fly_past(run: &Run, x_m: f64) {
    run.wait_for_process("simulator");
    let watch = inotify::init(CreateFlags::CLOEXEC).expect("a watch");
    let log = run.log();
    let folder = log.parent().expect("a folder");
    inotify::add_watch(&watch, folder, WatchFlags::MODIFY | WatchFlags::CLOSE_WRITE).expect("watched");
    let mut buffer = [MaybeUninit::uninit(); 4096];
    let mut events = inotify::Reader::new(&watch, &mut buffer);
    let is_past = |truth: &Value| truth["position_m"][0].as_f64().is_some_and(|x| x >= x_m);
    while !logged(run, "world_truth").iter().any(is_past) {
        let event = events.next().expect("an event");
        let is_log = event.file_name().is_some_and(|name| name.to_bytes() == b"log.mcap");
        let ended = is_log && event.events().contains(ReadFlags::CLOSE_WRITE);
        assert!(!ended, "the flight ended before it was {x_m} m far");
    }
}

#[test]
fn the_default_flight_arrives_with_eight_processes_and_a_readable_log() {
    let _alone = real_time();
    let run = Run::new("default");
    let flown = run.fly(&[]);
    assert!(flown.output.status.success(), "{}", String::from_utf8_lossy(&flown.output.stderr));
    assert_eq!(flown.outcome(), "arrived");
    assert!(flown.number("distance_to_goal_m") < 1.0 && flown.number("straight_line_m") > 60.0);
    assert!(flown.number("cruise_speed_mps") >= 4.0, "{}", flown.summary);
    assert!(flown.number("clock_ratio") >= 0.98, "{}", flown.summary);
    let processes = flown.summary["processes"].as_array().expect("processes");
    let pids: HashSet<u64> = processes.iter().filter_map(|process| process["pid"].as_u64()).collect();
    assert_eq!(pids.len(), 8, "{processes:?}");
    let bytes = std::fs::read(run.log()).expect("a log");
    let summary = mcap::Summary::read(&bytes).expect("readable").expect("indexed");
    let topics: HashSet<&str> = summary.channels.values().map(|channel| channel.topic.as_str()).collect();
    let counts = &summary.stats.as_ref().expect("statistics").channel_message_counts;
    let has_messages = |topic: &str| {
        summary.channels.iter().any(|(id, channel)| channel.topic == topic && counts.get(id).is_some_and(|&n| n > 0))
    };
    for topic in [
        "vehicle_state",
        "flight_clock",
        "trajectory",
        "setpoint",
        "keyframe_set",
        "flown_path",
        "world_truth",
        "health",
        "goal",
    ] {
        assert!(has_messages(topic), "{topic} among {topics:?}");
    }
    assert!(summary.attachment_indexes.iter().any(|attachment| attachment.name == "config.ron"));
    run.assert_nothing_left();
}

/// Kills processes in mid-flight, one after the other, asserts that each is back at once, and returns how it ended.
fn killed(run: &Run, victims: &[&str]) -> common::Flown {
    let _alone = real_time();
    let flight = run.start(&["--seed", "2", "--speed", "4"]);
    for (index, process) in victims.iter().enumerate() {
        let_it_fly_past(run, 12.0 + 7.0 * index as f64);
        kill(run.wait_for_process(process), Signal::KILL);
    }
    let flown = run.flown(flight.wait_with_output().expect("ends"));
    let processes = flown.summary["processes"].as_array().expect("processes");
    for process in victims {
        let entry = processes.iter().find(|entry| entry["name"] == *process).expect("listed");
        println!("{process}: back after {} ms", entry["longest_recovery_ms"]);
        assert_eq!(entry["restarts"], 1, "{entry}");
        assert!(entry["longest_recovery_ms"].as_f64().expect("measured") < 200.0, "{entry}");
    }
    run.assert_nothing_left();
    flown
}

#[test]
fn a_killed_expansion_is_back_at_once_and_the_flight_goes_on() {
    assert_eq!(killed(&Run::new("expansion"), &["expansion"]).outcome(), "arrived");
}

/// A successor of the controller goes on from the last command and the trajectory of its predecessor: nothing jumps.
#[test]
fn a_killed_controller_goes_on_where_its_predecessor_died() {
    let run = Run::new("controller");
    assert_eq!(killed(&run, &["controller"]).outcome(), "arrived");
    let setpoints = logged(&run, "setpoint");
    let successor = setpoints.iter().position(|setpoint| setpoint["stamp"]["incarnation"] == 1).expect("a successor");
    let (last, first) = (&setpoints[successor - 1], &setpoints[successor]);
    let velocity = |setpoint: &Value| -> Vec<f64> {
        let velocity = setpoint["velocity_mps"].as_array().expect("a vector").iter();
        velocity.map(|v| v.as_f64().expect("a number")).collect()
    };
    let jump = velocity(last).iter().zip(velocity(first)).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt();
    let valid_s = |message: &Value| message["stamp"]["valid_ns"].as_f64().expect("a time") * 1e-9;
    let gap_s = valid_s(first) - valid_s(last);
    println!("{gap_s:.3} s without setpoints, then another by {jump:.3} m/s");
    let slew_mps2 = 8.0;
    assert!(jump <= slew_mps2 * gap_s + 1e-6, "a jump of {jump} m/s after {gap_s} s");
    assert!(velocity(last).iter().map(|v| v * v).sum::<f64>() > 1.0, "it was under way: {last}");
    assert_eq!(first["mode"], 1, "it tracks, and does not brake: {first}");
}

#[test]
fn stereo_memory_and_planner_may_be_killed_in_one_flight() {
    let flown = killed(&Run::new("three"), &["stereo-ingest", "memory", "planner"]);
    assert_eq!(flown.outcome(), "arrived");
}

/// A successor of the memory process goes on with the keyframes of its predecessor, but for the newest at most.
#[test]
fn a_killed_memory_is_back_with_its_keyframes() {
    let run = Run::new("memory");
    let flown = killed(&run, &["memory"]);
    assert_eq!(flown.outcome(), "arrived");
    let sets = logged(&run, "keyframe_set");
    let incarnation = |set: &Value| set["stamp"]["incarnation"].as_u64().expect("a number");
    let ids = |set: &Value| -> HashSet<u64> {
        let keyframes = set["elements"].as_array().expect("a list").iter();
        keyframes.map(|keyframe| keyframe["image_id"].as_u64().expect("a number")).collect()
    };
    let published_ms = |set: &Value| set["stamp"]["published_ns"].as_f64().expect("a time") * 1e-6;
    let last = sets.iter().rfind(|set| incarnation(set) == 0).expect("a predecessor");
    let first = sets.iter().find(|set| incarnation(set) == 1).expect("a successor");
    let (before, after) = (ids(last), ids(first));
    println!(
        "{} keyframes before, {} after, {:.1} ms between both sets",
        before.len(),
        after.len(),
        published_ms(first) - published_ms(last)
    );
    assert!(before.len() > 5, "{last}");
    assert!(before.difference(&after).count() <= 1, "{before:?} became {after:?}");
}

#[test]
fn an_interrupt_stops_everything_cleanly() {
    let _alone = real_time();
    let run = Run::new("interrupt");
    let flight = run.start(&[]);
    let_it_fly_past(&run, 3.0);
    kill(flight.id(), Signal::INT);
    let flown = run.flown(flight.wait_with_output().expect("ends"));
    assert_eq!(flown.outcome(), "interrupted");
    assert!(!flown.output.status.success());
    run.assert_nothing_left();
}

#[test]
fn two_graphs_fly_side_by_side_and_a_second_of_the_same_name_is_refused() {
    let _alone = real_time();
    let (one, two) = (Run::new("side-a"), Run::new("side-b"));
    let limit = ["--time-limit", "6"];
    let (first, second) = (one.start(&limit), two.start(&limit));
    one.wait_for_process("simulator");
    let refused = one.command(&["fly", "--run", &one.name]).output().expect("starts");
    let message = String::from_utf8_lossy(&refused.stderr).into_owned();
    assert!(!refused.status.success() && message.contains("already running"), "{message}");
    for (run, flight) in [(&one, first), (&two, second)] {
        let flown = run.flown(flight.wait_with_output().expect("ends"));
        assert_eq!(flown.outcome(), "timed_out");
        assert!(flown.number("path_length_m") > 1.0, "{}", flown.summary);
        run.assert_nothing_left();
    }
}
