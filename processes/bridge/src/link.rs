//! The session, once it is open: what is sent, and what has come in.

use crate::keys::{self, key};
use crate::process::About;
use crate::{BridgeConfig, NetworkError, network};
use ipc_types::ProcessId;
use ipc_types::messages::{Command, Order, Waypoint};
use ipc_types::topics::Commands;
use std::collections::{HashMap, VecDeque};
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, TryRecvError, sync_channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use zenoh::bytes::Encoding;
use zenoh::liveliness::LivelinessToken;
use zenoh::qos::{CongestionControl, Priority};
use zenoh::sample::Sample;
use zenoh::{Session, Wait};

/// Longest command, bytes: one with all its places is shorter.
const MOST_COMMAND_BYTES: usize = 4096;
/// Commands that wait to be judged; beyond, the oldest gives way, and is counted.
const MOST_WAITING: usize = 64;
/// Longest wait for a session to close: it may wait for peers that do not answer.
const CLOSING: Duration = Duration::from_millis(300);

/// A command as it came in.
pub(crate) type Incoming = (Command, Vec<Waypoint>);

/// A session, which opens in the background.
pub(crate) enum Link {
    Opening(Receiver<Result<Session, NetworkError>>),
    Open(Box<OpenLink>),
    Failed(String),
}

/// An open session.
pub(crate) struct OpenLink {
    session: Session,
    vehicle: String,
    inbox: Arc<Inbox>,
    alive: HashMap<ProcessId, LivelinessToken>,
    _alive: LivelinessToken,
}

impl std::fmt::Debug for Link {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Opening(_) => "Opening",
            Self::Open(_) => "Open",
            Self::Failed(_) => "Failed",
        })
    }
}

impl Link {
    /// Begins to open a session.
    pub(crate) fn begin(config: &BridgeConfig) -> Self {
        let (sender, receiver) = sync_channel(1);
        let config = config.clone();
        std::thread::spawn(move || {
            let opened = network::open(&config.listen, &config.connect, config.tls.as_ref(), Some(&config));
            // Who does not wait any more does not need it.
            let _ = sender.send(opened);
        });
        Self::Opening(receiver)
    }

    /// Goes on once the session is open.
    pub(crate) fn advance(&mut self, config: &BridgeConfig, about: &About) {
        let Self::Opening(receiver) = self else { return };
        let opened = match receiver.try_recv() {
            Err(TryRecvError::Empty) => return,
            Err(TryRecvError::Disconnected) => Err("it ended".to_owned()),
            Ok(opened) => opened.map_err(|error| error.to_string()),
        };
        let linked = opened
            .and_then(|session| OpenLink::new(session, &config.vehicle, about).map_err(|error| error.to_string()));
        *self = match linked {
            Ok(link) => Self::Open(Box::new(link)),
            Err(reason) => Self::Failed(reason),
        };
    }

    pub(crate) fn close(self) {
        let Self::Open(link) = self else { return };
        let (sender, closed) = sync_channel(1);
        std::thread::spawn(move || {
            let _ = link.session.close().wait();
            let _ = sender.send(());
        });
        // A peer that does not answer is not waited for.
        let _ = closed.recv_timeout(CLOSING);
    }
}

impl OpenLink {
    fn new(session: Session, vehicle: &str, about: &About) -> zenoh::Result<Self> {
        let inbox = Arc::new(Inbox::default());
        let fills = Arc::clone(&inbox);
        session
            .declare_subscriber(key(vehicle, &keys::command("*")))
            .callback(move |sample| fills.take(&sample))
            .background()
            .wait()?;
        answer(&session, key(vehicle, keys::SCHEMA), Encoding::APPLICATION_PROTOBUF, {
            let schema = about.schema.clone();
            move || schema.clone()
        })?;
        answer(&session, key(vehicle, keys::CONFIG), Encoding::TEXT_PLAIN, {
            let config = about.config.clone().into_bytes();
            move || config.clone()
        })?;
        answer(&session, key(vehicle, keys::STATUS), Encoding::APPLICATION_JSON, {
            let status = Arc::clone(&about.status);
            move || {
                let status = status.lock().unwrap_or_else(PoisonError::into_inner);
                let named = status.iter().map(|(process, health)| (process.name().to_owned(), health.clone()));
                serde_json::Value::Object(named.collect()).to_string().into_bytes()
            }
        })?;
        answer(&session, key(vehicle, keys::LOGS), Encoding::APPLICATION_JSON, {
            let folder = about.folder.clone();
            move || files(&folder)
        })?;
        let token = session.liveliness().declare_token(key(vehicle, keys::ALIVE)).wait()?;
        let vehicle = vehicle.to_owned();
        Ok(Self { session, vehicle, inbox, alive: HashMap::new(), _alive: token })
    }

