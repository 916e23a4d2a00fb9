//! The ground sees a real flight over a real network, and commands it.

mod common;

use common::{Run, free_endpoint, real_time};
use serde_json::Value;
use std::io::{BufRead, BufReader};
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

fn ground(run: &Run, endpoint: &str, arguments: &[&str]) -> Command {
    let mut command = run.command(&["ground", "--connect", endpoint]);
    command.args(arguments).stdout(Stdio::piped()).stderr(Stdio::piped());
    command
}

fn order(run: &Run, endpoint: &str, arguments: &[&str]) -> Output {
    ground(run, endpoint, &[&["--order"], arguments].concat()).output().expect("starts")
}

/// Lines of JSON from a ground that runs beside the flight, until one is as it should be.
struct Seen {
    ground: Child,
    lines: std::sync::mpsc::Receiver<String>,
}

impl Seen {
    fn begin(run: &Run, endpoint: &str) -> Self {
        let mut ground = ground(run, endpoint, &["--json"]).spawn().expect("starts");
        let (sender, lines) = std::sync::mpsc::channel();
        let read = BufReader::new(ground.stdout.take().expect("piped")).lines();
        std::thread::spawn(move || read.map_while(Result::ok).try_for_each(|line| sender.send(line)));
        Self { ground, lines }
    }

    fn until(&mut self, what: &str, is_it: impl Fn(&Value) -> bool) -> Value {
        let (begun, mut last) = (Instant::now(), Value::Null);
        while begun.elapsed() < Duration::from_secs(30) {
            let Ok(line) = self.lines.recv_timeout(Duration::from_secs(30)) else { break };
            last = serde_json::from_str(&line).expect("JSON");
            if is_it(&last) {
                return last;
            }
        }
        panic!("never {what}: {last}");
    }
}

impl Drop for Seen {
    fn drop(&mut self) {
        // It may have ended already.
        let _ = self.ground.kill();
        let _ = self.ground.wait();
    }
}

fn is_fast(view: &Value) -> bool {
    view["speed_mps"].as_f64().is_some_and(|speed| speed > 2.0)
}

#[test]
fn a_goal_is_commanded_and_the_flight_ends_there() {
    let _alone = real_time();
    let (run, endpoint) = (Run::new("goal"), free_endpoint());
    let flight = run.start(&["--listen", &endpoint, "--noise-camera", "--vehicle", "kestrel"]);
    let mut seen = Seen::begin(&run, &endpoint);
    let view = seen.until("under way", is_fast);
    assert_eq!((&view["name"], &view["connected"], &view["rung"]), (&"kestrel".into(), &true.into(), &"full".into()));
    assert_eq!(view["processes"].as_array().expect("a list").len(), 8, "{view}");
    // What is impossible is refused, with its reason, and the flight goes on.
    for (arguments, expected) in [
        (&["route", "--to", "900,0,1.5"][..], "outside the fence"),
        (&["speed", "--speed", "90"], "allowed is"),
        (&["speed"], "how fast"),
    ] {
        let output = order(&run, &endpoint, arguments);
        let said = String::from_utf8_lossy(&output.stdout).into_owned();
        assert!(output.status.code() == Some(1) && said.contains(expected), "{arguments:?}: {output:?}");
    }
    let unknown = order(&run, &endpoint, &["loop"]);
    assert!(!unknown.status.success() && String::from_utf8_lossy(&unknown.stderr).contains("loop"), "{unknown:?}");
    let accepted = order(&run, &endpoint, &["route", "--to", "30,8,1.5", "--speed", "3"]);
    assert!(accepted.status.success(), "{accepted:?}");
    let view = seen.until("led elsewhere", |view| view["mission"]["elements"][0]["position_m"][1] == 8.0);
    assert_eq!(view["mission"]["speed_mps"], 3.0);
    let flown = run.flown(flight.wait_with_output().expect("ends"));
    assert_eq!(flown.outcome(), "arrived", "{}", String::from_utf8_lossy(&flown.output.stderr));
    assert!(flown.number("distance_to_goal_m") < 1.0 && flown.number("straight_line_m") < 40.0, "{}", flown.summary);
    let states = recorder::Log::open(&run.log()).expect("a log").json("vehicle_state").expect("readable");
    let last = &states.last().expect("states")["position_m"];
    assert!((last[0].as_f64().expect("x") - 30.0).hypot(last[1].as_f64().expect("y") - 8.0) < 1.0, "{last}");
    drop(seen);
    run.assert_nothing_left();
}

