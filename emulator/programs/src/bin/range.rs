//! `range` measures the entire range of stable walls on the emulated chip, without and with the feed-forward. It writes
//! docs/results/range-chip.csv and the pictures in about ten minutes. `cargo xtask range` runs this program.
//!
//! Exit code: 1 if a measurement failed or a file could not be written.

use std::process::ExitCode;

use haptic_bridge::render::scene::FeedForward;
use haptic_emulator::range::{COLUMN_NAMES, DAMPING_COUNT, RATES, RELATIVE_PULLS, Rate, measure_range, section};
use haptic_emulator::results;
use haptic_host::output::csv_line;
use haptic_predict::measure::progress::Progress;

fn main() -> ExitCode {
    match run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("range: {error}");
            ExitCode::from(1)
        }
    }
}

fn run() -> Result<(), Box<dyn std::error::Error>> {
    let mut table = csv_line(COLUMN_NAMES);
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

/// Measures at `rate` without and with the feed-forward, each on its own board. Returns the results and the board's
/// delay.
fn measure_both(rate: Rate) -> Result<(Progress, f64), String> {
    let parts = std::thread::scope(|scope| {
        let running = [FeedForward::Off, FeedForward::Full].map(|mode| {
            scope.spawn(move || {
                let report = |done| {
                    eprintln!("{} Hz, {mode:?}: {done} of {}", rate.rate_hz, DAMPING_COUNT * RELATIVE_PULLS.len())
                };
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
