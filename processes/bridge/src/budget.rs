//! How much may be sent: what matters most goes first, and images only with what is left.

use ipc_types::HostTime;

/// What a message is worth.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Class {
    /// Goes whatever happens: it is little.
    Vital,
    /// Goes unless the budget was overdrawn by a quarter of a second.
    Useful,
    /// Goes with what is left.
    Bulk,
}

/// A budget that fills up over time. What is sent is taken from it, even if it is overdrawn.
#[derive(Debug)]
pub(crate) struct Budget {
    bytes_per_s: f64,
    left: f64,
    at: HostTime,
}

/// The budget is never fuller than for so long, s.
const SAVED_S: f64 = 0.5;
/// It is overdrawn so far, s, before what is useful waits.
const OVERDRAWN_S: f64 = 0.25;

impl Budget {
    pub(crate) fn new(kbit_s: u32, now: HostTime) -> Self {
        let bytes_per_s = f64::from(kbit_s) * 125.0;
        Self { bytes_per_s, left: SAVED_S * bytes_per_s, at: now }
    }

    /// Whether so many bytes may be sent now.
    pub(crate) fn spend(&mut self, now: HostTime, class: Class, bytes: usize) -> bool {
        let bytes = bytes as f64;
        self.left += self.bytes_per_s * now.saturating_since(self.at).as_secs_f64();
        self.left = self.left.min(SAVED_S * self.bytes_per_s);
        self.at = now;
        let may = match class {
            Class::Vital => true,
            Class::Useful => self.left > -OVERDRAWN_S * self.bytes_per_s,
            Class::Bulk => self.left >= bytes,
        };
        if may {
            self.left = (self.left - bytes).max(-self.bytes_per_s);
        }
        may
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Offered far more than fits: all that is vital goes, and no more than the budget.
    #[test]
    fn telemetry_survives_where_images_do_not() {
        let at = |ms: i64| HostTime::from_nanos(ms * 1_000_000);
        let mut budget = Budget::new(250, at(0));
        let mut sent = [0; 3];
        for ms in 0..10_000 {
            for (class, every_ms, bytes) in
                [(Class::Bulk, 100, 9000), (Class::Useful, 100, 600), (Class::Vital, 50, 150)]
            {
                if ms % every_ms == 0 && budget.spend(at(ms), class, bytes) {
                    sent[class as usize] += bytes;
                }
            }
        }
        assert_eq!(sent[0], 200 * 150);
        assert_eq!(sent[1], 100 * 600);
        let most = 250 * 125 * 10 + 250 * 125 / 2;
        assert!(sent[2] > 0 && sent.iter().sum::<usize>() <= most, "{sent:?}");
    }
}
