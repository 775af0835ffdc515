//! `range`: measures the whole range of stable walls on the emulated chip, without and with the feed-forward, and
//! writes its section of docs/results.md and its pictures. `cargo xtask range` calls it; it takes some ten minutes.
//! `range cables [DEVICE [RATE [no-emf]]]` prints the rows of docs/results/complete.md instead, of every device at
//! every rate or of those named, with the motors' back-EMF or without.
//!
//! Exit code 1: it could not be measured or written.

use std::path::Path;
use std::process::ExitCode;

use haptic::measure::progress::Progress;
use haptic_bridge::render::scene::FeedForward;
use virtual_board::range::{
    CABLE_HEAD, CABLE_RATES, CABLED, POINTS, RATES, REPEATS, Rate, introduction, section, whole, with_cables,
};

/// Where the section begins and ends.
const BEGIN: &str = "<!-- range on the chip: begin, written by cargo xtask range -->\n";
const END: &str = "<!-- range on the chip: end -->";

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    match if arguments.is_empty() { run() } else { cables(&arguments[1..]) } {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("range: {error}");
            ExitCode::from(1)
        }
    }
}

fn run() -> Result<(), Box<dyn std::error::Error>> {
    let occasion = std::env::var("HAPTIC_OCCASION").unwrap_or_else(|_| "Undated".to_owned());
    let docs = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs");
    let mut text = introduction(&occasion);
    for rate in RATES {
        let (progress, delay) = measured(rate)?;
        let (part, picture) = section(rate, &progress, delay);
        let name = format!("range-chip-{}hz.svg", rate.rate_hz);
        picture.save_svg(&docs.join("results").join(&name))?;
        text += &format!("{part}\n![measured on the emulated chip at {} Hz](results/{name})\n", rate.rate_hz);
    }
    let results = docs.join("results.md");
    let old = std::fs::read_to_string(&results)?;
    let (before, rest) = old.split_once(BEGIN).ok_or("docs/results.md lacks the mark where the section begins")?;
    let (_, after) = rest.split_once(END).ok_or("docs/results.md lacks the mark where the section ends")?;
    std::fs::write(&results, format!("{before}{BEGIN}{text}{END}{after}"))?;
    println!("{text}");
    Ok(())
}

/// Prints what is measured with cables at the joints, row by row; `only` a device, at a rate, without back-EMF.
fn cables(only: &[String]) -> Result<(), Box<dyn std::error::Error>> {
    let asked = |nth: usize, name: &str| only.get(nth).is_none_or(|wanted| wanted == name);
    let devices: Vec<_> = CABLED.into_iter().filter(|(name, _)| asked(0, name)).collect();
    let rates: Vec<_> = CABLE_RATES.into_iter().filter(|rate| asked(1, &rate.rate_hz.to_string())).collect();
    if devices.is_empty() || rates.is_empty() {
        let names = CABLED.map(|(name, _)| name).join(", ");
        let rates = CABLE_RATES.map(|rate| rate.rate_hz.to_string()).join(", ");
        return Err(format!("the devices are {names}, the rates {rates} Hz").into());
    }
    let back_emf = only.get(2).is_none_or(|word| word != "no-emf");
    let mut failed = Vec::new();
    println!("{CABLE_HEAD}");
    for rate in rates {
        for &device in &devices {
            // What one device faults with leaves the others to be measured.
            if let Err(error) = with_cables(device, rate, back_emf, |row| println!("{row}")) {
                let (name, board) = device;
                failed.push(format!("{name} on {} at {} Hz: {error}", board.name(), rate.rate_hz));
            }
        }
    }
    if failed.is_empty() { Ok(()) } else { Err(failed.join("\n").into()) }
}

/// Both feed-forwards at `rate`, each on a board of its own, and the delay that the board reports.
fn measured(rate: Rate) -> Result<(Progress, f64), String> {
    let parts = std::thread::scope(|scope| {
        let running = [FeedForward::Off, FeedForward::Full].map(|mode| {
            scope.spawn(move || {
                let told = |done| eprintln!("{} Hz, {mode:?}: {done} of {}", rate.rate_hz, POINTS * REPEATS);
                whole(rate, mode, told).map_err(|error| error.to_string())
            })
        });
        running.map(|thread| thread.join().unwrap_or_else(|_| Err("the measurement panicked".to_owned())))
    });
    let mut all = Progress::new("the emulated chip");
    let mut delay = 0.0;
    for part in parts {
        let (progress, seen) = part?;
        all.ends.extend(progress.ends);
        all.points.extend(progress.points);
        delay = seen;
    }
    Ok((all, delay))
}
