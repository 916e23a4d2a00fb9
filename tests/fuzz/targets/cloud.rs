//! Clouds of points (Foxglove's), as they come to the ground: whatever the bytes, they are refused, or no more points than they
//! have room for.

#![no_main]

use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| {
    if let Some((_, points)) = encoding::points(data) {
        assert!(12 * points.len() <= data.len(), "three numbers of four bytes each");
    }
});
