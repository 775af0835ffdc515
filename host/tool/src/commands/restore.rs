//! `haptic board restore`: puts a backup back into a board.

use super::port::{OnBoard, warn_of_weaker};
use haptic_bridge::board::settings::Key;
use haptic_host::backup::{Backup, Ready, Restored, restore};
use haptic_host::error::Failure;
use haptic_host::toml_file::Document;
use serde_json::json;
use std::path::PathBuf;

/// Put a backup back into the board's flash
///
/// The motors must be off. A polarity check is not restored: run `haptic polarity` again.
#[derive(clap::Args)]
pub struct Args {
    /// A file that `haptic board backup` wrote
    file: PathBuf,
    #[command(flatten)]
    on: OnBoard,
}

/// Understands the whole file, then writes the board.
pub fn run(args: Args) -> Result<(), Failure> {
    let place = args.file.display();
    let document = Document::load(&args.file)?;
    let wrong = |error| Failure::wrong(format!("{place}: {error}"));
    let backup = Backup::parse(document.text()).map_err(wrong)?;
    // Damage is found before a board is looked for.
    backup.ready().map_err(wrong)?;
    let mut board = args.on.open()?;
    let mut ready = backup.ready().map_err(wrong)?;
    let another = board.info().serial != backup.serial.as_str();
    if another {
        // Two boards of one name could not be told apart.
        ready.retain(|setting| setting.key != Key::Name);
    }
    haptic_host::tell!("writing flash: the board pauses for up to a second");
    let before = board.rules()?;
    restore(&mut board, &ready)?;
    warn_of_weaker(&before, &board.rules()?);
    let mut report = String::new();
    for setting in &ready {
        report += &match setting.how {
            Restored::AsItWas => format!("{}: restored\n", setting.key.name()),
            Restored::Translated => format!("{}: restored, in this firmware's version\n", setting.key.name()),
            Restored::MadeAnew => format!("{}: left out, to be made anew: `haptic polarity`\n", setting.key.name()),
        };
    }
    if another && backup.settings.contains_key(Key::Name.name()) {
        report += "name: left out, because the backup is of another board: `haptic board name`\n";
    }
    let how = |setting: &Ready| json!({ "setting": setting.key.name(), "how": format!("{:?}", setting.how) });
    args.on.answer(json!({ "restored": ready.iter().map(how).collect::<Vec<_>>() }), &report)
}
