//! `haptic backup`: writes everything a board keeps in flash into one file.

use super::port::Port;
use haptic::backup::Backup;
use haptic::error::{Failure, print};
use std::path::PathBuf;

/// Write everything the board keeps in flash to a file
///
/// What was loaded and not yet saved (`haptic save`) is not part of it.
#[derive(clap::Args)]
pub struct Args {
    /// The file to write (JSON)
    file: PathBuf,
    #[command(flatten)]
    port: Port,
}

/// Reads the board, then writes the file.
pub fn run(args: Args) -> Result<(), Failure> {
    let mut board = args.port.open_to_stay()?;
    let backup = Backup::read(&mut board)?;
    if backup.settings.is_empty() {
        return Err(Failure::impossible("the board keeps nothing in flash").remedy("`haptic save` first"));
    }
    for (key, _) in board.details()?.damage.iter().filter(|(key, _)| !backup.settings.contains_key(key.name())) {
        eprintln!("left out: the stored {} is damaged", key.name());
    }
    // First beside it, then in its place: an earlier backup is lost only to a whole new one.
    let partial = args.file.with_extension("partial");
    std::fs::write(&partial, backup.to_text()).and_then(|()| std::fs::rename(&partial, &args.file)).map_err(
        |error| {
            let _ = std::fs::remove_file(&partial);
            let reason = format!("{} cannot be written: {error}", args.file.display());
            Failure::impossible(reason).remedy("check the path, its permissions and the space left")
        },
    )?;
    let names: Vec<&str> = backup.settings.keys().map(String::as_str).collect();
    print(&format!("{}: {}\n", args.file.display(), names.join(", ")))
}
