//! Runs the gate (`cargo xtask test`), which every change must pass, and the longer tests in named parts (`cargo xtask
//! test --deep [PART]`). `cargo test` is the first stage of the gate.

use std::env;
use std::process::Command;
use std::time::Instant;

use anyhow::{Result, anyhow, ensure};

use crate::toolchain::{cargo, haptic_emulator, run};
use crate::tools::{self, Tool};
use crate::{bench, dist, firmware, fuzz, library, no_panic, paths, playground, python, report};

/// Arguments of cargo that select the tests of the tool, flashing, C and CHAI3D.
const TOOL_TESTS: [&str; 10] =
    ["--lib", "--bins", "--test", "quick", "--test", "flash", "--test", "c", "--test", "as_chai3d_does"];
/// Environment variable with the folder of the images, for tests and programs of the virtual board.
const IMAGES_VARIABLE: &str = "HAPTIC_FIRMWARE_DIR";
/// Duration of fuzzing of each target in the deep tests, s.
const FUZZ_SECONDS: u32 = 20;

/// A named part of the deep tests.
pub struct Part {
    pub name: &'static str,
    pub description: &'static str,
    /// Runs the part with further arguments for its program.
    run: fn(&[String]) -> Result<()>,
}

/// Declares a part that is a module of tool/tests/deep.
macro_rules! module {
    ($name:literal, $description:literal) => {
        Part { name: $name, description: $description, run: |arguments| tool(concat!($name, "::"), arguments) }
    };
}

/// All parts of the deep tests, cheapest first.
pub const PARTS: [Part; 17] = [
    Part { name: "clients", description: "The crates for other programs: dependencies and examples", run: clients },
    Part { name: "properties", description: "The library's tests with new random seeds", run: properties },
    module!("hard_cases", "Single precision against 106 bits"),
    module!("claims", "The figures of docs/claims/"),
    module!("cogging", "Cogging learnt on 50 drawn motors"),
    module!("lies", "Wrong files, wires and sensors, and forces in new random scenes"),
    module!("tune", "Results of `tune` and `design` against brute force"),
    module!("ranges", "Measured ranges of stable walls"),
    module!("soak", "Minutes of contact with telemetry"),
    module!("processes", "Second tools, killed tools and floods of requests"),
    module!("documents", "Commands in the documents, and their pictures and tables"),
    Part { name: "browser", description: "The page, served and as a file, in Chromium", run: browser },
    Part { name: "python", description: "The package for Python, with MuJoCo and Dask", run: python::test },
    Part {
        name: "dist",
        description: "Archive, wheel and published packages, installed as a user does",
        run: |_| dist::check(),
    },
    Part { name: "fuzzing", description: "Fuzzing of everything that reads input", run: fuzzing },
    Part { name: "counts", description: "Instructions of the control step", run: |_| bench::check() },
    Part { name: "emulated", description: "All tests of the images on the emulated chip", run: emulated_suite },
];

/// Runs the tests that every change must pass.
pub fn gate(arguments: &[String]) -> Result<()> {
    ensure!(arguments.is_empty(), "`cargo xtask test` takes only --deep, not: {}", arguments.join(" "));
    // Checks the tool before the first compile, because a late stage would report a missing tool only after minutes.
    tools::check(&[Tool::Chip])?;
    let began = Instant::now();
    // Builds the images in parallel with the other tests, because they occupy one compiler thread for minutes.
    std::thread::scope(|scope| {
        let images = scope.spawn(|| {
            stage("images and their sizes", firmware::size)?;
            stage("no panic in the control step", no_panic::prove)
        });
        stage("library", || run(cargo().current_dir(paths::root()).args(["test", "--locked"])))?;
        // Includes the emulated chip, so that cargo compiles common dependencies once.
        stage("compiling tool, C, CHAI3D and emulated chip", || run(gate_tests().arg("--no-run")))?;
        stage("tool, C and CHAI3D", || run(&mut tests(&TOOL_TESTS)))?;
        images.join().map_err(|_| anyhow!("the images' stages panicked"))?
    })?;
    stage("images on the emulated chip", || {
        run(gate_tests().args(["--", "gate::"]).env(IMAGES_VARIABLE, firmware::directory()))
    })?;
    println!("-- all stages: {} s", began.elapsed().as_secs());
    Ok(())
}

