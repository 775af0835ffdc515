//! Frames on the wire are those of COBS, as the `cobs` crate has it, whatever is in them and however they are cut.

use crate::common::cases;
use haptic_bridge::board::framing::{Decoder, encode, most_on_wire};
use haptic_bridge::board::protocol::MAX_FRAME;
use proptest::collection::vec;
use proptest::prelude::*;

/// A frame on a wire just as long as it must be, and on a longer one: what lies on a wire does not matter.
fn on_wire(frame: &[u8]) -> Vec<u8> {
    let shortest = most_on_wire(frame.len());
    let [short, long] = [vec![0xAA; shortest], vec![0; shortest + 9]].map(|mut wire| {
        wire[1..][..frame.len()].copy_from_slice(frame);
        let length = encode(&mut wire, frame.len()).expect("the wire is as long as it must be");
        wire.truncate(length);
        wire
    });
    assert_eq!(short, long);
    short
}

/// The frames that a decoder finds in a stream that comes in pieces of so many bytes.
fn found(stream: &[u8], piece: usize) -> Vec<Vec<u8>> {
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

/// Bytes as frames have them: many zeros, and long stretches without one.
fn bytes() -> impl Strategy<Value = Vec<u8>> {
    let stretch =
        prop_oneof![vec(Just(0_u8), 0..9), vec(1_u8.., 0..300), vec(any::<u8>(), 0..40), vec(250_u8.., 250..260)];
    vec(stretch, 0..5)
        .prop_map(|stretches| stretches.concat())
        .prop_filter("as long as a frame", |all| all.len() <= MAX_FRAME)
}

#[test]
fn a_frame_by_hand() {
    assert_eq!(on_wire(&[]), [1, 0]);
    assert_eq!(on_wire(&[0]), [1, 1, 0]);
    assert_eq!(on_wire(&[1, 2, 3, 4, 5, 0, 6]), [6, 1, 2, 3, 4, 5, 2, 6, 0]);
    let full = [7; 254];
    assert_eq!(on_wire(&full), [&[255][..], &full, &[0]].concat());
    assert_eq!(on_wire(&[&full[..], &[8]].concat()), [&[255][..], &full, &[2, 8, 0]].concat());
    assert_eq!(on_wire(&[&full[..], &[0]].concat()), [&[255][..], &full, &[1, 1, 0]].concat());
}

#[test]
fn a_wire_that_is_too_short_gets_nothing() {
    assert_eq!(encode(&mut [0, 1, 2, 3], 3), None);
    assert_eq!(encode(&mut [0, 1, 2, 3, 4], 3), Some(5));
    assert_eq!(encode(&mut [], 0), None);
}

#[test]
fn what_is_no_frame_is_skipped_and_the_next_one_found() {
    let good = on_wire(&[4, 0, 5]);
    // A block that is cut short, nothing at all, a frame that is too long, one of just the length, and one cut off by `forget`.
    let (long, just) = (on_wire(&[1; MAX_FRAME + 1]), on_wire(&[1; MAX_FRAME]));
    for noise in [&[9, 1, 2, 0][..], &[0, 0, 0], &long, &[5, 0]] {
        assert_eq!(found(&[noise, &good, &just].concat(), 64), [vec![4, 0, 5], vec![1; MAX_FRAME]], "{noise:?}");
    }
    let mut decoder = Decoder::default();
    assert_eq!(decoder.take(&good[..2]), (2, false));
    decoder.forget();
    assert_eq!(decoder.take(&good), (good.len(), true));
    assert_eq!(decoder.frame(), [4, 0, 5]);
}

proptest! {
    #![proptest_config(cases(256))]

    #[test]
    fn the_crate_reads_what_is_written_and_the_other_way_round(frame in bytes()) {
        let wire = on_wire(&frame);
        let (content, delimiter) = wire.split_at(wire.len() - 1);
        prop_assert_eq!(delimiter, [0]);
        prop_assert!(!content.contains(&0));
        prop_assert_eq!(cobs::decode_vec(content).unwrap(), frame.clone());
        let mut theirs = cobs::encode_vec(&frame);
        theirs.push(0);
        prop_assert_eq!(found(&theirs, 64), [frame]);
    }

    #[test]
    fn frames_are_found_however_they_are_cut(frames in vec(bytes(), 0..6), piece in 1_usize..80) {
        let stream: Vec<u8> = frames.iter().flat_map(|frame| on_wire(frame)).collect();
        prop_assert_eq!(found(&stream, piece), frames);
    }

    /// Wild bytes are read as the crate reads them, or not at all.
    #[test]
    fn wild_bytes_are_frames_only_where_the_crate_says_so(
        wild in vec(prop_oneof![0_u8..6, any::<u8>()], 0..200),
        piece in 1_usize..80,
    ) {
        let theirs = wild.split_inclusive(|byte| *byte == 0).filter_map(|piece| match piece.split_last() {
            Some((0, content)) if !content.is_empty() => cobs::decode_vec(content).ok(),
            _ => None,
        });
        prop_assert_eq!(found(&wild, piece), theirs.collect::<Vec<_>>());
    }
}
