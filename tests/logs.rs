//! Logs: whole, in parts, cut off, damaged, hostile, and of another version.

mod common;

use common::Run;
use rand::{RngExt, SeedableRng};
use recorder::{Log, recover};
use std::path::Path;

/// A few seconds of flight in lockstep, as a log.
fn flown(run: &Run, arguments: &[&str]) -> Vec<u8> {
    let flight = ["--lockstep", "--noise-camera", "--time-limit", "6"];
    let flown = run.fly(&[&flight[..], arguments].concat());
    assert_eq!(flown.outcome(), "timed_out", "{}", String::from_utf8_lossy(&flown.output.stderr));
    std::fs::read(run.log()).expect("a log")
}

/// Messages that can be read, and whether all of the file was.
fn readable(path: &Path, bytes: &[u8]) -> Result<(u64, bool), recorder::LogError> {
    std::fs::write(path, bytes).expect("writable");
    let mut messages = 0;
    let read = Log::open(path)?.each(|_| messages += 1)?;
    Ok((messages, read.damage.is_none() && read.no_messages == 0))
}

#[test]
fn a_log_is_whole_for_others_and_what_is_cut_off_it_is_read_and_recovered() {
    let run = Run::new("cut");
    let bytes = flown(&run, &["--record-images"]);
    let summary = mcap::Summary::read(&bytes).expect("readable").expect("indexed");
    assert!(summary.channels.values().all(|channel| channel.schema.is_some()), "every channel has a schema");
    let in_topics = |topic: &str| !topic.starts_with('/');
    let counts = &summary.stats.as_ref().expect("statistics").channel_message_counts;
    let ours = summary.channels.iter().filter(|(_, channel)| in_topics(&channel.topic));
    let counted: u64 = ours.filter_map(|(id, _)| counts.get(id)).sum();
    let path = run.path("cut.mcap");
    assert_eq!(readable(&path, &bytes).expect("readable"), (counted, true));
    assert!(counted > 2000, "{counted}");
    // At any byte: what is before the cut is read, the more the later.
    let mut before = 0;
    for index in 1..=60 {
        let cut = 8 + (bytes.len() - 9) * index / 60;
        let (messages, is_whole) = readable(&path, &bytes[..cut]).expect("readable");
        assert!(messages >= before && messages <= counted && !is_whole, "cut at {cut}: {messages} after {before}");
        before = messages;
    }
    assert!(before > counted * 9 / 10, "{before} of {counted}");
    readable(&path, &bytes[..bytes.len() * 2 / 3]).expect("readable");
    let whole = run.path("whole.mcap");
    let recovered = recover(&path, &whole).expect("recovered");
    assert!(recovered.damage.is_open && recovered.attachments == 2, "{recovered:?}");
    assert!(recover(&path, &whole).is_err(), "nothing is written over");
    let summary = mcap::Summary::read(&std::fs::read(&whole).expect("written")).expect("readable").expect("indexed");
    assert_eq!(summary.stats.expect("statistics").message_count, recovered.messages.values().sum::<u64>());
    let output = run.command(&["report", "cut.mcap", "--out", "cut.html"]).output().expect("starts");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let page = std::fs::read_to_string(run.path("cut.html")).expect("a page");
    assert!(page.contains("it has no end") && page.matches("<svg").count() == 7, "says that it is cut off");
}

