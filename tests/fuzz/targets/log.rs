//! Log files: whatever the bytes, they are refused, or read as far as they are sound; and so is what a graph was fed with.

#![no_main]

use libfuzzer_sys::fuzz_target;
use recorder::{Feed, Inputs, Log};

fuzz_target!(|data: &[u8]| {
    // The first bytes of every log, which are hard to guess and no news.
    let bytes = [mcap::MAGIC, data].concat();
    let logs = [Log::of(bytes).expect("it begins as a log does")];
    let mut messages = 0_u64;
    let _ = logs[0].each(|record| messages += u64::from(!record.to_json().is_null()));
    let _ = logs[0].attachment("config.ron");
    for feed in [Feed::Frames, Feed::Disparity] {
        if let Ok(inputs) = Inputs::of(&logs, &(0.0..=1e9), feed) {
            assert!(inputs.inputs.windows(2).all(|pair| pair[0].published() <= pair[1].published()));
        }
    }
});