/// Runs one part of the deep tests, or all parts, even if one of them fails.
pub fn deep(part: Option<&str>, arguments: &[String]) -> Result<()> {
    if let Some(part) = PARTS.iter().find(|known| Some(known.name) == part) {
        stage(part.name, || (part.run)(arguments))?;
        return match env::var_os("UPDATE_DOCS") {
            Some(_) => report::record(part.name, &format!("UPDATE_DOCS=1 cargo xtask test --deep {}", part.name)),
            None => Ok(()),
        };
    }
    tools::check(&Tool::ALL)?;
    let began = Instant::now();
    let mut failed = Vec::new();
    for part in &PARTS {
        if let Err(error) = stage(part.name, || (part.run)(&[])) {
            eprintln!("{}: {error:#}", part.name);
            failed.push(part.name);
        }
    }
    println!("-- all parts: {} s", began.elapsed().as_secs());
    ensure!(failed.is_empty(), "failed: {}", failed.join(", "));
    Ok(())
}

fn stage(name: &str, work: impl FnOnce() -> Result<()>) -> Result<()> {
    println!("== {name}");
    let began = Instant::now();
    let outcome = work();
    println!("-- {name}: {} s{}", began.elapsed().as_secs(), if outcome.is_ok() { "" } else { ", failed" });
    outcome
}

fn tool(module: &str, arguments: &[String]) -> Result<()> {
    run(tests(&["--test", "deep", "--", module]).args(arguments).env("HAPTIC_FRESH_SEEDS", "1"))
}

fn clients(arguments: &[String]) -> Result<()> {
    library::check()?;
    let crates = library::CRATES.iter().flat_map(|name| ["--package", *name]);
    run(cargo().current_dir(paths::root()).args(["test", "--locked", "--doc"]).args(crates).args(arguments))
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
    tools::check(&[Tool::Chromium, Tool::Chip])?;
    let page = playground::build()?;
    run(cargo().current_dir(paths::root()).args(["test", "--locked", "--package", "haptic-page"]))?;
    // Builds an image, because a test of the page connects to the image on the emulated chip.
    firmware::build("odrive-v3")?;
    let board =
        ["build", "--locked", "--ignore-rust-version", "--package", "haptic-emulator-programs", "--bin", "board"];
    run(cargo().current_dir(paths::root()).args(board))?;
    let test = ["test", "--locked", "--package", "haptic", "--test", "browser", "--"];
    let mut tests = cargo();
    tests.current_dir(paths::root()).args(test).args(arguments).env("HAPTIC_PLAYGROUND", page);
    tests.env("HAPTIC_VIRTUAL_BOARD", paths::target_directory().join("debug/board"));
    run(tests.env(IMAGES_VARIABLE, firmware::directory()))
}

fn fuzzing(_: &[String]) -> Result<()> {
    fuzz::run(&fuzz::Options::short(FUZZ_SECONDS))
}

/// Runs all tests of the release images and of an image with a toy board. Further arguments go to `cargo test`.
fn emulated_suite(arguments: &[String]) -> Result<()> {
    firmware::build_all()?;
    firmware::build(firmware::TOY_BOARD)?;
    run(tests(&["--test", "emulated"]).args(arguments).env(IMAGES_VARIABLE, firmware::directory()))
}

/// Returns the cargo call for all tests of the gate except the tests of the library.
fn gate_tests() -> Command {
    let mut all = tests(&TOOL_TESTS);
    all.args(["--test", "emulated"]);
    all
}

/// Returns the cargo call for tests of the tool and the virtual board. All calls have the same packages, so that the
/// dependencies have the same features and are compiled once.
fn tests(targets: &[&str]) -> Command {
    let others = ["haptic", "haptic-c", "haptic-chai3d", "haptic-emulator", "xtask"];
    let packages = library::CRATES.iter().chain(&others).flat_map(|name| ["--package", *name]);
    let mut test = cargo();
    test.current_dir(paths::root()).args(["test", "--locked", "--ignore-rust-version"]).args(packages).args(targets);
    test
}

/// Runs the real firmware on an emulated board for a user. Further arguments go to the board's program.
pub fn run_board(arguments: &[String]) -> Result<()> {
    run(program("board")?.args(arguments))
}

/// Runs a program of the virtual board that measures on the emulated chip and writes a document.
pub fn measure(name: &str, arguments: &[String]) -> Result<()> {
    run(program(name)?.args(arguments))?;
    if arguments.is_empty() { report::record(name, &format!("cargo xtask {name}")) } else { Ok(()) }
}

/// Builds the boards' images and returns the call of a program of the virtual board that runs them.
fn program(name: &str) -> Result<Command> {
    firmware::build_all()?;
    let mut command = haptic_emulator(name);
    command.env(IMAGES_VARIABLE, firmware::directory());
    Ok(command)
}
