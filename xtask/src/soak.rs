//! Runs the soak test tool/tests/deep/soak.rs on the simulated board for hours, and writes a report.

use std::fs;

use anyhow::{Context as _, Result};

use crate::paths::{root, target_directory};
use crate::report;
use crate::toolchain::{cargo, run as run_command};

/// Options of `cargo xtask soak`.
#[derive(clap::Args)]
pub struct Options {
    /// Simulated hours, 0.05 to 1000
    #[arg(long, value_name = "N", default_value_t = 24.0, value_parser = hours)]
    hours: f64,
    /// Write docs/results/soak.md
    #[arg(long)]
    record: bool,
}

/// Parses the duration, h. The test needs 0.05 h to measure the normal values.
fn hours(text: &str) -> Result<f64, String> {
    let number = text.parse().ok().filter(|hours| (0.05..=1000.0).contains(hours));
    number.ok_or_else(|| "must be a number from 0.05 to 1000".into())
}

pub fn run(options: &Options) -> Result<()> {
    let hours = options.hours;
    let date_and_commit = report::date_and_commit();
    let figures = target_directory().join("soak.md");
    run_command(
        cargo()
            .current_dir(root())
            .args(["test", "--locked", "--release", "--package", "haptic", "--test", "deep", "--", "soak::"])
            .env("HAPTIC_SOAK_SECONDS", format!("{:.0}", hours * 3600.0))
            .env("HAPTIC_SOAK_REPORT", &figures),
    )?;
    let text = fs::read_to_string(&figures).with_context(|| format!("cannot read {}", figures.display()))?;
    println!("{text}");
    if options.record {
        let heading = format!("# Soak\n\n{date_and_commit}. `cargo xtask soak --hours {hours} --record`\n\n");
        report::write("soak.md", &(heading + &text))?;
    }
    Ok(())
}
