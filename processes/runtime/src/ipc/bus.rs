//! The iceoryx2 types behind the topics: node, carrier types, service names, attributes.

use super::{IpcError, While};
use crate::run_dir::RunDir;
use bytemuck::TransparentWrapper;
use iceoryx2::prelude::*;
use iceoryx2::service::attribute::{AttributeKey, AttributeValue};
use iceoryx2::service::builder::publish_subscribe::Builder;
use ipc_types::topics::Topic;
use ipc_types::wire::Wire;
use ipc_types::{ProcessId, topics::TopicInfo};

/// Gives a wire type the trait that iceoryx2 asks for.
#[repr(transparent)]
#[derive(Clone, Copy, TransparentWrapper)]
pub(super) struct Carrier<T: Wire>(pub(super) T);

// SAFETY: a wire type is plain old data (`Pod`): `repr(C)`, no padding, no pointers, every bit pattern valid, and
// the wrapper is transparent. Its versioned name and the schema hash on every service guard the layout.
unsafe impl<T: Wire> ZeroCopySend for Carrier<T> {
    unsafe fn type_name() -> &'static str {
        T::KIND.name()
    }
}

impl<T: Wire> std::fmt::Debug for Carrier<T> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(T::KIND.name())
    }
}

impl<T: Wire> Default for Carrier<T> {
    fn default() -> Self {
        Self(T::zeroed())
    }
}

/// Headers and elements as iceoryx2 sees them.
pub(super) type HeaderOf<T> = Carrier<<T as Topic>::Header>;
pub(super) type ElementOf<T> = Carrier<<T as Topic>::Element>;
pub(super) type TopicBuilder<T> = Builder<[ElementOf<T>], HeaderOf<T>, ipc::Service>;

/// The run's iceoryx2 configuration. Only the cleaner (the supervisor) removes what dead processes left.
pub(super) fn config(run: &RunDir, is_cleaner: bool) -> Result<Config, IpcError> {
    let mut config = Config::default();
    let root = run.iceoryx_root();
    config.global.set_root_path(&Path::new(root.as_os_str().as_encoded_bytes()).doing("name the run's root folder")?);
    config.global.prefix = FileName::new(run.prefix().as_bytes()).doing("name the run's segments")?;
    config.global.creation_timeout = std::time::Duration::from_secs(1);
    // [`super::Services`] does that, who first removes what would stop the cleaner.
    config.global.node.cleanup_dead_nodes_on_creation = false;
    config.global.node.cleanup_dead_nodes_on_destruction = false;
    config.global.service.cleanup_dead_nodes_on_open = is_cleaner;
    Ok(config)
}

pub(super) fn node(config: &Config, process: ProcessId) -> Result<Node<ipc::Service>, IpcError> {
    set_log_level(LogLevel::Error);
    NodeBuilder::new()
        .name(&NodeName::new(process.name()).doing("name the node")?)
        .config(config)
        .signal_handling_mode(SignalHandlingMode::Disabled)
        .create::<ipc::Service>()
        .doing(format!("join the run as {process}"))
}

pub(super) fn topic_builder<T: Topic>(node: &Node<ipc::Service>) -> Result<TopicBuilder<T>, IpcError> {
    let name = ServiceName::new(T::INFO.name).doing("name a topic")?;
    Ok(node.service_builder(&name).publish_subscribe::<[ElementOf<T>]>().user_header::<HeaderOf<T>>())
}

pub(super) fn bell_name(process: ProcessId) -> Result<ServiceName, IpcError> {
    ServiceName::new(&format!("bell/{process}")).doing("name a bell")
}

/// The attribute that refuses processes built with other messages.
pub(super) fn schema<T: Topic>(salt: u64) -> Result<(AttributeKey, AttributeValue), IpcError> {
    let key = AttributeKey::try_from("schema").doing("name the schema attribute")?;
    let value = AttributeValue::try_from(format!("{:016x}", (T::INFO.schema_hash)() ^ salt).as_str())
        .doing("write the schema hash")?;
    Ok((key, value))
}

/// What to say when a topic cannot be opened.
pub(super) fn opening(topic: &TopicInfo) -> String {
    format!(
        "open topic {} ({}); was this process built from the same source as the supervisor?",
        topic.name,
        topic.header.name()
    )
}
