//! Faults injected into real processes in flight: whatever dies, hangs or lies, the vehicle touches nothing.

mod common;

use common::{Flown, Run, real_time};
use rustix::process::{Pid, Signal, kill_process};
use serde_json::Value;
use std::fs;
use std::os::unix::net::UnixDatagram;
use std::os::unix::process::ExitStatusExt;
use std::time::{Duration, Instant};

/// Flies with the faults of a list, at 4 m/s through the default forest.
fn fly(run: &Run, faults: &str, more: &[&str]) -> Flown {
    fs::write(run.path("faults.ron"), format!("(faults: [{faults}])")).expect("writable");
    let mut arguments = vec!["--faults", "faults.ron", "--seed", "2", "--speed", "4"];
    arguments.extend_from_slice(more);
    let flown = run.fly(&arguments);
    println!("{}{}", String::from_utf8_lossy(&flown.output.stdout), String::from_utf8_lossy(&flown.output.stderr));
    run.assert_nothing_left();
    flown
}

fn deaths<'a>(flown: &'a Flown, process: &str) -> Vec<&'a Value> {
    let deaths = flown.summary["deaths"].as_array().expect("a list");
    deaths.iter().filter(|death| death["process"] == process).collect()
}

fn rungs(flown: &Flown) -> Vec<&str> {
    let steps = flown.summary["degradation"].as_array().expect("a list");
    steps.iter().map(|step| step["rung"].as_str().expect("a name")).collect()
}

fn events(run: &Run) -> Vec<Value> {
    let text = fs::read_to_string(run.path("runs").join(&run.name).join("events.jsonl")).expect("a log");
    text.lines().map(|line| serde_json::from_str(line).expect("JSON")).collect()
}

#[test]
fn what_is_stopped_hangs_or_falls_silent_is_replaced_and_the_goal_is_reached() {
    let _alone = real_time();
    let run = Run::new("hang");
    let faults = "(at_s: 5.0, fault: stop(process: memory)), (at_s: 7.0, fault: hang(process: planner)), \
                  (at_s: 9.0, fault: silence(process: expansion)), (at_s: 12.0, fault: stop(process: recorder)), \
                  (at_s: 13.0, fault: stop(process: controller))";
    let flown = fly(&run, faults, &[]);
    assert_eq!(flown.outcome(), "arrived");
    let injected = flown.summary["faults"].as_array().expect("a list");
    assert_eq!(injected.len(), 5);
    for (process, how) in [
        ("memory", "stopped by a signal"),
        ("planner", "not beaten"),
        ("expansion", "made nothing"),
        ("recorder", "stopped by a signal"),
        ("controller", "stopped by a signal"),
    ] {
        let deaths = deaths(&flown, process);
        assert_eq!(deaths.len(), 1, "{process}: {deaths:?}");
        assert!(deaths[0]["how"].as_str().expect("a text").contains(how), "{deaths:?}");
        assert!(deaths[0]["recovered_ms"].is_number(), "{deaths:?}");
        // Whatever cannot say anything any more has a report that does.
        let report = fs::read_to_string(run.path("runs").join(&run.name).join(format!("crash-{process}-0.txt")));
        assert!(report.expect("a crash report").contains(how), "{process}");
    }
    let lines = events(&run);
    let died = lines.iter().find(|line| line["message"] == "died" && line["child"] == "planner").expect("logged");
    assert!(died["flight_s"].as_f64().expect("a number") > 7.0 && died["span"]["run"] == run.name.as_str(), "{died}");
}

#[test]
fn a_crash_loop_is_given_up_with_the_reason_and_the_vehicle_hovers_until_it_is_handed_back() {
    let _alone = real_time();
    let run = Run::new("crash-loop");
    let flown = fly(&run, "(at_s: 6.0, fault: crash_loop(process: planner, for_s: 600.0))", &[]);
    assert_eq!(flown.outcome(), "handed_back");
    assert!(!flown.output.status.success());
    assert_eq!(rungs(&flown).last(), Some(&"hand back"));
    let processes = flown.summary["processes"].as_array().expect("a list");
    let planner = processes.iter().find(|process| process["name"] == "planner").expect("listed");
    let why = planner["given_up"].as_str().expect("a reason");
    // A panic aborts what is released, and unwinds what is tested.
    let is_panic = why.contains("signal 6") || why.contains("status 101");
    assert!(why.contains("died 16 times") && is_panic, "{why}");
    let report = fs::read_to_string(run.path("runs").join(&run.name).join("crash-planner-0.txt")).expect("a report");
    for expected in ["injected: crash_loop of planner", "backtrace", "last keyframe_set: sequence"] {
        assert!(report.contains(expected), "{expected}: {report}");
    }
}