#[test]
fn hover_resume_and_return_and_a_killed_planner_is_seen() {
    let _alone = real_time();
    let (run, endpoint) = (Run::new("hover"), free_endpoint());
    let flight = run.start(&["--listen", &endpoint, "--noise-camera", "--seed", "3"]);
    let mut seen = Seen::begin(&run, &endpoint);
    seen.until("under way", is_fast);
    assert!(order(&run, &endpoint, &["hover"]).status.success());
    seen.until("at rest", |view| {
        view["mission"]["hovers"] == 1 && view["speed_mps"].as_f64().is_some_and(|speed| speed < 0.3)
    });
    let planner = run.wait_for_process("planner");
    rustix::process::kill_process(
        rustix::process::Pid::from_raw(planner as i32).expect("a number"),
        rustix::process::Signal::KILL,
    )
    .expect("killed");
    let killed = Instant::now();
    let is_back = |view: &Value| {
        let processes = view["processes"].as_array().expect("a list");
        processes.iter().any(|process| process["name"] == "planner" && process["restarts"] == 1)
    };
    seen.until("seen to be restarted", is_back);
    println!("seen after {:.1} s", killed.elapsed().as_secs_f64());
    assert!(order(&run, &endpoint, &["resume"]).status.success());
    seen.until("under way again", is_fast);
    assert!(order(&run, &endpoint, &["return"]).status.success());
    let flown = run.flown(flight.wait_with_output().expect("ends"));
    assert_eq!(flown.outcome(), "arrived", "{}", String::from_utf8_lossy(&flown.output.stderr));
    let states = recorder::Log::open(&run.log()).expect("a log").json("vehicle_state").expect("readable");
    let last = &states.last().expect("states")["position_m"];
    assert!(last[0].as_f64().expect("x").abs() < 3.0, "it is back: {last}");
    drop(seen);
    run.assert_nothing_left();
}

/// Junk on every key, commands cut and damaged, and a ground that is stopped while it is connected.
#[test]
fn junk_and_a_stopped_ground_change_nothing_in_flight() {
    use rand::{Rng, SeedableRng};
    use zenoh::Wait;
    let _alone = real_time();
    let (run, endpoint) = (Run::new("junk"), free_endpoint());
    let flight = run.start(&["--listen", &endpoint, "--noise-camera", "--seed", "5"]);
    let mut seen = Seen::begin(&run, &endpoint);
    seen.until("heard", |view| view["connected"] == true);
    let pid = rustix::process::Pid::from_raw(seen.ground.id() as i32).expect("a number");
    rustix::process::kill_process(pid, rustix::process::Signal::STOP).expect("stopped");
    let session = bridge::open(&[], std::slice::from_ref(&endpoint), None, None).expect("a session");
    let mut random = rand_pcg::Pcg64Mcg::seed_from_u64(1);
    let begun = Instant::now();
    let mut sent = 0_u64;
    while begun.elapsed() < Duration::from_secs(5) {
        for path in ["command", "command/eve", "answer", "topic/health", "image/left", "anything"] {
            let length = random.next_u32() as usize % if path == "command/eve" { 6000 } else { 600 };
            let mut bytes = vec![0; length];
            random.fill_bytes(&mut bytes);
            session.put(format!("sparrowhawk/scout/{path}"), bytes).wait().expect("sent");
            sent += 1;
        }
        std::thread::yield_now();
    }
    println!("{sent} messages of junk");
    assert!(sent > 1000);
    let flown = run.flown(flight.wait_with_output().expect("ends"));
    assert_eq!(flown.outcome(), "arrived", "{}", String::from_utf8_lossy(&flown.output.stderr));
    // A machine that is busy with the junk may cost images, and so some speed; it does not stop.
    let rungs = flown.summary["degradation"].as_array().cloned().unwrap_or_default();
    assert!(rungs.iter().all(|rung| rung["rung"] != "hover" && rung["rung"] != "hand back"), "{rungs:?}");
    assert!(flown.summary["losses"]["bridge"]["dropped"].as_u64() > Some(100), "{}", flown.summary["losses"]);
    drop(session);
    drop(seen);
    run.assert_nothing_left();
}

