//! Clouds of points (Foxglove's), as they come to the ground: whatever the bytes, they are refused, or finite points.

#![no_main]

use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| {
    if let Some((_, points)) = encoding::points(data) {
        assert!(points.len() <= data.len(), "no more than were sent");
    }
});
