//! Two logs, compared topic by topic: what a flight made of what it saw, and what was made of it again.
//!
//! Messages are told apart by who published them and for when they are valid, so that one that is missing does not make all
//! behind it others.

use ipc_types::messages::FlightClock;
use ipc_types::topics::{Clock, HealthReports, State, TOPICS, Topic};
use ipc_types::wire::Stamp;
use ipc_types::{FlightTime, ProcessId};
use recorder::{Entry, Log, LogError};
use serde::Serialize;
use std::collections::{BTreeMap, HashMap};
use std::ops::RangeInclusive;
use xxhash_rust::xxh3::xxh3_128;

/// What of two logs is compared.
#[derive(Clone, Debug)]
pub(crate) struct Scope {
    /// By whom messages were published; anybody if empty.
    pub(crate) producers: Vec<ProcessId>,
    /// When they were published, flight time, s.
    pub(crate) range_s: RangeInclusive<f64>,
    /// Whether they are to have been published at the same instant, too, after as many others.
    pub(crate) times: bool,
}

/// What became of a topic.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(crate) struct Comparison {
    /// Messages then.
    pub(crate) then: usize,
    /// And now.
    pub(crate) now: usize,
    /// That are in both, and the same.
    pub(crate) same: usize,
    /// For when the first is valid that is another, or missing, s.
    pub(crate) first_s: Option<f64>,
}

impl Comparison {
    pub(crate) fn is_same(&self) -> bool {
        self.then == self.same && self.now == self.same
    }
}

impl std::fmt::Display for Comparison {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self.first_s {
            None => write!(f, "{:>8} messages  the same", self.then),
            Some(first_s) => write!(
                f,
                "{:>8} messages  {} now, {} the same, from {first_s:.3} s on others",
                self.then, self.now, self.same
            ),
        }
    }
}

/// A message by what tells it from others of its topic: by whom, for when, the how manieth for then.
type Key = (i64, u32, usize);
type Messages = BTreeMap<Key, u128>;

/// Compares what is in the scope, by topic; images by their pixels, where both recordings have them. A recording is one log, or
/// its parts.
pub(crate) fn compare(
    then: &[Log],
    now: &[Log],
    scope: &Scope,
) -> Result<BTreeMap<&'static str, Comparison>, LogError> {
    let (then, now) = (by_topic(then, scope)?, by_topic(now, scope)?);
    let none = Messages::new();
    let names = then.keys().chain(now.keys());
    let is_image =
        |name: &str| name.starts_with('/') || TOPICS.iter().any(|topic| topic.name == name && topic.is_image);
    Ok(names
        // Images are recorded on request: what was not recorded of one of them cannot be compared.
        .filter(|name| !is_image(name) || (then.contains_key(*name) && now.contains_key(*name)))
        // Heartbeats come by the host's time, and count from the beginning.
        .filter(|name| scope.times || **name != HealthReports::INFO.name)
        .map(|name| (*name, of_topic(then.get(name).unwrap_or(&none), now.get(name).unwrap_or(&none))))
        .collect())
}

fn of_topic(then: &Messages, now: &Messages) -> Comparison {
    let same = then.iter().filter(|(key, message)| now.get(*key) == Some(message)).count();
    let others = then.keys().chain(now.keys()).filter(|key| then.get(*key) != now.get(*key));
    let first_s = others.min().map(|(valid_ns, ..)| FlightTime::from_nanos(*valid_ns).as_secs_f64());
    Comparison { then: then.len(), now: now.len(), same, first_s }
}

/// The hashes of all messages.
fn by_topic(logs: &[Log], scope: &Scope) -> Result<BTreeMap<&'static str, Messages>, LogError> {
    let mut topics: BTreeMap<_, Messages> = BTreeMap::new();
    let mut counts: HashMap<(&'static str, i64, u32), usize> = HashMap::new();
    for log in logs {
        // The last message, whose pixels follow it, if it is in the scope.
        let mut last = None;
        let take = |entry: Entry<'_>| {
            let (topic, hash) = match entry {
                Entry::Record(record) => {
                    last = Some(record.stamp()).filter(|stamp| is_in(scope, stamp));
                    let from = if scope.times { 0 } else { size_of::<Stamp>() };
                    (record.topic.name, xxh3_128(&[&record.header[from..], &record.elements].concat()))
                }
                Entry::View(view, data) if view.is_image() => (view.topic(), xxh3_128(data)),
                Entry::View(..) => return,
            };
            let Some(stamp) = last else { return };
            let count = counts.entry((topic, stamp.valid_ns, stamp.producer)).or_default();
            topics.entry(topic).or_default().insert((stamp.valid_ns, stamp.producer, *count), hash);
            *count += 1;
        };
        log.entries(|_| true, take)?;
    }
    Ok(topics)
}

fn is_in(scope: &Scope, stamp: &Stamp) -> bool {
    let is_by = scope.producers.iter().any(|&process| process as u32 == stamp.producer);
    let published_s = FlightTime::from_nanos(stamp.published_ns).as_secs_f64();
    (is_by || scope.producers.is_empty()) && scope.range_s.contains(&published_s)
}

/// What of a recording is known before it is replayed.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Known {
    /// When the last state was published, s: all topics are complete until then.
    pub(crate) last_state_s: f64,
    /// Whether it was flown in lockstep, which knows no time of the host's.
    pub(crate) in_lockstep: bool,
}

/// Looks through a recording.
pub(crate) fn look_through(logs: &[Log]) -> Result<Known, LogError> {
    let mut known = Known { last_state_s: f64::NEG_INFINITY, in_lockstep: true };
    for log in logs {
        log.entries(
            |name| [State::INFO.name, Clock::INFO.name].contains(&name),
            |entry| {
                let Entry::Record(record) = entry else { return };
                if let Some(clock) = record.header::<FlightClock>() {
                    known.in_lockstep &= clock.host_ns == 0;
                } else {
                    let published_s = FlightTime::from_nanos(record.stamp().published_ns).as_secs_f64();
                    known.last_state_s = known.last_state_s.max(published_s);
                }
            },
        )?;
    }
    Ok(known)
}