/// A port that somebody else has: the page says so, and the flight goes on without the ground.
#[test]
fn a_busy_port_is_named() {
    let _alone = real_time();
    let run = Run::new("busy");
    let taken = std::net::TcpListener::bind("127.0.0.1:0").expect("a port");
    let address = taken.local_addr().expect("an address").to_string();
    let flown = run.fly(&["--listen", &format!("tcp/{address}"), "--noise-camera", "--time-limit", "4"]);
    assert_eq!(flown.outcome(), "timed_out", "{}", String::from_utf8_lossy(&flown.output.stderr));
    let events = std::fs::read_to_string(run.path("runs").join(&run.name).join("events.jsonl")).expect("a log");
    assert!(events.contains("no session") && events.contains(&address), "{events}");
    let other = Run::new("page");
    let endpoint = free_endpoint();
    let flight = other.start(&["--listen", &endpoint, "--noise-camera", "--time-limit", "6"]);
    let page = other.command(&["ground", "--connect", &endpoint, "--page", &address]).output().expect("starts");
    let said = String::from_utf8_lossy(&page.stderr).into_owned();
    assert!(page.status.code() == Some(2) && said.contains(&address), "{page:?}");
    other.flown(flight.wait_with_output().expect("ends"));
}

#[test]
fn what_would_let_anybody_command_is_refused() {
    let run = Run::new("open");
    let output = run.command(&["fly", "--listen", "tcp/0.0.0.0:7447"]).output().expect("starts");
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.code() == Some(2) && said.contains("only tls/ is possible"), "{said}");
}

/// Certificates of an authority, and of those whom it knows.
struct Authority {
    folder: std::path::PathBuf,
    issuer: rcgen::CertifiedIssuer<'static, rcgen::KeyPair>,
}

impl Authority {
    fn new(folder: &std::path::Path, name: &str) -> Self {
        let folder = folder.join(name);
        std::fs::create_dir_all(&folder).expect("writable");
        let mut params = rcgen::CertificateParams::new(Vec::new()).expect("no names");
        params.is_ca = rcgen::IsCa::Ca(rcgen::BasicConstraints::Unconstrained);
        params.distinguished_name.push(rcgen::DnType::CommonName, name);
        let issuer = rcgen::CertifiedIssuer::self_signed(params, rcgen::KeyPair::generate().expect("a key"));
        let issuer = issuer.expect("signed");
        std::fs::write(folder.join("ca.pem"), AsRef::<rcgen::Certificate>::as_ref(&issuer).pem()).expect("writable");
        Self { folder, issuer }
    }

    /// Certifies somebody; the three files that `--tls` wants.
    fn certify(&self, name: &str) -> [String; 3] {
        let mut params = rcgen::CertificateParams::new(vec!["127.0.0.1".to_owned()]).expect("an address");
        params.distinguished_name.push(rcgen::DnType::CommonName, name);
        let key = rcgen::KeyPair::generate().expect("a key");
        let certificate = params.signed_by(&key, &self.issuer).expect("signed");
        let file = |kind: &str| self.folder.join(format!("{name}.{kind}"));
        std::fs::write(file("pem"), certificate.pem()).expect("writable");
        std::fs::write(file("key"), key.serialize_pem()).expect("writable");
        [self.folder.join("ca.pem"), file("pem"), file("key")].map(|path| path.display().to_string())
    }
}

