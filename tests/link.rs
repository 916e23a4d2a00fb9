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
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, Mutex};
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
    is_cut: Arc<AtomicBool>,
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
        let is_cut = Arc::new(AtomicBool::new(false));
        let cut = Arc::clone(&is_cut);
        std::thread::spawn(move || {
            for (number, ground) in listener.incoming().map_while(Result::ok).enumerate() {
                let Ok(vehicle) = connect(vehicle) else { continue };
                let (from_ground, from_vehicle) = (ground.try_clone(), vehicle.try_clone());
                carry(from_ground.expect("cloned"), vehicle, &cut, 2 * number as u64);
                carry(from_vehicle.expect("cloned"), ground, &cut, 2 * number as u64 + 1);
            }
        });
        Self { endpoint, is_cut }
    }

    /// Nothing gets through, or everything does again.
    fn cut(&self, is_cut: bool) {
        self.is_cut.store(is_cut, Ordering::Relaxed);
    }
}

fn connect(to: SocketAddr) -> std::io::Result<TcpStream> {
    let socket = Socket::new(Domain::IPV4, Type::STREAM, None)?;
    socket.set_recv_buffer_size(4096)?;
    socket.connect(&to.into())?;
    Ok(socket.into())
}

/// Carries one way.
fn carry(mut from: TcpStream, mut to: TcpStream, cut: &Arc<AtomicBool>, seed: u64) {
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
    let cut = Arc::clone(cut);
    std::thread::spawn(move || {
        for (due, packet) in receiver {
            std::thread::sleep(due.saturating_duration_since(Instant::now()));
            while cut.load(Ordering::Relaxed) {
                std::thread::sleep(Duration::from_millis(5));
            }
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
    // When states were heard, and the last one's flight time.
    let heard: Arc<Mutex<(Vec<Instant>, i64)>> = Arc::default();
    let hears = Arc::clone(&heard);
    let key = "sparrowhawk/scout/topic/vehicle_state";
    let hear = move |sample: zenoh::sample::Sample| {
        let (state, _) = encoding::decode_message::<State>(0, &sample.payload().to_bytes()).expect("a state");
        let mut heard = hears.lock().expect("sound");
        heard.0.push(Instant::now());
        heard.1 = state.stamp.valid_ns;
    };
    session.declare_subscriber(key).callback(hear).background().wait().expect("subscribed");
    let begun = Instant::now();
    while heard.lock().expect("sound").0.len() < 20 {
        assert!(begun.elapsed() < Duration::from_secs(30), "nothing is heard");
        std::thread::sleep(Duration::from_millis(20));
    }
    let accepted = order(&run, &link, &["speed", "--speed", "3", "--valid", "8"]).wait_with_output().expect("ends");
    assert!(accepted.status.success(), "{accepted:?}");
    std::thread::sleep(Duration::from_secs(8));
    let (listened, last_ns) = heard.lock().expect("sound").clone();
    let for_s = listened[0].elapsed().as_secs_f64();
    let rate_hz = listened.len() as f64 / for_s;
    println!("{rate_hz:.1} states a second over {for_s:.1} s");
    assert!(rate_hz >= 5.0, "{rate_hz} Hz");
    // Sent while there is no link, it comes when it has run out.
    link.cut(true);
    let late = Command {
        number: LATE,
        expires_ns: last_ns + 1_000_000_000,
        order: Order::Hover as u32,
        operator: Text::from("late"),
        ..Command::zeroed()
    };
    let mut bytes = Vec::new();
    encoding::encode_message::<Commands>(&late, &[], &mut bytes);
    session.put("sparrowhawk/scout/command/late", bytes).wait().expect("sent");
    // Not so long that the session is given up, which would lose it.
    std::thread::sleep(Duration::from_millis(1800));
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
