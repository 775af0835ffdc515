//! `haptic flash`: writes firmware to a board, over USB or through a debug probe.

use super::answer::Json;
use super::port::{MOTORS_GO_OFF, Port, confirm};
use haptic_bridge::board::protocol::PROTOCOL;
use haptic_flash::{
    Bus, FlashSummary, FlashTarget, Image, Phase, Progress, WITHOUT_IMAGES, embedded_images, find_board, flash, parse,
    probe,
};
use haptic_host::error::{Choice, Failure, on_one_line, overwrite_line, say};
use haptic_host::link::{PortSpec, boards};
use serde_json::json;
use std::io::{BufRead, IsTerminal};
use std::path::{Path, PathBuf};

/// Put the firmware of this tool on a board, over USB
///
/// The board restarts into the boot loader in its chip, unless it is already there. Only the sectors of the image are
/// erased, every byte is read back, and the settings stay. After an interruption the board starts no firmware and its
/// motors stay off: run the same command again. On Linux, `haptic udev` writes the rule that lets you open boot
/// loaders.
#[derive(clap::Args)]
pub struct Args {
    /// Kind of board, such as odrive-v3; required only for a board that is in its boot loader
    board: Option<String>,
    #[command(flatten)]
    port: Port,
    /// Flash this update file (.dfu) instead of the image in this tool
    #[arg(long, value_name = "FILE")]
    file: Option<PathBuf>,
    /// Flash through a debug probe, by probe-rs
    #[arg(long)]
    probe: bool,
    /// Do not ask
    #[arg(long)]
    yes: bool,
    #[command(flatten)]
    json: Json,
}

pub fn run(args: Args) -> Result<(), Failure> {
    let serial = requested_serial(args.port.spec())?;
    let file = args.file.as_deref().map(read_image).transpose()?;
    if file.is_none() && embedded_images().is_empty() {
        return Err(Failure::impossible(WITHOUT_IMAGES).choose(Choice::Image));
    }
    if let Some(board) = &args.board {
        image_for_board(&file, board)?;
    }
    if args.probe {
        return flash_by_probe(&args, &file);
    }
    let target = find_board(&mut Bus::of_this_computer(), serial.as_deref()).map_err(Failure::impossible)?;
    let image = match &target {
        FlashTarget::Running(board) => {
            haptic_host::tell!(
                "found {}, serial number {}, with firmware {} (protocol {})",
                on_one_line(&board.board),
                on_one_line(&board.serial),
                on_one_line(&board.firmware),
                board.protocol
            );
            let image = image_for_board(&file, args.board.as_deref().unwrap_or(&board.board))?;
            // Refuses the image of another board below without a question.
            if image.board == board.board {
                confirm_restart(&board.serial, args.yes)?;
            }
            image
        }
        FlashTarget::BootLoader(loader) => {
            haptic_host::tell!("found a boot loader, serial number {}", on_one_line(&loader.serial));
            image_for_boot_loader(&args, &file)?
        }
    };
    haptic_host::tell!("flashing {}", describe_image(&image));
    let done = flash(&mut Bus::of_this_computer(), &target, image, &mut |progress| show_progress(progress));
    let FlashSummary { identity, restored, sectors, bytes } = done.map_err(Failure::impossible)?;
    let mut words = format!(
        "{} runs firmware {} (protocol {}): {bytes} bytes in {sectors} sectors, every one read back; settings kept\n",
        on_one_line(&identity.board),
        on_one_line(&identity.firmware),
        identity.protocol
    );
    if !restored.is_empty() {
        words += &format!("put back for this firmware: {}\n", restored.join(", "));
    }
    let document = json!({
        "board": identity.board, "serial": identity.serial, "firmware": identity.firmware, "protocol": identity.protocol,
        "bytes": bytes, "sectors": sectors, "restored": restored,
    });
    args.json.answer(document, &words)
}

fn read_image(file: &Path) -> Result<Image, Failure> {
    let wrong = |error: &dyn std::fmt::Display| Failure::wrong(format!("{}: {error}", file.display()));
    let bytes = haptic_host::input::read(file).map_err(|error| wrong(&error))?;
    parse(&bytes).map_err(|error| wrong(&error))
}

/// Returns the file's image, which the caller must check for this board, or the image in this tool.
fn image_for_board(file: &Option<Image>, board: &str) -> Result<Image, Failure> {
    if let Some(image) = file {
        return Ok(image.clone());
    }
    let Some(embedded_image) = embedded_images().iter().find(|image| image.board == board) else {
        let reason = format!("this tool has no image for {}", on_one_line(board));
        return Err(Failure::wrong(reason)
            .remedy(format!("give one of {}, or an update file with --file", boards_with_images().join(", "))));
    };
    let broken = |why| Failure::impossible(format!("the image for {board} in this tool is broken: {why}"));
    let image = embedded_image.image().map_err(broken)?;
    match image.protocol {
        Some(protocol) if protocol != PROTOCOL => {
            let reason = format!("the images in this tool use protocol {protocol} and the tool uses {PROTOCOL}");
            Err(Failure::impossible(reason).remedy("run `cargo xtask images` and build the tool again"))
        }
        _ => Ok(image),
    }
}

fn boards_with_images() -> Vec<&'static str> {
    embedded_images().iter().map(|image| image.board).collect()
}

