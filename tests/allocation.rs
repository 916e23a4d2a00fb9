//! After warm-up the cores that every image passes allocate nothing.

use expansion::Expander;
use ipc_types::disparity::decode;
use sparrowhawk::config::FlightConfig;
use stats_alloc::{INSTRUMENTED_SYSTEM, Region, StatsAlloc};
use std::alloc::System;
use stereo_ingest::Matcher;

#[global_allocator]
static ALLOCATOR: &StatsAlloc<System> = &INSTRUMENTED_SYSTEM;

#[test]
fn matching_and_expanding_allocate_nothing() {
    let vehicle = FlightConfig::load(None, None).expect("loads").vehicle;
    let rig = vehicle.rig;
    let (width, pixels) = (rig.width_px as usize, rig.pixels());
    let texture = |index: usize| (index.wrapping_mul(2_654_435_761) >> 7) as u8;
    let left: Vec<u8> = (0..pixels).map(texture).collect();
    let right: Vec<u8> =
        (0..pixels).map(|index| texture((index + 12).min(index / width * width + width - 1))).collect();
    let mut matcher = Matcher::new(&rig, vehicle.stereo);
    let mut expander = Expander::new(rig, &vehicle.noise, vehicle.stereo.max_disparity_px, vehicle.expansion);
    let (mut disparity, mut planes) = (vec![0; pixels], vec![0; 3 * pixels]);
    let mut step = || {
        matcher.step(&left, &right, &mut disparity).expect("sizes agree");
        expander.step(&disparity, &mut planes).expect("sizes agree");
    };
    step();
    let region = Region::new(ALLOCATOR);
    step();
    let change = region.change();
    assert_eq!((change.allocations, change.reallocations), (0, 0), "{change:?}");
    let found = disparity.iter().filter_map(|&pixel| decode(pixel)).filter(|d| (d - 12.0).abs() < 0.5).count();
    assert!(found > pixels / 2, "it does its work: {found} of {pixels} pixels matched");
}
