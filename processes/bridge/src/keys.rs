//! The key space.

/// What every key begins with.
pub const ROOT: &str = "sparrowhawk";

/// Whether a vehicle may be called so: its name is a part of every key.
pub fn is_name(name: &str) -> bool {
    (1..=32).contains(&name.len()) && name.bytes().all(|byte| byte.is_ascii_alphanumeric() || b"-_".contains(&byte))
}

/// A key of a vehicle: `alive`, `topic/health`, `command` and so on.
pub fn key(vehicle: &str, path: &str) -> String {
    format!("{ROOT}/{vehicle}/{path}")
}

/// Liveliness token of a vehicle.
pub const ALIVE: &str = "alive";
/// Commands, to the vehicle.
pub const COMMAND: &str = "command";
/// The schema of all messages, to be queried.
pub const SCHEMA: &str = "schema";
/// The configuration, to be queried.
pub const CONFIG: &str = "config";
/// The files of the run, to be queried.
pub const LOGS: &str = "logs";
