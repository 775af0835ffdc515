//! `count IMAGE.elf`: prints the instructions and the name of each variant of a counting image, a line each.
//! `haptic_emulator::count` describes the convention for images.
//!
//! Exit code 1: the image could not be counted; 2: the command is wrong.

use std::process::ExitCode;

use haptic_emulator::count::count;
use haptic_emulator::image::Firmware;

/// Virtual seconds until an image must be done.
const SECONDS: u64 = 60;

fn main() -> ExitCode {
    let mut arguments = std::env::args().skip(1);
    let (Some(path), None) = (arguments.next(), arguments.next()) else {
        eprintln!("usage: count IMAGE.elf");
        return ExitCode::from(2);
    };
    match Firmware::read(&path).and_then(|firmware| count(&firmware, SECONDS)) {
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
