//! One MCAP file being written.

use encoding::View;
use foxglove::Schema;
use ipc_types::topics::{TOPICS, TopicInfo};
use mcap::records::{MessageHeader, Metadata};
use mcap::{Attachment, Compression, WriteOptions, Writer};
use std::borrow::Cow;
use std::collections::{BTreeMap, HashMap};
use std::fs::File;
use std::io::BufWriter;
use std::path::Path;

/// Key of a channel's metadata: hash of the messages' layout.
pub(crate) const LAYOUT: &str = "layout";
/// Key of a channel's metadata: versioned name of the messages.
pub(crate) const VERSION: &str = "version";

/// Why a log cannot be written or read.
#[derive(Debug, thiserror::Error)]
pub enum LogError {
    /// The file.
    #[error("{path}: {source}")]
    Io {
        /// The file.
        path: String,
        /// Why.
        source: std::io::Error,
    },
    /// The format.
    #[error("MCAP: {0}")]
    Mcap(#[from] mcap::McapError),
    /// Written by another version.
    #[error(
        "{topic}: its messages are {found} of layout {found_layout}, this version reads {expected} of layout {expected_layout}"
    )]
    OtherVersion {
        /// The topic.
        topic: &'static str,
        /// What is in the file.
        found: String,
        /// Its layout.
        found_layout: String,
        /// What could be read.
        expected: &'static str,
        /// Its layout.
        expected_layout: String,
    },
}

impl LogError {
    pub(crate) fn io(path: &Path) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.display().to_string();
        move |source| Self::Io { path, source }
    }
}

/// What identifies the layout of a topic's messages.
pub(crate) fn layout(topic: &TopicInfo) -> String {
    format!("{:016x}", (topic.schema_hash)())
}

/// When a message was published, and for when it is valid, ns of flight time.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Times {
    pub(crate) valid_ns: i64,
    pub(crate) published_ns: i64,
}

/// Writes messages to channels.
pub(crate) struct LogFile {
    writer: Writer<BufWriter<File>>,
    topics: HashMap<&'static str, u16>,
    views: HashMap<View, u16>,
}

impl std::fmt::Debug for LogFile {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("LogFile")
    }
}

impl LogFile {
    /// Creates the file, with all channels; those of images only if asked for. What is attached comes as name and text.
    pub(crate) fn create(path: &Path, attachments: &[(String, String)], images: bool) -> Result<Self, LogError> {
        let file = File::create(path).map_err(LogError::io(path))?;
        let options = WriteOptions::new().compression(Some(Compression::Lz4)).library("sparrowhawk");
        let writer = options.create(BufWriter::new(file))?;
        let mut log = Self { writer, topics: HashMap::new(), views: HashMap::new() };
        for (name, text) in attachments {
            log.attach(name, text)?;
        }
        for topic in TOPICS {
            log.add_topic(topic)?;
        }
        for view in View::ALL.into_iter().filter(|view| images || !view.is_image()) {
            if let Some(Schema { name, encoding, data }) = view.schema() {
                let schema = log.writer.add_schema(&name, &encoding, &data)?;
                log.views.insert(view, log.writer.add_channel(schema, view.topic(), "protobuf", &BTreeMap::new())?);
            }
        }
        // Not only in the buffer: a disk that is full is to show here.
        log.flush()?;
        Ok(log)
    }

    fn add_topic(&mut self, topic: &TopicInfo) -> Result<(), LogError> {
        let descriptors = encoding::descriptor_set(&[(topic.header, topic.element)]);
        let schema = self.writer.add_schema(&encoding::message_name(topic.header), "protobuf", &descriptors)?;
        let metadata = [(LAYOUT, layout(topic)), (VERSION, topic.header.name().to_owned())];
        let metadata = metadata.into_iter().map(|(key, value)| (key.to_owned(), value)).collect();
        self.topics.insert(topic.name, self.writer.add_channel(schema, topic.name, "protobuf", &metadata)?);
        Ok(())
    }

    fn attach(&mut self, name: &str, text: &str) -> Result<(), LogError> {
        Ok(self.writer.attach(&Attachment {
            log_time: 0,
            create_time: 0,
            name: name.to_owned(),
            media_type: "text/plain".to_owned(),
            data: Cow::Borrowed(text.as_bytes()),
        })?)
    }

    /// Writes a message of a topic.
    pub(crate) fn write(&mut self, topic: &str, sequence: u64, times: Times, message: &[u8]) -> Result<(), LogError> {
        let channel = self.topics.get(topic).copied();
        channel.map_or(Ok(()), |channel| self.write_to(channel, sequence, times, message))
    }

    /// Writes what a viewer shows.
    pub(crate) fn show(&mut self, view: View, sequence: u64, times: Times, message: &[u8]) -> Result<(), LogError> {
        let channel = self.views.get(&view).copied();
        channel.map_or(Ok(()), |channel| self.write_to(channel, sequence, times, message))
    }

    fn write_to(&mut self, channel_id: u16, sequence: u64, times: Times, message: &[u8]) -> Result<(), LogError> {
        let header = MessageHeader {
            channel_id,
            sequence: sequence as u32,
            log_time: times.published_ns.max(0) as u64,
            publish_time: times.valid_ns.max(0) as u64,
        };
        Ok(self.writer.write_to_known_channel(&header, message)?)
    }

    /// Puts everything written so far on disk.
    pub(crate) fn flush(&mut self) -> Result<(), LogError> {
        Ok(self.writer.flush()?)
    }

    /// Notes what was lost so far.
    pub(crate) fn note_lost(&mut self, metadata: BTreeMap<String, String>) -> Result<(), LogError> {
        Ok(self.writer.write_metadata(&Metadata { name: "lost so far".to_owned(), metadata })?)
    }

    /// Writes the index, and ends the file.
    pub(crate) fn finish(&mut self) -> Result<(), LogError> {
        self.writer.finish()?;
        Ok(())
    }
}
