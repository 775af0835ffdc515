//! Backups of a board's settings: one JSON file, readable by people and by later versions of this tool.
//!
//! The file holds every setting twice: its bytes as the board stores them, and its decoded value with names. A board of
//! the same version gets the bytes unchanged; a board whose firmware stores the setting in another version gets the
//! value, encoded again. Nothing is sent before the complete file has been decoded.

use crate::digits::shorten_all;
use crate::link::{Board, BoardError};
use haptic_bridge::board::protocol::KeyList;
use haptic_bridge::board::settings::{BoardName, Damage, Entry, Key, Polarity, Setting, decode, encode};
use haptic_bridge::control::Rules;
use haptic_bridge::model::cogging::Potentials;
use haptic_bridge::model::device::Device;
use haptic_bridge::render::scene::Scene;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::collections::BTreeMap;

/// Version of the file layout.
pub const FORMAT: u32 = 1;

/// The content of a backup file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Backup {
    /// Version of the file layout, [`FORMAT`].
    #[serde(rename = "haptic-backup")]
    pub format: u32,
    /// Version of the board's firmware.
    pub firmware: String,
    /// Kind of board.
    pub board: String,
    /// Serial number of the board.
    pub serial: String,
    /// The settings by name. Settings that were never saved are missing.
    pub settings: BTreeMap<String, SavedSetting>,
}

/// A setting in a backup.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SavedSetting {
    /// Version of the encoding of `bytes`.
    pub version: u8,
    /// The decoded value; `None` if this tool could not decode the bytes.
    pub value: Option<Value>,
    /// The setting as the board stores it, in hexadecimal.
    pub bytes: String,
}

impl SavedSetting {
    /// Encodes a value as the board stores it; `None` if the encoding is too long.
    pub fn of<S: Setting>(value: &S) -> Option<Self> {
        Some(saved_setting(S::KEY, &encode(value).ok()?))
    }
    /// Decodes the bytes if this tool knows their version, otherwise reads the JSON value.
    pub fn read<S: Setting>(&self) -> Result<S, BackupError> {
        let (entry, _) = usable_entry_as::<S>(self)?;
        decode(&entry).map_err(|damage| damage_error(S::KEY, damage))
    }
}

/// The reason why a backup cannot be used.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[allow(missing_docs)]
pub enum BackupError {
    #[error("this is not a backup of a board: {0}")]
    NotABackup(String),
    #[error("the backup has format {0}, and this tool knows {FORMAT}: update the tool")]
    Format(u32),
    #[error("the backup holds a setting {0:?} that this tool does not know: update the tool")]
    UnknownSetting(String),
    /// The value and the bytes of a setting differ because one of them was edited.
    #[error(
        "the setting {0:?} in the backup has a \"value\" that differs from its \"bytes\", and the board would get the bytes: \
        undo the edit, or change the setting with a device file, a scene file or `haptic rules`"
    )]
    ValueAndBytesDiffer(&'static str),
    #[error("the setting {0:?} in the backup is damaged: {1}")]
    Damaged(&'static str, String),
}

/// The way in which a setting is restored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RestoreMethod {
    /// The bytes of the backup, unchanged.
    Unchanged,
    /// The value, encoded again because the backup's bytes have another version.
    Translated,
    /// Not restored, because a polarity check is valid only for the wiring that was checked.
    NotRestored,
}

/// A setting that is ready to be sent to a board.
#[derive(Clone, Debug, PartialEq)]
pub struct PreparedSetting {
    /// Key of the setting.
    pub key: Key,
    /// The setting in this tool's encoding.
    pub entry: Entry,
    /// The way in which the setting is restored.
    pub method: RestoreMethod,
}

/// The order in which settings are restored, because a new device resets the settings that depend on it.
const RESTORE_ORDER: [Key; Key::ALL.len()] =
    [Key::Rules, Key::Device, Key::Cogging, Key::Scene, Key::Name, Key::Polarity];

/// A setting of earlier firmware, the source of the mass matrix. It is not restored, because this firmware always
/// computes the exact one.
pub const FORMER_SETTING: &str = "mass-model";

