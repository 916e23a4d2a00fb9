//! Opening a Zenoh session with safe defaults: no scouting, no plain TCP beyond what is asked for, roles by certificate.

use crate::keys;
use crate::{BridgeConfig, TlsConfig};
use serde_json::{Value, json};
use zenoh::{Config, Session, Wait};

/// Why there is no session.
#[derive(Debug, thiserror::Error)]
pub enum NetworkError {
    /// What was asked for is no configuration of Zenoh's.
    #[error("the network cannot be set up: {0}")]
    Config(String),
    /// The session does not open.
    #[error("cannot listen at {listen:?} or connect to {connect:?}: {reason}")]
    Open {
        /// Where it was to listen.
        listen: Vec<String>,
        /// Where it was to connect.
        connect: Vec<String>,
        /// Why not.
        reason: String,
    },
}

/// Opens a session. Who only connects blocks until somebody answers; who listens, too, goes on trying in the background.
///
/// # Errors
/// What is wrong with the endpoints or the certificates.
pub fn open(
    listen: &[String],
    connect: &[String],
    tls: Option<&TlsConfig>,
    roles: Option<&BridgeConfig>,
) -> Result<Session, NetworkError> {
    let config = configuration(listen, connect, tls, roles).to_string();
    let config = Config::from_json5(&config).map_err(|error| NetworkError::Config(error.to_string()))?;
    zenoh::open(config).wait().map_err(|error| NetworkError::Open {
        listen: listen.to_vec(),
        connect: connect.to_vec(),
        reason: error.to_string(),
    })
}

fn configuration(
    listen: &[String],
    connect: &[String],
    tls: Option<&TlsConfig>,
    roles: Option<&BridgeConfig>,
) -> Value {
    let mut config = json!({
        "mode": if listen.is_empty() { "client" } else { "peer" },
        "listen": { "endpoints": with_buffers(listen), "exit_on_failure": true },
        "connect": {
            "endpoints": with_buffers(connect),
            // Goes on trying.
            "timeout_ms": -1,
            "exit_on_failure": false,
            "retry": { "period_init_ms": 200, "period_max_ms": 1000, "period_increase_factor": 2.0 },
        },
        "scouting": { "multicast": { "enabled": false }, "gossip": { "enabled": false } },
        // Small batches and buffers: what waits in them is stale.
        "transport": { "link": {
            "tx": { "batch_size": 8192, "lease": 3000, "keep_alive": 4 },
            "rx": { "max_message_size": if roles.is_some() { MOST_VEHICLE_BYTES } else { MOST_GROUND_BYTES } },
        } },
    });
    if let Some(tls) = tls {
        config["transport"]["link"]["tls"] = json!({
            "root_ca_certificate": tls.authority,
            "listen_certificate": tls.certificate,
            "listen_private_key": tls.key,
            "connect_certificate": tls.certificate,
            "connect_private_key": tls.key,
            "enable_mtls": true,
            "verify_name_on_connect": true,
            "close_link_on_expiration": true,
        });
    }
    if let Some(roles) = roles.filter(|roles| roles.tls.is_some()) {
        config["access_control"] = access_control(roles);
    }
    config
}

/// Largest message that comes to a vehicle, and to the ground, bytes.
const MOST_VEHICLE_BYTES: usize = 16 << 10;
const MOST_GROUND_BYTES: usize = 2 << 20;

/// Kernel buffers as small as they may be, so that little is stale in them.
fn with_buffers(endpoints: &[String]) -> Vec<String> {
    endpoints.iter().map(|endpoint| format!("{endpoint}#so_sndbuf=16384;so_rcvbuf=65536")).collect()
}

/// Observers may look, pilots may command as well, by the names in their certificates. Nobody else may do anything.
fn access_control(roles: &BridgeConfig) -> Value {
    let all = keys::key(&roles.vehicle, "**");
    let command = |operator: &str| keys::key(&roles.vehicle, &keys::command(operator));
    // Who looks for vehicles does not know their names yet: what may be declared is wider than what is told.
    let any = keys::key("*", "**");
    let look = ["query", "liveliness_query", "declare_liveliness_subscriber", "declare_subscriber"];
    let tell = ["put", "delete", "reply", "declare_queryable", "liveliness_token"];
    let rule = |id: &str, messages: &[&str], flow: &str, key: &str| json!({ "id": id, "messages": messages, "flows": [flow], "permission": "allow", "key_exprs": [key] });
    let subject = |id: &str, names: &[String]| json!({ "id": id, "cert_common_names": names });
    // Each pilot is a subject of his own: his certificate lets him command by his own name alone.
    let own = |pilot: &String| format!("pilot {pilot}");
    let mut everybody: Vec<_> = roles.pilots.iter().map(own).collect();
    let mut subjects: Vec<_> =
        roles.pilots.iter().map(|pilot| subject(&own(pilot), std::slice::from_ref(pilot))).collect();
    for observer in &roles.observers {
        let id = format!("observer {observer}");
        subjects.push(subject(&id, std::slice::from_ref(observer)));
        everybody.push(id);
    }
    let mut rules = vec![
        rule("look", &look, "ingress", &any),
        rule("told", &tell, "egress", &all),
        // The vehicle asks for commands; only a pilot's come in.
        rule("asked", &["declare_subscriber"], "egress", &command("*")),
    ];
    rules.extend(roles.pilots.iter().map(|pilot| rule(&own(pilot), &["put"], "ingress", &command(pilot))));
    let mut policies = vec![json!({ "rules": ["look", "told", "asked"], "subjects": everybody })];
    policies.extend(roles.pilots.iter().map(|pilot| json!({ "rules": [own(pilot)], "subjects": [own(pilot)] })));
    json!({
        "enabled": true,
        "default_permission": "deny",
        "rules": rules,
        "subjects": subjects,
        "policies": policies,
    })
}
