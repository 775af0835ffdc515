//! The test runs: the gate (`cargo xtask test`), which every change passes, and everything else in named parts that run
//! alone (`cargo xtask test --deep [PART]`). `cargo test` is the first stage of the gate.

use std::env;
use std::process::Command;
use std::time::Instant;

use anyhow::{Result, anyhow, ensure};

use crate::toolchain::{Use, cargo, haptic_emulator, run};
use crate::{bench, dist, firmware, fuzz, library, no_panic, paths, playground, python, report, tools};

/// The tests of the tool, of flashing, of C and of CHAI3D, as cargo is asked for them.
const TOOL: [&str; 10] =
    ["--lib", "--bins", "--test", "quick", "--test", "flash", "--test", "c", "--test", "as_chai3d_does"];
/// The variable that tells tests and programs of the virtual board the folder of the images.
const IMAGES: &str = "HAPTIC_FIRMWARE_DIR";
/// Seconds of fuzzing that each target gets in the deep tests.
const FUZZ_SECONDS: u32 = 20;

/// A named part of the deep tests.
pub struct Part {
    /// The name on the command line.
    pub name: &'static str,
    /// A description of the test.
    pub what: &'static str,
    /// Runs it, with further arguments for the program that it is.
    run: fn(&[String]) -> Result<()>,
}

/// A part that is a module of tool/tests/deep.
macro_rules! module {
    ($name:literal, $what:literal) => {
        Part { name: $name, what: $what, run: |arguments| tool(concat!($name, "::"), arguments) }
    };
}

/// All parts of the deep tests, cheapest first.
pub const PARTS: [Part; 16] = [
    Part { name: "clients", what: "What programs build on: what it brings along, and its examples", run: clients },
    Part { name: "properties", what: "The library's tests from seeds drawn anew", run: properties },
    module!("hard_cases", "Single precision against 106 bits"),
    module!("claims", "The figures of docs/claims/"),
    module!("lies", "Files, wires and sensors that are wrong, and forces in scenes drawn anew"),
    module!("tune", "What `tune` and `design` find, against brute force"),
    module!("ranges", "Measured ranges of stable walls"),
    module!("soak", "Minutes of contact with telemetry"),
    module!("processes", "Tools that come second, are killed or flood"),
    module!("documents", "What the documents say to type, and their pictures and tables made again"),
    Part { name: "browser", what: "The page, served and as a file, in Chromium", run: browser },
    Part { name: "python", what: "The package for Python, with MuJoCo and Dask", run: python::test },
    Part {
        name: "dist",
        what: "Archive, wheel and published packages, installed as others do",
        run: |_| dist::check(),
    },
    Part { name: "fuzzing", what: "Wild input for everything that reads any", run: fuzzing },
    Part { name: "counts", what: "Instructions of the control step", run: |_| bench::check() },
    Part {
        name: "emulated",
        what: "Everything that is tested of the images on the emulated chip",
        run: emulated_suite,
    },
];

/// Runs the tests that every change must pass.
pub fn gate(arguments: &[String]) -> Result<()> {
    ensure!(arguments.is_empty(), "`cargo xtask test` takes no arguments but --deep: {}", arguments.join(" "));
    // Before the first compile: what only a late stage needs would else be missed minutes later.
    tools::provide(&tools::TEST)?;
    let began = Instant::now();
    // The images take a compiler's one thread for minutes, which the other tests leave free.
    std::thread::scope(|scope| {
        let images = scope.spawn(|| {
            stage("images and their sizes", firmware::size)?;
            stage("no panic in the control step", no_panic::prove)
        });
        stage("library", || run(cargo().current_dir(paths::root()).args(["test", "--locked"])))?;
        // The emulated chip with them: what cargo is asked for together it compiles once.
        stage("compiling tool, C, CHAI3D and emulated chip", || run(gate_tests().arg("--no-run")))?;
        stage("tool, C and CHAI3D", || run(&mut tests(&TOOL)))?;
        images.join().map_err(|_| anyhow!("the images' stages panicked"))?
    })?;
    stage("images on the emulated chip", || {
        run(gate_tests().args(["--", "gate::"]).env(IMAGES, firmware::directory()))
    })?;
    println!("-- all of it: {} s", began.elapsed().as_secs());
    Ok(())
}

