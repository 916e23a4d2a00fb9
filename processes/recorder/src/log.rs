//! An MCAP file being written.

use mcap::records::{MessageHeader, Metadata};
use mcap::{Attachment, Compression, WriteOptions, Writer};
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufWriter;
use std::path::Path;

/// Why a log cannot be written.
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
}

/// Writes messages to channels.
pub struct LogWriter {
    writer: Writer<BufWriter<File>>,
}

impl std::fmt::Debug for LogWriter {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("LogWriter")
    }
}

impl LogWriter {
    /// Creates the file.
    ///
    /// # Errors
    /// It cannot be created.
    pub fn create(path: &Path) -> Result<Self, LogError> {
        let file = File::create(path).map_err(|source| LogError::Io { path: path.display().to_string(), source })?;
        let options = WriteOptions::new().compression(Some(Compression::Lz4)).library("sparrowhawk");
        Ok(Self { writer: options.create(BufWriter::new(file))? })
    }

    /// Adds a channel of JSON messages.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn add_channel(&mut self, topic: &str, schema_name: &str, schema: &str) -> Result<u16, LogError> {
        let schema = self.writer.add_schema(schema_name, "jsonschema", schema.as_bytes())?;
        Ok(self.writer.add_channel(schema, topic, "json", &BTreeMap::new())?)
    }

    /// Writes a message; times in ns of flight time.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn write(
        &mut self,
        channel: u16,
        sequence: u64,
        valid_ns: i64,
        published_ns: i64,
        json: &[u8],
    ) -> Result<(), LogError> {
        let header = MessageHeader {
            channel_id: channel,
            sequence: sequence as u32,
            log_time: published_ns.max(0) as u64,
            publish_time: valid_ns.max(0) as u64,
        };
        Ok(self.writer.write_to_known_channel(&header, json)?)
    }

    /// Attaches a text file.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn attach(&mut self, name: &str, text: &str) -> Result<(), LogError> {
        Ok(self.writer.attach(&Attachment {
            log_time: 0,
            create_time: 0,
            name: name.to_owned(),
            media_type: "text/plain".to_owned(),
            data: Cow::Borrowed(text.as_bytes()),
        })?)
    }

    /// Puts everything written so far on disk.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn flush(&mut self) -> Result<(), LogError> {
        Ok(self.writer.flush()?)
    }

    /// Writes metadata and the index, and ends the file.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn finish(&mut self, metadata: BTreeMap<String, String>) -> Result<(), LogError> {
        self.writer.write_metadata(&Metadata { name: "recorder".to_owned(), metadata })?;
        self.writer.finish()?;
        Ok(())
    }
}
