//! Everything that vehicles tell, as it comes in.

use crate::vehicle::{Vehicle, VehicleView};
use bridge::{NetworkError, TlsConfig, keys};
use ipc_types::messages::VehicleState;
use ipc_types::rig::CameraMount;
use ipc_types::topics::TOPICS;
use ipc_types::wire::Wire;
use serde_json::Value;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use zenoh::sample::Sample;
use zenoh::{Session, Wait};

/// Largest message that is looked at, bytes.
const MOST_BYTES: usize = 1 << 20;
/// Vehicles, at most: names beyond are left out.
const MOST_VEHICLES: usize = 64;
/// Images that are kept.
const IMAGES: [&str; 2] = ["left", "disparity"];
/// Until a vehicle's configuration is known.
const LEVEL: CameraMount = CameraMount { position_m: [0.0; 3], pitch_up_deg: 0.0 };

type Vehicles = BTreeMap<String, Vehicle>;

/// The vehicles of a network.
#[derive(Clone)]
pub struct Watch {
    pub(crate) session: Session,
    vehicles: Arc<Mutex<Vehicles>>,
}

impl std::fmt::Debug for Watch {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Watch")
    }
}

impl Watch {
    /// Joins a network: connects to these endpoints and goes on trying, or listens for vehicles that connect.
    ///
    /// # Errors
    /// What is wrong with the endpoints or the certificates.
    pub fn begin(connect: &[String], listen: &[String], tls: Option<&TlsConfig>) -> Result<Self, NetworkError> {
        let session = bridge::open(listen, connect, tls, None)?;
        let watch = Self { session, vehicles: Arc::default() };
        let vehicles = Arc::clone(&watch.vehicles);
        let failed = |error: zenoh::Error| NetworkError::Config(error.to_string());
        watch
            .session
            .declare_subscriber(format!("{}/*/**", keys::ROOT))
            .callback(move |sample| take(&vehicles, &sample))
            .background()
            .wait()
            .map_err(failed)?;
        Ok(watch)
    }

    pub(crate) fn vehicles(&self) -> MutexGuard<'_, Vehicles> {
        self.vehicles.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// All vehicles that were heard.
    pub fn views(&self) -> Vec<VehicleView> {
        self.vehicles().iter().map(|(name, vehicle)| vehicle.view(name)).collect()
    }

    pub(crate) fn drawing(&self, name: &str) -> Option<Value> {
        self.vehicles().get(name).map(Vehicle::drawing)
    }

    pub(crate) fn image(&self, name: &str, image: &str) -> Option<Vec<u8>> {
        self.vehicles().get(name).and_then(|vehicle| vehicle.image(image))
    }

    /// A vehicle's camera is where its configuration says.
    pub fn set_mount(&self, name: &str, mount: CameraMount) {
        self.vehicles().entry(name.to_owned()).or_insert_with(|| Vehicle::new(LEVEL)).take_mount(mount);
    }

    /// Asks a vehicle for something of its own: its configuration, schema, files. `None` where it does not answer in time.
    pub fn ask(&self, name: &str, what: &str) -> Option<Vec<u8>> {
        let replies = self.session.get(keys::key(name, what)).timeout(std::time::Duration::from_secs(2)).wait().ok()?;
        let reply = replies.recv().ok()?;
        reply.result().ok().map(|sample| sample.payload().to_bytes().into_owned())
    }
}

/// Takes what came in: `sparrowhawk/<vehicle>/<kind>/<name>`.
fn take(vehicles: &Mutex<Vehicles>, sample: &Sample) {
    let mut parts = sample.key_expr().as_str().splitn(4, '/').skip(1);
    let (Some(name), Some(kind)) = (parts.next(), parts.next()) else { return };
    let what = parts.next().unwrap_or_default();
    if kind == keys::COMMAND || !keys::is_name(name) {
        return;
    }
    let bytes = sample.payload().to_bytes();
    let mut vehicles = vehicles.lock().unwrap_or_else(PoisonError::into_inner);
    if vehicles.len() >= MOST_VEHICLES && !vehicles.contains_key(name) {
        return;
    }
    let vehicle = vehicles.entry(name.to_owned()).or_insert_with(|| Vehicle::new(LEVEL));
    let is_taken = bytes.len() <= MOST_BYTES
        && match kind {
            "topic" => take_topic(vehicle, what, &bytes),
            "view" => vehicle.take_cloud(&bytes),
            "image" if IMAGES.contains(&what) => {
                vehicle.take_image(what, bytes.to_vec());
                true
            }
            _ => false,
        };
    match is_taken {
        true => vehicle.hear(bytes.len()),
        false => vehicle.refuse(),
    }
}

fn take_topic(vehicle: &mut Vehicle, name: &str, bytes: &[u8]) -> bool {
    let Some(topic) = TOPICS.iter().find(|topic| topic.name == name) else { return false };
    let decoded = encoding::decode(topic.header, topic.element, encoding::MOST_ELEMENTS, bytes);
    let Ok((header, elements)) = decoded else { return false };
    if topic.header == VehicleState::KIND && vehicle.is_over(&bytemuck::pod_read_unaligned(&header)) {
        *vehicle = vehicle.anew();
    }
    vehicle.take(topic, &header, &elements);
    true
}
