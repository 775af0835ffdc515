//! The firmware's log in words: defmt frames decoded with the image's own strings.

use defmt_decoder::{DecodeError, Table};

use crate::image::Firmware;

/// The log's strings, taken from an image.
pub struct Decoder {
    table: Table,
}

impl Decoder {
    /// The strings of `firmware`, or `None` for an image that does not log.
    #[must_use]
    pub fn new(firmware: &Firmware) -> Option<Self> {
        Table::parse(firmware.bytes()).ok().flatten().map(|table| Self { table })
    }

    /// A reader that is fed raw bytes and hands out lines.
    #[must_use]
    pub fn reader(&self) -> Reader<'_> {
        Reader { stream: self.table.new_stream_decoder() }
    }

    /// Every line of a log that is there whole.
    #[must_use]
    pub fn lines(&self, raw: &[u8]) -> Vec<String> {
        self.reader().feed(raw)
    }
}

/// A log on its way.
pub struct Reader<'a> {
    stream: Box<dyn defmt_decoder::StreamDecoder + Send + Sync + 'a>,
}

impl Reader<'_> {
    /// Takes bytes in and hands out the lines they complete.
    pub fn feed(&mut self, raw: &[u8]) -> Vec<String> {
        self.stream.received(raw);
        let mut lines = Vec::new();
        loop {
            match self.stream.decode() {
                Ok(frame) => lines.push(frame.display(false).to_string()),
                Err(DecodeError::UnexpectedEof) => return lines,
                Err(DecodeError::Malformed) => lines.push("(a part of the log that cannot be read)".to_owned()),
            }
        }
    }
}
