//! Encodes and finds frames. A frame is postcard-rpc's header and a postcard body, COBS-encoded, and ends with a zero.

use haptic_bridge::board::framing::max_wire_length;
pub use haptic_bridge::board::protocol::MAX_FRAME;
use postcard_rpc::header::VarHeader;

/// One message with its header.
#[derive(Clone, Debug, PartialEq)]
pub struct Packet {
    /// Key of endpoint or topic, and sequence number.
    pub header: VarHeader,
    /// The serialised message.
    pub body: Vec<u8>,
}

/// Encodes a message as a frame on the wire.
pub fn encode(header: &VarHeader, body: &[u8]) -> Vec<u8> {
    // A header is at most 1 + 8 + 4 bytes.
    let mut head = [0; 16];
    let used = header.write_to_slice(&mut head).map_or(0, |(used, _)| used.len());
    let mut plain = Vec::with_capacity(used + body.len());
    plain.extend_from_slice(&head[..used]);
    plain.extend_from_slice(body);
    encode_plain(&plain)
}

/// Encodes a frame that already has its header.
pub fn encode_plain(plain: &[u8]) -> Vec<u8> {
    let mut bytes = cobs::encode_vec(plain);
    bytes.push(0);
    bytes
}

/// Finds frames in a byte stream that arrives in arbitrary pieces. Skips and counts invalid byte sequences.
#[derive(Clone, Debug, Default)]
pub struct Deframer {
    partial: Vec<u8>,
    is_overlong: bool,
    /// Number of byte sequences between zeros that were not frames.
    pub garbled: u64,
}

impl Deframer {
    /// Decodes bytes and passes every completed message to `found`.
    pub fn feed(&mut self, bytes: &[u8], mut found: impl FnMut(Packet)) {
        let mut headless = 0;
        self.feed_plain(bytes, |plain| match VarHeader::take_from_slice(plain) {
            Some((header, body)) => found(Packet { header, body: body.to_vec() }),
            None => headless += 1,
        });
        self.garbled += headless;
    }

    /// Decodes bytes and passes every completed frame, without its COBS encoding, to `found`.
    pub fn feed_plain(&mut self, bytes: &[u8], mut found: impl FnMut(&[u8])) {
        for piece in bytes.split_inclusive(|byte| *byte == 0) {
            let (content, ended) = match piece.split_last() {
                Some((0, content)) => (content, true),
                _ => (piece, false),
            };
            if self.partial.len() + content.len() >= max_wire_length(MAX_FRAME) {
                self.is_overlong = true;
                self.partial.clear();
            } else if !self.is_overlong {
                self.partial.extend_from_slice(content);
            }
            if ended {
                if self.is_overlong {
                    self.garbled += 1;
                } else if !self.partial.is_empty() {
                    match cobs::decode_in_place(&mut self.partial) {
                        Ok(length) => found(self.partial.get(..length).unwrap_or_default()),
                        Err(_) => self.garbled += 1,
                    }
                }
                self.is_overlong = false;
                self.partial.clear();
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use postcard_rpc::Key;
    use postcard_rpc::header::{VarKey, VarSeq};

    fn header(seq: u16) -> VarHeader {
        let key = Key::for_path::<u32>("some/path");
        VarHeader { key: VarKey::Key8(key), seq_no: VarSeq::Seq2(seq) }
    }

    #[test]
    fn the_bytes_are_those_of_postcard_rpc() {
        // Two-byte key and sequence number: discriminant 0b0101_0000, then key, then sequence number little endian.
        let mut key = VarKey::Key8(Key::for_path::<u32>("some/path"));
        key.shrink_to(postcard_rpc::header::VarKeyKind::Key2);
        let VarKey::Key2(short) = key else { panic!("a key of two bytes") };
        let [a, b] = short.to_bytes();
        let bytes = encode(&VarHeader { key, seq_no: VarSeq::Seq2(0x0201) }, &[0, 9]);
        // COBS replaces each zero by the distance to the next: 6 bytes to the zero in the body, then 2.
        assert_eq!(bytes, [6, 0x50, a, b, 1, 2, 2, 9, 0]);
    }

    #[test]
    fn frames_are_found_in_a_stream_cut_anywhere() {
        let mut stream = encode(&header(1), &[1, 0, 2]);
        stream.extend(encode(&header(2), &[0; 300]));
        for size in 1..40 {
            let mut deframer = Deframer::default();
            let mut frames = Vec::new();
            for chunk in stream.chunks(size) {
                deframer.feed(chunk, |frame| frames.push(frame));
            }
            assert_eq!(frames.len(), 2);
            assert_eq!(frames[0], Packet { header: header(1), body: vec![1, 0, 2] });
            assert_eq!(frames[1].body, [0; 300]);
        }
    }

    #[test]
    fn the_longest_frame_fits_with_its_cobs_overhead() {
        let (mut deframer, mut lengths) = (Deframer::default(), Vec::new());
        for length in [MAX_FRAME, MAX_FRAME + 9] {
            deframer.feed_plain(&encode_plain(&vec![1; length]), |plain| lengths.push(plain.len()));
        }
        assert_eq!((lengths, deframer.garbled), (vec![MAX_FRAME], 1));
    }

    #[test]
    fn noise_between_frames_is_counted_and_skipped() {
        let mut stream = vec![7, 7, 7, 0, 0, 0];
        stream.extend(vec![3; 2 * MAX_FRAME]);
        stream.push(0);
        stream.extend(encode(&header(5), &[4]));
        let mut deframer = Deframer::default();
        let mut frames = Vec::new();
        deframer.feed(&stream, |frame| frames.push(frame));
        assert_eq!(frames, [Packet { header: header(5), body: vec![4] }]);
        assert_eq!(deframer.garbled, 2);
    }
}
