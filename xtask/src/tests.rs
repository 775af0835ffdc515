//! The whole test run: what plain `cargo test` covers, a short round of fuzzing, then the images, the step's
//! instructions, and the emulated board. The page as a file (`cargo xtask playground --test`), the soak and what
//! measures on the emulated chip take longer and are runs of their own.

use std::process::Command;
use std::time::Instant;

use anyhow::Result;

use crate::toolchain::{cargo, run};
use crate::{bench, deny, firmware, fuzz, library, no_panic, paths, python, report, tools};

/// Seconds of fuzzing that each target gets in the whole run.
const FUZZ_SECONDS: u32 = 4;

/// Every test there is, cheapest first; tells what each stage took.
pub fn all(install: bool) -> Result<()> {
    // Before the first compile: what only a late stage needs would else be missed half an hour later.
    tools::provide(&tools::TEST, install)?;
    let stage = |name: &str, work: &dyn Fn() -> Result<()>| {
        let began = Instant::now();
        work()?;
        println!("-- {name}: {} s", began.elapsed().as_secs());
        Ok(())
    };
    stage("library, simulated board and tool", &|| {
        run(cargo().current_dir(paths::root()).args(["test", "--locked", "--workspace"]))
    })?;
    stage("library without the command line", &library::alone)?;
    stage("package for Python", &|| python::test(&[], &python::AFTERWARDS, install))?;
    stage("licences, sources and advisories of dependencies", &deny::check)?;
    stage("fuzzing", &|| fuzz::run(&fuzz::Options::short(FUZZ_SECONDS), install))?;
    stage("images and their sizes", &|| firmware::size(install))?;
    stage("no panic in the control step", &|| no_panic::prove(install))?;
    stage("instructions of the control step", &|| bench::check(install))?;
    stage("images on the emulated chip", &|| board(&[], install))?;
    stage("what the documents say to type, the longer part", &documents)
}

/// Types what the documents say to type and what takes longer than a test of the tool may (host/tests/documents).
fn documents() -> Result<()> {
    let test = ["test", "--locked", "--package", "haptic", "--test", "documents", "--", "--ignored"];
    run(cargo().current_dir(paths::root()).args(test))
}

/// The tests of the real images, and of one with a toy board, on the emulated chip. Further arguments go to
/// `cargo test`.
pub fn board(arguments: &[String], install: bool) -> Result<()> {
    firmware::build(firmware::TOY, install)?;
    run(emulated("test", install)?.args(arguments))
}

/// The real firmware on an emulated board, for a person. Further arguments go to the board.
pub fn play(arguments: &[String], install: bool) -> Result<()> {
    run(emulated("run", install)?.args(["--quiet", "--bin", "board", "--"]).args(arguments))
}

/// A program of the virtual board's that measures on the emulated chip and writes a document.
pub fn measure(program: &str, arguments: &[String], install: bool) -> Result<()> {
    let mut command = emulated("run", install)?;
    command.args(["--quiet", "--bin", program, "--"]).args(arguments);
    run(command.env("HAPTIC_OCCASION", report::occasion()))
}

/// A cargo call in the virtual board's workspace, which is one of its own because the emulator declares a newer
/// compiler than it needs. Its tests and its program take the images from where this built them.
fn emulated(call: &str, install: bool) -> Result<Command> {
    let images = firmware::build_all(install)?;
    let mut command = cargo();
    command.current_dir(paths::root().join("emulator")).args([call, "--locked", "--ignore-rust-version"]);
    if let Some(directory) = images.first().and_then(|image| image.parent()) {
        command.env("HAPTIC_FIRMWARE_DIR", directory);
    }
    Ok(command)
}
