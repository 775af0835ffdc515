//! What the washout keeps of the feed-forward's gain in stable area: (washed out - off) / (full - off), over its
//! corner.

use super::{CASES, Case, FULL, Mode, measured, measured_area, predicted};
use haptic::sim::{BoardOptions, TIMER_HZ};
use haptic_bridge::drive::carrier::Carrier;
use std::fmt::Write as _;

/// Corners of the washout, Hz.
const CORNERS: [f64; 6] = [0.5, 1.0, 2.0, 5.0, 10.0, 20.0];
/// The case that is measured, and the corners at which it is.
const MEASURED: &str = "range-1khz";
const MEASURED_CORNERS: [f64; 3] = [0.5, 2.0, 10.0];
const REPEATS: usize = 3;

/// The table, and the line above it.
pub fn section() -> Result<String, Box<dyn std::error::Error>> {
    let mut text = String::from(
        "\n### What a washout keeps\n\n\
         The share of the gained area, (washed out - off) / (full - off), that is left when the feed-forward is high-passed \
         so that a resting hand feels none of it. Predicted by `haptic range --washout`; in brackets, measured as above \
         with 3 repeats.\n\n| corner |",
    );
    for case in &CASES {
        let _ = write!(text, " {} Hz, cutoff {} Hz |", case.rate_hz, case.cutoff_hz);
    }
    let _ = write!(text, "\n|---:|{}\n", "---:|".repeat(CASES.len()));
    for corner in CORNERS {
        let _ = write!(text, "| {corner} Hz |");
        for case in &CASES {
            let _ = write!(text, " {:.1} %", 100.0 * kept(case, corner)?);
            if case.name == MEASURED && MEASURED_CORNERS.contains(&corner) {
                let _ = write!(text, " ({:.1} %)", 100.0 * kept_measured(case, corner)?);
            }
            text.push_str(" |");
        }
        text.push('\n');
    }
    text.push_str(
        "\nAt 10 kHz and above 2 Hz keep nearly all of it. A slow loop reacts within the same times as a hand, so a washout that \
         a hand does not feel takes the gain away: at 200 Hz or 1 kHz choose 0.5 Hz, or `feed_forward = \"full\"`. Below zero \
         the washed-out wall is stable in a smaller area than one without feed-forward.\n",
    );
    Ok(text)
}

fn share(off: f64, full: f64, washed: f64) -> f64 {
    (washed - off) / (full - off)
}

fn kept(case: &Case, corner: f64) -> Result<f64, Box<dyn std::error::Error>> {
    // As the simulated board reports it.
    let divider = f64::from(Carrier::for_rate(TIMER_HZ, case.rate_hz as f32).divider);
    let range = predicted(case, BoardOptions::default().delay / divider, Some(corner))?;
    let washed = range.washout.as_ref().ok_or("a washout was asked for")?;
    Ok(share(range.off.area, range.full.area, washed.area))
}

fn kept_measured(case: &Case, corner: f64) -> Result<f64, Box<dyn std::error::Error>> {
    let modes = [FULL[0], FULL[1], Mode::Washout];
    let progress = measured(case, &modes, corner, REPEATS)?.progress;
    let area = |mode| measured_area(&progress, mode);
    Ok(share(area(Mode::Off), area(Mode::Full), area(Mode::Washout)))
}