    /// Sends; what the network does not take at once is dropped.
    pub(crate) fn send(&self, path: &str, bytes: Vec<u8>, encoding: Encoding, is_vital: bool) -> bool {
        let priority = if is_vital { Priority::RealTime } else { Priority::DataLow };
        let put = self.session.put(key(&self.vehicle, path), bytes).encoding(encoding).priority(priority);
        put.congestion_control(CongestionControl::Drop).wait().is_ok()
    }

    /// The next command that has come in.
    pub(crate) fn command(&self) -> Option<Incoming> {
        self.inbox.waiting().pop_front()
    }

    /// What came in and was no command, or one too many.
    pub(crate) fn refused(&self) -> u64 {
        self.inbox.refused.load(Ordering::Relaxed)
    }

    /// Shows, or does not show any more, that a process lives.
    pub(crate) fn show_process(&mut self, process: ProcessId, lives: bool) {
        if !lives {
            // Dropped, it is withdrawn.
            self.alive.remove(&process);
        } else if !self.alive.contains_key(&process) {
            let path = key(&self.vehicle, &format!("process/{process}"));
            // Where it cannot be shown now, the next heartbeat tries again.
            self.session.liveliness().declare_token(path).wait().into_iter().for_each(|token| {
                self.alive.insert(process, token);
            });
        }
    }
}

/// Commands that have come in. To hover goes before everything else.
#[derive(Default)]
struct Inbox {
    waiting: Mutex<VecDeque<Incoming>>,
    refused: AtomicU64,
}

impl Inbox {
    fn waiting(&self) -> MutexGuard<'_, VecDeque<Incoming>> {
        self.waiting.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn take(&self, sample: &Sample) {
        let Some(incoming) = decoded(sample) else {
            self.refused.fetch_add(1, Ordering::Relaxed);
            return;
        };
        let mut waiting = self.waiting();
        match incoming.0.order == Order::Hover as u32 {
            true => waiting.push_front(incoming),
            false => waiting.push_back(incoming),
        }
        if waiting.len() > MOST_WAITING {
            let oldest = waiting.iter().position(|(command, _)| command.order != Order::Hover as u32).unwrap_or(0);
            waiting.remove(oldest);
            self.refused.fetch_add(1, Ordering::Relaxed);
        }
    }
}

fn decoded(sample: &Sample) -> Option<Incoming> {
    let payload = sample.payload();
    if payload.len() > MOST_COMMAND_BYTES {
        return None;
    }
    let command = encoding::decode_message::<Commands>(Command::MOST_PLACES, &payload.to_bytes()).ok()?;
    // Who may send by this key is one thing, and whom the command names another.
    let operator = sample.key_expr().as_str().rsplit('/').next()?;
    (command.0.operator.to_string_lossy() == operator).then_some(command)
}

/// Answers whoever asks.
fn answer(
    session: &Session,
    key: String,
    encoding: Encoding,
    content: impl Fn() -> Vec<u8> + Send + Sync + 'static,
) -> zenoh::Result<()> {
    let asked = key.clone();
    session
        .declare_queryable(key)
        .callback(move |query| {
            // Who has gone meanwhile gets no answer.
            let _ = query.reply(asked.clone(), content()).encoding(encoding.clone()).wait();
        })
        .background()
        .wait()
}

/// The files of the run, with their sizes, as JSON.
fn files(folder: &Path) -> Vec<u8> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let file = |entry: std::fs::DirEntry| {
        let metadata = entry.metadata().ok().filter(std::fs::Metadata::is_file)?;
        let name = entry.file_name().to_string_lossy().into_owned();
        Some(serde_json::json!({ "name": name, "bytes": metadata.len() }))
    };
    serde_json::Value::Array(entries.filter_map(file).collect()).to_string().into_bytes()
}
