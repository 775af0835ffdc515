//! Entry points that need more than one cargo call. `cargo xtask help` lists them.

mod bench;
mod deny;
mod dfu;
mod firmware;
mod fuzz;
mod image;
mod no_panic;
mod report;
mod soak;
mod tests;
mod thumb;
mod toolchain;
mod tools;
mod undefined;

use std::process::ExitCode;

use anyhow::{Result, bail};

const HELP: &str = "\
cargo xtask COMMAND

  fw [BOARD]        build the firmware of one board, or of all; also `cargo fw`
  size              build all boards, print flash and RAM, fail above the limits
  clippy-fw         clippy for the chip, warnings are errors
  flash BOARD       build and flash with probe-rs; also `cargo flash-BOARD`
  dfu BOARD         build and write a .dfu update file that leaves the settings alone
  no-panic          prove that the control step cannot panic, and bound its stack
  bench             count instructions of every variant of the control step, remake the report
  bench --check     fail when a variant's instructions grew by more than 5 % over the kept figures
  tools             say whether everything that the tests need is on this computer, or what is missing
  test              every test: this computer's, both images, the emulated board
  test-board        of these, the tests that run the images on the emulated board
  timing            count the control interrupt's instructions, stage by stage, into docs/results/timing.md
  fuzz [TARGET] [--seconds N] [--record]
                    wild input for everything that reads any, guided by coverage; N seconds a target (60),
                    --record writes docs/results/fuzz.md
  sanitize          the library's tests under the address sanitizer
  miri              some of them under Miri, which needs a nightly toolchain
  deny              licences, sources and known advisories of everything that is linked; with cargo-deny, today's too
  soak [--chip] [--hours N] [--record]
                    simulated hours (24) of contact with telemetry: nothing lost, no drift, no growth; with --chip (1 hour) on
                    the emulated chip, random bytes into another one beside it; --record writes docs/results/soak.md, or
                    soak-chip.md
  range             measure the range of stable walls on the emulated board (half an hour), into docs/results.md
  faults            bring every fault about on the emulated board, into docs/results/faults.md
  board [BOARD] [--device FILE] [--tcp PORT] [--fast]
                    the real firmware on an emulated board with a simulated device, to talk to

Boards: odrive-v3, h-bridge-f405. Options: --install puts missing Debian packages in place (root).";

fn main() -> ExitCode {
    let mut arguments: Vec<String> = std::env::args().skip(1).collect();
    let install = arguments.iter().position(|a| a == "--install").map(|at| arguments.remove(at)).is_some();
    match run(&arguments, install) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("xtask: {error:#}");
            ExitCode::FAILURE
        }
    }
}

fn run(arguments: &[String], install: bool) -> Result<()> {
    let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
    match arguments.as_slice() {
        ["fw"] => firmware::build_all(install).map(drop),
        ["fw", board] => firmware::build(firmware::board(board)?, install).map(drop),
        ["size"] => firmware::size(install),
        ["clippy-fw"] => firmware::clippy(install),
        ["flash", board] => firmware::flash(firmware::board(board)?, install),
        ["dfu", board] => firmware::dfu(firmware::board(board)?, install),
        ["no-panic"] => no_panic::prove(install),
        ["bench"] => bench::refresh(install),
        ["bench", "--check"] => bench::check(install),
        ["tools"] => tools::check(install),
        ["test"] => tests::all(install),
        ["test-board", rest @ ..] => tests::board(rest, install),
        ["faults"] => tests::measure("faults", &[], install),
        ["range"] => tests::measure("range", &[], install),
        ["timing"] => tests::measure("timing", &[], install),
        ["fuzz", rest @ ..] => fuzz::run(&fuzz::Options::parse(rest)?, install),
        ["sanitize", rest @ ..] => undefined::sanitize(rest),
        ["miri"] => undefined::miri(),
        ["deny"] => deny::run(),
        ["soak", rest @ ..] => soak::run(rest, install),
        ["board", rest @ ..] => tests::play(rest, install),
        [] | ["help" | "--help" | "-h"] => {
            println!("{HELP}");
            Ok(())
        }
        _ => bail!("unknown command: {}\n\n{HELP}", arguments.join(" ")),
    }
}
