//! Log files: whatever the bytes, they are refused, or read as far as they are sound.

#![no_main]

use libfuzzer_sys::fuzz_target;
use recorder::Log;

fuzz_target!(|data: &[u8]| {
    // The first bytes of every log, which are hard to guess and no news.
    let bytes = [mcap::MAGIC, data].concat();
    let log = Log::of(bytes).expect("it begins as a log does");
    let mut messages = 0_u64;
    let _ = log.each(|record| messages += u64::from(!record.to_json().is_null()));
    let _ = log.attachment("config.ron");
    let _ = log.views(encoding::View::Left, |_| messages += 1);
});
