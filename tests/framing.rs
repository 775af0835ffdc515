//! The library's frames equal those of the `cobs` crate, for any content and any split into pieces.

use crate::common::property_config;
use haptic_bridge::board::framing::{Decoder, encode, max_wire_length};
use haptic_bridge::board::protocol::MAX_FRAME;
use proptest::collection::vec;
use proptest::prelude::*;

/// Encodes a frame in the shortest possible buffer and in a longer buffer with other contents, which must not matter.
fn encode_frame(frame: &[u8]) -> Vec<u8> {
    let shortest = max_wire_length(frame.len());
    let [short, long] = [vec![0xAA; shortest], vec![0; shortest + 9]].map(|mut wire| {
        wire[1..][..frame.len()].copy_from_slice(frame);
        let length = encode(&mut wire, frame.len()).expect("the buffer is long enough");
        wire.truncate(length);
        wire
    });
    assert_eq!(short, long);
    short
}

/// Decodes a stream that arrives in pieces of `piece` bytes.
fn decode(stream: &[u8], piece: usize) -> Vec<Vec<u8>> {
    let (mut decoder, mut frames) = (Decoder::default(), Vec::new());
    for mut left in stream.chunks(piece) {
        while !left.is_empty() {
            let (taken, completed) = decoder.take(left);
            if completed {
                frames.push(decoder.frame().to_vec());
            }
            left = &left[taken..];
        }
    }
    frames
}

/// Generates contents of frames with many zeros and with long stretches without zeros.
fn frame_contents() -> impl Strategy<Value = Vec<u8>> {
    let stretch =
        prop_oneof![vec(Just(0_u8), 0..9), vec(1_u8.., 0..300), vec(any::<u8>(), 0..40), vec(250_u8.., 250..260)];
    vec(stretch, 0..5)
        .prop_map(|stretches| stretches.concat())
        .prop_filter("at most as long as a frame", |all| all.len() <= MAX_FRAME)
}

#[test]
fn frames_are_encoded_as_computed_by_hand() {
    assert_eq!(encode_frame(&[]), [1, 0]);
    assert_eq!(encode_frame(&[0]), [1, 1, 0]);
    assert_eq!(encode_frame(&[1, 2, 3, 4, 5, 0, 6]), [6, 1, 2, 3, 4, 5, 2, 6, 0]);
    let full = [7; 254];
    assert_eq!(encode_frame(&full), [&[255][..], &full, &[0]].concat());
    assert_eq!(encode_frame(&[&full[..], &[8]].concat()), [&[255][..], &full, &[2, 8, 0]].concat());
    assert_eq!(encode_frame(&[&full[..], &[0]].concat()), [&[255][..], &full, &[1, 1, 0]].concat());
}

#[test]
fn a_buffer_that_is_too_short_is_rejected() {
    assert_eq!(encode(&mut [0, 1, 2, 3], 3), None);
    assert_eq!(encode(&mut [0, 1, 2, 3, 4], 3), Some(5));
    assert_eq!(encode(&mut [], 0), None);
}

#[test]
fn bytes_that_are_no_frame_are_skipped() {
    let good = encode_frame(&[4, 0, 5]);
    // The noise is a truncated block, empty frames, a frame that is too long, and a frame whose block is cut off.
    let (too_long, longest) = (encode_frame(&[1; MAX_FRAME + 1]), encode_frame(&[1; MAX_FRAME]));
    for noise in [&[9, 1, 2, 0][..], &[0, 0, 0], &too_long, &[5, 0]] {
        assert_eq!(decode(&[noise, &good, &longest].concat(), 64), [vec![4, 0, 5], vec![1; MAX_FRAME]], "{noise:?}");
    }
    let mut decoder = Decoder::default();
    assert_eq!(decoder.take(&good[..2]), (2, false));
    decoder.forget();
    assert_eq!(decoder.take(&good), (good.len(), true));
    assert_eq!(decoder.frame(), [4, 0, 5]);
}

proptest! {
    #![proptest_config(property_config(256))]

    #[test]
    fn the_crate_and_the_library_read_each_others_frames(frame in frame_contents()) {
        let wire = encode_frame(&frame);
        let (content, delimiter) = wire.split_at(wire.len() - 1);
        prop_assert_eq!(delimiter, [0]);
        prop_assert!(!content.contains(&0));
        prop_assert_eq!(cobs::decode_vec(content).unwrap(), frame.clone());
        let mut theirs = cobs::encode_vec(&frame);
        theirs.push(0);
        prop_assert_eq!(decode(&theirs, 64), [frame]);
    }

    #[test]
    fn frames_are_found_in_a_stream_of_any_pieces(frames in vec(frame_contents(), 0..6), piece in 1_usize..80) {
        let stream: Vec<u8> = frames.iter().flat_map(|frame| encode_frame(frame)).collect();
        prop_assert_eq!(decode(&stream, piece), frames);
    }

    #[test]
    fn random_bytes_are_decoded_as_the_crate_decodes_them(
        random in vec(prop_oneof![0_u8..6, any::<u8>()], 0..200),
        piece in 1_usize..80,
    ) {
        let theirs = random.split_inclusive(|byte| *byte == 0).filter_map(|piece| match piece.split_last() {
            Some((0, content)) if !content.is_empty() => cobs::decode_vec(content).ok(),
            _ => None,
        });
        prop_assert_eq!(decode(&random, piece), theirs.collect::<Vec<_>>());
    }
}
