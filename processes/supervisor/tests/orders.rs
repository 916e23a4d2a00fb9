//! Commands: who may, what is possible, and that nothing is followed late or twice.

use ipc_types::limits::Fence;
use ipc_types::messages::{Command, Order, VehicleState, Waypoint};
use ipc_types::wire::Text;
use ipc_types::{FlightTime, Point};
use proptest::prelude::*;
use supervisor::{AtGoal, Directive, HomeConfig, LinkConfig, LinkLoss, MissionConfig, Orders, Verdict};

const LINK: LinkConfig = LinkConfig { lost_s: 3.0, then: LinkLoss::Hover };

fn mission() -> MissionConfig {
    MissionConfig {
        start_m: [0.0, 0.0],
        start_heading_deg: 0.0,
        waypoints_m: Vec::new(),
        goal_m: [50.0, 0.0, 1.5],
        at_goal: AtGoal::Hover,
        cruise_speed_mps: 5.0,
        cruise_height_m: 1.5,
        home: HomeConfig { radius_m: 2.0, height_m: 3.0 },
        fence: Fence { least_m: [-10.0, -20.0, 0.0], most_m: [60.0, 20.0, 6.0] },
        time_limit_s: 100.0,
    }
}

fn at(seconds: f64) -> FlightTime {
    FlightTime::from_secs_f64(seconds)
}

fn command(operator: &str, number: u64, order: Order, expires_s: f64) -> Command {
    Command {
        number,
        expires_ns: at(expires_s).as_nanos(),
        order: order as u32,
        operator: Text::from(operator),
        ..bytemuck::Zeroable::zeroed()
    }
}

fn state() -> VehicleState {
    VehicleState { position_m: [7.0, 1.0, 1.5], ..bytemuck::Zeroable::zeroed() }
}

fn judge(orders: &mut Orders, now_s: f64, command: &Command, places: &[[f64; 3]]) -> Verdict {
    let places: Vec<_> = places.iter().map(|&position_m| Waypoint { position_m }).collect();
    orders.judge(at(now_s), command, &places, Some(&state()), &mission(), &LINK)
}

fn refused(verdict: &Verdict) -> &str {
    verdict.directive.as_ref().expect_err("refused")
}

#[test]
fn a_route_within_the_fence_is_followed() {
    let mut orders = Orders::default();
    let places = [[10.0, 5.0, 2.0], [20.0, -5.0, 2.0]];
    let route = Command { speed_mps: 3.0, ..command("ann", 1, Order::Route, 12.0) };
    let verdict = judge(&mut orders, 10.0, &route, &places);
    assert_eq!(verdict.directive, Ok(Directive::Route(places.to_vec(), Some(3.0))));
    assert_eq!(orders.commander(), Some("ann"));
}

#[test]
fn what_is_impossible_is_refused_with_its_reason() {
    let mut orders = Orders::default();
    let mut number = 0;
    let mut refusal = |order: Order, speed_mps: f64, places: &[[f64; 3]]| {
        number += 1;
        let command = Command { speed_mps, ..command("ann", number, order, 2.0) };
        refused(&judge(&mut orders, 1.0, &command, places)).to_owned()
    };
    assert!(refusal(Order::Route, 0.0, &[]).contains("0 places"));
    assert!(refusal(Order::Route, 0.0, &[[99.0, 0.0, 1.0]]).contains("outside the fence"));
    assert!(refusal(Order::Route, 0.0, &[[f64::NAN, 0.0, 1.0]]).contains("outside the fence"));
    assert!(refusal(Order::Route, 9.0, &[[9.0, 0.0, 1.0]]).contains("allowed is 0.2 to 5"));
    assert!(refusal(Order::Route, f64::NAN, &[[9.0, 0.0, 1.0]]).contains("allowed is"));
    assert!(refusal(Order::Route, 1.0, &[[9.0, 0.0, 1.0]; 65]).contains("65 places"));
    assert!(refusal(Order::Speed, 0.0, &[]).contains("how fast"));
    assert!(refusal(Order::Return, 0.0, &[]).contains("nothing was flown"));
    let unknown = Command { order: 77, ..command("ann", 100, Order::Hover, 2.0) };
    assert!(refused(&judge(&mut orders, 1.0, &unknown, &[])).contains("number 77"));
    assert!(refused(&judge(&mut orders, 1.0, &command("", 101, Order::Hover, 2.0), &[])).contains("who asks"));
}

#[test]
fn nothing_is_followed_late_twice_or_out_of_order() {
    let mut orders = Orders::default();
    assert!(refused(&judge(&mut orders, 10.0, &command("ann", 5, Order::Hover, 9.9), &[])).contains("expired"));
    assert!(refused(&judge(&mut orders, 10.0, &command("ann", 5, Order::Hover, 99.0), &[])).contains("allowed"));
    let hover = command("ann", 5, Order::Hover, 12.0);
    assert_eq!(judge(&mut orders, 10.0, &hover, &[]).directive, Ok(Directive::Hover));
    let again = judge(&mut orders, 10.5, &hover, &[]);
    assert_eq!((again.directive, again.is_repeated), (Ok(Directive::Nothing), true));
    assert!(refused(&judge(&mut orders, 10.6, &command("ann", 4, Order::Resume, 12.0), &[])).contains("out of order"));
    // A refusal that comes twice is the same refusal.
    let speed = command("ann", 6, Order::Speed, 12.0);
    let first = judge(&mut orders, 10.7, &speed, &[]);
    let second = judge(&mut orders, 10.8, &speed, &[]);
    assert!(first.directive == second.directive && second.is_repeated);
}

