//! The firmware's log in words: defmt frames decoded with the image's own strings.

use defmt_decoder::{DecodeError, Table};

use haptic_emulator::image::Firmware;

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

#[cfg(test)]
mod tests {
    use haptic_emulator::boards::BoardKind;
    use haptic_emulator::rig::{Rig, firmware};

    use super::Decoder;

    #[test]
    fn the_log_says_which_board_started() {
        for kind in BoardKind::ALL {
            let rig = Rig::empty(kind);
            let raw = rig.with(|stopped| stopped.take_log());
            let lines = Decoder::new(firmware(kind)).expect("the image logs");
            let lines = lines.reader().feed(&raw);
            assert!(lines.iter().any(|line| line.contains(kind.name())), "{lines:?}");
        }
    }
}
