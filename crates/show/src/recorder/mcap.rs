//! MCAP: a recording that Foxglove, PlotJuggler and the format's own libraries open directly.
//!
//! Rows are protocol buffers with their description, on the channel `/rows`; events are `foxglove.Log` on `/events`. A
//! metadata record describes the recording. Rows are gathered into chunks, and only complete chunks reach the file: after a killed tool
//! or on a full disk, the file is readable up to its last chunk.

use super::about::About;
use super::protobuf::{Field as Packed, Type, describe};
use super::{RecordError, Recording, STATES, protobuf};
use haptic_bridge::board::telemetry::Field;
use haptic_host::error::Failure;
use haptic_host::link::{Column, Losses};
use haptic_host::output::{self, Overwrite};
use mcap::records::{MessageHeader, Metadata, Record};
use mcap::write::NoSeek;
use mcap::{McapError, WriteOptions, Writer};
use prost_reflect::MessageDescriptor;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{SystemTime, UNIX_EPOCH};

/// Bytes at the start of an MCAP file.
pub const MAGIC: &[u8] = b"\x89MCAP0\r\n";
/// Message bytes in a chunk; `flush` ends a chunk earlier.
const CHUNK_BYTES: usize = 512 * 1024;
/// Words of Foxglove's levels by their numbers, and the level of an event: a fault that the board reported.
const LEVELS: [&str; 6] = ["UNKNOWN", "DEBUG", "INFO", "WARNING", "ERROR", "FATAL"];
const EVENT_LEVEL: i32 = 4;
/// Names of the metadata records at the head and at the end.
const HEAD_RECORD: &str = "haptic-bridge";
/// Name of the metadata record at the end.
const END_RECORD: &str = "haptic-bridge end";

/// Encoded bytes that are not yet in the file.
#[derive(Clone, Debug, Default)]
struct PendingBytes(Arc<Mutex<Vec<u8>>>);

impl PendingBytes {
    fn take(&self) -> Vec<u8> {
        std::mem::take(&mut *self.0.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

impl Write for PendingBytes {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).extend_from_slice(bytes);
        Ok(bytes.len())
    }
    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// An MCAP file being written.
pub struct McapRecorder {
    writer: Writer<NoSeek<PendingBytes>>,
    pending: PendingBytes,
    file: File,
    path: PathBuf,
    /// Length of the file's complete chunks, bytes.
    complete: u64,
    can_truncate: bool,
    row: MessageDescriptor,
    event: MessageDescriptor,
    channels: [u16; 2],
    /// This computer's clock at the first row, ns since 1970.
    start_ns: u64,
    sequence: u32,
    gathered_bytes: usize,
    /// Number of rows in complete chunks.
    rows: u64,
    pending_rows: u64,
    is_ended: bool,
}

impl std::fmt::Debug for McapRecorder {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("McapRecorder").field("path", &self.path).field("rows", &self.rows).finish_non_exhaustive()
    }
}

fn field_type(column: &Column) -> Type {
    match (column.field, column.axis) {
        (Field::State, 0) => Type::Enum,
        (Field::State | Field::Saturated, _) => Type::Uint32,
        (Field::Counts, _) => Type::Sfixed32,
        _ => Type::Float,
    }
}

/// Converts an error of the MCAP writer. Writing into memory fails only if the format is used wrongly.
fn record_error(error: McapError) -> RecordError {
    RecordError::Failed(Failure::impossible(error))
}

impl McapRecorder {
    /// Creates the file and writes its description.
    pub fn create(path: &Path, about: &About, columns: &[Column], overwrite: Overwrite) -> Result<Self, Failure> {
        let fields: Vec<Packed> = [("step".to_string(), Type::Uint32), ("time_s".into(), Type::Double)]
            .into_iter()
            .chain(columns.iter().map(|column| (column.label.clone(), field_type(column))))
            .collect();
        let states = if fields.iter().any(|(_, kind)| *kind == Type::Enum) { &STATES[..] } else { &[] };
        let row = describe("haptic.Row", &fields, ("State", states)).map_err(Failure::impossible)?;
        let log = [("timestamp", Type::Message), ("level", Type::Enum), ("message", Type::String)];
        let log = log.map(|(name, kind)| (name.to_string(), kind));
        let event = describe("foxglove.Log", &log, ("Level", &LEVELS)).map_err(Failure::impossible)?;
        let pending = PendingBytes::default();
        let begin = || -> Result<_, McapError> {
            let mut writer = WriteOptions::new()
                .library(format!("haptic {}", env!("CARGO_PKG_VERSION")))
                .chunk_size(None)
                .disable_seeking(true)
                .create(NoSeek::new(pending.clone()))?;
            writer.write_metadata(&Metadata { name: HEAD_RECORD.into(), metadata: about.entries() })?;
            let mut channel = |topic, message: &MessageDescriptor| -> Result<u16, McapError> {
                let set = message.parent_pool().encode_to_vec();
                let schema = writer.add_schema(message.full_name(), "protobuf", &set)?;
                writer.add_channel(schema, topic, "protobuf", &BTreeMap::new())
            };
            let channels = [channel("/rows", &row)?, channel("/events", &event)?];
            writer.flush()?;
            Ok((writer, channels))
        };
        let (writer, channels) = begin().map_err(Failure::impossible)?;
        let (file, can_truncate) = output::open(path, overwrite)?;
        let mut recorder = Self {
            writer,
            pending,
            file,
            path: path.into(),
            complete: 0,
            can_truncate,
            row,
            event,
            channels,
            start_ns: 0,
            sequence: 0,
            gathered_bytes: 0,
            rows: 0,
            pending_rows: 0,
            is_ended: false,
        };
        recorder.write_pending().map_err(|error| {
            if let (true, Ok(file)) = (can_truncate, std::fs::canonicalize(path)) {
                // Removes the file, which is useless without its head.
                let _ = std::fs::remove_file(file);
            }
            output::write_failure(path, &error)
        })?;
        Ok(recorder)
    }