#[test]
fn a_lockstep_flight_is_flown_again_from_its_log_to_the_bit() {
    let run = Run::new("again");
    flown(&run, &["--seed", "12"]);
    let log = run.log().display().to_string();
    let again = run.command(&["refly", &log]).output().expect("starts");
    let said = String::from_utf8_lossy(&again.stdout).into_owned();
    assert!(again.status.success() && said.contains("0 topics differ"), "{again:?}");
    assert!(said.lines().filter(|line| line.ends_with("the same")).count() >= 12, "{said}");
    // One flown in real time is another flight.
    let other = Run::new("other");
    let _alone = common::real_time();
    other.fly(&["--noise-camera", "--record-images", "--time-limit", "3", "--seed", "12"]);
    let again = other.command(&["refly", &other.log().display().to_string()]).output().expect("starts");
    assert_eq!(again.status.code(), Some(1), "{again:?}");
    assert!(String::from_utf8_lossy(&again.stdout).contains(" now, "), "{again:?}");
    // And what it saw is matched to the same, though at other instants.
    let output = other
        .command(&["replay", &other.log().display().to_string(), "--playback-rate", "fast"])
        .output()
        .expect("starts");
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    let disparity =
        said.lines().find(|line| line.starts_with("disparity_image")).unwrap_or_else(|| panic!("{output:?}"));
    let numbers: Vec<u64> = disparity.split_whitespace().filter_map(|word| word.parse().ok()).collect();
    assert!(disparity.ends_with("the same") || numbers[2] + 2 >= numbers[0], "{said}");
}

/// Cameras' images or disparity through the graph again: as fast as possible the same comes of it to the bit, over processes the
/// same as far as no time is in it.
#[test]
fn what_a_flight_saw_is_replayed() {
    let run = Run::new("replayed");
    flown(&run, &["--seed", "13", "--record-images"]);
    let log = run.log().display().to_string();
    let replay = |arguments: &[&str]| {
        let output = run.command(&[&["replay", &log], arguments].concat()).output().expect("starts");
        (output.status.code(), String::from_utf8_lossy(&output.stdout).into_owned(), output)
    };
    for (arguments, topics) in [(&["--record-images"][..], 9), (&["--feed", "disparity"], 5)] {
        let (code, said, output) = replay(&[&["--playback-rate", "fast"], arguments].concat());
        assert!(code == Some(0) && said.contains("0 topics differ"), "{output:?}");
        assert!(said.matches("messages  the same").count() >= topics, "{said}");
    }
    // With another planner another flight is planned, by the same map.
    run.configure(str::to_owned);
    let vehicle = run.path("config/vehicles/scout.ron");
    let text = std::fs::read_to_string(&vehicle).expect("readable");
    std::fs::write(&vehicle, text.replacen("lead_s: 0.06", "lead_s: 0.05", 1)).expect("writable");
    let (code, said, output) = replay(&["--playback-rate", "fast", "--config", "config/default.ron"]);
    let line = |topic: &str| said.lines().find(|line| line.starts_with(topic)).unwrap_or_else(|| panic!("{output:?}"));
    assert!(code == Some(1) && line("keyframe_set").ends_with("the same"), "{output:?}");
    assert!(!line("trajectory").ends_with("the same"), "{output:?}");
    // A range of it, over processes, as fast as it was flown: what was made of an image is the same, unless the image was missed.
    let _alone = common::real_time();
    let again = Run::new("again-slowly");
    let range =
        ["--from", "2", "--until", "4", "--playback-rate", "1", "--run", &again.name, "--summary", "summary.json"];
    let (code, said, output) = replay(&range);
    assert!(code == Some(0) && said.contains("replayed           25 images"), "{output:?}");
    let summary = std::fs::read_to_string(run.path("summary.json")).expect("a summary");
    let topics = &serde_json::from_str::<serde_json::Value>(&summary).expect("JSON")["topics"];
    let count = |topic: &str, what: &str| topics[topic][what].as_u64().expect("a number");
    let [now, same] = ["now", "same"].map(|what| count("disparity_image", what));
    assert!(same == now && now >= 20, "{topics}");
    assert!(count("trajectory", "now") >= 15, "{topics}");
    again.assert_nothing_left();
    for (arguments, expected) in [
        (&["--from", "900"][..], "look at --from and --until"),
        (&["--config", "config/fast.ron"], "its camera is not the one"),
        (&["--playback-rate", "0"], "allowed are 0.05 to 20"),
        (&["left.png"], "images and logs"),
        (&["--calib", "calib.txt"], "--calib is for images"),
    ] {
        let (code, _, output) = replay(arguments);
        assert!(code == Some(2) && String::from_utf8_lossy(&output.stderr).contains(expected), "{output:?}");
    }
    run.assert_nothing_left();
}

