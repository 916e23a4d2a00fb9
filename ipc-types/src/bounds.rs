//! Collects every violation of a configuration's bounds, so that all of them are reported together.

use std::fmt::{Debug, Display};
use std::ops::RangeInclusive;

/// Violations found so far, and the path of the section being checked.
#[derive(Debug, Default)]
pub struct Bounds {
    section: Vec<String>,
    violations: Vec<String>,
}

impl Bounds {
    /// Checks a nested section: `path` is prefixed to what `check` reports.
    pub fn section(&mut self, path: &str, check: impl FnOnce(&mut Self)) {
        self.section.push(path.to_owned());
        check(self);
        self.section.pop();
    }

    /// `value` must lie in `allowed`; NaN never does.
    pub fn range<T: PartialOrd + Display + Debug>(&mut self, key: &str, value: T, allowed: RangeInclusive<T>) {
        if !allowed.contains(&value) {
            let (low, high) = (allowed.start(), allowed.end());
            self.violation(key, format_args!("is {value}, allowed is {low} to {high}"));
        }
    }

    /// A condition that ties several values together; `message` says which and why.
    pub fn require(&mut self, condition: bool, key: &str, message: impl Display) {
        if !condition {
            self.violation(key, message);
        }
    }

    fn violation(&mut self, key: &str, message: impl Display) {
        let mut path = self.section.join(".");
        if !path.is_empty() && !key.is_empty() {
            path.push('.');
        }
        self.violations.push(format!("{path}{key} {message}"));
    }

    /// Every violation, in the order found.
    pub fn into_violations(self) -> Vec<String> {
        self.violations
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reports_all_violations_with_their_path_and_range() {
        let mut bounds = Bounds::default();
        bounds.section("planner", |bounds| {
            bounds.range("speed_mps", f64::NAN, 0.1..=20.0);
            bounds.range("samples", 0, 1..=9);
            bounds.range("fine", 1, 1..=9);
        });
        let violations = bounds.into_violations();
        assert_eq!(violations.len(), 2);
        assert_eq!(violations[0], "planner.speed_mps is NaN, allowed is 0.1 to 20");
        assert!(violations[1].starts_with("planner.samples is 0"));
    }
}