    /// Returns the time of the log (ns since 1970) at a time since the first row (s).
    fn log_time(&mut self, time: f64) -> u64 {
        if self.start_ns == 0 {
            let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
            self.start_ns = u64::try_from(now.as_nanos()).unwrap_or(1).max(1);
        }
        self.start_ns + (1e9 * time.max(0.0)).round() as u64
    }

    fn write(&mut self, channel: usize, time: f64, message: &[u8]) -> Result<(), RecordError> {
        let log_time = self.log_time(time);
        self.sequence = self.sequence.wrapping_add(1);
        let header = MessageHeader {
            channel_id: self.channels[channel],
            sequence: self.sequence,
            log_time,
            publish_time: log_time,
        };
        self.writer.write_to_known_channel(&header, message).map_err(record_error)?;
        self.gathered_bytes += message.len();
        Ok(())
    }

    /// Adds a row: its step, its time since the first row (s), and a number for each column.
    pub fn add_row(&mut self, step: u32, time: f64, row: &[f64]) -> Result<(), RecordError> {
        let message =
            protobuf::encode_numbers(&self.row, [f64::from(step), time].into_iter().chain(row.iter().copied()));
        self.write(0, time, &message)?;
        self.pending_rows += 1;
        if self.gathered_bytes >= CHUNK_BYTES { self.flush() } else { Ok(()) }
    }

    /// Adds an event at a time since the first row, s.
    pub fn add_event(&mut self, time: f64, words: &str) -> Result<(), RecordError> {
        let now = self.log_time(time);
        let message = protobuf::pack_log(&self.event, now, EVENT_LEVEL, words);
        self.write(1, time, &message)
    }

    /// Ends the chunk and writes it; if the disk has no room for it, the file keeps the previous chunks.
    pub fn flush(&mut self) -> Result<(), RecordError> {
        self.gathered_bytes = 0;
        self.writer.flush().map_err(record_error)?;
        let pending_rows = std::mem::take(&mut self.pending_rows);
        match self.write_pending() {
            Ok(()) => {
                self.rows += pending_rows;
                Ok(())
            }
            Err(error) if error.kind() == io::ErrorKind::BrokenPipe => Err(RecordError::ReaderGone),
            Err(error) => Err(RecordError::Failed(output::write_failure(&self.path, &error))),
        }
    }

