//! The settings that the board keeps in flash: one entry each, with its own version and checksum.
//!
//! An entry that is damaged or has an unknown version is refused alone; the others are kept. The bytes are identical in
//! flash, in a backup file and on the link.

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
/// Bytes of an entry.
pub type Entry = Vec<u8, LONGEST_SETTING>;

/// Key of a setting. The numbers never change.
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
    /// Fingerprint of a device whose polarity was checked once. Older boards and their backups contain it; it no longer
    /// counts as a check.
    Polarity = 5,
    /// The board's name.
    Name = 6,
}

// The settings' entries lie between the catalogue and the decision, and `ALL` is in the order of the keys.
const _: () = {
    let mut place = 0;
    while place < Key::ALL.len() {
        let key = Key::ALL[place] as usize;
        assert!(key == place + 1 && key < DECISION as usize);
        place += 1;
    }
};

impl Key {
    /// All keys.
    pub const ALL: [Key; 6] = [Key::Device, Key::Scene, Key::Rules, Key::MassModel, Key::Polarity, Key::Name];

    /// Returns the key's name in backups and reports.
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

/// A value that is stored under a key.
pub trait Setting: Serialize + DeserializeOwned {
    /// Key of the setting.
    const KEY: Key;
    /// Version of the encoding, increased whenever the fields change.
    const VERSION: u8;
    /// Earlier versions that lack bytes: the version, the position of the missing bytes (from the value's first byte, or
    /// `END`), and the values of the later fields for such an entry.
    const SHORTER: &'static [(u8, usize, &'static [u8])] = &[];
}

/// Position after the last byte.
const END: usize = usize::MAX;

impl Setting for Device<f32> {
    const KEY: Key = Key::Device;
    /// 2: scale of a five-bar's rods.
    const VERSION: u8 = 2;
}
impl Setting for Scene<f32> {
    const KEY: Key = Key::Scene;
    /// 2: feed-forward gain and held coordinate of a redundant device; `velocity_terms` is no longer a flag. 3:
    /// joint-space estimators with their options. 4: posture.
    const VERSION: u8 = 4;
    /// Defaults: a gain of 1, the orientation, no posture. Earlier estimators are unchanged.
    const SHORTER: &'static [(u8, usize, &'static [u8])] =
        &[(1, END, &[0x00, 0x00, 0x80, 0x3f, 0x00, 0x00]), (2, END, &[0x00]), (3, END, &[0x00])];
}
impl Setting for Rules {
    const KEY: Key = Key::Rules;
    /// 2: force limit at the tip.
    const VERSION: u8 = 2;
    /// The gentle force limit, at the end of the limits, which come first: fifteen numbers of four bytes.
    const SHORTER: &'static [(u8, usize, &'static [u8])] = &[(1, 60, &GENTLE_FORCE.to_le_bytes())];
}
impl Setting for MassModelData {
    const KEY: Key = Key::MassModel;
    const VERSION: u8 = 1;
}

/// Fingerprint of a device whose polarity was checked once. Read so that old flash and backups stay valid. It proves
/// nothing, because wires may change while a board has no power.
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

/// Reason why an entry cannot be used.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub enum Damage {
    /// The checksum or the encoding is wrong.
    Corrupt,
    /// The entry has a version that this firmware does not know.
    UnknownVersion(u8),
    /// The entry belongs to another key.
    OtherKey,
    /// The entry is too long.
    TooLong,
}

/// Encodes an entry: key, version, the value's postcard bytes, CRC-32 of these.
///
/// Errors: [`Damage::TooLong`] if the entry needs more than [`LONGEST_SETTING`] bytes.
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

/// Decodes the value of an entry.
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
            let mut complete = Entry::new();
            for part in [before, missing, after] {
                complete.extend_from_slice(part).map_err(|_| Damage::TooLong)?;
            }
            value_of(&complete)
        }
        [_, _, value @ ..] => value_of(value),
        _ => Err(Damage::Corrupt),
    }
}

/// Decodes a value from exactly these bytes.
fn value_of<S: Setting>(bytes: &[u8]) -> Result<S, Damage> {
    match postcard::take_from_bytes(bytes) {
        Ok((value, [])) => Ok(value),
        _ => Err(Damage::Corrupt),
    }
}
