//! Where the bridge listens, who may do what, and how much it sends.

use crate::{NetworkError, keys};
use ipc_types::bounds::Bounds;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;
use x509_parser::pem::parse_x509_pem;

/// The bridge.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BridgeConfig {
    /// The vehicle's name in the key space.
    pub vehicle: String,
    /// Endpoints to listen at, `tcp/127.0.0.1:7447` or `tls/0.0.0.0:7447`.
    pub listen: Vec<String>,
    /// Endpoints to connect to: a router, or the ground.
    pub connect: Vec<String>,
    /// Certificates, for `tls/` endpoints.
    pub tls: Option<TlsConfig>,
    /// Names in the certificates of those who may command; without certificates, everybody on this machine may.
    pub pilots: Vec<String>,
    /// Names in the certificates of those who may look.
    pub observers: Vec<String>,
    /// Most that is sent, to each who is connected, kbit/s.
    pub budget_kbit_s: u32,
    /// How often.
    pub rates: RatesConfig,
}

/// How often what is sent, at most, Hz; 0: never.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RatesConfig {
    /// The vehicle's state.
    pub state_hz: f64,
    /// Each process' health, the mission, the rung.
    pub health_hz: f64,
    /// Plan, goal, keyframes, path flown, setpoint.
    pub plan_hz: f64,
    /// Previews of images.
    pub image_hz: f64,
    /// Points of obstacles.
    pub obstacles_hz: f64,
}

/// Files (PEM) of mutual TLS.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TlsConfig {
    /// The authority that signed all certificates.
    pub authority: PathBuf,
    /// One's own certificate ...
    pub certificate: PathBuf,
    /// ... and its key.
    pub key: PathBuf,
}

impl TlsConfig {
    /// The common name in one's own certificate: by it others know one's role.
    ///
    /// # Errors
    /// The file cannot be read, or is no certificate with a name.
    pub fn own_name(&self) -> Result<String, NetworkError> {
        let wrong = |reason: &str| NetworkError::Config(format!("{}: {reason}", self.certificate.display()));
        let pem = std::fs::read(&self.certificate).map_err(|error| wrong(&error.to_string()))?;
        let (_, pem) = parse_x509_pem(&pem).map_err(|error| wrong(&error.to_string()))?;
        let certificate = pem.parse_x509().map_err(|error| wrong(&error.to_string()))?;
        let name = certificate.subject().iter_common_name().next().and_then(|name| name.as_str().ok());
        name.map(str::to_owned).ok_or_else(|| wrong("is a certificate without a name"))
    }
}

impl BridgeConfig {
    /// Whether there is anybody to talk to.
    pub fn is_on(&self) -> bool {
        !self.listen.is_empty() || !self.connect.is_empty()
    }

    /// Reports what cannot be, or must not be.
    pub fn check(&self, bounds: &mut Bounds) {
        let vehicle = &self.vehicle;
        let message = format_args!("is \"{vehicle}\", expected 1 to 32 letters, digits, - or _").to_string();
        bounds.require(keys::is_name(vehicle), "vehicle", message);
        bounds.range("budget_kbit_s", self.budget_kbit_s, 20..=10_000_000);
        let rates = &self.rates;
        bounds.section("rates", |bounds| {
            bounds.range("state_hz", rates.state_hz, 1.0..=100.0);
            bounds.range("health_hz", rates.health_hz, 0.5..=10.0);
            bounds.range("plan_hz", rates.plan_hz, 0.0..=50.0);
            bounds.range("image_hz", rates.image_hz, 0.0..=50.0);
            bounds.range("obstacles_hz", rates.obstacles_hz, 0.0..=50.0);
        });
        for endpoint in self.listen.iter().chain(&self.connect) {
            let (is_tls, is_tcp) = (endpoint.starts_with("tls/"), endpoint.starts_with("tcp/"));
            bounds.require(is_tls || is_tcp, endpoint, "is no endpoint; expected tcp/ADDRESS:PORT or tls/ADDRESS:PORT");
            bounds.require(!is_tls || self.tls.is_some(), endpoint, "needs tls: authority, certificate and key");
            let message = "would let anybody command who reaches it: beyond 127.0.0.1 and [::1] only tls/ is possible";
            bounds.require(is_tls || is_loopback(endpoint), endpoint, message);
        }
        for pilot in &self.pilots {
            let message = format_args!("is \"{pilot}\", expected 1 to 32 letters, digits, - or _").to_string();
            bounds.require(keys::is_name(pilot), "pilots", message);
            let message = format_args!("has \"{pilot}\" as well, who is a pilot and may look anyway").to_string();
            bounds.require(!self.observers.contains(pilot), "observers", message);
        }
        let names_needed = self.tls.is_none() || !self.pilots.is_empty();
        bounds.require(names_needed, "pilots", "is empty: with certificates, it names those who may command");
    }
}

/// Whether an endpoint is on this machine: by number, for a name may mean anything.
fn is_loopback(endpoint: &str) -> bool {
    let address = endpoint.split_once('/').map_or("", |(_, address)| address);
    address.parse::<std::net::SocketAddr>().is_ok_and(|address| address.ip().is_loopback())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nobody_commands_from_elsewhere_without_a_certificate() {
        for (endpoint, expected) in [
            ("tcp/127.0.0.1:7447", true),
            ("tcp/[::1]:7447", true),
            ("tcp/0.0.0.0:7447", false),
            ("tcp/10.0.0.2:7447", false),
            ("tcp/localhost:7447", false),
            ("tcp/127.0.0.1", false),
            ("udp/127.0.0.1:7447", false),
        ] {
            let config = BridgeConfig {
                vehicle: "scout".to_owned(),
                listen: vec![endpoint.to_owned()],
                connect: Vec::new(),
                tls: None,
                pilots: Vec::new(),
                observers: Vec::new(),
                budget_kbit_s: 1000,
                rates: RatesConfig { state_hz: 10.0, health_hz: 2.0, plan_hz: 5.0, image_hz: 5.0, obstacles_hz: 2.0 },
            };
            let mut bounds = Bounds::default();
            config.check(&mut bounds);
            assert_eq!(bounds.into_violations().is_empty(), expected, "{endpoint}");
        }
    }
}