#[test]
fn one_commands_at_a_time_and_anybody_may_stop_it() {
    let mut orders = Orders::default();
    assert!(judge(&mut orders, 1.0, &command("ann", 1, Order::Take, 3.0), &[]).directive.is_ok());
    assert!(refused(&judge(&mut orders, 1.5, &command("bob", 1, Order::Land, 3.0), &[])).contains("ann commands"));
    assert_eq!(judge(&mut orders, 1.6, &command("bob", 2, Order::Hover, 3.0), &[]).directive, Ok(Directive::Hover));
    assert_eq!(orders.commander(), Some("ann"));
    // She is there, and then she is not.
    assert!(judge(&mut orders, 3.0, &command("ann", 2, Order::Present, 5.0), &[]).directive.is_ok());
    assert!(refused(&judge(&mut orders, 5.0, &command("bob", 3, Order::Resume, 7.0), &[])).contains("ann commands"));
    assert_eq!(judge(&mut orders, 6.5, &command("bob", 4, Order::Resume, 8.0), &[]).directive, Ok(Directive::Resume));
    assert_eq!(orders.commander(), Some("bob"));
}

#[test]
fn a_lost_link_has_its_consequence_once() {
    let mut orders = Orders::default();
    assert_eq!(orders.look(at(100.0), &LINK, &mission()), None, "nobody commanded");
    for x in 0..40 {
        orders.note_place(Point::new(f64::from(x), 0.0, 1.5));
    }
    judge(&mut orders, 0.5, &command("ann", 1, Order::Take, 3.0), &[]);
    assert_eq!(orders.clone().look(at(90.0), &LINK, &mission()), None, "who asks once and goes is not missed");
    judge(&mut orders, 1.0, &command("ann", 2, Order::Present, 3.0), &[]);
    assert_eq!(orders.look(at(3.9), &LINK, &mission()), None);
    let back = LinkConfig { then: LinkLoss::Return, ..LINK };
    let directive = orders.clone().look(at(4.0), &back, &mission()).expect("lost");
    let Directive::Route(way, None) = directive else { panic!("{directive:?}") };
    assert!(way[0][0] > 36.0 && way.last() == Some(&[0.0, 0.0, 1.5]) && way.len() <= 21, "{way:?}");
    assert_eq!(orders.clone().look(at(4.0), &LinkConfig { then: LinkLoss::Continue, ..LINK }, &mission()), None);
    assert_eq!(orders.look(at(4.0), &LINK, &mission()), Some(Directive::Hover));
    assert!(orders.is_link_lost() && orders.look(at(5.0), &LINK, &mission()).is_none(), "once");
    judge(&mut orders, 6.0, &command("ann", 3, Order::Present, 8.0), &[]);
    assert_eq!(orders.look(at(6.1), &LINK, &mission()), None);
    assert_eq!(orders.look(at(9.0), &LINK, &mission()), Some(Directive::Hover), "lost again");
}

#[test]
fn the_way_back_is_never_too_long_for_a_route() {
    let mut orders = Orders::default();
    for step in 0..100_000 {
        orders.note_place(Point::new(0.5 * f64::from(step), 0.0, 1.5));
    }
    let far = MissionConfig { fence: Fence { least_m: [-1e6; 3], most_m: [1e6; 3] }, ..mission() };
    let back = command("ann", 1, Order::Return, 2.0);
    let verdict = orders.judge(at(1.0), &back, &[], Some(&state()), &far, &LINK);
    let Ok(Directive::Route(way, None)) = verdict.directive else { panic!("{verdict:?}") };
    assert!((20..64).contains(&way.len()) && way.last() == Some(&[0.0, 0.0, 1.5]), "{}", way.len());
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

    /// Whatever comes, and whenever: nothing follows from what has expired, nothing from what was followed, and no place
    /// outside the fence is flown to.
    #[test]
    fn whatever_comes_nothing_forbidden_follows(
        commands in prop::collection::vec(
            (0_u8..3, 0_u64..6, 0_u32..12, -5.0..70.0, -30.0..30.0, 0.0..8.0, 0.0..2.0), 1..60),
    ) {
        let (mut orders, mut now_s) = (Orders::default(), 0.0);
        let mut followed = std::collections::HashMap::new();
        for (operator, number, order, expires_s, y, speed_mps, later_s) in commands {
            now_s += later_s;
            let name = format!("operator {operator}");
            let command = Command {
                number, order, speed_mps,
                expires_ns: at(now_s + expires_s).as_nanos(),
                operator: Text::from(name.as_str()),
                ..bytemuck::Zeroable::zeroed()
            };
            let verdict = judge(&mut orders, now_s, &command, &[[5.0, y, 1.5]]);
            prop_assert!(expires_s > 0.0 || verdict.directive.is_err() || verdict.is_repeated);
            let Ok(directive) = verdict.directive else { continue };
            let last = followed.get(&name).copied();
            // To be there has no number, and to stop is never too often.
            let has_number = order != Order::Present as u32 && order != Order::Hover as u32;
            prop_assert!(verdict.is_repeated || !has_number || last.is_none_or(|last| number > last));
            if verdict.is_repeated {
                prop_assert_eq!(directive, Directive::Nothing);
                continue;
            }
            if order != Order::Present as u32 {
                followed.entry(name).and_modify(|last: &mut u64| *last = number.max(*last)).or_insert(number);
            }
            if let Directive::Route(places, speed) = directive {
                prop_assert!(places.iter().all(|p| mission().fence.contains(Point::from_array(*p))));
                prop_assert!(speed.is_none_or(|speed| (0.2..=5.0).contains(&speed)));
            }
        }
    }
}
