//! Every service of a run, created and held by the supervisor, which is also the sole cleaner of dead nodes.

use super::bus::{bell_name, config, node, schema, topic_builder};
use super::{IpcError, While, half_made};
use crate::run_dir::RunDir;
use iceoryx2::node::NodeCleanupFailure;
use iceoryx2::prelude::*;
use ipc_types::topics::{RECORDER_DEPTH, RECORDER_IMAGE_DEPTH, Topic};
use ipc_types::{ProcessId, for_each_topic, topics};
use std::any::Any;
use std::time::Duration;

/// Wait for the resources of a dead node to come free.
const CLEANUP_TIMEOUT: Duration = Duration::from_millis(100);
/// Samples a consumer may hold at once.
const BORROWED: usize = 4;
/// Restarted ports may briefly coexist with what the cleaner has not yet removed.
const SPARE_PORTS: usize = 4;

/// Holds every service of a run open. While this lives, a process killed at any instant cannot wedge a service.
#[derive(Debug)]
pub struct Services {
    run: RunDir,
    config: Config,
    _held: Vec<Box<dyn Any>>,
    _node: Node<ipc::Service>,
}

impl Services {
    /// Creates every topic and every bell; in a run that was taken over, opens those that its processes hold.
    ///
    /// # Errors
    /// Whatever iceoryx2 refuses.
    pub fn hold(run: &RunDir) -> Result<Self, IpcError> {
        half_made::remove(run);
        let config = config(run, true)?;
        let node = node(&config, ProcessId::Supervisor)?;
        let mut held: Vec<Box<dyn Any>> = Vec::new();
        macro_rules! create {
            ($($topic:ident),*) => { $(held.push(create_topic::<topics::$topic>(&node)?);)* };
        }
        for_each_topic!(create);
        for process in ProcessId::ALL {
            let nodes = ProcessId::ALL.len() + SPARE_PORTS;
            let bell = node
                .service_builder(&bell_name(process)?)
                .event()
                .max_notifiers(2 * nodes)
                .max_listeners(1 + SPARE_PORTS)
                .max_nodes(2 * nodes)
                .event_id_max_value(1)
                .open_or_create()
                .doing(format!("create the bell of {process}"))?;
            held.push(Box::new(bell));
        }
        let services = Self { run: run.clone(), config, _held: held, _node: node };
        // What a dead supervisor has left. The services themselves are held by now.
        services.clean_dead_nodes();
        Ok(services)
    }

    /// Removes what dead processes left. To be called after reaping and before restarting.
    /// Returns how many nodes could not be cleaned; they are tried again at the next death.
    pub fn clean_dead_nodes(&self) -> usize {
        if !half_made::remove(&self.run) {
            return 1;
        }
        let mut failed = 0;
        let listed = Node::<ipc::Service>::list(&self.config, |state| {
            if let NodeState::Dead(view) = state {
                match view.blocking_remove_stale_resources(CLEANUP_TIMEOUT) {
                    Ok(_) | Err(NodeCleanupFailure::ResourcesAlreadyCleanedUp) => {}
                    Err(_) => failed += 1,
                }
            }
            CallbackProgression::Continue
        });
        failed + usize::from(listed.is_err())
    }
}

impl Drop for Services {
    fn drop(&mut self) {
        self.clean_dead_nodes();
    }
}

fn create_topic<T: Topic>(node: &Node<ipc::Service>) -> Result<Box<dyn Any>, IpcError> {
    let info = T::INFO;
    let (key, value) = schema::<T>(0)?;
    let attributes = AttributeVerifier::new().require(&key, &value).doing("attach the schema hash")?;
    let deepest = if info.is_image { RECORDER_IMAGE_DEPTH } else { RECORDER_DEPTH };
    let ports = info.producers.len() + info.consumers.len() + SPARE_PORTS;
    let service = topic_builder::<T>(node)?
        .history_size(info.history.max(1))
        .subscriber_max_buffer_size(deepest.max(info.depth))
        .subscriber_max_borrowed_samples(BORROWED)
        .max_publishers(info.producers.len() + SPARE_PORTS)
        .max_subscribers(info.consumers.len() + SPARE_PORTS)
        .max_nodes(2 * ports + 1)
        .enable_safe_overflow(true)
        .payload_alignment(Alignment::ALIGN_64)
        .open_or_create_with_attributes(&attributes)
        .doing(format!("create topic {}", info.name))?;
    Ok(Box::new(service))
}
