//! Telemetry has a row for every step that the stream keeps, and reports the exact number of missing rows.

use crate::common::property_config;
use haptic_bridge::board::telemetry::{
    BATCH_BYTES, Batch, Columns, Field, Fields, Frames, Packer, RowShape, StreamRequest,
};
use haptic_bridge::control::frame::StepRecord;
use haptic_bridge::control::joints::Counts;
use haptic_bridge::render::step_result::{AtWalls, DeviceState};
use haptic_bridge::safety::fault::State;
use proptest::prelude::*;
use std::collections::VecDeque;

fn frame(step: u32) -> StepRecord {
    StepRecord {
        step,
        counts: Counts([-7, 16_777_217, 3]),
        at: DeviceState {
            q: [step as f32, 0.5, -0.5],
            walls: AtWalls { contacts: 2, ..AtWalls::default() },
            ..DeviceState::default()
        },
        state: State::Armed,
        ..StepRecord::default()
    }
}

fn width(batch: &Batch) -> usize {
    Fields(batch.fields).bytes(batch.shape())
}

fn rows(batch: &Batch) -> impl Iterator<Item = u32> + '_ {
    (0..batch.rows.len() / width(batch)).map(|row| batch.first_step.wrapping_add(row as u32 * batch.divider))
}

fn packer(fields: Fields, divider: u32, axes: usize) -> Packer {
    let mut packer = Packer::default();
    packer.start(&StreamRequest { fields, divider, stream: 41 }, RowShape::from(axes));
    packer
}

#[test]
fn a_row_holds_its_fields_in_their_order() {
    let mut packer = packer(Fields(Field::Angle.bit() | Field::Counts.bit() | Field::State.bit()), 1, 2);
    assert!(packer.push(&frame(9), 0).is_none());
    let batch = packer.flush().unwrap().clone();
    assert_eq!(batch.stream, 41, "the stream of the rows");
    assert_eq!((batch.first_step, batch.axes, width(&batch)), (9, 2, 4 + 4 + 4 + 4 + 1));
    // IEEE 754: 9 = 1.125 · 2^3, 0.5 = 1 · 2^-1.
    assert_eq!(batch.rows[..8], [0, 0, 0x10, 0x41, 0, 0, 0, 0x3F]);
    assert_eq!(batch.rows[8..12], [0xF9, 0xFF, 0xFF, 0xFF], "-7");
    assert_eq!(batch.rows[12..16], [1, 0, 0, 1], "16777217, which f32 cannot represent");
    assert_eq!(batch.rows[16..], [0x21], "armed, two walls");
}

#[test]
fn a_row_has_a_number_for_each_encoder_without_a_motor() {
    let mut packer = Packer::default();
    let request = StreamRequest { fields: Fields(Field::Sensed.bit() | Field::State.bit()), divider: 1, stream: 41 };
    packer.start(&request, RowShape { joints: 3, sensed: 2 });
    packer.push(&StepRecord { sensed: [0.5, -1.0, 3.0], ..frame(9) }, 0);
    let batch = packer.flush().unwrap().clone();
    assert_eq!((batch.axes, batch.sensed, width(&batch)), (3, 2, 9));
    assert_eq!(batch.rows[..], [0x21, 0, 0, 0, 0x3F, 0, 0, 0x80, 0xBF]);
    let mut bytes = [0; 100];
    let written = postcard::to_slice(&batch, &mut bytes).unwrap();
    assert_eq!(postcard::from_bytes::<Batch>(written).unwrap(), batch);
}

#[test]
fn a_batch_has_the_bytes_of_postcard() {
    let mut packer = packer(Fields::USUAL, 1, 2);
    packer.push(&frame(9), 3);
    let batch = packer.flush().unwrap();
    assert_eq!(batch.rows.len(), 39, "nine floats and three bytes");
    let mut bytes = [0; 100];
    let written = postcard::to_slice(batch, &mut bytes).unwrap();
    assert_eq!(written[..2], [41, 0], "stream and number");
    assert_eq!(written[written.len() - 40], 39, "number of bytes that follow");
    assert_eq!(&postcard::from_bytes::<Batch>(written).unwrap(), batch);
}

#[test]
fn a_stream_keeps_every_nth_step_and_zero_stops_it() {
    let packer_of_three = packer(Fields::USUAL, 3, 2);
    let kept: Vec<u32> = (0..10).filter(|step| packer_of_three.wants(*step)).collect();
    assert_eq!(kept, [0, 3, 6, 9]);
    assert!(!packer(Fields::USUAL, 0, 2).wants(0));
    assert!(!packer(Fields(0), 1, 2).wants(0));
    assert!(!Packer::default().wants(0));
}

#[test]
fn a_full_batch_leaves_at_once_with_complete_rows() {
    for axes in 1..=3 {
        let mut packer = packer(Fields::ALL, 1, axes);
        let mut step = 0;
        let batch = loop {
            step += 1;
            if let Some(batch) = packer.push(&frame(step), 0).cloned() {
                break batch;
            }
        };
        assert_eq!(batch.rows.len() % width(&batch), 0, "complete rows");
        assert!(batch.rows.len() + width(&batch) > BATCH_BYTES, "as many rows as fit");
        assert_eq!(rows(&batch).last(), Some(step));
    }
}

