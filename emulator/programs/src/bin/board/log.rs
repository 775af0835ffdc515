//! Decodes the firmware's log, which consists of defmt frames with strings from the image.

use defmt_decoder::{DecodeError, Table};

use haptic_emulator::image::Firmware;

/// The log's strings from an image.
pub struct Decoder {
    table: Table,
}

impl Decoder {
    /// Returns the strings of `firmware`, or `None` for an image without a log.
    #[must_use]
    pub fn new(firmware: &Firmware) -> Option<Self> {
        Table::parse(firmware.bytes()).ok().flatten().map(|table| Self { table })
    }

    #[must_use]
    pub fn reader(&self) -> Reader<'_> {
        Reader { stream: self.table.new_stream_decoder() }
    }
}

/// A log whose bytes arrive in parts.
pub struct Reader<'a> {
    stream: Box<dyn defmt_decoder::StreamDecoder + Send + Sync + 'a>,
}

impl Reader<'_> {
    /// Receives bytes and returns the lines that these bytes complete.
    pub fn feed(&mut self, raw: &[u8]) -> Vec<String> {
        self.stream.received(raw);
        let mut lines = Vec::new();
        loop {
            match self.stream.decode() {
                Ok(frame) => lines.push(frame.display(false).to_string()),
                Err(DecodeError::UnexpectedEof) => return lines,
                Err(DecodeError::Malformed) => lines.push("(unreadable part of the log)".to_owned()),
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
    fn the_log_names_the_board_at_the_start() {
        for kind in BoardKind::ALL {
            let rig = Rig::empty(kind);
            let raw = rig.while_stopped(|stopped| stopped.take_log());
            let lines = Decoder::new(firmware(kind)).expect("the image logs");
            let lines = lines.reader().feed(&raw);
            assert!(lines.iter().any(|line| line.contains(kind.name())), "{lines:?}");
        }
    }
}
