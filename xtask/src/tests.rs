//! The test runs: the gate (`cargo xtask test`), which every change passes, and everything else in named parts that run
//! alone (`cargo xtask test --deep [PART]`). `cargo test` is the first stage of the gate.

use std::process::Command;
use std::time::Instant;

use anyhow::{Result, ensure};

use crate::toolchain::{Use, cargo, run};
use crate::{bench, deny, firmware, fuzz, library, no_panic, paths, playground, python, report, tools};

/// Seconds of fuzzing that each target gets in the deep tests.
const FUZZ_SECONDS: u32 = 20;

/// A named part of the deep tests.
pub struct Part {
    /// What it is called by.
    pub name: &'static str,
    /// What it tests.
    pub what: &'static str,
    /// Runs it, with further arguments for the program that it is.
    run: fn(&[String]) -> Result<()>,
}

/// A part that is a module of host/tests/deep.
macro_rules! module {
    ($name:literal, $what:literal) => {
        Part { name: $name, what: $what, run: |arguments| tool(concat!($name, "::"), arguments) }
    };
}

/// All parts of the deep tests, cheapest first.
pub const PARTS: [Part; 15] = [
    Part { name: "licences", what: "Licences, sources and advisories of dependencies", run: |_| deny::run() },
    Part { name: "clients", what: "The library without the command line, and its examples", run: clients },
    Part { name: "properties", what: "The library's tests from seeds drawn anew", run: properties },
    module!("hard_cases", "Single precision against 106 bits"),
    module!("claims", "The figures of docs/claims.md"),
    module!("tune", "What `tune` and `design` find, against brute force"),
    module!("ranges", "Measured ranges of stable walls"),
    module!("soak", "Minutes of contact with telemetry"),
    module!("processes", "Tools that come second, are killed or flood"),
    module!("documents", "What the documents say to type, and their pictures and tables made again"),
    Part { name: "browser", what: "The page, served and as a file, in Chromium", run: browser },
    Part { name: "python", what: "The package for Python, with MuJoCo and Dask", run: python::test },
    Part { name: "fuzzing", what: "Wild input for everything that reads any", run: fuzzing },
    Part { name: "counts", what: "Instructions of the control step", run: |_| bench::check() },
    Part {
        name: "emulated",
        what: "Everything that is tested of the images on the emulated chip",
        run: emulated_suite,
    },
];

/// What every change passes.
pub fn gate(arguments: &[String]) -> Result<()> {
    ensure!(arguments.is_empty(), "`cargo xtask test` takes no arguments but --deep: {}", arguments.join(" "));
    // Before the first compile: what only a late stage needs would else be missed minutes later.
    tools::provide(&tools::TEST)?;
    let began = Instant::now();
    stage("library", || run(cargo().current_dir(paths::root()).args(["test", "--locked"])))?;
    stage("tool, C and CHAI3D", || {
        let packages = ["haptic", "haptic-capi", "haptic-chai3d", "haptic-playground", "xtask"]
            .map(|name| ["--package", name])
            .concat();
        let targets = ["--lib", "--bins", "--test", "quick", "--test", "c", "--test", "as_chai3d_does"];
        run(cargo().current_dir(paths::root()).args(["test", "--locked"]).args(packages).args(targets))
    })?;
    stage("images and their sizes", firmware::size)?;
    stage("no panic in the control step", no_panic::prove)?;
    stage("images on the emulated chip", || board(&["--test", "emulated", "gate::"].map(String::from)))?;
    println!("-- all of it: {} s", began.elapsed().as_secs());
    Ok(())
}

/// One part of what takes longer, or all of them: then the others go on after one has failed.
pub fn deep(part: Option<&str>, arguments: &[String]) -> Result<()> {
    if let Some(part) = PARTS.iter().find(|known| Some(known.name) == part) {
        return stage(part.name, || (part.run)(arguments));
    }
    tools::provide(&tools::DEEP)?;
    let began = Instant::now();
    let mut failed = Vec::new();
    for part in &PARTS {
        if let Err(error) = stage(part.name, || (part.run)(&[])) {
            eprintln!("{}: {error:#}", part.name);
            failed.push(part.name);
        }
    }
    println!("-- all of it: {} s", began.elapsed().as_secs());
    ensure!(failed.is_empty(), "failed: {}", failed.join(", "));
    Ok(())
}

/// Does something, and says what it took.
fn stage(name: &str, work: impl FnOnce() -> Result<()>) -> Result<()> {
    println!("== {name}");
    let began = Instant::now();
    let outcome = work();
    println!("-- {name}: {} s{}", began.elapsed().as_secs(), if outcome.is_ok() { "" } else { ", failed" });
    outcome
}

/// A module of host/tests/deep.
fn tool(module: &str, arguments: &[String]) -> Result<()> {
    let mut test = cargo();
    test.current_dir(paths::root()).args(["test", "--locked", "--package", "haptic", "--test", "deep", "--", module]);
    run(test.args(arguments).env("HAPTIC_FRESH_SEEDS", "1"))
}

fn clients(arguments: &[String]) -> Result<()> {
    library::alone()?;
    let examples = ["test", "--locked", "--package", "haptic", "--doc"];
    run(cargo().current_dir(paths::root()).args(examples).args(arguments))
}

fn properties(arguments: &[String]) -> Result<()> {
    let mut test = cargo();
    test.current_dir(paths::root()).args([
        "test",
        "--locked",
        "--test",
        "library",
        "--",
        "--include-ignored",
        "--nocapture",
    ]);
    run(test.args(arguments).env("HAPTIC_FRESH_SEEDS", "1"))
}

fn browser(arguments: &[String]) -> Result<()> {
    tools::provide(&[Use::Page])?;
    let page = playground::build()?;
    let test = ["test", "--locked", "--package", "haptic", "--test", "browser", "--"];
    run(cargo().current_dir(paths::root()).args(test).args(arguments).env("HAPTIC_PLAYGROUND", page))
}

fn fuzzing(_: &[String]) -> Result<()> {
    fuzz::run(&fuzz::Options::short(FUZZ_SECONDS))
}

/// All tests of the release images, and of one with a toy board. Further arguments go to `cargo test`.
fn emulated_suite(arguments: &[String]) -> Result<()> {
    firmware::build(firmware::TOY)?;
    board(arguments)
}

/// Tests of the release images on the emulated chip.
fn board(arguments: &[String]) -> Result<()> {
    run(emulated("test")?.args(arguments))
}

/// The real firmware on an emulated board, for a person. Further arguments go to the board.
pub fn play(arguments: &[String]) -> Result<()> {
    run(emulated("run")?.args(["--quiet", "--bin", "board", "--"]).args(arguments))
}

/// A program of the virtual board's that measures on the emulated chip and writes a document.
pub fn measure(program: &str, arguments: &[String]) -> Result<()> {
    let mut command = emulated("run")?;
    command.args(["--quiet", "--bin", program, "--"]).args(arguments);
    run(command.env("HAPTIC_OCCASION", report::occasion()))
}

/// A cargo call in the virtual board's workspace, which is one of its own because the emulator declares a newer
/// compiler than it needs. Its tests and its program take the images from where this built them.
fn emulated(call: &str) -> Result<Command> {
    let images = firmware::build_all()?;
    let mut command = cargo();
    command.current_dir(paths::root().join("emulator")).args([call, "--locked", "--ignore-rust-version"]);
    if let Some(directory) = images.first().and_then(|image| image.parent()) {
        command.env("HAPTIC_FIRMWARE_DIR", directory);
    }
    Ok(command)
}
