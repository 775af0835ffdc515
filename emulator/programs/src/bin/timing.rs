//! `timing`: measures the control interrupt of two boards and writes the tables of docs/results/timing.md. `cargo xtask
//! timing` runs it.
//!
//! Exit code 1: a table could not be written.

use std::process::ExitCode;

use haptic_emulator::cases::{CASES, Case, SCENES};
use haptic_emulator::results;
use haptic_emulator::timing::{Timing, rates, replacements, scenes, steps, table};

fn main() -> ExitCode {
    let measured = |cases: &[Case]| -> Vec<Timing> {
        let measured = cases.iter().map(|case| {
            let timing = case.measure();
            println!("{}: longest {}, at a valley {}", case.name(), timing.longest, timing.valley);
            timing
        });
        measured.collect()
    };
    let mut tables = vec![("timing", table(&measured(&CASES))), ("timing-scenes", scenes(&measured(&SCENES)))];
    // A rate that is too high ends in a panic on its own thread, which counts as not sustained.
    std::panic::set_hook(Box::new(|_| ()));
    tables.extend([("timing-steps", steps()), ("timing-new-scenes", replacements()), ("timing-rates", rates())]);
    for (name, table) in tables {
        if let Err(error) = std::fs::write(results(name), table) {
            eprintln!("timing: {}: {error}", results(name).display());
            return ExitCode::from(1);
        }
    }
    ExitCode::SUCCESS
}
