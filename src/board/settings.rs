//! The settings in the board's flash: one entry each, with its own version and checksum.
//!
//! An entry that is damaged or has an unknown version is refused without the other entries. The bytes are identical in
//! flash, in a backup file and on the link.

use crate::board::storage::{CATALOGUE_KEY, DECISION_KEY};
use crate::checksum::crc32;
use crate::control::Rules;
use crate::model::catalogue::MAX_JOINTS;
use crate::model::cogging::Potentials;
use crate::model::description::{Homing, MAX_SENSED};
use crate::model::device::{Device, Joint, NAME_LENGTH, Sensed};
use crate::model::mechanism::AnyMechanism;
use crate::model::motor::{Motor, Winding};
use crate::render::scene::Scene;
use crate::safety::limits::GENTLE_FORCE;
use heapless::{String, Vec};
use postcard_schema::Schema;
use serde::{Deserialize, Serialize, de::DeserializeOwned};

/// Maximum length of an entry, bytes.
pub const LONGEST_SETTING: usize = 1024;
/// Bytes of an entry.
pub type Entry = Vec<u8, LONGEST_SETTING>;

/// Key of a setting. The numbers never change. Old flash may contain a former setting under key 4, see [`is_former`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[repr(u8)]
pub enum Key {
    /// The device.
    Device = 1,
    /// The scene.
    Scene = 2,
    /// Limits and rules.
    Rules = 3,
    /// Potentials of the device's motors.
    Cogging = 4,
    /// Checksum of a device that once passed the polarity check. Unused, but contained in old flash and backups.
    Polarity = 5,
    /// The board's name.
    Name = 6,
}

// The settings' keys lie between `CATALOGUE_KEY` and `DECISION_KEY`, and `ALL` is in the order of the keys.
const _: () = {
    let (mut place, mut before) = (0, CATALOGUE_KEY);
    while place < Key::ALL.len() {
        let key = Key::ALL[place] as u8;
        assert!(before < key && key < DECISION_KEY);
        (place, before) = (place + 1, key);
    }
};

impl Key {
    /// All keys.
    pub const ALL: [Key; 6] = [Key::Device, Key::Scene, Key::Rules, Key::Cogging, Key::Polarity, Key::Name];

    /// Returns the key's name in backups and reports.
    pub const fn name(self) -> &'static str {
        match self {
            Key::Device => "device",
            Key::Scene => "scene",
            Key::Rules => "rules",
            Key::Cogging => "cogging",
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
    /// Earlier versions with fewer bytes: the version, the position of the missing bytes (from the value's first byte,
    /// or `END_POSITION`), and the bytes to insert.
    const EARLIER_VERSIONS: &'static [(u8, usize, &'static [u8])] = &[];

    /// Decodes a value of an earlier version from exactly these bytes, after the missing bytes were inserted.
    fn from_earlier_bytes(bytes: &[u8]) -> Result<Self, Damage> {
        value_of(bytes)
    }
}

/// Position after the last byte.
const END_POSITION: usize = usize::MAX;

impl Setting for Device<f32> {
    const KEY: Key = Key::Device;
    /// Version 2 added the scale of a five-bar's rods, version 3 the reference of homing and the encoders without motors,
    /// version 4 three-phase motors and absolute encoders.
    const VERSION: u8 = 4;
    /// Appends homing by hand and an empty list.
    const EARLIER_VERSIONS: &'static [(u8, usize, &'static [u8])] =
        &[(2, END_POSITION, &[0x00, 0x00]), (3, END_POSITION, &[])];

    fn from_earlier_bytes(bytes: &[u8]) -> Result<Self, Damage> {
        value_of::<EarlierDevice>(bytes).map(Self::from)
    }
}

/// A device of version 3, with brushed motors and incremental encoders.
#[derive(Deserialize)]
struct EarlierDevice {
    name: String<NAME_LENGTH>,
    mechanism: AnyMechanism<f32>,
    weight: bool,
    joints: [EarlierJoint; MAX_JOINTS],
    home: Option<[f32; MAX_JOINTS]>,
    homing: Homing<f32>,
    sensed: Vec<Sensed<f32>, MAX_SENSED>,
}