#[test]
fn a_killed_supervisor_is_followed_by_one_that_restarts_nobody() {
    let _alone = real_time();
    let run = Run::new("takeover");
    fs::write(run.path("faults.ron"), "(faults: [(at_s: 6.0, fault: kill(process: supervisor))])").expect("writable");
    let arguments = ["--faults", "faults.ron", "--seed", "2", "--speed", "4"];
    // Its children hold its standard error open: only its end is waited for.
    let mut first = run.start(&arguments);
    assert_eq!(first.wait().expect("ends").signal(), Some(9));
    let before = run.processes();
    assert_eq!(before.len(), 7, "the graph flies on");
    let refused = run.command(&["fly", "--run", &run.name]).output().expect("starts");
    assert!(String::from_utf8_lossy(&refused.stderr).contains("--adopt"), "{refused:?}");
    let flown = run.fly(&["--adopt"]);
    assert_eq!(flown.outcome(), "arrived", "{}", String::from_utf8_lossy(&flown.output.stderr));
    assert_eq!((flown.number("takeovers"), flown.number("restarts")), (1.0, 0.0));
    let processes = flown.summary["processes"].as_array().expect("a list").iter();
    let mut pids: Vec<u64> = processes.filter_map(|process| process["pid"].as_u64()).collect();
    pids.pop(); // The supervisor's own.
    assert!(pids.iter().all(|&pid| before.contains(&(pid as u32))), "{pids:?} were {before:?}");
    assert!(rungs(&flown).is_empty(), "the flight was not affected: {:?}", rungs(&flown));
    run.assert_nothing_left();
}

#[test]
fn messages_sensors_and_machine_may_fail() {
    let _alone = real_time();
    let run = Run::new("lies");
    let faults = "(at_s: 5.0, fault: lose(topic: \"keyframe_set\", for_s: 1.0, share: 0.5)), \
                  (at_s: 6.5, fault: delay(topic: \"trajectory\", for_s: 1.0, by_ms: 60.0)), \
                  (at_s: 8.0, fault: duplicate(topic: \"expanded_image\", for_s: 1.0, share: 0.5)), \
                  (at_s: 9.5, fault: corrupt(topic: \"vehicle_state\", for_s: 0.5, share: 0.2)), \
                  (at_s: 11.0, fault: freeze_camera(for_s: 1.0)), \
                  (at_s: 13.0, fault: fill_disk(for_s: 1.0)), \
                  (at_s: 14.0, fault: stall_reader(topic: \"trajectory\", for_s: 2.0)), \
                  (at_s: 15.0, fault: other_version), \
                  (at_s: 16.0, fault: descriptors(process: memory, for_s: 1.0))";
    let flown = fly(&run, faults, &[]);
    assert_eq!(flown.outcome(), "arrived");
    let said = String::from_utf8_lossy(&flown.output.stderr).into_owned();
    assert!(said.contains("IncompatibleAttributes"), "the other version is refused: {said}");
    // Every fault had its effect, and was counted.
    let losses = |process: &str, kind: &str| flown.summary["losses"][process][kind].as_u64().unwrap_or(0);
    assert!(losses("planner", "missed") > 0, "lost keyframe sets: {}", flown.summary["losses"]);
    assert!(losses("memory", "dropped") > 1, "doubled images, damaged states: {}", flown.summary["losses"]);
    assert!(losses("recorder", "dropped") > 0, "what could not be written: {}", flown.summary["losses"]);
    let second = run.log().with_extension("part2.mcap");
    let second = fs::read(&second).expect("a second file, once there is room again");
    assert!(
        mcap::Summary::read(&second).expect("readable").expect("indexed").stats.expect("counted").message_count > 100
    );
    let faulted: Vec<_> = events(&run).into_iter().filter(|line| line["message"] == "faulted").collect();
    for expected in ["frozen", "its file cannot be written"] {
        let is_said = |line: &Value| line["note"].as_str().is_some_and(|note| note.contains(expected));
        assert!(faulted.iter().any(is_said), "{expected}: {faulted:?}");
    }
}

