//! Builds, measures, lints and flashes the firmware images.

use std::path::PathBuf;
use std::process::Command;

use anyhow::{Context as _, Result, bail};

use crate::dfu;
use crate::image::{FLASH_LIMIT, Image, RAM_LIMIT, seal};
use crate::paths::{root, target_directory};
use crate::toolchain::{TARGET, cargo_for, chip_cargo, run};
use crate::tools::{self, Tool};

/// All boards by the names of their Cargo features.
pub const BOARDS: [&str; 3] = ["odrive-v3", "h-bridge-f405", "h-bridge-f407-disc1"];

/// Name of a toy board, whose image only a test on the emulated chip uses.
pub const TOY_BOARD: &str = "toy-board";

const BINARY: &str = "haptic-firmware";
const CHIP: &str = "STM32F405RGTx";

fn for_board(mut command: Command, board: &str) -> Command {
    command.current_dir(root().join("firmware")).arg("--target-dir").arg(target_directory());
    command.args(["--locked", "--package", BINARY, "--profile", "firmware", "--features", board]);
    command
}

pub fn directory() -> PathBuf {
    target_directory().join(TARGET).join("firmware")
}

/// Builds one image, stores it under its board's name with its checksum, and returns its path.
pub fn build(board: &str) -> Result<PathBuf> {
    tools::check(&[Tool::Chip])?;
    run(&mut for_board(chip_cargo(), board))?;
    let directory = directory();
    let image = directory.join(format!("{BINARY}-{board}.elf"));
    std::fs::copy(directory.join(BINARY), &image).with_context(|| format!("cannot write {}", image.display()))?;
    seal(&image)?;
    println!("{board}: {}", image.display());
    Ok(image)
}

pub fn build_all() -> Result<Vec<PathBuf>> {
    BOARDS.into_iter().map(build).collect()
}

/// Prints the flash and RAM of the images. Fails if an image is too large.
pub fn size() -> Result<()> {
    let mut over = Vec::new();
    let mut lines = Vec::new();
    for board in BOARDS {
        let image = Image::read(&build(board)?)?;
        lines.push(format!(
            "{board:<20} {:>7} B of {FLASH_LIMIT}   {:>6} B of {RAM_LIMIT}  ({} statics, {} stack)",
            image.flash,
            image.ram(),
            image.statics,
            image.stack
        ));
        if image.flash > FLASH_LIMIT || image.ram() > RAM_LIMIT {
            over.push(board);
        }
    }
    println!("{:<20} {:<20} RAM\n{}", "board", "flash", lines.join("\n"));
    if !over.is_empty() {
        bail!("too large: {}", over.join(", "));
    }
    Ok(())
}

pub fn clippy() -> Result<()> {
    tools::check(&[Tool::Chip])?;
    for board in BOARDS.into_iter().chain([TOY_BOARD]) {
        let packages = ["--package", "haptic-bridge", "--package", "haptic-counting"];
        run(for_board(cargo_for("clippy", TARGET), board).args(packages).args(["--", "-D", "warnings"]))?;
    }
    Ok(())
}

/// Builds and flashes through a debug probe, then shows the log.
pub fn flash(board: &str) -> Result<()> {
    let image = build(board)?;
    run(Command::new("probe-rs").args(["run", "--chip", CHIP]).arg(image))
        .context("flashing needs probe-rs; `cargo install probe-rs-tools --locked` installs it, see docs/flashing.md")
}

pub fn dfu(board: &str) -> Result<()> {
    let elf = build(board)?;
    let image = Image::read(&elf)?;
    let path = elf.with_extension("dfu");
    std::fs::write(&path, dfu::file(&image.segments, board))
        .with_context(|| format!("cannot write {}", path.display()))?;
    println!("{}: {} segments; flash with\n    dfu-util -a 0 -D {}", board, image.segments.len(), path.display());
    Ok(())
}
