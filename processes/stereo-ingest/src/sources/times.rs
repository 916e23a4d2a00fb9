//! Times of exposures in file names and lists, to the nanosecond: a float would lose them.

/// The year 2000.
const LEAST_EPOCH_NS: i64 = 946_684_800_000_000_000;

/// A time in a file name, since 1970: milli-, micro- or nanoseconds, or seconds with a point. Other numbers count frames.
pub(super) fn time_in(name: &str) -> Option<i64> {
    let is_number = |text: &str| !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit());
    if is_number(name) && [13, 16, 19].contains(&name.len()) {
        return format!("{name:0<19}").parse().ok().filter(|at_ns| *at_ns >= LEAST_EPOCH_NS);
    }
    let (whole, fraction) = name.split_once('.')?;
    (is_number(whole) && is_number(fraction) && whole.len() >= 9).then(|| seconds_as_ns(name)).flatten()
}

/// Decimal seconds, to the nanosecond: a float would lose them.
pub(super) fn seconds_as_ns(text: &str) -> Option<i64> {
    let text = text.trim();
    if text.contains(['e', 'E']) {
        return text.parse::<f64>().ok().filter(|seconds| seconds.is_finite()).map(|seconds| (seconds * 1e9) as i64);
    }
    let (whole, fraction) = text.split_once('.').unwrap_or((text, ""));
    let digits = fraction.get(..9).unwrap_or(fraction);
    let nanoseconds: i64 = format!("{digits:0<9}").parse().ok().filter(|part| *part >= 0)?;
    let signed = if whole.starts_with('-') { -nanoseconds } else { nanoseconds };
    whole.parse::<i64>().ok()?.checked_mul(1_000_000_000)?.checked_add(signed)
}

/// A date and a time of day, as KITTI's raw recordings have them: 2011-09-26 13:02:25.964389445.
pub(super) fn date_as_ns(text: &str) -> Option<i64> {
    let (date, time) = text.trim().split_once(' ')?;
    let [year, month, day]: [i64; 3] = numbers(date, '-')?;
    let (clock, fraction) = time.split_once('.').unwrap_or((time, "0"));
    let [hour, minute, second]: [i64; 3] = numbers(clock, ':')?;
    let plausible = (1970..2200).contains(&year) && (1..=12).contains(&month) && (1..=31).contains(&day);
    // Days since 1970 of a calendar whose years begin in March, so that leap days come last.
    let (shifted, months) = (year - i64::from(month < 3), (month + 9) % 12);
    let leaps = shifted / 4 - shifted / 100 + shifted / 400;
    let days = 365 * shifted + leaps + (153 * months + 2) / 5 + day - 719_469;
    let seconds = days * 86_400 + hour * 3600 + minute * 60 + second;
    plausible.then(|| seconds_as_ns(&format!("{seconds}.{fraction}"))).flatten()
}

fn numbers(text: &str, separator: char) -> Option<[i64; 3]> {
    let parts: Option<Vec<i64>> = text.split(separator).map(|part| part.parse().ok()).collect();
    parts?.try_into().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_keep_their_nanoseconds() {
        assert_eq!(time_in("1403715273262142976"), Some(1_403_715_273_262_142_976));
        assert_eq!(time_in("1403715273262142"), Some(1_403_715_273_262_142_000));
        assert_eq!(time_in("1403715273262"), Some(1_403_715_273_262_000_000));
        assert_eq!((time_in("0000000000000042"), time_in("20260101")), (None, None), "counters and dates");
        assert_eq!(time_in("1305031102.160407"), Some(1_305_031_102_160_407_000));
        assert_eq!((time_in("000042"), time_in("frame.1"), time_in("99999999999999999999")), (None, None, None));
        assert_eq!(seconds_as_ns("1.5e+01"), Some(15_000_000_000));
        assert_eq!((seconds_as_ns("-1.5"), seconds_as_ns("-0.25")), (Some(-1_500_000_000), Some(-250_000_000)));
        assert_eq!(date_as_ns("1970-01-01 00:00:00"), Some(0));
        assert_eq!(date_as_ns("2011-09-26 13:02:25.964389445"), Some(1_317_042_145_964_389_445));
        assert_eq!(date_as_ns("2024-02-29 23:59:59.5"), Some(1_709_251_199_500_000_000));
        assert_eq!((date_as_ns("2011-13-26 13:02:25"), date_as_ns("12.5")), (None, None));
    }
}