#[test]
fn a_fault_file_that_cannot_be_is_refused_with_its_place() {
    let run = Run::new("bad-faults");
    for (text, expected) in [
        ("(faults: [(at_s: 3.0, fault: kill(process: pilot))])", "faults.ron:1:"),
        ("(faults: [(at_s: -3.0, fault: kill(process: planner))])", "faults[0].at_s is -3, allowed is 0 to 36000"),
        ("(faults: [(at_s: 3.0, fault: kill(process: simulator))])", "the world"),
    ] {
        fs::write(run.path("faults.ron"), text).expect("writable");
        let output = run.command(&["fly", "--faults", "faults.ron"]).output().expect("starts");
        let error = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(output.status.code() == Some(2) && error.contains(expected), "{text}: {error}");
    }
}

#[test]
fn systemd_is_told_when_the_graph_is_up_and_that_it_is_alive() {
    let _alone = real_time();
    let run = Run::new("systemd");
    let socket = UnixDatagram::bind(run.path("notify")).expect("a socket");
    socket.set_read_timeout(Some(Duration::from_secs(20))).expect("settable");
    let mut command = run.command(&["fly", "--run", &run.name, "--time-limit", "3"]);
    let mut flight = command.env("NOTIFY_SOCKET", run.path("notify")).spawn().expect("starts");
    let (mut said, mut buffer) = (String::new(), [0; 1024]);
    while !(said.contains("READY=1") && said.contains("WATCHDOG=1") && said.contains("STOPPING=1")) {
        let length = socket.recv(&mut buffer).expect("a notification");
        said += &String::from_utf8_lossy(&buffer[..length]);
    }
    flight.wait().expect("ends");
    run.assert_nothing_left();
}

#[test]
fn status_shows_every_process_while_it_flies() {
    let _alone = real_time();
    let run = Run::new("status");
    let mut flight = run.start(&["--time-limit", "6"]);
    let began = Instant::now();
    let record = loop {
        let output = run.command(&["status", "--run", &run.name, "--json"]).output().expect("starts");
        let record: Value = serde_json::from_slice(&output.stdout).unwrap_or_default();
        if record["flight_s"].as_f64().is_some_and(|flight_s| flight_s > 3.0) {
            break record;
        }
        assert!(began.elapsed() < Duration::from_secs(30), "{record}");
    };
    let processes = record["processes"].as_array().expect("a list");
    assert_eq!(processes.len(), 8, "the graph and its supervisor");
    for process in processes {
        assert!(process["state"] == "running" && process["pid"].is_number(), "{process}");
        assert!(process["usage"]["resident_bytes"].as_u64().expect("known") > 1 << 20, "{process}");
    }
    let text = run.command(&["status", "--run", &run.name, "--once"]).output().expect("starts");
    let text = String::from_utf8_lossy(&text.stdout).into_owned();
    assert!(text.contains("stereo-ingest") && text.contains("beat ms"), "{text}");
    flight.wait().expect("ends");
    let over = run.command(&["status", "--run", &run.name]).output().expect("starts");
    assert!(!over.status.success());
    run.assert_nothing_left();
}

/// Waits until the run's log holds a message.
fn wait_for_event(run: &Run, message: &str) {
    let began = Instant::now();
    let log = run.path("runs").join(&run.name).join("events.jsonl");
    while !fs::read_to_string(&log).unwrap_or_default().contains(message) {
        assert!(began.elapsed() < Duration::from_secs(60), "no \"{message}\" in {}", log.display());
        std::thread::yield_now();
    }
}

#[test]
fn an_interrupt_while_one_hangs_and_another_restarts_ends_all() {
    let _alone = real_time();
    let run = Run::new("interrupted");
    let faults = "(faults: [(at_s: 3.0, fault: hang(process: planner)), (at_s: 3.0, fault: kill(process: memory))])";
    fs::write(run.path("faults.ron"), faults).expect("writable");
    let flight = run.start(&["--faults", "faults.ron"]);
    wait_for_event(&run, "kill of memory");
    kill_process(Pid::from_raw(flight.id() as i32).expect("a process number"), Signal::INT).expect("sent");
    let flown = run.flown(flight.wait_with_output().expect("ends"));
    assert_eq!(flown.outcome(), "interrupted");
    run.assert_nothing_left();
}