impl Backup {
    /// Reads all settings in a board's flash. Skips a setting if its only copy is damaged.
    pub fn read(board: &mut Board) -> Result<Self, BoardError> {
        let mut settings = BTreeMap::new();
        for key in Key::ALL {
            if let Some(entry) = board.read_entry(key)?.filter(|entry| !entry.is_empty()) {
                settings.insert(key.name().to_string(), saved_setting(key, &entry));
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

    /// Returns the text of the file.
    pub fn to_text(&self) -> String {
        // A map with string keys always serialises to JSON.
        serde_json::to_string_pretty(self).unwrap_or_default() + "\n"
    }
    /// Parses the text of a file.
    pub fn parse(text: &str) -> Result<Self, BackupError> {
        let value: Value = serde_json::from_str(text).map_err(|error| BackupError::NotABackup(error.to_string()))?;
        match value.get("haptic-backup").and_then(Value::as_u64) {
            Some(format) if format == u64::from(FORMAT) => {}
            Some(format) => return Err(BackupError::Format(format as u32)),
            None => return Err(BackupError::NotABackup("the key \"haptic-backup\" is missing".into())),
        }
        serde_json::from_value(value).map_err(|error| BackupError::NotABackup(error.to_string()))
    }

    /// Returns every setting in this version's encoding, in the order to send them.
    pub fn prepared_settings(&self) -> Result<Vec<PreparedSetting>, BackupError> {
        let is_known = |name: &str| name == FORMER_SETTING || Key::ALL.iter().any(|key| key.name() == name);
        if let Some(unknown) = self.settings.keys().find(|name| !is_known(name)) {
            return Err(BackupError::UnknownSetting(unknown.clone()));
        }
        let mut ready = Vec::new();
        for key in RESTORE_ORDER {
            if let Some(saved) = self.settings.get(key.name()) {
                let (entry, mut method) = usable_entry(key, saved)?;
                if key == Key::Polarity {
                    method = RestoreMethod::NotRestored;
                }
                ready.push(PreparedSetting { key, entry, method });
            }
        }
        Ok(ready)
    }
}

/// Sends prepared settings to a board, then applies and saves them as one change. If the link or the power fails, the
/// board has all of the settings or none. The motors must be off.
pub fn restore(board: &mut Board, ready: &[PreparedSetting]) -> Result<(), BoardError> {
    let mut keys = KeyList::new();
    for setting in ready.iter().filter(|setting| setting.method != RestoreMethod::NotRestored) {
        board.stage_entry(setting.key, setting.entry.clone())?;
        // The list has room for every key, and a backup contains each key once.
        let _ = keys.push(setting.key);
    }
    board.commit_entries(&keys)
}

/// Returns the names of the settings that a board would lose in a restart, because they differ from the saved settings.
pub fn unsaved_settings(board: &mut Board) -> Result<Vec<&'static str>, BoardError> {
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
    let cogging = board.cogging()?;
    if !cogging.is_empty() && differs(board, &cogging)? {
        unsaved.push("cogging");
    }
    let name = BoardName(board.details()?.name);
    if !name.0.is_empty() && differs(board, &name)? {
        unsaved.push("name");
    }
    Ok(unsaved)
}

fn damage_error(key: Key, damage: Damage) -> BackupError {
    let reason = match damage {
        Damage::Corrupt => "its checksum or encoding is wrong".to_string(),
        Damage::UnknownVersion(version) => format!("its bytes have version {version}, and its value is missing"),
        Damage::OtherKey => "its bytes belong to another setting".to_string(),
        Damage::TooLong => "its bytes are too long".to_string(),
    };
    BackupError::Damaged(key.name(), reason)
}

fn saved_setting(key: Key, entry: &[u8]) -> SavedSetting {
    fn value<S: Setting>(entry: &[u8]) -> Option<Value> {
        serde_json::to_value(decode::<S>(entry).ok()?).ok().map(shorten_all)
    }
    let value = match key {
        Key::Device => value::<Device<f32>>(entry),
        Key::Scene => value::<Scene<f32>>(entry),
        Key::Rules => value::<Rules>(entry),
        Key::Cogging => value::<Potentials>(entry),
        Key::Polarity => value::<Polarity>(entry),
        Key::Name => value::<BoardName>(entry),
    };
    let bytes = entry.iter().map(|byte| format!("{byte:02x}")).collect();
    SavedSetting { version: entry.get(1).copied().unwrap_or(0), value, bytes }
}

fn usable_entry(key: Key, saved: &SavedSetting) -> Result<(Entry, RestoreMethod), BackupError> {
    match key {
        Key::Device => usable_entry_as::<Device<f32>>(saved),
        Key::Scene => usable_entry_as::<Scene<f32>>(saved),
        Key::Rules => usable_entry_as::<Rules>(saved),
        Key::Cogging => usable_entry_as::<Potentials>(saved),
        Key::Polarity => usable_entry_as::<Polarity>(saved),
        Key::Name => usable_entry_as::<BoardName>(saved),
    }
}

/// Returns the bytes if this version can decode them, otherwise the value in this version's encoding.
fn usable_entry_as<S: Setting>(saved: &SavedSetting) -> Result<(Entry, RestoreMethod), BackupError> {
    let bytes = from_hex(&saved.bytes).ok_or_else(|| damage_error(S::KEY, Damage::Corrupt))?;
    match decode::<S>(&bytes) {
        Ok(value) => {
            let decoded = serde_json::to_value(&value).ok().map(shorten_all);
            if saved.value.clone().is_some_and(|written| Some(shorten_all(written)) != decoded) {
                return Err(BackupError::ValueAndBytesDiffer(S::KEY.name()));
            }
            let entry = Entry::from_slice(&bytes).map_err(|_| damage_error(S::KEY, Damage::TooLong))?;
            Ok((entry, RestoreMethod::Unchanged))
        }
        Err(Damage::UnknownVersion(version)) => {
            let value = saved.value.clone().ok_or_else(|| damage_error(S::KEY, Damage::UnknownVersion(version)))?;
            let value: S = serde_json::from_value(value)
                .map_err(|error| BackupError::Damaged(S::KEY.name(), error.to_string()))?;
            Ok((encode(&value).map_err(|error| damage_error(S::KEY, error))?, RestoreMethod::Translated))
        }
        Err(other) => Err(damage_error(S::KEY, other)),
    }
}

fn from_hex(text: &str) -> Option<Vec<u8>> {
    let digits: Option<Vec<u32>> = text.chars().map(|c| c.to_digit(16)).collect();
    let digits = digits.filter(|digits| digits.len() % 2 == 0)?;
    Some(digits.chunks(2).map(|pair| (pair[0] * 16 + pair[1]) as u8).collect())
}
