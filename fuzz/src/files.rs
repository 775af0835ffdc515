//! Fuzzes the tool's input from a user: device and scene files, backups, recordings, measurements and command lines.
//! The tool must accept or refuse each input without a panic.

use crate::cli;
use haptic_bridge::model::device::Device;
use haptic_bridge::render::scene::FeedForward;
use haptic_host::backup::Backup;
use haptic_host::device_file::DeviceFile;
use haptic_host::scene_file::SceneFile;
use haptic_predict::measure::progress::Progress;
use haptic_show::recorder::Recording;

/// Parses a device file. An accepted file must result in a device.
pub fn device_file(data: &[u8]) {
    let Ok(text) = core::str::from_utf8(data) else { return };
    match DeviceFile::parse(text, "fuzz.toml") {
        Ok(file) => {
            drop(Device::<f32>::new(&file.name, &file.description).expect("an accepted file makes a device"));
            let _ = file.missing_for_board();
        }
        Err(error) => assert!(!error.to_string().is_empty()),
    }
}

/// Parses a scene file for each task dimension. An accepted file must result in a scene that the board accepts.
pub fn scene_file(data: &[u8]) {
    let Ok(text) = core::str::from_utf8(data) else { return };
    for task in 1..=3 {
        match SceneFile::parse(text, "fuzz.toml", task) {
            Ok(file) => {
                let scene = file.scene::<f32>().expect("an accepted file makes a scene");
                assert_eq!(scene.check(task), Ok(()), "the board refuses a scene that the tool accepted");
            }
            Err(error) => assert!(!error.to_string().is_empty()),
        }
    }
}

/// Parses backups, recordings and measurements, which the tool writes and reads again.
pub fn kept_file(data: &[u8]) {
    let Ok(text) = core::str::from_utf8(data) else { return };
    if let Ok(backup) = Backup::parse(text) {
        let ready = backup.prepared_settings();
        let again = Backup::parse(&backup.to_text()).expect("a written backup is readable");
        assert_eq!(again.prepared_settings(), ready, "the copy of a backup differs");
    }
    if let Ok(recording) = Recording::parse(text) {
        assert!(recording.rows.iter().all(|row| row.len() == recording.columns.len()));
    }
    if let Ok(progress) = serde_json::from_str::<Progress>(text) {
        for mode in [FeedForward::Off, FeedForward::Full, FeedForward::Washout] {
            let _ = progress.end(mode);
            for point in progress.of(mode) {
                let _ = (point.median(), point.bounds());
            }
        }
    }
}

/// Parses arguments separated by zeros or line breaks.
pub fn command_line(data: &[u8]) {
    let Ok(text) = core::str::from_utf8(data) else { return };
    let words = core::iter::once("haptic").chain(text.split(['\0', '\n'])).map(Into::into).collect();
    if let Err(error) = cli::read(words) {
        assert!(!error.to_string().is_empty());
    }
}
