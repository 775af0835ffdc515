//! Entries from flash or from a backup: decoded or refused; what is decoded survives being stored, and a board that
//! boots from it stands still.

use crate::board::Board;
use haptic_bridge::board::settings::{BoardName, Entry, Key, Polarity, Setting, decode, encode};
use haptic_bridge::checksum::crc32;
use haptic_bridge::model::device::Device;
use haptic_bridge::model::precomputed::MassModelData;
use haptic_bridge::render::scene::Scene;
use haptic_bridge::safety::fault::State;
use haptic_bridge::control::Rules;
use std::collections::BTreeMap;

/// Entries, each behind a byte for its key and two for its length. The highest bit of the key seals the entry with a
/// checksum that fits, so that the fuzzer is not stopped by 32 bits of luck.
pub fn settings(data: &[u8]) {
    let mut flash = BTreeMap::new();
    let mut rest = data;
    while let [key, low, high, more @ ..] = rest {
        let (body, after) = more.split_at(usize::from(u16::from_le_bytes([*low, *high])).min(more.len()));
        rest = after;
        let seal = if key & 0x80 == 0 { Vec::new() } else { crc32(body).to_le_bytes().to_vec() };
        let Ok(entry) = Entry::from_slice(&[body, &seal].concat()) else { continue };
        survives::<Device<f32>>(&entry);
        survives::<Scene<f32>>(&entry);
        survives::<Rules>(&entry);
        survives::<MassModelData>(&entry);
        survives::<Polarity>(&entry);
        survives::<BoardName>(&entry);
        flash.insert(Key::ALL[usize::from(key & 0x7F) % Key::ALL.len()] as u8, entry);
    }
    let mut board = Board::with_flash(true, flash);
    for _ in 0..10 {
        board.tick();
        assert!(matches!(board.state(), State::Disarmed | State::Fault));
    }
    let _ = board.service.save(&mut board.machine);
    board.keeps_its_promises();
}

fn survives<S: Setting>(entry: &[u8]) {
    let Ok(value) = decode::<S>(entry) else { return };
    // A value may be longer in this version's encoding than the entry it came from, and then be refused.
    let Ok(once) = encode(&value) else { return };
    let twice = decode::<S>(&once).and_then(|value| encode(&value));
    assert_eq!(Ok(once), twice, "a setting changes by being stored");
}
