//! A bad link between ground and vehicle: slow, late, with losses that TCP makes good by waiting, and sometimes none at all.

mod common;

use bytemuck::Zeroable;
use common::{Run, free_endpoint, real_time};
use ipc_types::messages::{Command, Order};
use ipc_types::topics::{Commands, State};
use ipc_types::wire::Text;
use rand::{RngExt, SeedableRng};
use serde_json::Value;
use socket2::{Domain, Socket, Type};
use std::io::{Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::process::Stdio;
use std::sync::mpsc::{Receiver, SyncSender, channel, sync_channel};
use std::sync::{Arc, Condvar, Mutex};
use std::time::{Duration, Instant};
use zenoh::Wait;

/// One way, bytes/s: 250 kbit/s.
const RATE: f64 = 31_250.0;
/// One way.
const DELAY: Duration = Duration::from_millis(200);
/// Bytes that are sent at once; so many of them are lost, and sent again after so long, which holds up all behind them.
const PACKET: usize = 1400;
const LOST: f64 = 0.02;
const SENT_AGAIN: Duration = Duration::from_millis(250);
/// Packets on their way and waiting, at most: the buffer of a radio.
const QUEUE: usize = 24;

/// Number of the command that comes too late.
const LATE: u64 = 4711;

/// A link that whoever connects to it has to the vehicle.
struct Link {
    endpoint: String,
    gate: Arc<Gate>,
}

/// Where what comes late waits for as long as the link is cut.
#[derive(Default)]
struct Gate {
    is_cut: Mutex<bool>,
    changed: Condvar,
}

impl Gate {
    fn pass(&self) {
        let is_cut = self.is_cut.lock().expect("sound");
        drop(self.changed.wait_while(is_cut, |is_cut| *is_cut).expect("sound"));
    }
}

impl Link {
    /// To an endpoint.
    fn to(endpoint: &str) -> Self {
        let vehicle: SocketAddr = endpoint.trim_start_matches("tcp/").parse().expect("an address");
        let socket = Socket::new(Domain::IPV4, Type::STREAM, None).expect("a socket");
        // What the kernel buffers is on no radio.
        socket.set_recv_buffer_size(4096).expect("set");
        socket.bind(&SocketAddr::from(([127, 0, 0, 1], 0)).into()).expect("bound");
        socket.listen(8).expect("listens");
        let listener: TcpListener = socket.into();
        let endpoint = format!("tcp/{}", listener.local_addr().expect("an address"));
        let gate = Arc::<Gate>::default();
        let passed = Arc::clone(&gate);
        std::thread::spawn(move || {
            for (number, ground) in listener.incoming().map_while(Result::ok).enumerate() {
                let Ok(vehicle) = connect(vehicle) else { continue };
                let (from_ground, from_vehicle) = (ground.try_clone(), vehicle.try_clone());
                carry(from_ground.expect("cloned"), vehicle, &passed, 2 * number as u64);
                carry(from_vehicle.expect("cloned"), ground, &passed, 2 * number as u64 + 1);
            }
        });
        Self { endpoint, gate }
    }

    /// Nothing gets through, or everything does again.
    fn cut(&self, is_cut: bool) {
        *self.gate.is_cut.lock().expect("sound") = is_cut;
        self.gate.changed.notify_all();
    }
}

fn connect(to: SocketAddr) -> std::io::Result<TcpStream> {
    let socket = Socket::new(Domain::IPV4, Type::STREAM, None)?;
    socket.set_recv_buffer_size(4096)?;
    socket.connect(&to.into())?;
    Ok(socket.into())
}

/// Carries one way.
fn carry(mut from: TcpStream, mut to: TcpStream, gate: &Arc<Gate>, seed: u64) {
    let (sender, receiver): (SyncSender<(Instant, Vec<u8>)>, Receiver<_>) = sync_channel(QUEUE);
    let mut random = rand_pcg::Pcg64Mcg::seed_from_u64(seed);
    std::thread::spawn(move || {
        let (mut packet, mut free) = ([0; PACKET], Instant::now());
        while let Ok(length @ 1..) = from.read(&mut packet) {
            // The medium is taken for as long as the packet is sent.
            free = free.max(Instant::now()) + Duration::from_secs_f64(length as f64 / RATE);
            if random.random::<f64>() < LOST {
                free += SENT_AGAIN;
            }
            if sender.send((free + DELAY, packet[..length].to_vec())).is_err() {
                return;
            }
            std::thread::sleep(free.saturating_duration_since(Instant::now()));
        }
    });
    let gate = Arc::clone(gate);
    std::thread::spawn(move || {
        for (due, packet) in receiver {
            std::thread::sleep(due.saturating_duration_since(Instant::now()));
            gate.pass();
            if to.write_all(&packet).is_err() {
                return;
            }
        }
    });
}

fn order(run: &Run, link: &Link, arguments: &[&str]) -> std::process::Child {
    let mut command = run.command(&["ground", "--connect", &link.endpoint, "--order"]);
    command.args(arguments).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("starts")
}

/// For so long states are counted.
const LISTENS: Duration = Duration::from_secs(10);
/// Longest wait for one.
const PATIENCE: Duration = Duration::from_secs(30);

/// The instants for which states are valid, ns of flight time, as they are heard.
fn states(session: &zenoh::Session) -> Receiver<i64> {
    let (sender, states) = channel();
    let hear = move |sample: zenoh::sample::Sample| {
        let (state, _) = encoding::decode_message::<State>(0, &sample.payload().to_bytes()).expect("a state");
        // Who listens no longer does not need it.
        let _ = sender.send(state.stamp.valid_ns);
    };
    let key = "sparrowhawk/scout/topic/vehicle_state";
    session.declare_subscriber(key).callback(hear).background().wait().expect("subscribed");
    states
}

/// 250 kbit/s, 200 ms each way, 2 % lost; and no link for a while. States go on coming; what is commanded is answered, or runs out
/// before it comes and is not followed.
#[test]
fn telemetry_survives_a_bad_link_and_no_command_is_late() {
    let _alone = real_time();
    let (run, endpoint) = (Run::new("radio"), free_endpoint());
    run.configure(|text| text.replace("budget_kbit_s: 8000", "budget_kbit_s: 180"));
    let config = [
        "--config",
        "config/default.ron",
        "--listen",
        &endpoint,
        "--noise-camera",
        "--seed",
        "6",
        "--time-limit",
        "26",
    ];
    let flight = run.start(&config);
    let link = Link::to(&endpoint);
    let session = bridge::open(&[], std::slice::from_ref(&link.endpoint), None, None).expect("a session");
    let states = states(&session);
    let mut heard: Vec<i64> = (0..20).map(|_| states.recv_timeout(PATIENCE).expect("heard")).collect();
    let begun = Instant::now();
    let accepted = order(&run, &link, &["speed", "--speed", "3", "--valid", "8"]).wait_with_output().expect("ends");
    assert!(accepted.status.success(), "{accepted:?}");
    let before = heard.len();
    while begun.elapsed() < LISTENS {
        heard.extend(states.recv_timeout(LISTENS));
    }
    let for_s = begun.elapsed().as_secs_f64();
    let rate_hz = (heard.len() - before) as f64 / for_s;
    println!("{rate_hz:.1} states a second over {for_s:.1} s");
    assert!(rate_hz >= 5.0, "{rate_hz} Hz");
    // Sent while there is no link, it comes when it has run out.
    link.cut(true);
    let late = Command {
        number: LATE,
        expires_ns: heard.last().expect("heard") + 1_000_000_000,
        order: Order::Hover as u32,
        operator: Text::from("late"),
        ..Command::zeroed()
    };
    let mut bytes = Vec::new();
    encoding::encode_message::<Commands>(&late, &[], &mut bytes);
    session.put("sparrowhawk/scout/command/late", bytes).wait().expect("sent");
    // Until then, and not so long that the session is given up, which would lose it.
    let beside = bridge::open(&[], std::slice::from_ref(&endpoint), None, None).expect("a session");
    let flown_on = self::states(&beside);
    while flown_on.recv_timeout(PATIENCE).expect("heard") <= late.expires_ns {}
    link.cut(false);
    let flown = run.flown(flight.wait_with_output().expect("ends"));
    println!("{:.3} flight seconds per second", flown.number("clock_ratio"));
    assert!(["arrived", "timed_out"].contains(&flown.outcome()), "{}", String::from_utf8_lossy(&flown.output.stderr));
    assert_in_time(&run);
    run.assert_nothing_left();
}

/// Every command that was followed was valid still; the late one came, and was not.
fn assert_in_time(run: &Run) {
    let log = recorder::Log::open(&run.log()).expect("a log");
    let [commands, answers] = ["command", "answer"].map(|topic| log.json(topic).expect("readable"));
    let ns = |value: &Value| value.as_i64().or_else(|| value.as_str()?.parse().ok()).expect("a number");
    for answer in answers.iter().filter(|answer| answer["accepted"] == 1) {
        let command = commands.iter().find(|command| command["number"] == answer["number"]).expect("recorded");
        assert!(ns(&answer["stamp"]["published_ns"]) <= ns(&command["expires_ns"]), "{answer} {command}");
    }
    let late = answers.iter().find(|answer| ns(&answer["number"]) == LATE as i64).expect("it came in the end");
    assert!(late["accepted"] == 0 && late["reason"].as_str().expect("a text").contains("expired"), "{late}");
    println!("{} commands came in, {} were answered", commands.len(), answers.len());
}