/// One part of what takes longer, or all of them: then the others go on after one has failed.
pub fn deep(part: Option<&str>, arguments: &[String]) -> Result<()> {
    if let Some(part) = PARTS.iter().find(|known| Some(known.name) == part) {
        stage(part.name, || (part.run)(arguments))?;
        return match env::var_os("UPDATE_DOCS") {
            Some(_) => report::record(part.name, &format!("UPDATE_DOCS=1 cargo xtask test --deep {}", part.name)),
            None => Ok(()),
        };
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

/// A module of tool/tests/deep.
fn tool(module: &str, arguments: &[String]) -> Result<()> {
    run(tests(&["--test", "deep", "--", module]).args(arguments).env("HAPTIC_FRESH_SEEDS", "1"))
}

fn clients(arguments: &[String]) -> Result<()> {
    library::alone()?;
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
    tools::provide(&[Use::Page, Use::Build])?;
    let page = playground::build()?;
    run(cargo().current_dir(paths::root()).args(["test", "--locked", "--package", "haptic-page"]))?;
    // The page also opens the real image, on the emulated chip.
    firmware::build("odrive-v3")?;
    let board =
        ["build", "--locked", "--ignore-rust-version", "--package", "haptic-emulator-programs", "--bin", "board"];
    run(cargo().current_dir(paths::root()).args(board))?;
    let test = ["test", "--locked", "--package", "haptic", "--test", "browser", "--"];
    let mut tests = cargo();
    tests.current_dir(paths::root()).args(test).args(arguments).env("HAPTIC_PLAYGROUND", page);
    tests.env("HAPTIC_VIRTUAL_BOARD", paths::target_directory().join("debug/board"));
    run(tests.env(IMAGES, firmware::directory()))
}

fn fuzzing(_: &[String]) -> Result<()> {
    fuzz::run(&fuzz::Options::short(FUZZ_SECONDS))
}

/// All tests of the release images, and of one with a toy board. Further arguments go to `cargo test`.
fn emulated_suite(arguments: &[String]) -> Result<()> {
    firmware::build_all()?;
    firmware::build(firmware::TOY)?;
    run(tests(&["--test", "emulated"]).args(arguments).env(IMAGES, firmware::directory()))
}

/// All that the gate compiles for the tool and the emulated chip.
fn gate_tests() -> Command {
    let mut all = tests(&TOOL);
    all.args(["--test", "emulated"]);
    all
}

/// Tests of the tool and of the virtual board. The packages are always the same, and so are then their dependencies'
/// features: each is compiled once.
fn tests(targets: &[&str]) -> Command {
    let others = ["haptic", "haptic-c", "haptic-chai3d", "haptic-emulator", "xtask"];
    let packages = library::CRATES.iter().chain(&others).flat_map(|name| ["--package", *name]);
    let mut test = cargo();
    test.current_dir(paths::root()).args(["test", "--locked", "--ignore-rust-version"]).args(packages).args(targets);
    test
}

/// The real firmware on an emulated board, for a person. Further arguments go to the board.
pub fn play(arguments: &[String]) -> Result<()> {
    run(program("board")?.args(arguments))
}

/// A program of the virtual board's that measures on the emulated chip and writes a document.
pub fn measure(name: &str, arguments: &[String]) -> Result<()> {
    run(program(name)?.args(arguments))?;
    if arguments.is_empty() { report::record(name, &format!("cargo xtask {name}")) } else { Ok(()) }
}

/// A program of the virtual board's that runs the images of the boards, which this builds.
fn program(name: &str) -> Result<Command> {
    firmware::build_all()?;
    let mut command = haptic_emulator(name);
    command.env(IMAGES, firmware::directory());
    Ok(command)
}