#[test]
fn damaged_and_hostile_logs_are_read_as_far_as_they_are_sound() {
    let run = Run::new("damage");
    let bytes = flown(&run, &[]);
    let path = run.path("damaged.mcap");
    let (counted, _) = readable(&path, &bytes).expect("readable");
    let mut random = rand_pcg::Pcg64Mcg::seed_from_u64(3);
    let mut fewest = counted;
    for _ in 0..150 {
        let mut damaged = bytes.clone();
        for _ in 0..random.random_range(1..4) {
            let at = random.random_range(8..damaged.len());
            damaged[at] ^= 1 << random.random_range(0..8);
        }
        // A damaged channel may claim to be of another version: then it is refused.
        if let Ok((messages, _)) = readable(&path, &damaged) {
            assert!(messages <= counted);
            fewest = fewest.min(messages);
        }
        let whole = run.path("whole.mcap");
        let _ = recover(&path, &whole);
        let _ = std::fs::remove_file(&whole);
    }
    assert!(fewest < counted, "something was damaged");
    // Lengths that no file has.
    for (opcode, length) in [(6, u64::MAX), (6, 1 << 62), (9, 1 << 40), (9, 3), (5, u64::MAX - 8), (3, 2)] {
        let mut hostile = bytes[..8].to_vec();
        hostile.push(opcode);
        hostile.extend_from_slice(&u64::to_le_bytes(length));
        hostile.extend_from_slice(&[0xff; 40]);
        assert_eq!(readable(&path, &hostile).expect("read as far as it goes").0, 0);
    }
    for no_log in [&b"not a log at all"[..], &[]] {
        let error = readable(&path, no_log).expect_err("refused");
        assert!(error.to_string().contains("magic"), "{error}");
        assert!(recover(&path, &run.path("never.mcap")).is_err() && !run.path("never.mcap").exists());
    }
}

/// The recorder is killed at 50 instants of a flight: of what lived longer than a second, all is readable until a second before.
#[test]
fn what_was_recorded_a_second_before_a_kill_is_readable() {
    let _alone = common::real_time();
    let run = Run::new("killed");
    // So many deaths are no crash loop here, nor is anybody to wait for its end.
    run.configure(|text| {
        let (before, recorder) = text.split_once("process: recorder").expect("listed");
        format!(
            "{before}process: recorder{}",
            recorder.replacen("most: 15", "most: 100", 1).replacen("longest_ms: 1000", "longest_ms: 2", 1)
        )
    });
    let mut random = rand_pcg::Pcg64Mcg::seed_from_u64(50);
    let mut at_s = 1.0;
    let mut kills = Vec::new();
    for _ in 0..50 {
        kills.push(at_s);
        at_s += random.random_range(0.5..1.6);
    }
    let faults: Vec<_> =
        kills.iter().map(|at_s| format!("(at_s: {at_s:.3}, fault: kill(process: recorder))")).collect();
    std::fs::write(run.path("faults.ron"), format!("(faults: [{}])", faults.join(", "))).expect("writable");
    let arguments = ["--config", "config/default.ron", "--noise-camera", "--speed", "1", "--faults", "faults.ron"];
    let flown = run.fly(&[&arguments[..], &["--time-limit", "56"]].concat());
    assert_eq!(flown.outcome(), "timed_out", "{}", String::from_utf8_lossy(&flown.output.stderr));
    let deaths = flown.summary["deaths"].as_array().expect("a list").iter();
    let deaths: Vec<_> = deaths.filter(|death| death["process"] == "recorder").collect();
    let folder = run.path("runs").join(&run.name);
    let (mut checked, mut least_s) = (0, f64::INFINITY);
    for (incarnation, death) in deaths.iter().enumerate() {
        let name = if incarnation == 0 { "log.mcap".to_owned() } else { format!("log.{incarnation}.mcap") };
        let killed_s = death["at_s"].as_f64().expect("a number");
        let began_s = incarnation.checked_sub(1).map_or(Some(0.0), |before| {
            Some(deaths[before]["at_s"].as_f64()? + 1e-3 * deaths[before]["recovered_ms"].as_f64()?)
        });
        // Of what lived for less, nothing is promised.
        if began_s.is_none_or(|began_s| killed_s - began_s < 1.1) {
            continue;
        }
        let mut published_s = Vec::new();
        let log = Log::open(&folder.join(&name)).unwrap_or_else(|error| panic!("{name}: {error}"));
        let read = log.each(|record| {
            if let Some(state) = record.header::<ipc_types::messages::VehicleState>() {
                published_s.push(state.stamp.published_ns as f64 * 1e-9);
            }
        });
        let read = read.unwrap_or_else(|error| panic!("{name}: {error}"));
        assert!(read.damage.is_open && read.no_messages == 0, "{name}: {read:?}");
        let last_s = published_s.last().copied().unwrap_or_else(|| panic!("{name} is empty"));
        assert!(last_s > killed_s - 1.0, "{name}: until {last_s} s of {killed_s} s");
        assert!(published_s.windows(2).all(|pair| pair[1] - pair[0] < 0.05), "{name} has gaps");
        (checked, least_s) = (checked + 1, least_s.min(last_s - killed_s));
    }
    let killed = deaths.len();
    println!("{killed} kills, {checked} files of more than a second, all until {:.2} s before", -least_s);
    assert!(killed >= 48 && checked >= 8, "{killed} {checked}");
    run.assert_nothing_left();
}

