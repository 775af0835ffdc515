//! `haptic board restore`: restores a backup to a board.

use super::port::{OnBoard, confirm, warn_of_weaker_rules};
use haptic_bridge::board::settings::Key;
use haptic_host::backup::{Backup, FORMER_SETTING, PreparedSetting, RestoreMethod, restore};
use haptic_host::error::{Failure, on_one_line};
use haptic_host::toml_file::Document;
use serde_json::json;
use std::path::PathBuf;

/// Restore a backup to the board's flash
///
/// The motors must be off. A polarity check is not restored: run `haptic polarity` again. A backup of another board is
/// restored only after you have agreed, and without that board's name.
#[derive(clap::Args)]
pub struct Args {
    /// File that `haptic board backup` wrote
    file: PathBuf,
    /// Do not ask before the settings of another board are restored
    #[arg(long)]
    yes: bool,
    #[command(flatten)]
    on: OnBoard,
}

pub fn run(args: Args) -> Result<(), Failure> {
    let place = args.file.display();
    let document = Document::load(&args.file)?;
    let wrong = |error| Failure::wrong(format!("{place}: {error}"));
    let backup = Backup::parse(document.text()).map_err(wrong)?;
    // Reports damage before a board is opened.
    backup.prepared_settings().map_err(wrong)?;
    let mut board = args.on.open()?;
    let mut ready = backup.prepared_settings().map_err(wrong)?;
    let info = board.info();
    let from_another = (backup.board.as_str(), backup.serial.as_str()) != (info.board.as_str(), info.serial.as_str());
    if from_another {
        let [kind, serial] = [&backup.board, &backup.serial].map(|text| on_one_line(text));
        let what = format!(
            "the backup is of another board ({kind}, serial number {serial}) and this is {}, serial number {}: its \
             device, limits and scene replace those of this board",
            on_one_line(&info.board),
            on_one_line(&info.serial)
        );
        confirm(args.yes, &what)?;
        ready.retain(|setting| setting.key != Key::Name);
    }
    haptic_host::tell!("writing flash: the board pauses for up to a second");
    let before = board.rules()?;
    restore(&mut board, &ready)?;
    let units = board.device()?.map(|device| device.mechanism.units()).unwrap_or_default();
    warn_of_weaker_rules(&before, &board.rules()?, &units);
    let mut report = String::new();
    for setting in &ready {
        report += &match setting.method {
            RestoreMethod::Unchanged => format!("{}: restored\n", setting.key.name()),
            RestoreMethod::Translated => format!("{}: restored, in this firmware's version\n", setting.key.name()),
            RestoreMethod::NotRestored => format!("{}: left out; run `haptic polarity` again\n", setting.key.name()),
        };
    }
    if backup.settings.contains_key(FORMER_SETTING) {
        report += &format!("{FORMER_SETTING}: left out; this firmware always computes the exact mass matrix\n");
    }
    if from_another {
        report += "name: unchanged; `haptic board name` changes it\n";
    }
    let how =
        |setting: &PreparedSetting| json!({ "setting": setting.key.name(), "how": format!("{:?}", setting.method) });
    args.on.answer(json!({ "restored": ready.iter().map(how).collect::<Vec<_>>() }), &report)
}
