//! `haptic board backup`: writes a board's saved settings to a file.

use super::force::ForceOption;
use super::port::OnBoard;
use haptic_host::backup::Backup;
use haptic_host::error::Failure;
use haptic_host::output;
use serde_json::json;
use std::path::PathBuf;

/// Write everything the board keeps in flash to a file
///
/// Settings that were loaded and not yet saved (`haptic board save`) are not part of it.
#[derive(clap::Args)]
pub struct Args {
    /// File to write (JSON)
    file: PathBuf,
    #[command(flatten)]
    force: ForceOption,
    #[command(flatten)]
    on: OnBoard,
}

pub fn run(args: Args) -> Result<(), Failure> {
    args.force.check([&args.file])?;
    let mut board = args.on.open_to_stay()?;
    let backup = Backup::read(&mut board)?;
    if backup.settings.is_empty() {
        return Err(Failure::impossible("the board keeps nothing in flash").remedy("run `haptic board save` first"));
    }
    for (key, _) in board.details()?.damage.iter().filter(|(key, _)| !backup.settings.contains_key(key.name())) {
        haptic_host::tell!("left out: the stored {} is damaged", key.name());
    }
    output::write(&args.file, backup.to_text().as_bytes(), args.force.overwrite())?;
    let names: Vec<&str> = backup.settings.keys().map(String::as_str).collect();
    let words = format!("{}: {}\n", args.file.display(), names.join(", "));
    args.on.answer(json!({ "file": args.file, "settings": names }), &words)
}