#[test]
fn a_large_recording_is_in_parts_and_another_versions_is_refused() {
    let run = Run::new("parts");
    run.configure(|text| text.replace("file_mib: 1024", "file_mib: 1"));
    let _alone = common::real_time();
    let arguments = ["--config", "config/default.ron", "--noise-camera", "--record-images", "--time-limit", "8"];
    let flown = run.fly(&arguments);
    assert!(["timed_out", "arrived"].contains(&flown.outcome()), "{}", flown.summary);
    let parts: Vec<_> =
        (2..).map(|part| run.log().with_extension(format!("part{part}.mcap"))).take_while(|p| p.exists()).collect();
    assert!(parts.len() >= 3, "{parts:?}");
    let mut sequences = Vec::new();
    for path in [run.log()].iter().chain(&parts) {
        let read = Log::open(path).expect("a log").each(|record| {
            if let Some(state) = record.header::<ipc_types::messages::VehicleState>() {
                sequences.push(state.stamp.sequence);
            }
        });
        assert!(read.expect("readable").damage.is_none(), "{} is whole", path.display());
    }
    assert!(sequences.windows(2).all(|pair| pair[1] == pair[0] + 1), "nothing is lost between them");
    // All parts are played, and what is made of them may be in parts, too.
    let log = run.log().display().to_string();
    let output = run.command(&["replay", &log, "--playback-rate", "fast", "--record-images"]).output().expect("starts");
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    let number = |line: &str| {
        said.lines()
            .find(|said| said.starts_with(line))
            .and_then(|line| line.split_whitespace().find_map(|word| word.parse::<usize>().ok()))
    };
    let images = number("replayed").unwrap_or_else(|| panic!("{output:?}"));
    assert!(images >= 60 && number("disparity_image") > Some(images - 10), "{said}");
    // A log whose messages were others.
    let log = Log::open(&run.log()).expect("a log");
    assert!(log.attachment("config.ron").expect("readable").is_some_and(|text| text.contains("file_mib: 1,")));
    let mut bytes = Vec::new();
    let mut writer = mcap::Writer::new(std::io::Cursor::new(&mut bytes)).expect("begun");
    let metadata = [("layout", "0123456789abcdef"), ("version", "sparrowhawk/Goal/1")];
    let metadata = metadata.into_iter().map(|(key, value)| (key.to_owned(), value.to_owned())).collect();
    writer.add_channel(0, "goal", "protobuf", &metadata).expect("added");
    writer.finish().expect("ended");
    drop(writer);
    let error = readable(&run.path("old.mcap"), &bytes).expect_err("refused").to_string();
    assert!(
        error.contains("sparrowhawk/Goal/1 of layout 0123456789abcdef") && error.contains("sparrowhawk/Goal/2"),
        "{error}"
    );
}
