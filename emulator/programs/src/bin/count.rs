//! `count IMAGE.elf`: prints the instructions and the name of each variant of a counting image, one variant per line.
//! `haptic_emulator::count` describes the convention for images.
//!
//! Exit codes: 1 if the image could not be counted, 2 if the command is wrong.

use std::process::ExitCode;

use haptic_emulator::count::count;
use haptic_emulator::image::Firmware;

/// Virtual time after which an unfinished image fails, s.
const MAX_VIRTUAL_SECONDS: u64 = 60;

fn main() -> ExitCode {
    let mut arguments = std::env::args().skip(1);
    let (Some(path), None) = (arguments.next(), arguments.next()) else {
        eprintln!("usage: count IMAGE.elf");
        return ExitCode::from(2);
    };
    match Firmware::read(&path).and_then(|firmware| count(&firmware, MAX_VIRTUAL_SECONDS)) {
        Ok(variants) => {
            variants.iter().for_each(|(name, instructions)| println!("{instructions} {name}"));
            ExitCode::SUCCESS
        }
        Err(error) => {
            eprintln!("count: {error}");
            ExitCode::from(1)
        }
    }
}