#[derive(Deserialize)]
struct EarlierJoint {
    radians_per_count: f32,
    counts_per_turn: i32,
    offset: f32,
    viscous: f32,
    coulomb: f32,
    limits: Option<(f32, f32)>,
    motor: Option<EarlierMotor>,
}

#[derive(Deserialize)]
struct EarlierMotor {
    torque_constant: f32,
    resistance: f32,
    inductance: f32,
    back_emf: f32,
    max_current: f32,
    verified: bool,
}

impl From<EarlierDevice> for Device<f32> {
    fn from(earlier: EarlierDevice) -> Self {
        let EarlierDevice { name, mechanism, weight, joints, home, homing, sensed } = earlier;
        let joints = joints.map(|joint| {
            let EarlierJoint { radians_per_count, counts_per_turn, offset, viscous, coulomb, limits, motor } = joint;
            let motor = motor.map(|motor| {
                let EarlierMotor { torque_constant, resistance, inductance, back_emf, max_current, verified } = motor;
                let winding = Winding::Brushed;
                Motor { torque_constant, resistance, inductance, back_emf, max_current, winding, verified }
            });
            let absolute = None;
            Joint { radians_per_count, counts_per_turn, offset, viscous, coulomb, limits, motor, absolute }
        });
        Self { name, mechanism, weight, joints, home, homing, sensed }
    }
}
impl Setting for Scene<f32> {
    const KEY: Key = Key::Scene;
    /// Version 2 added the feed-forward gain and the held coordinate, and `velocity_terms` is no longer a flag. Version
    /// 3 added joint estimators with their options, version 4 the posture.
    const VERSION: u8 = 4;
    /// Inserts the defaults: a gain of 1, a held orientation, no posture. Earlier estimators keep their encoding.
    const EARLIER_VERSIONS: &'static [(u8, usize, &'static [u8])] = &[
        (1, END_POSITION, &[0x00, 0x00, 0x80, 0x3f, 0x00, 0x00]),
        (2, END_POSITION, &[0x00]),
        (3, END_POSITION, &[0x00]),
    ];
}
impl Setting for Rules {
    const KEY: Key = Key::Rules;
    /// Version 2 added the force limit at the tip.
    const VERSION: u8 = 2;
    /// Inserts [`GENTLE_FORCE`] after the other limits, which are the first fifteen numbers of four bytes.
    const EARLIER_VERSIONS: &'static [(u8, usize, &'static [u8])] = &[(1, 60, &GENTLE_FORCE.to_le_bytes())];
}
impl Setting for Potentials {
    const KEY: Key = Key::Cogging;
    /// Version 1 is the version of the former setting, see [`is_former`].
    const VERSION: u8 = 2;
}

/// Returns true for an entry of the former setting under [`Key::Cogging`], a mass matrix, which counts as missing.
pub fn is_former(entry: &[u8]) -> bool {
    matches!(entry, [key, 1, ..] if *key == Key::Cogging as u8)
}

/// Checksum of a device that once passed the polarity check. Old flash and backups may contain it. The checksum has no
/// effect, because wires may change while a board has no power.
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

/// Encodes an entry: key, version, the value's postcard bytes, and the CRC-32 of all these. Returns [`Damage::TooLong`]
/// if the entry needs more than [`LONGEST_SETTING`] bytes.
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
            let missing = S::EARLIER_VERSIONS.iter().find(|(earlier, ..)| earlier == version);
            let (_, at, missing) = missing.ok_or(Damage::UnknownVersion(*version))?;
            let (before, after) = value.split_at((*at).min(value.len()));
            let mut complete = Entry::new();
            for part in [before, missing, after] {
                complete.extend_from_slice(part).map_err(|_| Damage::TooLong)?;
            }
            S::from_earlier_bytes(&complete)
        }
        [_, _, value @ ..] => value_of(value),
        _ => Err(Damage::Corrupt),
    }
}

/// Decodes a value from exactly these bytes.
fn value_of<T: DeserializeOwned>(bytes: &[u8]) -> Result<T, Damage> {
    match postcard::take_from_bytes(bytes) {
        Ok((value, [])) => Ok(value),
        _ => Err(Damage::Corrupt),
    }
}
