//! Walks through the bytes of an MCAP file that may be cut off, damaged or hostile.
//!
//! The crate's own readers end at the first error, and allocate what a record's length says. Here the file's outermost
//! records are told apart by their lengths, which are checked against what is there; a chunk is decompressed by the crate, with
//! its checksum and limits, and one that is damaged is left out and counted, so that those behind it are read.

use crate::file::LogError;
use crate::lengths;
use mcap::records::{self, ChunkHeader, MessageHeader, Record, op};
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};
use mcap::{McapError, parse_record};
use std::borrow::Cow;
use std::collections::HashMap;

/// Largest record in a chunk, and largest chunk, bytes: more than any that we write.
const MOST_RECORD_BYTES: usize = 64 << 20;
const MOST_CHUNK_BYTES: u64 = 256 << 20;

/// What could not be read.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Damage {
    /// Chunks and attachments that were left out.
    pub left_out: u64,
    /// Bytes at the end that are no whole record.
    pub cut_bytes: u64,
    /// The file has no end: its writer was killed, or writes still.
    pub is_open: bool,
}

impl Damage {
    /// Whether everything was read.
    pub fn is_none(&self) -> bool {
        *self == Self::default()
    }
}

impl std::fmt::Display for Damage {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self.is_open {
            true => f.write_str("it has no end")?,
            false => f.write_str("it has an end")?,
        }
        write!(f, ", {} damaged parts were left out, {} bytes were cut off", self.left_out, self.cut_bytes)
    }
}

/// A part of a file.
pub(crate) enum Part<'a> {
    /// What a channel carries.
    Schema(records::SchemaHeader, &'a [u8]),
    /// A channel.
    Channel(records::Channel),
    /// A message.
    Message(MessageHeader, &'a [u8]),
    /// A text, say.
    Attachment(records::AttachmentHeader, &'a [u8]),
    /// Names and values.
    Metadata(records::Metadata),
}

/// Hands every part of a file to `take`, in the order written.
///
/// # Errors
/// It is no MCAP file, or what `take` says.
pub(crate) fn scan(bytes: &[u8], mut take: impl FnMut(Part<'_>) -> Result<(), LogError>) -> Result<Damage, LogError> {
    let mut rest = bytes.strip_prefix(mcap::MAGIC).ok_or(McapError::BadMagic)?;
    let mut damage = Damage { is_open: true, ..Damage::default() };
    while let Some((opcode, body, behind)) = split(rest) {
        match opcode {
            op::CHUNK => damage.left_out += u64::from(!scan_chunk(&rest[..9 + body.len()], body, &mut take)?),
            op::ATTACHMENT => match attachment(body) {
                Some((header, data)) => take(Part::Attachment(header, &data))?,
                None => damage.left_out += 1,
            },
            // Behind it only the index follows, which repeats what was read.
            op::DATA_END => {
                damage.is_open = mcap::read::footer(bytes).is_err();
                return Ok(damage);
            }
            _ => damage.left_out += u64::from(!hand_on(opcode, body, &mut take)?),
        }
        rest = behind;
    }
    damage.cut_bytes = rest.len() as u64;
    Ok(damage)
}

/// Opcode and content of the first record, and what is behind it; `None` if it is not whole.
fn split(bytes: &[u8]) -> Option<(u8, &[u8], &[u8])> {
    let (&opcode, rest) = bytes.split_first()?;
    let (length, rest) = rest.split_first_chunk()?;
    let length = usize::try_from(u64::from_le_bytes(*length)).ok()?;
    let (body, behind) = rest.split_at_checked(length)?;
    Some((opcode, body, behind))
}

/// Hands on a record that is not nested; whether it was sound.
fn hand_on(opcode: u8, body: &[u8], take: &mut impl FnMut(Part<'_>) -> Result<(), LogError>) -> Result<bool, LogError> {
    if !matches!(opcode, op::SCHEMA | op::CHANNEL | op::MESSAGE | op::METADATA) {
        return Ok(true);
    }
    if !lengths::are_possible(opcode, body) {
        return Ok(false);
    }
    match parse_record(opcode, body) {
        Ok(Record::Schema { header, data }) => take(Part::Schema(header, &data))?,
        Ok(Record::Channel(channel)) => take(Part::Channel(channel))?,
        Ok(Record::Message { header, data }) => take(Part::Message(header, &data))?,
        Ok(Record::Metadata(metadata)) => take(Part::Metadata(metadata))?,
        Ok(_) => {}
        Err(_) => return Ok(false),
    }
    Ok(true)
}

/// Hands on what is in a chunk, nothing of it if its checksum is wrong, else up to the first record that is none; whether it was sound.
fn scan_chunk(
    record: &[u8],
    body: &[u8],
    take: &mut impl FnMut(Part<'_>) -> Result<(), LogError>,
) -> Result<bool, LogError> {
    if !lengths::are_possible(op::CHUNK, body) {
        return Ok(false);
    }
    let Ok(Record::Chunk { header: ChunkHeader { uncompressed_size, .. }, .. }) = parse_record(op::CHUNK, body) else {
        return Ok(false);
    };
    if uncompressed_size > MOST_CHUNK_BYTES {
        return Ok(false);
    }
    let options = LinearReaderOptions::default()
        .with_skip_start_magic(true)
        .with_skip_end_magic(true)
        .with_prevalidate_chunk_crcs(true)
        .with_record_length_limit(MOST_RECORD_BYTES);
    let mut reader = LinearReader::new_with_options(options);
    let mut rest = record;
    while let Some(event) = reader.next_event() {
        match event {
            Ok(LinearReadEvent::ReadRequest(_)) if rest.is_empty() => break,
            Ok(LinearReadEvent::ReadRequest(wanted)) => {
                let (now, later) = rest.split_at(wanted.clamp(1, rest.len()));
                reader.insert(now.len()).copy_from_slice(now);
                reader.notify_read(now.len());
                rest = later;
            }
            Ok(LinearReadEvent::Record { data, opcode }) => {
                if !hand_on(opcode, data, take)? {
                    return Ok(false);
                }
            }
            Err(_) => return Ok(false),
        }
    }
    Ok(true)
}

/// An attachment, if its lengths are possible and its checksum right.
fn attachment(body: &[u8]) -> Option<(records::AttachmentHeader, Cow<'_, [u8]>)> {
    if !lengths::are_possible(op::ATTACHMENT, body) {
        return None;
    }
    match parse_record(op::ATTACHMENT, body) {
        Ok(Record::Attachment { header, data, .. }) => Some((header, data)),
        _ => None,
    }
}

/// Channels by number, as they are met.
#[derive(Debug, Default)]
pub(crate) struct Channels(HashMap<u16, records::Channel>);

impl Channels {
    pub(crate) fn meet(&mut self, channel: records::Channel) {
        self.0.insert(channel.id, channel);
    }

    pub(crate) fn get(&self, id: u16) -> Option<&records::Channel> {
        self.0.get(&id)
    }
}
