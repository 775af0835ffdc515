//! `count IMAGE.elf [--seconds N]`: prints the instruction counts of a counting image's variants as a JSON document:
//! `{"image":…,"variants":[{"name":…,"calls":…,"instructions":…,"instructions_min":…,"instructions_mean":…,"results":[[…]]},…]}`.
//!
//! `instructions` is the worst case over the calls without the markers' cost; `results` contains the words that the
//! image left in `BENCH_RESULT` at each call. `haptic_emulator::count` describes the convention for images.
//! Exit code 1: the image could not be counted; 2: the command is wrong.

use std::process::ExitCode;

use haptic_emulator::count::count;
use haptic_emulator::image::Firmware;
use serde_json::json;

fn main() -> ExitCode {
    let mut path = None;
    let mut seconds = 60;
    let mut arguments = std::env::args().skip(1);
    while let Some(argument) = arguments.next() {
        match (argument.as_str(), &path) {
            ("--seconds", _) => match arguments.next().and_then(|value| value.parse().ok()) {
                Some(value) => seconds = value,
                None => return usage(),
            },
            (word, None) if !word.starts_with('-') => path = Some(argument),
            _ => return usage(),
        }
    }
    let Some(path) = path else { return usage() };
    let counted = Firmware::read(&path).map_err(Into::into).and_then(|firmware| count(&firmware, seconds));
    match counted {
        Ok(variants) => {
            let variants: Vec<_> = variants
                .iter()
                .map(|variant| {
                    json!({
                        "name": variant.name,
                        "calls": variant.instructions.len(),
                        "instructions": variant.max(),
                        "instructions_min": variant.min(),
                        "instructions_mean": variant.mean(),
                        "results": variant.results,
                    })
                })
                .collect();
            println!("{:#}", json!({ "image": path, "variants": variants }));
            ExitCode::SUCCESS
        }
        Err(error) => {
            eprintln!("count: {error}");
            ExitCode::from(1)
        }
    }
}

fn usage() -> ExitCode {
    eprintln!("usage: count IMAGE.elf [--seconds N]");
    ExitCode::from(2)
}
