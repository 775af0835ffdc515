//! Fuzzes the settings from flash or from a backup. Decoded values must not change when they are stored, and a board
//! that starts with these settings must keep its motors off.

use crate::board::Board;
use haptic_bridge::board::settings::{BoardName, Entry, Key, Polarity, Setting, decode, encode};
use haptic_bridge::checksum::crc32;
use haptic_bridge::control::Rules;
use haptic_bridge::model::device::Device;
use haptic_bridge::render::scene::Scene;
use haptic_bridge::safety::fault::State;
use std::collections::BTreeMap;

/// Decodes entries, each of which follows a byte with its key and two bytes with its length. If the highest bit of the
/// key is set, adds the right checksum, because the fuzzer could not guess it.
pub fn settings(data: &[u8]) {
    let mut flash = BTreeMap::new();
    let mut rest = data;
    while let [key, low, high, more @ ..] = rest {
        let (body, after) = more.split_at(usize::from(u16::from_le_bytes([*low, *high])).min(more.len()));
        rest = after;
        let seal = if key & 0x80 == 0 { Vec::new() } else { crc32(body).to_le_bytes().to_vec() };
        let Ok(entry) = Entry::from_slice(&[body, &seal].concat()) else { continue };
        check_round_trip::<Device<f32>>(&entry);
        check_round_trip::<Scene<f32>>(&entry);
        check_round_trip::<Rules>(&entry);
        check_round_trip::<Polarity>(&entry);
        check_round_trip::<BoardName>(&entry);
        flash.insert(Key::ALL[usize::from(key & 0x7F) % Key::ALL.len()] as u8, entry);
    }
    let mut board = Board::with_flash(true, flash);
    for _ in 0..10 {
        board.tick();
        assert!(matches!(board.state(), State::Disarmed | State::Fault));
    }
    let _ = board.service.save(&mut board.machine);
    board.check_invariants();
}

fn check_round_trip<S: Setting>(entry: &[u8]) {
    let Ok(value) = decode::<S>(entry) else { return };
    // Ignores a value that is too long to store in the encoding of this version.
    let Ok(once) = encode(&value) else { return };
    let twice = decode::<S>(&once).and_then(|value| encode(&value));
    assert_eq!(Ok(once), twice, "a setting changes when it is stored");
}
