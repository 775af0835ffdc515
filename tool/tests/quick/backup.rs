//! A backup restores all saved settings, byte for byte, or no setting at all, also from another firmware version.

use crate::common::prelude::*;
use crate::common::{board, plane_wall, shipped_device};
use haptic_bridge::board::settings::{Entry, Key};
use haptic_bridge::safety::limits::Limits;
use haptic_host::backup::{Backup, BackupError, RestoreMethod, restore};
use haptic_sim::SimulatedBoard;
use std::collections::BTreeMap;

fn saved_entries(board: &mut Board) -> BTreeMap<&'static str, Entry> {
    Key::ALL.into_iter().filter_map(|key| Some((key.name(), board.read_entry(key).unwrap()?))).collect()
}

/// Returns a board with a value saved under every key that a tool can set.
fn board_with_all_settings() -> Board {
    let (_, mut board) = board(&shipped_device("coupled-five-bar"), BoardOptions::default());
    let plane = plane_wall([0.0, -0.2, 0.0], [0.0, 1.0, 0.0], 1234.5, 0.1);
    let wall = Wall { feed_forward: FeedForward::Washout, ..plane };
    let mut scene = Scene { task: 2, ..Scene::default() };
    scene.walls.push(wall).unwrap();
    board.set_scene(&scene).unwrap();
    board.set_rules(&Rules { limits: Limits { power: 3.3, ..Limits::default() }, ..Rules::default() }).unwrap();
    board.set_name(&"bench left".try_into().unwrap()).unwrap();
    board.save().unwrap();
    board
}

fn empty_board(serial: &str) -> Board {
    let options = BoardOptions { serial: serial.into(), ..BoardOptions::default() };
    let board = SimulatedBoard::new(&shipped_device("coupled-five-bar").description, options).unwrap();
    Board::over(SharedBoard::new(board).wire(), "sim").unwrap()
}

#[test]
fn saved_settings_are_restored_byte_for_byte() {
    let mut source = board_with_all_settings();
    let saved = saved_entries(&mut source);
    assert!(saved.len() >= 4, "{:?}", saved.keys());
    let text = Backup::read(&mut source).unwrap().to_text();
    let mut target = empty_board("SIM0001");
    let ready = Backup::parse(&text).unwrap().prepared_settings().unwrap();
    assert!(ready.iter().all(|setting| setting.method == RestoreMethod::Unchanged));
    restore(&mut target, &ready).unwrap();
    assert_eq!(saved_entries(&mut target), saved);
    assert_eq!(target.scene().unwrap(), source.scene().unwrap());
    assert_eq!(target.rules().unwrap(), source.rules().unwrap());
}

#[test]
fn a_backup_of_another_version_is_translated() {
    let mut source = board_with_all_settings();
    let saved = saved_entries(&mut source);
    let mut backup = Backup::read(&mut source).unwrap();
    for (name, setting) in &mut backup.settings {
        // Another firmware would have written the same value with another version and other bytes.
        let mut body = saved[name.as_str()][..saved[name.as_str()].len() - 4].to_vec();
        body[1] = 77;
        body.extend([1, 2, 3]);
        let sum = haptic_bridge::checksum::crc32(&body).to_le_bytes();
        body.extend(sum);
        setting.version = 77;
        setting.bytes = body.iter().map(|byte| format!("{byte:02x}")).collect();
    }
    let ready = Backup::parse(&backup.to_text()).unwrap().prepared_settings().unwrap();
    assert!(ready.iter().all(|setting| setting.method == RestoreMethod::Translated));
    let mut target = empty_board("SIM0001");
    restore(&mut target, &ready).unwrap();
    assert_eq!(saved_entries(&mut target), saved);
}

#[test]
fn damage_is_detected_before_anything_is_sent() {
    let backup = Backup::read(&mut board_with_all_settings()).unwrap();
    for name in backup.settings.keys() {
        let mut damaged = backup.clone();
        let bytes = &mut damaged.settings.get_mut(name).unwrap().bytes;
        let flipped = if bytes.ends_with('0') { '1' } else { '0' };
        bytes.pop();
        bytes.push(flipped);
        assert!(matches!(damaged.prepared_settings(), Err(BackupError::Damaged(..))), "{name}");
    }
    let mut unknown = backup.clone();
    unknown.settings.insert("colour".into(), backup.settings["rules"].clone());
    assert_eq!(unknown.prepared_settings(), Err(BackupError::UnknownSetting("colour".into())));
}

#[test]
fn a_value_that_was_edited_is_not_silently_ignored() {
    let text = Backup::read(&mut board_with_all_settings()).unwrap().to_text();
    assert!(text.contains("3.3,") && !text.contains("3.2999"), "numbers must have few digits: {text}");
    let edited = text.replace("3.3,", "1000.0,");
    assert_ne!(edited, text);
    let error = Backup::parse(&edited).unwrap().prepared_settings().unwrap_err();
    assert_eq!(error, BackupError::ValueAndBytesDiffer("rules"));
    assert!(error.to_string().contains("haptic rules"));
    // The same number in another notation is no change.
    assert!(Backup::parse(&text.replace("3.3,", "3.30,")).unwrap().prepared_settings().is_ok());
    assert!(Backup::parse(&text.replace("3.3,", "3.299999952316284,")).unwrap().prepared_settings().is_ok());
}

#[test]
fn a_polarity_check_is_never_restored() {
    let mut backup = Backup::read(&mut board_with_all_settings()).unwrap();
    let entry = haptic_bridge::board::settings::encode(&haptic_bridge::board::settings::Polarity(7)).unwrap();
    let bytes = entry.iter().map(|byte| format!("{byte:02x}")).collect();
    let saved_setting = haptic_host::backup::SavedSetting { version: 1, value: None, bytes };
    backup.settings.insert("polarity".into(), saved_setting);
    let ready = backup.prepared_settings().unwrap().into_iter().find(|setting| setting.key == Key::Polarity).unwrap();
    assert_eq!(ready.method, RestoreMethod::NotRestored);
}

/// Every backup of earlier firmware contains the former setting, which must not prevent its use.
#[test]
fn a_mass_matrix_in_an_earlier_backup_is_left_out() {
    let backup = Backup::read(&mut board_with_all_settings()).unwrap();
    let mut earlier = backup.clone();
    let value = Some(serde_json::json!("Exact"));
    let saved_setting = haptic_host::backup::SavedSetting { version: 1, value, bytes: "0401008f4053e1".into() };
    earlier.settings.insert("mass-model".into(), saved_setting);
    assert_eq!(earlier.prepared_settings(), backup.prepared_settings());
}

#[test]
fn files_that_are_no_backups_are_refused() {
    for text in ["", "{}", "[]", "{\"haptic-backup\": \"one\"}", "{\"haptic-backup\": 1}"] {
        assert!(matches!(Backup::parse(text), Err(BackupError::NotABackup(_))), "{text}");
    }
    assert_eq!(Backup::parse("{\"haptic-backup\": 2}"), Err(BackupError::Format(2)));
}