fn describe_image(image: &Image) -> String {
    let board = on_one_line(&image.board);
    match (&image.version, image.protocol) {
        (Some(version), Some(protocol)) => format!("{board} {version} (protocol {protocol}), {} bytes", image.size()),
        _ => format!("{board}, {} bytes", image.size()),
    }
}

/// Returns the serial number of the requested port; `None` if no port was given.
fn requested_serial(port: &PortSpec) -> Result<Option<String>, Failure> {
    match port {
        PortSpec::Find => Ok(None),
        PortSpec::Serial(name) => {
            let known = boards().0.into_iter().find(|board| board.path == *name);
            Ok(Some(known.map_or(name.clone(), |board| board.serial)))
        }
        PortSpec::Tcp(_) | PortSpec::Sim(_) => Err(Failure::wrong("a simulated board has no flash for firmware")
            .remedy("plug in a board, or leave the port out")),
    }
}

/// Asks before a restart that turns motors off or loses unsaved settings.
fn confirm_restart(serial: &str, yes: bool) -> Result<(), Failure> {
    match haptic_flash::motors_on_and_unsaved_settings(serial)? {
        None => confirm(yes, "the board restarts, and its motors go off if they are on"),
        Some((drives, unsaved)) => {
            let mut loses = Vec::new();
            if drives {
                loses.push(MOTORS_GO_OFF.to_string());
            }
            if !unsaved.is_empty() {
                loses.push(format!(
                    "unsaved settings will be lost: {} (`haptic board save` keeps them)",
                    unsaved.join(", ")
                ));
            }
            if loses.is_empty() { Ok(()) } else { confirm(yes, &loses.join("; ")) }
        }
    }
}

/// Returns the image for a boot loader, and asks for the kind of board, because a boot loader does not know it.
fn image_for_boot_loader(args: &Args, file: &Option<Image>) -> Result<Image, Failure> {
    let board = match (&args.board, file) {
        (Some(board), Some(image)) if *board != image.board => {
            let reason = format!("the file is for {} and the board is {board}", on_one_line(&image.board));
            return Err(Failure::wrong(reason).remedy("give the update file for this board"));
        }
        (Some(board), _) => board.clone(),
        (None, Some(image)) => image.board.clone(),
        (None, None) => ask_for_board()?,
    };
    let image = image_for_board(file, &board)?;
    let board = on_one_line(&image.board);
    confirm(args.yes, &format!("a boot loader does not identify its board: the image drives the pins of {board}"))?;
    Ok(image)
}

fn ask_for_board() -> Result<String, Failure> {
    let known = boards_with_images();
    let unknown = || Failure::wrong("a boot loader does not identify its board");
    let first = known.first().copied().unwrap_or_default();
    if !std::io::stdin().is_terminal() {
        return Err(unknown().remedy(format!("give the kind, as in haptic flash {first}")));
    }
    say(format_args!("a boot loader does not identify its board; which board is it ({})? ", known.join(", ")));
    let mut answer = String::new();
    let read = std::io::stdin().lock().read_line(&mut answer);
    match known.iter().find(|board| read.is_ok() && **board == answer.trim()) {
        Some(board) => Ok(board.to_string()),
        None => Err(unknown().remedy(format!("write one of {}", known.join(", ")))),
    }
}

fn flash_by_probe(args: &Args, file: &Option<Image>) -> Result<(), Failure> {
    let board = match (&args.board, file) {
        (Some(board), _) => board.clone(),
        (None, Some(image)) => image.board.clone(),
        (None, None) => {
            let first = boards_with_images().first().copied().unwrap_or_default();
            let reason = "a probe does not identify its board";
            return Err(Failure::wrong(reason).remedy(format!("give the kind, as in haptic flash {first} --probe")));
        }
    };
    let image = image_for_board(file, &board)?;
    if image.board != board {
        return Err(Failure::wrong(format!("the file is for {} and the board is {board}", on_one_line(&image.board)))
            .remedy("give the update file for this board"));
    }
    confirm(args.yes, &format!("the board at the probe restarts as {board}, and its motors go off"))?;
    haptic_host::tell!("flashing {}", describe_image(&image));
    probe::flash("probe-rs", &image).map_err(Failure::impossible)?;
    let words = format!("{board} is flashed through the probe and has restarted; settings kept\n");
    args.json.answer(json!({ "board": board, "bytes": image.size(), "by": "probe-rs" }), &words)
}

/// Shows the progress, on a terminal on a line that is overwritten.
fn show_progress(progress: Progress) {
    let terminal = std::io::stderr().is_terminal();
    match progress {
        // Writing and reading alternate; the percentage shows both.
        Progress::Begins(Phase::Write | Phase::ReadBack) if terminal => {}
        Progress::Begins(step) => haptic_host::tell!("{step}"),
        Progress::Done(step, done, of) if terminal => {
            let line = format!("{step}: {} %   ", 100 * done / of.max(1));
            overwrite_line(format_args!("{line}"), done == of);
        }
        Progress::Done(..) => {}
        Progress::PowerCycle => haptic_host::tell!(
            "the board does not restart by itself: set its DIP switch back to RUN (or BOOT0 low), then switch its \
             power off and on"
        ),
    }
}
