//! Who was refused by the network's access control: it says so in traces alone, which are too many to be logged.
//!
//! [`RefusalLayer`] listens to those traces in the process' log; the bridge tells what it heard, at most once a second.

use std::fmt::Debug;
use std::sync::{Mutex, PoisonError};
use tracing::field::{Field, Visit};
use tracing::{Event, Level, Metadata, Subscriber};
use tracing_subscriber::layer::{Context, Layer};

/// What has been refused and not been told yet: how often, and the last of it.
static REFUSED: Mutex<(u64, String)> = Mutex::new((0, String::new()));
/// Where access control is traced.
const TARGET: &str = "zenoh::net::routing::interceptor::access_control";
/// Longest text that is kept, bytes.
const LONGEST: usize = 300;

/// A layer of the process' log.
#[derive(Clone, Copy, Debug, Default)]
pub struct RefusalLayer;

impl RefusalLayer {
    /// Whether it is to hear of something.
    pub fn hears(metadata: &Metadata<'_>) -> bool {
        metadata.target() == TARGET && *metadata.level() == Level::TRACE
    }
}

impl<S: Subscriber> Layer<S> for RefusalLayer {
    fn on_event(&self, event: &Event<'_>, _: Context<'_, S>) {
        event.record(&mut Message);
    }
}

/// Looks at an event's text.
struct Message;

impl Visit for Message {
    fn record_debug(&mut self, field: &Field, value: &dyn Debug) {
        if field.name() != "message" {
            return;
        }
        let mut text = format!("{value:?}");
        // What is sent to somebody and does not reach him is his role's; what comes from him is his doing. Whether he might
        // is worked out for every key that is declared, too: those are patterns, or nothing that is commanded by.
        let is_put = text.contains("unauthorized to Put (ingress) on ") && text.contains("/command/");
        if is_put && !text.contains('*') {
            text.truncate(text.floor_char_boundary(LONGEST));
            let mut refused = REFUSED.lock().unwrap_or_else(PoisonError::into_inner);
            *refused = (refused.0 + 1, text);
        }
    }
}

/// What was refused since this was asked last: how often, and the last of it.
pub(crate) fn take() -> Option<(u64, String)> {
    let mut refused = REFUSED.lock().unwrap_or_else(PoisonError::into_inner);
    (refused.0 > 0).then(|| std::mem::take(&mut *refused))
}
