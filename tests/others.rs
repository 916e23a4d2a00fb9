//! What others make of it: Python's MCAP reader, Zenoh's Python client, a browser. Each is skipped, loudly, where it is not
//! installed: `pip install -r tests/python/requirements.txt`, and Debian's chromium.

mod common;

use common::{Run, free_endpoint, real_time, skipped};
use serde_json::Value;
use std::io::{BufRead, BufReader, Read, Write};
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};

/// A script of `tests/python`, if what it imports is there.
fn script(name: &str, imports: &str) -> Option<Command> {
    let imported = Command::new("python3").args(["-c", &format!("import {imports}")]).output();
    if !imported.is_ok_and(|output| output.status.success()) {
        skipped(&format!("Python has no {imports}; pip install -r tests/python/requirements.txt"));
        return None;
    }
    let mut command = Command::new("python3");
    command.arg(Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/python").join(name));
    Some(command)
}

fn found(output: &Output) -> Value {
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    println!("{text}");
    serde_json::from_str(text.lines().last().expect("a line")).expect("JSON")
}

#[test]
fn pythons_reader_decodes_every_message_and_misses_none() {
    let Some(mut read) = script("read_log.py", "mcap, mcap_protobuf") else { return };
    let _alone = real_time();
    let run = Run::new("python");
    run.fly(&["--noise-camera", "--record-images", "--time-limit", "6"]);
    let found = found(&read.arg(run.log()).output().expect("starts"));
    assert!(found["channels"].as_u64() > Some(25) && found["messages"].as_u64() > Some(2000), "{found}");
    assert_eq!(found["attached"], serde_json::json!(["config.ron", "version.txt"]));
}

#[test]
fn pythons_zenoh_client_commands_a_goal_and_the_flight_ends_there() {
    let Some(mut command) = script("command.py", "zenoh, google.protobuf") else { return };
    let _alone = real_time();
    let (run, endpoint) = (Run::new("stranger"), free_endpoint());
    let flight = run.start(&["--listen", &endpoint, "--noise-camera", "--seed", "8"]);
    let output = command.args([&endpoint, "scout", "20", "-6", "1.5"]).output().expect("starts");
    let flown = run.flown(flight.wait_with_output().expect("ends"));
    let found = found(&output);
    assert!(found["processes"].as_u64() >= Some(7) && found["states"].as_u64() > Some(50), "{found}");
    assert_eq!(flown.outcome(), "arrived", "{}", String::from_utf8_lossy(&flown.output.stderr));
    assert!(flown.number("distance_to_goal_m") < 1.0 && flown.number("straight_line_m") < 30.0, "{}", flown.summary);
    run.assert_nothing_left();
}

fn ground(run: &Run, endpoint: &str, address: &str) -> Child {
    let mut ground = run.command(&["ground", "--connect", endpoint, "--page", address]);
    let mut ground = ground.stderr(Stdio::piped()).spawn().expect("starts");
    let mut lines = BufReader::new(ground.stderr.take().expect("piped")).lines().map_while(Result::ok);
    lines.find(|line| line.contains("the page is")).expect("a page");
    // Read on, or it would wait for the pipe.
    std::thread::spawn(move || lines.for_each(drop));
    ground
}

#[test]
fn the_page_in_a_browser_sees_and_commands() {
    let Some(mut page) = script("page.py", "playwright") else { return };
    if !Path::new("/usr/bin/chromium").exists() && std::env::var_os("CHROMIUM").is_none() {
        skipped("no /usr/bin/chromium; set CHROMIUM");
        return;
    }
    let _alone = real_time();
    let (run, endpoint) = (Run::new("page"), free_endpoint());
    let address = free_endpoint().replace("tcp/", "");
    // What follows from a ground that is gone for long is not asked here.
    run.configure(|text| text.replace("link: (lost_s: 5.0", "link: (lost_s: 60.0"));
    let config = ["--config", "config/default.ron", "--noise-camera", "--seed", "3", "--speed", "1.5"];
    let flight = run.start(&[&config[..], &["--listen", &endpoint]].concat());
    let planner = run.wait_for_process("planner").to_string();
    let mut first = ground(&run, &endpoint, &address);
    let screenshot = run.path("page.png");
    page.arg(format!("http://{address}/")).arg(&screenshot).args([&planner, &first.id().to_string()]);
    let mut page = page.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().expect("starts");
    let mut said = BufReader::new(page.stdout.take().expect("piped"));
    let mut line = String::new();
    said.read_line(&mut line).expect("readable");
    assert_eq!(line, "gone\n", "the page saw what it should, and that the ground was gone");
    first.wait().expect("killed");
    let mut second = ground(&run, &endpoint, &address);
    page.stdin.take().expect("piped").write_all(b"back\n").expect("heard");
    let mut rest = String::new();
    said.read_to_string(&mut rest).expect("readable");
    assert!(page.wait().expect("ends").success());
    let found: Value = serde_json::from_str(&rest).expect("JSON");
    println!("{found}");
    assert!(found["seen_s"].as_f64() < Some(1.0), "{found}");
    let flown = run.flown(flight.wait_with_output().expect("ends"));
    second.kill().expect("killed");
    second.wait().expect("killed");
    assert_eq!(flown.outcome(), "arrived", "{}", String::from_utf8_lossy(&flown.output.stderr));
    assert!(flown.number("distance_to_goal_m") < 1.0, "where it was clicked: {}", flown.summary);
    assert!(std::fs::metadata(&screenshot).expect("a picture").len() > 20_000);
    run.assert_nothing_left();
}
