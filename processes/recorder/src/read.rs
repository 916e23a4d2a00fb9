//! Logs, read again: also of a flight that is under way, or of one whose recorder was killed.

use crate::file::{LAYOUT, LogError, VERSION, layout};
use crate::scan::{Channels, Damage, Part, scan};
use encoding::View;
use ipc_types::topics::{TOPICS, TopicInfo};
use mcap::records::Channel;
use serde_json::Value;
use std::path::Path;

/// A log file in memory.
#[derive(Debug)]
pub struct Log {
    bytes: Vec<u8>,
}

/// A message of a log.
#[derive(Debug)]
pub struct Record {
    /// Its topic.
    pub topic: &'static TopicInfo,
    /// Its header, as in shared memory.
    pub header: Vec<u8>,
    /// Its elements, where they are structs.
    pub elements: Vec<u8>,
}

/// How a log was read.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Reading {
    /// What could not, of the file.
    pub damage: Damage,
    /// Messages that are none.
    pub no_messages: u64,
}

impl Log {
    /// Reads a file.
    ///
    /// # Errors
    /// It cannot be read, or is no MCAP file.
    pub fn open(path: &Path) -> Result<Self, LogError> {
        let bytes = std::fs::read(path).map_err(LogError::io(path))?;
        bytes.starts_with(mcap::MAGIC).then_some(Self { bytes }).ok_or(mcap::McapError::BadMagic.into())
    }

    /// Hands all messages of the topics to `take`, in the order written.
    ///
    /// # Errors
    /// Another version wrote them.
    pub fn each(&self, mut take: impl FnMut(Record)) -> Result<Reading, LogError> {
        let (mut channels, mut no_messages) = (Channels::default(), 0);
        let damage = scan(&self.bytes, |part| {
            match part {
                Part::Channel(channel) => {
                    TOPICS
                        .iter()
                        .find(|topic| topic.name == channel.topic)
                        .map_or(Ok(()), |topic| check(topic, &channel))?;
                    channels.meet(channel);
                }
                Part::Message(header, data) => {
                    let name = channels.get(header.channel_id).map(|channel| channel.topic.as_str());
                    let topic = TOPICS.iter().find(|topic| Some(topic.name) == name);
                    match topic.map(|topic| {
                        (topic, encoding::decode(topic.header, topic.element, encoding::MOST_ELEMENTS, data))
                    }) {
                        Some((topic, Ok((header, elements)))) => take(Record { topic, header, elements }),
                        Some((_, Err(_))) => no_messages += 1,
                        None => {}
                    }
                }
                Part::Schema(..) | Part::Attachment(..) | Part::Metadata(_) => {}
            }
            Ok(())
        })?;
        Ok(Reading { damage, no_messages })
    }

    /// The messages of one topic as JSON.
    ///
    /// # Errors
    /// As [`Log::each`].
    pub fn json(&self, topic: &str) -> Result<Vec<Value>, LogError> {
        let mut values = Vec::new();
        self.each(|record| {
            if record.topic.name == topic {
                values.push(record.to_json());
            }
        })?;
        Ok(values)
    }

    /// Hands what viewers show of one kind to `take`, in the order written: Foxglove's messages.
    ///
    /// # Errors
    /// None that [`Log::open`] has not had.
    pub fn views(&self, view: View, mut take: impl FnMut(&[u8])) -> Result<(), LogError> {
        let mut channels = Channels::default();
        scan(&self.bytes, |part| {
            match part {
                Part::Channel(channel) => channels.meet(channel),
                Part::Message(header, data) => {
                    if channels.get(header.channel_id).is_some_and(|channel| channel.topic == view.topic()) {
                        take(data);
                    }
                }
                Part::Schema(..) | Part::Attachment(..) | Part::Metadata(_) => {}
            }
            Ok(())
        })
        .map(drop)
    }

    /// An attached text: the configuration, say.
    ///
    /// # Errors
    /// None that [`Log::open`] has not had.
    pub fn attachment(&self, name: &str) -> Result<Option<String>, LogError> {
        let mut found = None;
        scan(&self.bytes, |part| {
            if let Part::Attachment(header, data) = part
                && header.name == name
            {
                found.get_or_insert_with(|| String::from_utf8_lossy(data).into_owned());
            }
            Ok(())
        })?;
        Ok(found)
    }
}

impl Record {
    /// As JSON.
    pub fn to_json(&self) -> Value {
        encoding::to_json(self.topic.header, &self.header, self.topic.element, &self.elements)
    }

    /// Its header, if it is one of that type.
    pub fn header<H: ipc_types::wire::Wire>(&self) -> Option<H> {
        (self.topic.header == H::KIND).then(|| bytemuck::pod_read_unaligned(&self.header))
    }
}

/// Refuses what another version wrote.
fn check(topic: &'static TopicInfo, channel: &Channel) -> Result<(), LogError> {
    let expected_layout = layout(topic);
    let found = |key| channel.metadata.get(key).cloned().unwrap_or_else(|| "unknown".to_owned());
    if found(LAYOUT) == expected_layout {
        return Ok(());
    }
    let (found, found_layout) = (found(VERSION), found(LAYOUT));
    Err(LogError::OtherVersion {
        topic: topic.name,
        found,
        found_layout,
        expected: topic.header.name(),
        expected_layout,
    })
}