    fn write_pending(&mut self) -> io::Result<()> {
        let bytes = self.pending.take();
        if let Err(error) = self.file.write_all(&bytes) {
            if self.can_truncate {
                let _ = self.file.set_len(self.complete).and_then(|()| self.file.seek(SeekFrom::Start(self.complete)));
            }
            // Ends the file, because later records would need the truncated part.
            self.is_ended = true;
            return Err(error);
        }
        self.complete += bytes.len() as u64;
        Ok(())
    }

    /// Writes the summary and the index, which end the file.
    pub fn end(&mut self, words: &str, losses: &Losses) -> Result<(), RecordError> {
        if self.is_ended {
            return Ok(());
        }
        self.flush()?;
        let entries = [
            ("about", words.to_string()),
            ("rows", self.rows.to_string()),
            ("missing", losses.missing.to_string()),
            ("dropped_by_board", losses.dropped_by_board.to_string()),
            ("batches_lost", losses.batches_lost.to_string()),
            ("frames_garbled", losses.garbled.to_string()),
        ];
        let metadata = entries.map(|(name, value)| (name.to_string(), value)).into();
        self.writer.write_metadata(&Metadata { name: END_RECORD.into(), metadata }).map_err(record_error)?;
        self.writer.finish().map_err(record_error)?;
        let result =
            self.write_pending().map_err(|error| RecordError::Failed(output::write_failure(&self.path, &error)));
        self.is_ended = true;
        result
    }

    /// Returns the number of rows in the file.
    pub fn rows(&self) -> u64 {
        self.rows
    }

    /// Returns the number of bytes in the file.
    pub fn bytes(&self) -> u64 {
        self.complete
    }

    /// Returns the path of the file.
    pub fn path(&self) -> &Path {
        &self.path
    }
}

impl Drop for McapRecorder {
    fn drop(&mut self) {
        if !self.is_ended {
            let _ = self.flush();
            // Ends the writer; its index goes to memory that is never read.
            let _ = self.writer.finish();
        }
    }
}

/// Parses a recording up to its last complete chunk.
pub fn parse(bytes: &[u8]) -> Result<Recording, String> {
    let options = mcap::read::Options::IgnoreEndMagic | mcap::read::Options::ValidateChunkCrcs;
    let records = mcap::read::ChunkFlattener::new_with_options(bytes, options).map_err(|error| error.to_string())?;
    let mut recording = Recording { torn: true, ..Recording::default() };
    let mut schemas: BTreeMap<u16, (String, Vec<u8>)> = BTreeMap::new();
    let mut rows: Option<(u16, MessageDescriptor)> = None;
    let mut events = None;
    for record in records {
        // Data behind the last complete record is ignored.
        let Ok(record) = record else { break };
        match record {
            Record::Metadata(Metadata { name, metadata }) if name == HEAD_RECORD || name == END_RECORD => {
                let about = metadata.get("about").map(String::as_str).unwrap_or_default();
                recording.about.extend(about.lines().map(Into::into));
            }
            Record::Schema { header, data } if header.encoding == "protobuf" => {
                schemas.insert(header.id, (header.name, data.into_owned()));
            }
            Record::Channel(channel) => {
                let message = schemas.get(&channel.schema_id).and_then(|(name, set)| protobuf::find_message(set, name));
                match (channel.topic.as_str(), message) {
                    ("/rows", Some(message)) => {
                        recording.columns = protobuf::field_names(&message);
                        rows = Some((channel.id, message));
                    }
                    ("/events", Some(message)) => events = Some((channel.id, message)),
                    _ => {}
                }
            }
            Record::Message { header, data } => match (&rows, &events) {
                (Some((id, message)), _) if *id == header.channel_id => {
                    recording.rows.push(protobuf::decode_numbers(message, &data));
                }
                (_, Some((id, message))) if *id == header.channel_id => {
                    recording.about.extend(protobuf::first_text(message, &data));
                }
                _ => {}
            },
            Record::Footer(_) => recording.torn = false,
            _ => {}
        }
    }
    match rows {
        Some(_) => Ok(recording),
        None => Err("it has no channel /rows of protocol buffers, so it is not a recording of `haptic record`".into()),
    }
}