#[test]
fn fields_that_do_not_exist_are_not_sent() {
    let mut packer = packer(Fields(u32::MAX), 1, 7);
    packer.push(&frame(1), 0);
    let batch = packer.flush().unwrap().clone();
    assert_eq!((Fields(batch.fields), batch.axes), (Fields::ALL, 3));
    assert_eq!(batch.rows.len(), width(&batch));
}

proptest! {
    #![proptest_config(property_config(256))]

    #[test]
    fn every_step_is_either_in_a_batch_or_counted_as_lost(
        divider in 1_u32..5,
        start in prop_oneof![Just(0_u32), Just(u32::MAX - 100), any::<u32>()],
        fields in 1_u32..(1 << 17),
        // Two numbers for each row. A first 0 makes the board drop the row, a second 0 makes the link lose a batch.
        events in proptest::collection::vec((0_u8..8, 0_u8..6), 1..300),
    ) {
        let mut packer = packer(Fields(fields), divider, 2);
        let first = start - start % divider;
        let (mut dropped, mut sent, mut arrived, mut lost_on_link) = (0_u32, 0_usize, Vec::new(), 0_usize);
        let mut send = |batch: &Batch, lose: bool| {
            if lose {
                lost_on_link += rows(batch).count();
            } else {
                arrived.push(batch.clone());
            }
        };
        for (i, (drop, lose)) in events.iter().enumerate() {
            let step = first.wrapping_add(i as u32 * divider);
            if *drop == 0 {
                dropped += 1;
                continue;
            }
            sent += 1;
            if let Some(batch) = packer.push(&frame(step), dropped) {
                send(batch, *lose == 0);
            }
        }
        if let Some(batch) = packer.flush() {
            send(batch, false);
        }
        let received: usize = arrived.iter().map(|batch| batch.rows.len() / width(batch)).sum();
        prop_assert_eq!(received + lost_on_link, sent);
        prop_assert_eq!(sent + dropped as usize, events.len());
        // Rows belong to the steps that the batch states, and lost batches leave a gap in the numbers.
        for batch in &arrived {
            if Fields(fields).has(Field::Angle) {
                for (row, step) in (0..).zip(0..batch.rows.len() / width(batch)) {
                    let expected = batch.first_step.wrapping_add(row * divider);
                    prop_assert_eq!(&batch.rows[step * width(batch)..][..4], (expected as f32).to_le_bytes());
                }
            }
        }
        for pair in arrived.windows(2) {
            prop_assert!(pair[1].number > pair[0].number);
            prop_assert!(pair[1].dropped >= pair[0].dropped);
        }
        if let Some(last) = arrived.last() {
            prop_assert!(last.dropped <= dropped);
        }
    }
}

struct FrameQueue(VecDeque<StepRecord>);

impl Frames for FrameQueue {
    fn first(&self) -> Option<&StepRecord> {
        self.0.front()
    }

    fn drop_first(&mut self) {
        self.0.pop_front();
    }
}

#[test]
fn queued_frames_leave_in_order_and_the_rest_when_late() {
    let mut packer = packer(Fields(Field::Angle.bit()), 2, 1);
    let mut queue = FrameQueue((0..400).map(frame).collect());
    let full = packer.drain(&mut queue, 7, false).expect("200 rows are more than a batch").clone();
    assert_eq!((full.number, full.first_step, full.rows.len(), full.dropped), (0, 0, BATCH_BYTES, 7));
    assert!(packer.drain(&mut queue, 7, false).is_none());
    assert!(queue.0.is_empty());
    let rest = packer.drain(&mut queue, 7, true).expect("late").clone();
    assert_eq!((rest.number, rest.first_step), (1, 2 * BATCH_BYTES as u32 / 4));
    assert!(rows(&full).chain(rows(&rest)).eq((0..400).step_by(2)));
    assert!(packer.drain(&mut queue, 7, true).is_none());
}

#[test]
fn the_table_in_the_docs_agrees_with_the_fields() {
    let page = include_str!("../docs/telemetry.md");
    let rows: Vec<Vec<&str>> = page
        .lines()
        .filter(|line| line.starts_with("| `"))
        .map(|line| line.trim_matches('|').split('|').map(str::trim).collect())
        .collect();
    assert_eq!(rows.len(), Field::ALL.len(), "one row per field");
    for (row, field) in rows.iter().zip(Field::ALL) {
        assert_eq!(row[0], format!("`{}`", field.name()));
        assert_eq!((row[1], row[3]), (field.unit(), field.meaning()), "{field:?}");
        assert_eq!(row[2].starts_with("per "), field.columns() != Columns::One, "{field:?}");
    }
    let usual = page.split("`--fields usual` is ").nth(1).unwrap().split('.').next().unwrap();
    for field in Field::ALL {
        let named = usual.split(|c: char| !c.is_alphabetic()).any(|word| word == field.name());
        assert_eq!(named, Fields::USUAL.has(*field), "{field:?} in {usual:?}");
    }
}
