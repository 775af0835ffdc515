//! Backups of a board's settings: one JSON file, readable by people and by later versions of this tool.
//!
//! Every setting stands in it twice: its bytes as the board keeps them, and its value with names. The bytes go back
//! unchanged to a board of the same version; a board whose firmware keeps the setting in another version gets the
//! value, encoded again. Nothing is sent before the whole file has been understood.

use crate::digits::shortest;
use crate::link::{Board, BoardError};
use haptic_bridge::board::protocol::KeyList;
use haptic_bridge::board::settings::{BoardName, Damage, Entry, Key, Polarity, Setting, decode, encode};
use haptic_bridge::control::Rules;
use haptic_bridge::model::device::Device;
use haptic_bridge::model::precomputed::MassModelData;
use haptic_bridge::render::scene::Scene;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::collections::BTreeMap;

/// Version of the file's own layout.
pub const FORMAT: u32 = 1;

/// The content of a backup file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Backup {
    /// [`FORMAT`].
    #[serde(rename = "haptic-backup")]
    pub format: u32,
    /// Firmware it was read from.
    pub firmware: String,
    /// Kind of board.
    pub board: String,
    /// Its serial number.
    pub serial: String,
    /// The settings by name; those that were never saved are not there.
    pub settings: BTreeMap<String, SavedSetting>,
}

/// One setting.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SavedSetting {
    /// Version of its bytes.
    pub version: u8,
    /// The decoded value; `None` when this tool could not read the bytes.
    pub value: Option<Value>,
    /// The bytes, in hexadecimal.
    pub bytes: String,
}

impl SavedSetting {
    /// A value as the board would keep it; none where it is too long for that.
    pub fn of<S: Setting>(value: &S) -> Option<Self> {
        Some(kept(S::KEY, &encode(value).ok()?))
    }

    /// The value again, from bytes of this version or else from what they mean.
    pub fn read<S: Setting>(&self) -> Result<S, BackupError> {
        let (entry, _) = usable_as::<S>(self)?;
        decode(&entry).map_err(|damage| damaged(S::KEY, damage))
    }
}

/// Why a backup cannot be used.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum BackupError {
    /// Not JSON, or not of this shape.
    #[error("this is not a backup of a board: {0}")]
    NotABackup(String),
    /// Of a later tool.
    #[error("the backup has format {0}, and this tool knows {FORMAT}: update the tool")]
    Format(u32),
    /// A setting that this tool does not know.
    #[error("the backup holds a setting {0:?} that this tool does not know: update the tool")]
    UnknownSetting(String),
    /// Its value and its bytes do not say the same: somebody edited one of them.
    #[error(
        "the setting {0:?} in the backup has a \"value\" that is not what its \"bytes\" hold, and these go back to the board: \
         undo the edit, or change the setting with a device file, a scene file or `haptic rules`"
    )]
    Disagree(&'static str),
    /// Neither its bytes nor its value can be used.
    #[error("the setting {0:?} in the backup is damaged: {1}")]
    Damaged(&'static str, String),
}

/// The outcome for one setting.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Restored {
    /// The very bytes of the backup.
    AsItWas,
    /// Encoded again from its value, because the backup's bytes are of another version.
    Translated,
    /// Left out: a polarity check is valid only for the wiring it was made with, and the present wiring is unchecked.
    MadeAnew,
}

/// A setting ready to be sent.
#[derive(Clone, Debug, PartialEq)]
pub struct Ready {
    /// Which.
    pub key: Key,
    /// Its bytes in this version.
    pub entry: Entry,
    /// The way its bytes were obtained.
    pub how: Restored,
}

/// The order in which settings go back: a device resets what belongs to the one before.
const ORDER: [Key; Key::ALL.len()] = [Key::Rules, Key::Device, Key::MassModel, Key::Scene, Key::Name, Key::Polarity];

impl Backup {
    /// Reads everything that a board keeps in flash. A setting of which only damage is left is left out.
    pub fn read(board: &mut Board) -> Result<Self, BoardError> {
        let mut settings = BTreeMap::new();
        for key in Key::ALL {
            if let Some(entry) = board.read_entry(key)?.filter(|entry| !entry.is_empty()) {
                settings.insert(key.name().to_string(), kept(key, &entry));
            }
        }
        let info = board.info();
        Ok(Self {
            format: FORMAT,
            firmware: info.firmware.to_string(),
            board: info.board.to_string(),
            serial: info.serial.to_string(),
            settings,
        })
    }

    /// The file's text.
    pub fn to_text(&self) -> String {
        // A map with names for keys always becomes JSON.
        serde_json::to_string_pretty(self).unwrap_or_default() + "\n"
    }

    /// Reads a file's text.
    pub fn parse(text: &str) -> Result<Self, BackupError> {
        let value: Value = serde_json::from_str(text).map_err(|error| BackupError::NotABackup(error.to_string()))?;
        match value.get("haptic-backup").and_then(Value::as_u64) {
            Some(format) if format == u64::from(FORMAT) => {}
            Some(format) => return Err(BackupError::Format(format as u32)),
            None => return Err(BackupError::NotABackup("it has no \"haptic-backup\"".into())),
        }
        serde_json::from_value(value).map_err(|error| BackupError::NotABackup(error.to_string()))
    }

