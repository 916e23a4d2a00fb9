//! The key space.

/// What every key begins with.
pub const ROOT: &str = "sparrowhawk";

/// Whether a vehicle, or an operator, may be called so: the name is a part of keys.
pub fn is_name(name: &str) -> bool {
    (1..=32).contains(&name.len()) && name.bytes().all(|byte| byte.is_ascii_alphanumeric() || b"-_".contains(&byte))
}

/// A key of a vehicle: `alive`, `topic/health`, `command` and so on.
pub fn key(vehicle: &str, path: &str) -> String {
    format!("{ROOT}/{vehicle}/{path}")
}

/// Liveliness token of a vehicle.
pub const ALIVE: &str = "alive";
/// What commands to the vehicle begin with; behind it comes who commands.
pub const COMMAND: &str = "command";
/// Commands of one operator, or of anybody (`*`). A pilot's certificate is good for his own alone.
pub fn command(operator: &str) -> String {
    format!("{COMMAND}/{operator}")
}
/// The schema of all messages, to be queried.
pub const SCHEMA: &str = "schema";
/// The configuration, to be queried.
pub const CONFIG: &str = "config";
/// The processes' last heartbeats, to be queried.
pub const STATUS: &str = "status";
/// The files of the run, to be queried.
pub const LOGS: &str = "logs";
