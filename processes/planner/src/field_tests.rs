//! The cost-to-go on maps made by hand.

use super::*;
use crate::fixtures::{FENCE, RIG, before, home_only};

const ASK: Ask = Ask { threshold: 0.9, unknown_price: 0.3, clearance_price: 0.0, height_m: 2.0, height_price: 0.5 };
const GOAL: Point<World> = Point::new(40.0, 0.0, 2.0);
const AT: Point<World> = Point::new(0.0, 0.0, 2.0);

#[test]
fn it_is_the_straight_distance_where_all_is_free() {
    let mut field = Field::new(10.0, 1.0);
    field.update(&home_only(200.0), &FENCE, AT, GOAL, ASK);
    for point in [AT, Point::new(5.0, 3.0, 2.0), Point::new(-4.0, -6.0, 2.0)] {
        let (found, straight) = (field.to_goal_m(point), point.distance(GOAL));
        assert!((straight - 0.1..straight * 1.09).contains(&found), "{point:?}: {found}, straight {straight}");
    }
    let beyond = field.to_goal_m(Point::new(13.0, 0.0, 2.0));
    assert!((27.0..35.0).contains(&beyond), "beyond the grid there is no cliff: {beyond}");
}

#[test]
fn unknown_space_is_dear_and_a_closed_rim_dearer() {
    let mut field = Field::new(10.0, 1.0);
    field.update(&home_only(3.0), &FENCE, AT, GOAL, ASK);
    let known = field.to_goal_m(AT);
    assert!(known > 40.0 + 0.2 * (10.0 - 3.0), "{known}");
    let narrow = Fence { most_m: [6.0, 50.0, 6.0], ..FENCE };
    field.update(&home_only(200.0), &narrow, AT, GOAL, ASK);
    assert!(field.to_goal_m(AT) > known, "the rim towards the goal is closed");
}

#[test]
fn the_way_leads_downhill() {
    let mut field = Field::new(10.0, 1.0);
    field.update(&home_only(200.0), &FENCE, AT, GOAL, ASK);
    let downhill = field.downhill(Point::new(1.0, 0.5, 2.0)).expect("a way");
    assert!(downhill.x > 0.98 && (downhill.norm() - 1.0).abs() < 1e-9, "{downhill:?}");
    assert_eq!(field.downhill(Point::new(50.0, 0.0, 2.0)), None, "beyond the grid");
}

#[test]
fn a_way_leads_to_the_goal_and_costs_what_it_crosses() {
    let (mut field, mut way) = (Field::new(10.0, 1.0), Vec::new());
    let going = |way: &[Point<World>]| -> Vec<Sample> {
        way.iter().map(|&position| Sample { position, velocity: Vector::ZERO }).collect()
    };
    field.update(&home_only(200.0), &FENCE, AT, GOAL, ASK);
    field.way(AT, 8.0, &mut way);
    let end = way.last().expect("a way");
    assert!((end.x - 8.0).abs() < 0.3 && end.y.abs() < 0.3 && (end.z - 2.0).abs() < 0.1, "{end:?}");
    assert_eq!(field.beyond_length_m(&going(&way)), 0.0);
    // Known for 3 m alone, and never seen before: what lies beyond costs its price.
    let mut field = Field::new(10.0, 1.0);
    field.update(&home_only(3.0), &FENCE, AT, GOAL, ASK);
    let cost_m = field.beyond_length_m(&going(&way));
    assert!((cost_m - 0.3 * 5.0).abs() < 0.2, "{cost_m}");
    // Across the fence all is closed.
    let narrow = Fence { most_m: [4.0, 50.0, 6.0], ..FENCE };
    field.update(&home_only(200.0), &narrow, AT, GOAL, ASK);
    let cost_m = field.beyond_length_m(&going(&way));
    assert!((cost_m - (CLOSED_PRICE - 1.0) * 4.0).abs() < 6.0, "{cost_m}");
    assert_eq!(field.beyond_length_m(&[]), 0.0);
}

#[test]
fn hostile_points_are_far() {
    let mut field = Field::new(10.0, 1.0);
    field.update(&home_only(200.0), &FENCE, AT, GOAL, ASK);
    for hostile in [f64::NAN, f64::INFINITY, -1e300] {
        assert!(!field.to_goal_m(Point::new(hostile, 0.0, 2.0)).is_finite() || hostile.is_finite());
        assert!(!field.to_goal_m(Point::new(0.0, 0.0, hostile)).is_nan());
        field.update(&home_only(200.0), &FENCE, Point::new(hostile, 1e300, hostile), GOAL, ASK);
        field.update(&home_only(200.0), &FENCE, AT, Point::new(hostile, hostile, hostile), ASK);
        field.update(&home_only(200.0), &FENCE, AT, GOAL, Ask { height_m: hostile, ..ASK });
    }
}

/// All is free but a slab across the way from 4 to 6 m, up to a height of 3 m, as far as the image reaches to either side.
fn before_a_low_wall() -> View {
    before(|_, row| {
        let up = (RIG.cy_px - row as f64) / RIG.focal_px;
        if up * 4.0 < 1.0 { [4.0, 6.0] } else { [40.0, 40.0] }
    })
}

