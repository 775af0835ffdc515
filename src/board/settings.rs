//! The settings that the board keeps in flash: one entry each, with its own version and checksum.
//!
//! An entry that is damaged or of an unknown version is refused by itself; the others are kept. The bytes are the same
//! in flash, in a backup file and on the link.

use crate::board::storage::DECISION;
use crate::checksum::crc32;
use crate::control::Rules;
use crate::model::device::Device;
use crate::model::precomputed::MassModelData;
use crate::render::scene::Scene;
use crate::safety::limits::GENTLE_FORCE;
use heapless::{String, Vec};
use postcard_schema::Schema;
use serde::{Deserialize, Serialize, de::DeserializeOwned};

/// Largest entry, bytes.
pub const LONGEST_SETTING: usize = 1024;
/// An entry's bytes.
pub type Entry = Vec<u8, LONGEST_SETTING>;

/// A setting's key; the numbers never change.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[repr(u8)]
pub enum Key {
    /// The device.
    Device = 1,
    /// The scene.
    Scene = 2,
    /// Limits and rules.
    Rules = 3,
    /// The mass model.
    MassModel = 4,
    /// The fingerprint of a device whose polarity was checked once. Boards in the field and their backups hold it; it
    /// does not count as a check any longer.
    Polarity = 5,
    /// The board's name.
    Name = 6,
}

// Their entries lie in flash between the catalogue's and the decision's, and `ALL` has them in the order of their keys.
const _: () = {
    let mut place = 0;
    while place < Key::ALL.len() {
        let key = Key::ALL[place] as usize;
        assert!(key == place + 1 && key < DECISION as usize);
        place += 1;
    }
};

impl Key {
    /// Every key.
    pub const ALL: [Key; 6] = [Key::Device, Key::Scene, Key::Rules, Key::MassModel, Key::Polarity, Key::Name];

    /// Its name in backups and reports.
    pub const fn name(self) -> &'static str {
        match self {
            Key::Device => "device",
            Key::Scene => "scene",
            Key::Rules => "rules",
            Key::MassModel => "mass-model",
            Key::Polarity => "polarity",
            Key::Name => "name",
        }
    }
}

/// A value that is kept under a key.
pub trait Setting: Serialize + DeserializeOwned {
    /// Its key.
    const KEY: Key;
    /// Version of its encoding; raised whenever its fields change.
    const VERSION: u8;
    /// Earlier versions that differ by lacking bytes: the version, where the bytes belong (counted from the value's
    /// first byte, or `END`), and what the later fields were before there were any.
    const SHORTER: &'static [(u8, usize, &'static [u8])] = &[];
}

/// Behind everything else.
const END: usize = usize::MAX;

impl Setting for Device<f32> {
    const KEY: Key = Key::Device;
    /// 2: a five-bar carries the scale of its rods.
    const VERSION: u8 = 2;
}
impl Setting for Scene<f32> {
    const KEY: Key = Key::Scene;
    /// 2: a feed-forward gain, and what a redundant device holds; `velocity_terms` is no longer a flag. 3: estimators
    /// that watch joints, with their choices. 4: a posture.
    const VERSION: u8 = 4;
    /// A gain of 1, the orientation and no posture; the estimators of before are what they were.
    const SHORTER: &'static [(u8, usize, &'static [u8])] =
        &[(1, END, &[0x00, 0x00, 0x80, 0x3f, 0x00, 0x00]), (2, END, &[0x00]), (3, END, &[0x00])];
}
impl Setting for Rules {
    const KEY: Key = Key::Rules;
    /// 2: a largest force at the tip.
    const VERSION: u8 = 2;
    /// A gentle one, at the end of the limits, which come first: fifteen numbers of four bytes.
    const SHORTER: &'static [(u8, usize, &'static [u8])] = &[(1, 60, &GENTLE_FORCE.to_le_bytes())];
}
impl Setting for MassModelData {
    const KEY: Key = Key::MassModel;
    const VERSION: u8 = 1;
}

/// The fingerprint of a device whose polarity was checked once. Read so that old flash and backups stay valid; it
/// vouches for nothing, as wires are changed while a board is without power.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Polarity(pub u32);
impl Setting for Polarity {
    const KEY: Key = Key::Polarity;
    const VERSION: u8 = 1;
}

/// The board's name.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct BoardName(pub String<32>);
impl Setting for BoardName {
    const KEY: Key = Key::Name;
    const VERSION: u8 = 1;
}

/// Why an entry cannot be used.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub enum Damage {
    /// Checksum or encoding are wrong.
    Corrupt,
    /// It was written by a version that this one does not know.
    UnknownVersion(u8),
    /// It belongs to another key.
    OtherKey,
    /// It does not fit.
    TooLong,
}

/// An entry: key, version, the value's postcard bytes, CRC-32 of all before.
///
/// Errors: [`Damage::TooLong`] when the value takes more than [`LONGEST_SETTING`] bytes.
#[inline(never)]
pub fn encode<S: Setting>(value: &S) -> Result<Entry, Damage> {
    let mut entry = Entry::new();
    entry.resize(LONGEST_SETTING, 0).map_err(|_| Damage::TooLong)?;
    entry[0] = S::KEY as u8;
    entry[1] = S::VERSION;
    let used = postcard::to_slice(value, &mut entry[2..LONGEST_SETTING - 4]).map_err(|_| Damage::TooLong)?.len();
    let end = 2 + used;
    let sum = crc32(&entry[..end]).to_le_bytes();
    entry[end..end + 4].copy_from_slice(&sum);
    entry.truncate(end + 4);
    Ok(entry)
}

/// The value of an entry. Errors say what is wrong with it.
#[inline(never)]
pub fn decode<S: Setting>(entry: &[u8]) -> Result<S, Damage> {
    let Some((body, sum)) = entry.split_last_chunk::<4>() else { return Err(Damage::Corrupt) };
    if crc32(body) != u32::from_le_bytes(*sum) {
        return Err(Damage::Corrupt);
    }
    match body {
        [key, ..] if *key != S::KEY as u8 => Err(Damage::OtherKey),
        [_, version, value @ ..] if *version != S::VERSION => {
            let missing = S::SHORTER.iter().find(|(earlier, ..)| earlier == version);
            let (_, at, missing) = missing.ok_or(Damage::UnknownVersion(*version))?;
            let (before, after) = value.split_at((*at).min(value.len()));
            let mut whole = Entry::new();
            for part in [before, missing, after] {
                whole.extend_from_slice(part).map_err(|_| Damage::TooLong)?;
            }
            value_of(&whole)
        }
        [_, _, value @ ..] => value_of(value),
        _ => Err(Damage::Corrupt),
    }
}

/// The value whose encoding is exactly these bytes.
fn value_of<S: Setting>(bytes: &[u8]) -> Result<S, Damage> {
    match postcard::take_from_bytes(bytes) {
        Ok((value, [])) => Ok(value),
        _ => Err(Damage::Corrupt),
    }
}
