//! Logs, read again: also of a flight that is under way, or of one whose recorder was killed.

use crate::file::{LAYOUT, LogError, VERSION, layout};
use crate::files::part;
use crate::scan::{Channels, Damage, Part, scan};
use encoding::View;
use ipc_types::topics::{TOPICS, TopicInfo};
use ipc_types::wire::Stamp;
use mcap::records::Channel;
use serde_json::Value;
use std::path::{Path, PathBuf};

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

/// A message of a log, or what viewers show of one.
#[derive(Debug)]
pub enum Entry<'a> {
    /// Ours.
    Record(Record),
    /// Foxglove's.
    View(View, &'a [u8]),
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
        Self::of(std::fs::read(path).map_err(LogError::io(path))?)
    }

    /// A file and the parts that follow it, as far as there are any: a recording.
    pub fn parts(path: &Path) -> Vec<PathBuf> {
        let following = (2..).map(|number| part(path, number)).take_while(|path| path.exists());
        std::iter::once(path.to_owned()).chain(following).collect()
    }

    /// A file's content.
    ///
    /// # Errors
    /// It is that of no MCAP file.
    pub fn of(bytes: Vec<u8>) -> Result<Self, LogError> {
        bytes.starts_with(mcap::MAGIC).then_some(Self { bytes }).ok_or(mcap::McapError::BadMagic.into())
    }

    /// Hands all messages of the topics to `take`, in the order written.
    ///
    /// # Errors
    /// Another version wrote them.
    pub fn each(&self, mut take: impl FnMut(Record)) -> Result<Reading, LogError> {
        let is_ours = |name: &str| TOPICS.iter().any(|topic| topic.name == name);
        self.entries(is_ours, |entry| {
            if let Entry::Record(record) = entry {
                take(record);
            }
        })
    }

    /// The messages of one topic as JSON.
    ///
    /// # Errors
    /// As [`Log::each`].
    pub fn json(&self, topic: &str) -> Result<Vec<Value>, LogError> {
        let mut values = Vec::new();
        self.entries(
            |name| name == topic,
            |entry| {
                if let Entry::Record(record) = entry {
                    values.push(record.to_json());
                }
            },
        )?;
        Ok(values)
    }

    /// Hands what viewers show of one kind to `take`, in the order written: Foxglove's messages.
    ///
    /// # Errors
    /// None that [`Log::open`] has not had.
    pub fn views(&self, view: View, mut take: impl FnMut(&[u8])) -> Result<(), LogError> {
        let entries = self.entries(
            |name| name == view.topic(),
            |entry| {
                if let Entry::View(_, data) = entry {
                    take(data);
                }
            },
        );
        entries.map(drop)
    }

    /// Hands what is in the channels that are wanted, by name, to `take`, in the order written.
    ///
    /// # Errors
    /// Another version wrote the messages of a topic that is wanted.
    pub fn entries(&self, wants: impl Fn(&str) -> bool, mut take: impl FnMut(Entry<'_>)) -> Result<Reading, LogError> {
        let (mut channels, mut no_messages) = (Channels::default(), 0);
        let damage = scan(&self.bytes, |part| {
            match part {
                Part::Channel(channel) if wants(&channel.topic) => {
                    if let Some(topic) = topic_named(&channel.topic) {
                        check(topic, &channel)?;
                    }
                    channels.meet(channel);
                }
                Part::Message(header, data) => {
                    let Some(channel) = channels.get(header.channel_id) else { return Ok(()) };
                    if let Some(topic) = topic_named(&channel.topic) {
                        match encoding::decode(topic.header, topic.element, encoding::MOST_ELEMENTS, data) {
                            Ok((header, elements)) => take(Entry::Record(Record { topic, header, elements })),
                            Err(_) => no_messages += 1,
                        }
                    } else if let Some(view) = View::ALL.into_iter().find(|view| view.topic() == channel.topic) {
                        take(Entry::View(view, data));
                    }
                }
                Part::Channel(_) | Part::Schema(..) | Part::Attachment(..) | Part::Metadata(_) => {}
            }
            Ok(())
        })?;
        Ok(Reading { damage, no_messages })
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

    /// Its stamp, with which every header begins.
    pub fn stamp(&self) -> Stamp {
        // What was decoded is as long as the topic's header.
        bytemuck::pod_read_unaligned(&self.header[..size_of::<Stamp>()])
    }

    /// Its header, if it is one of that type.
    pub fn header<H: ipc_types::wire::Wire>(&self) -> Option<H> {
        (self.topic.header == H::KIND).then(|| bytemuck::pod_read_unaligned(&self.header))
    }
}

fn topic_named(name: &str) -> Option<&'static TopicInfo> {
    TOPICS.iter().find(|topic| topic.name == name)
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