#[test]
fn a_low_wall_is_passed_over_and_behind_it_the_way_comes_down_again() {
    let (mut field, mut way, view) = (Field::new(10.0, 1.0), Vec::new(), before_a_low_wall());
    // No way leads around it.
    let fence = Fence { least_m: [-20.0, -2.5, 0.5], most_m: [50.0, 2.5, 6.0] };
    field.update(&view, &fence, AT, GOAL, ASK);
    let to_goal_m = field.to_goal_m(AT);
    assert!((40.9..44.0).contains(&to_goal_m), "{to_goal_m}");
    assert!(field.height_m(AT) > 2.9, "it rises at once: {}", field.height_m(AT));
    field.way(AT, 15.0, &mut way);
    assert!(way.iter().filter(|place| (4.2..5.8).contains(&place.x)).all(|place| place.z > 2.8), "{way:?}");
    assert!(way.iter().all(|place| place.y.abs() < 1.5), "{way:?}");
    field.update(&view, &fence, Point::new(7.5, 0.0, 4.0), GOAL, ASK);
    assert!(field.height_m(Point::new(7.5, 0.0, 4.0)) < 2.1, "behind it");
    // Where the fence ends below its top there is no way left.
    let low = Fence { most_m: [50.0, 2.5, 2.5], ..fence };
    field.update(&view, &low, AT, GOAL, ASK);
    assert!(field.to_goal_m(AT) > to_goal_m + 5.0, "{}", field.to_goal_m(AT));
    // Where there is no way at all it keeps its height.
    field.update(&view, &Fence { most_m: [-19.0, 2.5, 6.0], ..fence }, AT, GOAL, ASK);
    assert!(field.to_goal_m(AT).is_infinite() && field.height_m(AT) == 2.0);
}

#[test]
fn a_passage_lower_than_the_levels_lie_apart_may_lie_between_two() {
    // A slab across the way from 4 to 6 m, open from 1.2 to 1.8 m of height.
    let view = before(|_, row| {
        let z_m = 2.0 + 4.0 * (RIG.cy_px - row as f64) / RIG.focal_px;
        if (1.2..1.8).contains(&z_m) { [40.0, 40.0] } else { [4.0, 6.0] }
    });
    let fence = Fence { least_m: [-20.0, -2.5, 0.5], most_m: [50.0, 2.5, 3.5] };
    let (mut coarse, mut fine) = (Field::new(10.0, 1.0), Field::new(10.0, 0.3));
    coarse.update(&view, &fence, AT, GOAL, ASK);
    fine.update(&view, &fence, AT, GOAL, ASK);
    assert!((40.0..42.0).contains(&fine.to_goal_m(AT)), "{}", fine.to_goal_m(AT));
    assert!((1.2..1.8).contains(&fine.height_m(AT)), "{}", fine.height_m(AT));
    assert!(coarse.to_goal_m(AT) > fine.to_goal_m(AT) + 5.0, "{}", coarse.to_goal_m(AT));
}

#[test]
fn it_costs_no_more_far_from_the_goal_and_whatever_the_prices() {
    let view = before_a_low_wall();
    let mut field = Field::new(10.0, 1.0);
    let most = PUSHES * LEVELS * field.grid.cells();
    for ask in [ASK, Ask { unknown_price: 100.0, clearance_price: 100.0, height_price: 100.0, ..ASK }] {
        for away_m in [5.0, 50.0, 1e3, 1e5] {
            field.update(&view, &FENCE, Point::new(0.0, 0.0, 2.5), Point::new(away_m, away_m, 2.0), ask);
            assert!(field.known.len() > 3 && field.queue.count() <= most, "{away_m}: {}", field.queue.count());
        }
    }
}

#[test]
fn its_levels_hold_the_vehicle_wherever_it_is() {
    let view = before_a_low_wall();
    let fence = Fence { least_m: [-20.0, -2.5, 0.5], most_m: [50.0, 2.5, 9.0] };
    let asked = [(2.0, 5.5), (7.0, 2.0)];
    for (rise_m, (z_m, height_m)) in [0.3, 1.0, 2.0].into_iter().flat_map(|rise_m| asked.map(|asked| (rise_m, asked))) {
        let mut field = Field::new(10.0, rise_m);
        let at = Point::new(0.0, 0.0, z_m);
        field.update(&view, &fence, at, GOAL, Ask { height_m, ..ASK });
        let heights: Vec<_> = field.known.clone().map(|level| field.levels[level].z_m).collect();
        let [lowest, highest] = [heights[0], heights[heights.len() - 1]];
        assert!(lowest <= z_m && highest >= z_m, "{heights:?}");
        assert_eq!(field.price_at(Point::new(5.0, 0.0, z_m)).is_infinite(), z_m < 3.0, "the wall is there for it");
    }
}

#[test]
fn a_cell_is_asked_at_the_same_places_wherever_the_vehicle_is() {
    let (mut field, view) = (Field::new(10.0, 1.0), before_a_low_wall());
    let mut prices = Vec::new();
    for step in 0..6 {
        let at = Point::new(0.21 * f64::from(step), 0.0, 2.5);
        field.update(&view, &FENCE, at, GOAL, ASK);
        let price = |x: i32| field.price_at(Point::new(0.4 * f64::from(x) + 0.2, 0.2, 4.0));
        prices.push((5..20).map(price).collect::<Vec<_>>());
    }
    assert!(prices.iter().all(|row| *row == prices[0]), "{prices:?}");
}