#[test]
fn what_a_process_may_use_of_the_machine_is_asked_for_and_what_is_refused_is_said() {
    let _alone = real_time();
    let run = Run::new("resources");
    let copied = std::process::Command::new("cp")
        .args(["-r", concat!(env!("CARGO_MANIFEST_DIR"), "/config")])
        .arg(run.path("config"))
        .status();
    assert!(copied.expect("starts").success());
    let graph = run.path("config/graphs/droan.ron");
    let text = fs::read_to_string(&graph).expect("readable");
    let wanted = "(cpus: [0], realtime: 10, nice: 0, lock_memory: true, memory_mib: 2048)";
    // The planner's alone: pinned to one processor all of them would keep each other from it.
    let (before, planner) = text.split_once("process: planner").expect("a member");
    let planner = planner.replacen("(cpus: [], realtime: 0, nice: 0, lock_memory: false, memory_mib: 0)", wanted, 1);
    fs::write(&graph, format!("{before}process: planner{planner}")).expect("writable");
    let mut flight = run.start(&["--config", "config/default.ron", "--time-limit", "4"]);
    wait_for_event(&run, "\"up\"");
    let planner = run.wait_for_process("planner");
    // Once it is up it has asked for all of it.
    let began = Instant::now();
    let is_up = |line: &Value| line["message"] == "up" && line["span"]["process"] == "planner";
    while !events(&run).iter().any(is_up) {
        assert!(began.elapsed() < Duration::from_secs(20));
    }
    let process = procfs::process::Process::new(planner as i32).expect("alive");
    let (status, stat) = (process.status().expect("readable"), process.stat().expect("readable"));
    assert_eq!(status.cpus_allowed_list.expect("known"), [(0, 0)]);
    let refused: Vec<_> = events(&run).into_iter().filter(|line| line["message"] == "not permitted").collect();
    let is_refused =
        |what: &str| refused.iter().any(|line| line["refused"].as_str().is_some_and(|why| why.contains(what)));
    assert!(stat.rt_priority == Some(10) || is_refused("real-time priority 10"), "{stat:?} {refused:?}");
    let limit = process.limits().expect("readable").max_data_size.soft_limit;
    assert!(matches!(limit, procfs::process::LimitValue::Value(2_147_483_648)), "{limit:?}");
    flight.wait().expect("ends");
    run.assert_nothing_left();
}

/// In a mount namespace with a small shared memory, which a fault fills: keyframes are given up, and given back.
#[test]
fn full_shared_memory_costs_keyframes_not_the_flight() {
    let _alone = real_time();
    let run = Run::new("full");
    let fault = "(faults: [(at_s: 7.0, fault: fill_memory(for_s: 2.0))])";
    fs::write(run.path("faults.ron"), fault).expect("writable");
    let script = "mount -t tmpfs -o size=420m tmpfs /dev/shm && exec \"$@\"";
    let mut command = std::process::Command::new("unshare");
    command.args(["--user", "--map-root-user", "--mount", "--propagation", "private", "sh", "-c", script, "sh"]);
    let fly = [
        "fly",
        "--faults",
        "faults.ron",
        "--seed",
        "2",
        "--speed",
        "4",
        "--summary",
        "summary.json",
        "--run",
        &run.name,
    ];
    let output = command.arg(env!("CARGO_BIN_EXE_sparrowhawk")).args(fly).current_dir(run.folder.path()).output();
    let Ok(output) = output else { return eprintln!("SKIPPED: no unshare") };
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    if !run.path("summary.json").exists() {
        return eprintln!("SKIPPED: no mount namespace here: {said}");
    }
    let flown = run.flown(output);
    println!("{}{said}", String::from_utf8_lossy(&flown.output.stdout));
    assert_eq!(flown.outcome(), "arrived");
    assert_eq!(flown.summary["faults"].as_array().map(Vec::len), Some(1), "{said}");
    assert!(!rungs(&flown).is_empty(), "it was noticed");
}

#[test]
fn two_interrupts_during_start_up_leave_nothing() {
    let _alone = real_time();
    let run = Run::new("twice");
    let flight = run.start(&[]);
    run.wait_for_process("recorder");
    let pid = Pid::from_raw(flight.id() as i32).expect("a process number");
    for _ in 0..2 {
        kill_process(pid, Signal::INT).expect("sent");
    }
    let flown = run.flown(flight.wait_with_output().expect("ends"));
    assert_eq!(flown.outcome(), "interrupted");
    run.assert_nothing_left();
}
