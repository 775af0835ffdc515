//! `timing`: measures the control interrupt of both boards and writes docs/results/timing.md. `cargo xtask timing`
//! calls it.
//!
//! Exit code 1: the table could not be written.

use std::process::ExitCode;

use virtual_board::cases::{CASES, Case, SCENES};
use virtual_board::timing::{Timing, document, rates, replacements, scenes, table};

fn main() -> ExitCode {
    let measured = |cases: &[Case]| -> Vec<Timing> {
        let measured = cases.iter().map(|case| {
            let timing = case.measure();
            println!("{}: longest {}, at a valley {}", case.name(), timing.longest, timing.valley);
            timing
        });
        measured.collect()
    };
    let (stages, others) = (table(&measured(&CASES)), scenes(&measured(&SCENES)));
    // An attempt at too high a rate ends in a panic on its own thread, which is the answer.
    std::panic::set_hook(Box::new(|_| ()));
    match std::fs::write(document(), stages + &others + &replacements() + &rates()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("timing: {}: {error}", document().display());
            ExitCode::from(1)
        }
    }
}