/// Over mutual TLS: a pilot commands, an observer sees and is not heard, and strangers do not even see.
#[test]
fn who_has_no_certificate_sees_nothing_and_an_observer_commands_nothing() {
    let _alone = real_time();
    let run = Run::new("roles");
    let (ours, theirs) = (Authority::new(run.folder.path(), "ours"), Authority::new(run.folder.path(), "theirs"));
    let [authority, certificate, key] = ours.certify("vehicle");
    let endpoint = free_endpoint().replace("tcp/", "tls/");
    run.configure(|text| {
        let tls = format!("tls: Some((authority: {authority:?}, certificate: {certificate:?}, key: {key:?}))");
        let text = text.replace("tls: None", &tls).replace("pilots: []", "pilots: [\"ann\"]");
        text.replace("observers: []", "observers: [\"bob\"]").replace("listen: []", &format!("listen: [{endpoint:?}]"))
    });
    let mut flight = run.start(&["--config", "config/default.ron", "--noise-camera", "--seed", "4", "--speed", "2"]);
    let with = |name: &[String; 3], arguments: &[&str]| {
        let tls: Vec<&str> = ["--tls"].into_iter().chain(name.iter().map(String::as_str)).collect();
        ground(&run, &endpoint, &[&tls[..], arguments].concat())
    };
    let ask = |name: &[String; 3], arguments: &[&str]| {
        with(name, &[&["--order"], arguments].concat()).output().expect("starts")
    };
    let accepted = ask(&ours.certify("ann"), &["speed", "--speed", "1.5"]);
    assert!(accepted.status.success(), "{accepted:?}");
    // He hears it, or his order could not be dated; but nobody hears him.
    let unheard = ask(&ours.certify("bob"), &["hover"]);
    let said = String::from_utf8_lossy(&unheard.stdout).into_owned();
    assert!(unheard.status.code() == Some(1) && said.contains("no answer"), "{unheard:?}");
    // Known to the authority, and neither pilot nor observer; unknown to it; without any certificate.
    let strangers = [Some(ours.certify("eve")), Some(theirs.certify("ann")), None];
    for stranger in strangers {
        let output = match &stranger {
            Some(name) => ask(name, &["hover"]),
            None => order(&run, &endpoint, &["hover"]),
        };
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        let is_refused = said.contains("for 10 s") || said.contains("certificate");
        assert!(!output.status.success() && is_refused, "{stranger:?}: {output:?}");
    }
    // One who knows the authority, and shows no certificate of his own.
    let bare = serde_json::json!({
        "mode": "client",
        "connect": { "endpoints": [endpoint], "timeout_ms": 3000 },
        "scouting": { "multicast": { "enabled": false } },
        "transport": { "link": { "tls": { "root_ca_certificate": authority } } },
    });
    let bare = zenoh::Config::from_json5(&bare.to_string()).expect("a configuration");
    assert!(zenoh::Wait::wait(zenoh::open(bare)).is_err(), "without a certificate there is no session");
    // A pilot's certificate is good for his own name alone.
    let disguised = ask(&ours.certify("ann"), &["hover", "--operator", "carl"]);
    assert!(disguised.status.code() == Some(1), "{disguised:?}");
    assert!(String::from_utf8_lossy(&disguised.stdout).contains("no answer"), "{disguised:?}");
    assert!(flight.try_wait().expect("asked").is_none(), "it was there to be seen all the time");
    let flown = run.flown(flight.wait_with_output().expect("ends"));
    assert_eq!(flown.outcome(), "arrived", "{}", String::from_utf8_lossy(&flown.output.stderr));
    let answers = recorder::Log::open(&run.log()).expect("a log").json("answer").expect("readable");
    assert_eq!(answers.len(), 1, "one order came in: {answers:?}");
    assert_eq!(answers[0]["operator"], "ann", "by the name in his certificate");
    // All of them are in the run's log.
    let events = std::fs::read_to_string(run.path("runs").join(&run.name).join("events.jsonl")).expect("a log");
    for expected in [
        "command/bob",
        "command/carl",
        "did not match any configured ACL subject",
        "UnknownCA",
        "peer sent no certificates",
    ] {
        assert!(events.contains(expected), "{expected} is not in {events}");
    }
    for refused in events.lines().filter(|line| line.contains("his certificate does not let him")) {
        assert!(refused.contains("command/bob") || refused.contains("command/carl"), "{refused}");
    }
    run.assert_nothing_left();
}
