//! `range`: measures the entire range of stable walls on the emulated chip, without and with the feed-forward, and
//! writes docs/results/range-chip.csv and its pictures. `cargo xtask range` runs it; it takes about ten minutes. `range
//! cables` writes docs/results/complete-chip.csv. `range cables DEVICE [RATE [no-emf]]` prints only the rows of that
//! device, at every rate or at this rate, with or without the motors' back-EMF.
//!
//! Exit code 1: a measurement or a file failed.

use std::process::ExitCode;

use haptic_bridge::render::scene::FeedForward;
use haptic_emulator::range::{
    CABLE_HEAD, CABLE_RATES, CABLED, HEAD, POINTS, PULLS, RATES, Rate, measure_range, section, with_cables,
};
use haptic_emulator::results;
use haptic_host::output::csv_line;
use haptic_predict::measure::progress::Progress;

/// Row of the table of cables that is also measure_both without back-EMF.
const WITHOUT_EMF: (&str, f64) = ("woodenhaptics", 20_000.0);

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
    let mut table = csv_line(HEAD);
    for rate in RATES {
        let (progress, delay) = measure_both(rate)?;
        let (rows, summary, picture) = section(rate, &progress, delay);
        picture.save_svg(&results("range-chip").with_file_name(format!("range-chip-{}hz.svg", rate.rate_hz)))?;
        table += &rows;
        println!("{summary}");
    }
    std::fs::write(results("range-chip"), table)?;
    Ok(())
}

/// Measures with cables at the joints and prints the table row by row. Without arguments writes the complete table;
/// `only` restricts it to a device, a rate and motors without back-EMF.
fn cables(only: &[String]) -> Result<(), Box<dyn std::error::Error>> {
    let is_selected = |nth: usize, name: &str| only.get(nth).is_none_or(|wanted| wanted == name);
    let devices: Vec<_> = CABLED.into_iter().filter(|(name, _)| is_selected(0, name)).collect();
    let rates: Vec<_> = CABLE_RATES.into_iter().filter(|rate| is_selected(1, &rate.rate_hz.to_string())).collect();
    if devices.is_empty() || rates.is_empty() {
        let names = CABLED.map(|(name, _)| name).join(", ");
        let rates = CABLE_RATES.map(|rate| rate.rate_hz.to_string()).join(", ");
        return Err(format!("the devices are {names}, the rates {rates} Hz").into());
    }
    let back_emf = only.get(2).is_none_or(|word| word != "no-emf");
    let mut runs: Vec<_> =
        rates.iter().flat_map(|rate| devices.iter().map(|device| (*device, *rate, back_emf))).collect();
    if only.is_empty() {
        let again = runs.iter().filter(|((name, _), rate, _)| (*name, rate.rate_hz) == WITHOUT_EMF);
        runs.extend(again.map(|(device, rate, _)| (*device, *rate, false)).collect::<Vec<_>>());
    }
    let (mut failed, mut table) = (Vec::new(), csv_line(CABLE_HEAD));
    print!("{table}");
    for (device, rate, back_emf) in runs {
        let report = |row: &str| {
            print!("{row}");
            table += row;
        };
        // An error of one device does not stop the measurement of the others.
        if let Err(error) = with_cables(device, rate, back_emf, report) {
            let (name, board) = device;
            failed.push(format!("{name} on {} at {} Hz: {error}", board.name(), rate.rate_hz));
        }
    }
    if only.is_empty() {
        std::fs::write(results("complete-chip"), table)?;
    }
    if failed.is_empty() { Ok(()) } else { Err(failed.join("\n").into()) }
}

/// Measures both feed-forwards at `rate`, each on its own board. Returns the results and the delay that the board
/// reports.
fn measure_both(rate: Rate) -> Result<(Progress, f64), String> {
    let parts = std::thread::scope(|scope| {
        let running = [FeedForward::Off, FeedForward::Full].map(|mode| {
            scope.spawn(move || {
                let report = |done| eprintln!("{} Hz, {mode:?}: {done} of {}", rate.rate_hz, POINTS * PULLS.len());
                measure_range(rate, mode, report).map_err(|error| error.to_string())
            })
        });
        running.map(|thread| thread.join().unwrap_or_else(|_| Err("the measurement panicked".to_owned())))
    });
    let mut all = Progress::new("the emulated chip");
    let mut delay = 0.0;
    for part in parts {
        let (progress, board_delay) = part?;
        all.ends.extend(progress.ends);
        all.points.extend(progress.points);
        delay = board_delay;
    }
    Ok((all, delay))
}
