//! OctoMap files (.bt): whatever the bytes, they are refused, or are a map of boxes.

#![no_main]

use libfuzzer_sys::fuzz_target;
use simulator::Octomap;

fuzz_target!(|data: &[u8]| {
    if let Ok(map) = Octomap::parse(data) {
        let _ = (map.leaves(), map.bounds_m(), map.floor_m(), map.boxes().map(|boxes| boxes.len()));
    }
});
