//! `range`: measures the whole range of stable walls on the emulated chip, without and with the feed-forward, and
//! writes its section of docs/results.md and its pictures. `cargo xtask range` calls it; it takes some ten minutes.
//! `range cables` prints the rows of docs/results/complete.md instead.
//!
//! Exit code 1: it could not be measured or written.

use std::path::Path;
use std::process::ExitCode;

use haptic::measure::progress::Progress;
use haptic_bridge::render::scene::FeedForward;
use virtual_board::range::{self, CABLE_RATES, POINTS, RATES, REPEATS, Rate, introduction, section, whole};

/// Where the section begins and ends.
const BEGIN: &str = "<!-- range on the chip: begin, written by cargo xtask range -->\n";
const END: &str = "<!-- range on the chip: end -->";

fn main() -> ExitCode {
    let cables = std::env::args().nth(1).is_some_and(|part| part == "cables");
    match if cables { with_cables() } else { run() } {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("range: {error}");
            ExitCode::from(1)
        }
    }
}

fn run() -> Result<(), Box<dyn std::error::Error>> {
    let occasion = std::env::var("HAPTIC_OCCASION").unwrap_or_else(|_| "Undated".to_owned());
    let docs = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs");
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

/// Prints what is measured with cables at the joints, rate by rate.
fn with_cables() -> Result<(), Box<dyn std::error::Error>> {
    println!("| rate, cutoff | kd, N s/m | feed-forward | measured, N/m | predicted, N/m | off by |");
    println!("|---|---|---|---|---|---|");
    for rate in CABLE_RATES {
        print!("{}", range::with_cables(rate)?);
    }
    Ok(())
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