    /// Every setting in this version's bytes, in the order to send them.
    pub fn ready(&self) -> Result<Vec<Ready>, BackupError> {
        if let Some(unknown) = self.settings.keys().find(|name| Key::ALL.iter().all(|key| key.name() != **name)) {
            return Err(BackupError::UnknownSetting(unknown.clone()));
        }
        let mut ready = Vec::new();
        for key in ORDER {
            match self.settings.get(key.name()) {
                Some(kept) => {
                    let (entry, mut how) = usable(key, kept)?;
                    if key == Key::Polarity {
                        how = Restored::MadeAnew;
                    }
                    ready.push(Ready { key, entry, how });
                }
                // A device must not meet the mass model that the board kept for another one.
                None if key == Key::MassModel && self.settings.contains_key(Key::Device.name()) => {
                    let entry = encode(&MassModelData::Exact).map_err(|error| damaged(key, error))?;
                    ready.push(Ready { key, entry, how: Restored::AsItWas });
                }
                None => {}
            }
        }
        Ok(ready)
    }
}

/// Sends settings made ready to a board and puts them in force and into flash, as one change: wherever the link or the
/// power goes, the board has all of them or none. Motors must be off.
pub fn restore(board: &mut Board, ready: &[Ready]) -> Result<(), BoardError> {
    let mut keys = KeyList::new();
    for setting in ready.iter().filter(|setting| setting.how != Restored::MadeAnew) {
        board.stage_entry(setting.key, setting.entry.clone())?;
        // A backup has each key once.
        let _ = keys.push(setting.key);
    }
    board.commit_entries(&keys)
}

/// Names the settings on a board that a restart would lose: a device, a scene or a name other than what was saved, and
/// rules other than those saved, where any were.
pub fn unsaved(board: &mut Board) -> Result<Vec<&'static str>, BoardError> {
    fn differs<S: Setting + PartialEq>(board: &mut Board, now: &S) -> Result<bool, BoardError> {
        let saved = board.read_entry(S::KEY)?.and_then(|entry| decode::<S>(&entry).ok());
        Ok(saved.as_ref() != Some(now))
    }
    let mut unsaved = Vec::new();
    if let Some(device) = board.device()?
        && differs(board, &device)?
    {
        unsaved.push("device");
    }
    if let Some(scene) = board.scene()?
        && differs(board, &scene)?
    {
        unsaved.push("scene");
    }
    let rules = board.rules()?;
    if board.read_entry(Key::Rules)?.is_some_and(|entry| !entry.is_empty()) && differs(board, &rules)? {
        unsaved.push("rules");
    }
    let name = BoardName(board.details()?.name);
    if !name.0.is_empty() && differs(board, &name)? {
        unsaved.push("name");
    }
    Ok(unsaved)
}

fn damaged(key: Key, damage: Damage) -> BackupError {
    let reason = match damage {
        Damage::Corrupt => "its checksum or encoding is wrong".to_string(),
        Damage::UnknownVersion(version) => format!("it is of version {version}, and its value is missing"),
        Damage::OtherKey => "it belongs to another setting".to_string(),
        Damage::TooLong => "it is too long".to_string(),
    };
    BackupError::Damaged(key.name(), reason)
}

fn kept(key: Key, entry: &[u8]) -> SavedSetting {
    fn value<S: Setting>(entry: &[u8]) -> Option<Value> {
        serde_json::to_value(decode::<S>(entry).ok()?).ok().map(shortest)
    }
    let value = match key {
        Key::Device => value::<Device<f32>>(entry),
        Key::Scene => value::<Scene<f32>>(entry),
        Key::Rules => value::<Rules>(entry),
        Key::MassModel => value::<MassModelData>(entry),
        Key::Polarity => value::<Polarity>(entry),
        Key::Name => value::<BoardName>(entry),
    };
    let bytes = entry.iter().map(|byte| format!("{byte:02x}")).collect();
    SavedSetting { version: entry.get(1).copied().unwrap_or(0), value, bytes }
}

fn usable(key: Key, kept: &SavedSetting) -> Result<(Entry, Restored), BackupError> {
    match key {
        Key::Device => usable_as::<Device<f32>>(kept),
        Key::Scene => usable_as::<Scene<f32>>(kept),
        Key::Rules => usable_as::<Rules>(kept),
        Key::MassModel => usable_as::<MassModelData>(kept),
        Key::Polarity => usable_as::<Polarity>(kept),
        Key::Name => usable_as::<BoardName>(kept),
    }
}

/// Returns the bytes if this version understands them, otherwise the value in this version's encoding.
fn usable_as<S: Setting>(kept: &SavedSetting) -> Result<(Entry, Restored), BackupError> {
    let bytes = from_hex(&kept.bytes).ok_or_else(|| damaged(S::KEY, Damage::Corrupt))?;
    match decode::<S>(&bytes) {
        Ok(value) => {
            let said = serde_json::to_value(&value).ok().map(shortest);
            if kept.value.clone().is_some_and(|written| Some(shortest(written)) != said) {
                return Err(BackupError::Disagree(S::KEY.name()));
            }
            let entry = Entry::from_slice(&bytes).map_err(|_| damaged(S::KEY, Damage::TooLong))?;
            Ok((entry, Restored::AsItWas))
        }
        Err(Damage::UnknownVersion(version)) => {
            let value = kept.value.clone().ok_or_else(|| damaged(S::KEY, Damage::UnknownVersion(version)))?;
            let value: S = serde_json::from_value(value)
                .map_err(|error| BackupError::Damaged(S::KEY.name(), error.to_string()))?;
            Ok((encode(&value).map_err(|error| damaged(S::KEY, error))?, Restored::Translated))
        }
        Err(other) => Err(damaged(S::KEY, other)),
    }
}

fn from_hex(text: &str) -> Option<Vec<u8>> {
    let digits: Option<Vec<u32>> = text.chars().map(|c| c.to_digit(16)).collect();
    let digits = digits.filter(|digits| digits.len() % 2 == 0)?;
    Some(digits.chunks(2).map(|pair| (pair[0] * 16 + pair[1]) as u8).collect())
}
