//! What a fault campaign came to: a row for every fault, and a table of fault × victim.

use crate::fault_flight::{Flown, Verdict};
use ipc_types::messages::Rung;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fmt::Write;

/// A fault and what followed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct FaultRow {
    pub(crate) plan: String,
    pub(crate) seed: u64,
    pub(crate) at_s: f64,
    pub(crate) fault: String,
    pub(crate) victim: String,
    /// What the flight came to.
    pub(crate) verdict: Verdict,
    /// From the fault to when the victim was reaped, ms; absent if it did not die of it.
    pub(crate) detected_ms: Option<f64>,
    /// From then to its successor's first output, ms.
    pub(crate) recovered_ms: Option<f64>,
    /// The deepest rung of the ladder within a few seconds.
    pub(crate) rung: String,
    pub(crate) clock_ratio: Option<f64>,
    /// Of the flight.
    pub(crate) min_clearance_m: Option<f64>,
    pub(crate) flight_time_s: f64,
    pub(crate) takeovers: u32,
    pub(crate) restarts: u32,
    pub(crate) leaked: usize,
    pub(crate) version: String,
}

/// A consequence comes within this time, s.
const CONSEQUENCE_S: f64 = 3.0;

/// What a flight without faults has in their place.
pub(crate) const NONE: &str = "none";

/// The rows of a flight.
pub(crate) fn rows(plan: &str, seed: u64, flown: &Flown, version: &str) -> Vec<FaultRow> {
    // A flight that ended before anything was injected counts, too.
    let none = supervisor::FaultSummary { at_s: 0.0, fault: NONE.to_owned(), victim: String::new(), clock_ratio: None };
    let faults = flown.summary.as_ref().map_or(&[][..], |summary| &summary.faults);
    let none = faults.is_empty().then_some(none);
    faults.iter().chain(&none).map(|fault| row((plan, seed), flown, fault, version)).collect()
}

fn row((plan, seed): (&str, u64), flown: &Flown, fault: &supervisor::FaultSummary, version: &str) -> FaultRow {
    let summary = flown.summary.as_ref();
    let soon = |at_s: f64| (fault.at_s - 0.02..fault.at_s + CONSEQUENCE_S).contains(&at_s);
    let deaths = summary.map_or(&[][..], |summary| &summary.deaths);
    let death = deaths.iter().find(|death| death.process == fault.victim && soon(death.at_s));
    let steps = summary.map_or(&[][..], |summary| &summary.degradation);
    let deepest = steps.iter().filter(|step| soon(step.at_s)).max_by_key(|step| Rung::from_name(&step.rung));
    FaultRow {
        plan: plan.to_owned(),
        seed,
        at_s: fault.at_s,
        fault: fault.fault.clone(),
        victim: fault.victim.clone(),
        verdict: flown.verdict,
        detected_ms: death.map(|death| 1e3 * (death.at_s - fault.at_s).max(0.0)),
        recovered_ms: death.and_then(|death| death.recovered_ms),
        rung: deepest.map_or(Rung::Full.name(), |step| &step.rung).to_owned(),
        clock_ratio: fault.clock_ratio,
        min_clearance_m: summary.and_then(|summary| summary.min_clearance_m),
        flight_time_s: summary.map_or(0.0, |summary| summary.flight_time_s),
        takeovers: summary.map_or(0, |summary| summary.takeovers),
        restarts: summary.map_or(0, |summary| summary.restarts),
        leaked: flown.leaked,
        version: version.to_owned(),
    }
}

/// p50, p99 and longest; empty of nothing.
fn percentiles(mut values: Vec<f64>) -> String {
    values.sort_by(f64::total_cmp);
    let at = |share: f64| values.get(((values.len() as f64 * share).ceil() as usize).clamp(1, values.len().max(1)) - 1);
    match (at(0.5), at(0.99), values.last()) {
        (Some(p50), Some(p99), Some(most)) => format!("{p50:.0} / {p99:.0} / {most:.0}"),
        _ => "–".to_owned(),
    }
}

/// The table of fault × victim, as Markdown.
pub(crate) fn markdown(rows: &[FaultRow]) -> String {
    let mut groups: BTreeMap<(&str, &str), Vec<&FaultRow>> = BTreeMap::new();
    for row in rows {
        groups.entry((&row.fault, &row.victim)).or_default().push(row);
    }
    let mut text = String::new();
    // Writing to a string cannot fail.
    let _ = writeln!(
        text,
        "| fault | victim | faults | flights | arrived | hovered | late | failed | void | deepest rung | noticed, ms | back, ms | least clearance, m |"
    );
    let _ = writeln!(text, "|---|---|---:|---:|---:|---:|---:|---:|---:|---|---:|---:|---:|");
    for ((fault, victim), rows) in groups {
        let flights: BTreeMap<(&str, u64), Verdict> =
            rows.iter().map(|row| ((row.plan.as_str(), row.seed), row.verdict)).collect();
        let count = |verdict| flights.values().filter(|found| **found == verdict).count();
        let mut rungs: BTreeMap<&str, usize> = BTreeMap::new();
        rows.iter().for_each(|row| *rungs.entry(&row.rung).or_default() += 1);
        let rungs: Vec<_> = rungs
            .iter()
            .map(|(rung, count)| format!("{rung} {:.0} %", 100.0 * *count as f64 / rows.len() as f64))
            .collect();
        let clearance = rows.iter().filter_map(|row| row.min_clearance_m).fold(f64::INFINITY, f64::min);
        let _ = writeln!(
            text,
            "| {fault} | {victim} | {} | {} | {} | {} | {} | {} | {} | {} | {} | {} | {} |",
            rows.len(),
            flights.len(),
            count(Verdict::Arrived),
            count(Verdict::Hovered),
            count(Verdict::Late),
            count(Verdict::Failed),
            count(Verdict::Void),
            rungs.join(", "),
            percentiles(rows.iter().filter_map(|row| row.detected_ms).collect()),
            percentiles(rows.iter().filter_map(|row| row.recovered_ms).collect()),
            if clearance.is_finite() { format!("{clearance:.2}") } else { "> 5".to_owned() },
        );
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(seed: u64, fault: &str, verdict: Verdict, recovered_ms: Option<f64>) -> FaultRow {
        FaultRow {
            plan: "kills".to_owned(),
            seed,
            at_s: 5.0,
            fault: fault.to_owned(),
            victim: "planner".to_owned(),
            verdict,
            detected_ms: Some(3.0),
            recovered_ms,
            rung: "slower".to_owned(),
            clock_ratio: Some(1.0),
            min_clearance_m: Some(0.5 + seed as f64),
            flight_time_s: 30.0,
            takeovers: 0,
            restarts: 0,
            leaked: 0,
            version: "1".to_owned(),
        }
    }

    #[test]
    fn flights_are_counted_once_however_many_faults_they_have() {
        let rows = [
            row(1, "kill", Verdict::Arrived, Some(40.0)),
            row(1, "kill", Verdict::Arrived, Some(60.0)),
            row(2, "kill", Verdict::Failed, None),
            row(2, "stop", Verdict::Failed, None),
        ];
        let text = markdown(&rows);
        assert!(
            text.contains(
                "| kill | planner | 3 | 2 | 1 | 0 | 0 | 1 | 0 | slower 100 % | 3 / 3 / 3 | 40 / 60 / 60 | 1.50 |"
            ),
            "{text}"
        );
        assert!(
            text.contains("| stop | planner | 1 | 1 | 0 | 0 | 0 | 1 | 0 | slower 100 % | 3 / 3 / 3 | – | 2.50 |"),
            "{text}"
        );
    }
}
