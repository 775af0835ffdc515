//! `timing` measures the control interrupt of two boards, prints its instructions in each source file, and writes each
//! table of docs/results/timing.md as soon as the table is measured. `cargo xtask timing` runs this program.
//!
//! Exit code: 1 if a table could not be written.

use std::process::ExitCode;

use haptic_emulator::cases::{CASES, Case, SCENES};
use haptic_emulator::results;
use haptic_emulator::timing::{Timing, new_scene_table, rate_table, scene_table, step_table, table};

/// Name of a table, and the function that measures the table.
type Table = (&'static str, fn() -> String);

fn measure_cases(cases: &[Case]) -> Vec<Timing> {
    let measured = cases.iter().map(|case| {
        let timing = case.measure();
        println!("{}: longest {}, at a valley {}", case.name(), timing.longest_step, timing.longest_valley);
        timing.files.iter().for_each(|(file, instructions)| println!("{instructions:8.0} {file}"));
        timing
    });
    measured.collect()
}

fn main() -> ExitCode {
    let tables: [Table; 5] = [
        ("timing", || table(&measure_cases(&CASES))),
        ("timing-scenes", || scene_table(&measure_cases(&SCENES))),
        ("timing-steps", step_table),
        ("timing-new-scenes", new_scene_table),
        ("timing-rates", || {
            // A rate that is too high ends in a panic on its own thread, and the rate counts as not sustained.
            std::panic::set_hook(Box::new(|_| ()));
            rate_table()
        }),
    ];
    for (name, measure) in tables {
        if let Err(error) = std::fs::write(results(name), measure()) {
            eprintln!("timing: {}: {error}", results(name).display());
            return ExitCode::from(1);
        }
        println!("docs/results/{name}.csv is written");
    }
    ExitCode::SUCCESS
}
