//! A log that was cut off or damaged, made whole: everything that can be read, with the index that viewers want.

use crate::file::LogError;
use crate::scan::{Damage, Part, scan};
use mcap::{Attachment, Compression, WriteOptions, Writer};
use std::borrow::Cow;
use std::collections::{BTreeMap, HashMap};
use std::fs::File;
use std::io::BufWriter;
use std::path::Path;

/// What was found in a log.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Recovered {
    /// Messages by topic.
    pub messages: BTreeMap<String, u64>,
    /// Attachments.
    pub attachments: u64,
    /// What could not be read.
    pub damage: Damage,
}

/// A file being written, and what numbers of the damaged one are called in it.
struct Copy {
    writer: Writer<BufWriter<File>>,
    schemas: HashMap<u16, u16>,
    channels: HashMap<u16, (u16, String)>,
    found: Recovered,
}

/// Writes whatever can be read of a log, in the order written, to another file, which must not exist.
///
/// # Errors
/// The log is no MCAP file, or the other cannot be written; then there is none.
pub fn recover(from: &Path, to: &Path) -> Result<Recovered, LogError> {
    let bytes = std::fs::read(from).map_err(LogError::io(from))?;
    if to.exists() {
        return Err(LogError::io(to)(std::io::ErrorKind::AlreadyExists.into()));
    }
    // Under another name until it is whole.
    let partial = to.with_extension("partial");
    let file = File::create(&partial).map_err(LogError::io(&partial))?;
    let options = WriteOptions::new().compression(Some(Compression::Lz4)).library("sparrowhawk");
    let writer = options.create(BufWriter::new(file))?;
    let mut copy = Copy { writer, schemas: HashMap::new(), channels: HashMap::new(), found: Recovered::default() };
    let scanned = scan(&bytes, |part| copy.take(part));
    let written = scanned.and_then(|damage| {
        copy.writer.finish()?;
        copy.found.damage = damage;
        std::fs::rename(&partial, to).map_err(LogError::io(to))
    });
    if let Err(error) = written {
        // What there is of it is of no use; where it cannot be removed, it lies there under its name.
        let _ = std::fs::remove_file(&partial);
        return Err(error);
    }
    Ok(copy.found)
}

impl Copy {
    fn take(&mut self, part: Part<'_>) -> Result<(), LogError> {
        match part {
            Part::Schema(header, data) => {
                let schema = self.writer.add_schema(&header.name, &header.encoding, data)?;
                self.schemas.insert(header.id, schema);
            }
            Part::Channel(channel) => {
                let schema = self.schemas.get(&channel.schema_id).copied().unwrap_or(0);
                let encoding = &channel.message_encoding;
                let number = self.writer.add_channel(schema, &channel.topic, encoding, &channel.metadata)?;
                self.channels.insert(channel.id, (number, channel.topic));
            }
            Part::Message(mut header, data) => {
                // One whose channel was damaged cannot be told what it is.
                if let Some((number, topic)) = self.channels.get(&header.channel_id) {
                    header.channel_id = *number;
                    self.writer.write_to_known_channel(&header, data)?;
                    *self.found.messages.entry(topic.clone()).or_default() += 1;
                }
            }
            Part::Attachment(header, data) => {
                let (log_time, create_time, data) = (header.log_time, header.create_time, Cow::Borrowed(data));
                let (name, media_type) = (header.name, header.media_type);
                self.writer.attach(&Attachment { log_time, create_time, name, media_type, data })?;
                self.found.attachments += 1;
            }
            Part::Metadata(metadata) => self.writer.write_metadata(&metadata)?,
        }
        Ok(())
    }
}
