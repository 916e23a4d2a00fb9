//! Commands, one after the other, each judged at a time of its own: none is followed that has run out, that was followed before,
//! or whose places lie outside the fence.

#![no_main]

use ipc_types::limits::Fence;
use ipc_types::messages::{Command, VehicleState};
use ipc_types::topics::{Commands, State};
use ipc_types::{FlightTime, Point};
use libfuzzer_sys::fuzz_target;
use std::collections::HashMap;
use supervisor::{AtGoal, Directive, HomeConfig, LinkConfig, LinkLoss, MissionConfig, Orders};

const LINK: LinkConfig = LinkConfig { lost_s: 3.0, then: LinkLoss::Hover };
const FENCE: Fence = Fence { least_m: [-10.0, -20.0, 0.0], most_m: [60.0, 20.0, 6.0] };

fuzz_target!(|data: &[u8]| {
    let mission = MissionConfig {
        start_m: [0.0, 0.0],
        start_heading_deg: 0.0,
        waypoints_m: Vec::new(),
        goal_m: [50.0, 0.0, 1.5],
        at_goal: AtGoal::Hover,
        cruise_speed_mps: 5.0,
        cruise_height_m: 1.5,
        home: HomeConfig { radius_m: 2.0, height_m: 3.0 },
        fence: FENCE,
        time_limit_s: 100.0,
    };
    let (mut orders, mut now_ns, mut rest) = (Orders::default(), 0_i64, data);
    let mut followed: HashMap<String, u64> = HashMap::new();
    // Of an empty message all is zero.
    let (zero, _) = encoding::decode_message::<State>(0, &[]).expect("a message");
    let state = VehicleState { position_m: [7.0, 1.0, 1.5], ..zero };
    // A length, the time that passes, and the bytes of a command.
    while let Some((&[length, passes], behind)) = rest.split_first_chunk() {
        let (bytes, behind) = behind.split_at(behind.len().min(usize::from(length)));
        rest = behind;
        now_ns += i64::from(passes) * 20_000_000;
        let now = FlightTime::from_nanos(now_ns);
        orders.look(now, &LINK, &mission);
        let Ok((command, places)) = encoding::decode_message::<Commands>(Command::MOST_PLACES, bytes) else { continue };
        let verdict = orders.judge(now, &command, &places, Some(&state), &mission, &LINK);
        let Ok(directive) = verdict.directive else { continue };
        if matches!(directive, Directive::Nothing) {
            continue;
        }
        assert!(command.expires_ns >= now_ns, "followed though it had run out");
        // To stop is never too often, in whatever order.
        if matches!(directive, Directive::Hover) {
            continue;
        }
        let last = followed.insert(command.operator.to_string_lossy(), command.number);
        assert!(last.is_none_or(|last| last < command.number), "followed twice");
        if let Directive::Route(places, _) = directive {
            assert!(places.iter().all(|&place| FENCE.contains(Point::from_array(place))), "outside the fence");
        }
    }
});
