//! Long soak tests with dated reports: tool/tests/deep/soak.rs on the simulated board, or the release image on the
//! emulated chip (emulator/src/soak.rs).

use std::fs;

use anyhow::{Context as _, Result};

use crate::paths::{root, target_directory};
use crate::toolchain::{cargo, run as run_command};
use crate::{report, tests};

/// Default number of simulated hours: on the simulated board, and on the emulated chip.
const HOURS: (f64, f64) = (24.0, 1.0);

/// Duration and board.
#[derive(clap::Args)]
pub struct Options {
    /// Use the emulated chip, with a second one that receives random bytes
    #[arg(long)]
    chip: bool,
    /// Simulated hours, 0.05 to 1000 [default: 24, with --chip 1]
    #[arg(long, value_name = "N", value_parser = hours)]
    hours: Option<f64>,
    /// Write docs/results/soak.md, or soak-chip.md
    #[arg(long)]
    record: bool,
}

/// Parses the duration. The test needs a twentieth of an hour to learn the normal values.
fn hours(text: &str) -> Result<f64, String> {
    let number = text.parse().ok().filter(|hours| (0.05..=1000.0).contains(hours));
    number.ok_or_else(|| "must be a number from 0.05 to 1000".into())
}

/// Runs a soak.
pub fn run(options: &Options) -> Result<()> {
    let Options { chip, record, .. } = *options;
    let hours = options.hours.unwrap_or(if chip { HOURS.1 } else { HOURS.0 });
    let date_and_commit = report::date_and_commit();
    let figures = target_directory().join("soak.md");
    if chip {
        tests::measure("soak", &[hours.to_string(), figures.to_string_lossy().into_owned()])?;
    } else {
        run_command(
            cargo()
                .current_dir(root())
                .args(["test", "--locked", "--release", "--package", "haptic", "--test", "deep", "--", "soak::"])
                .env("HAPTIC_SOAK_SECONDS", format!("{:.0}", hours * 3600.0))
                .env("HAPTIC_SOAK_REPORT", &figures),
        )?;
    }
    let text = fs::read_to_string(&figures).with_context(|| format!("cannot read {}", figures.display()))?;
    println!("{text}");
    if record {
        let (name, what, option) =
            if chip { ("soak-chip.md", "Soak on the emulated chip", " --chip") } else { ("soak.md", "Soak", "") };
        let heading = format!("# {what}\n\n{date_and_commit}. `cargo xtask soak{option} --hours {hours} --record`\n\n");
        report::write(name, &(heading + &text))?;
    }
    Ok(())
}
