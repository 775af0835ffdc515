//! The soak: host/tests/soak.rs for as long as is wanted, with its figures as a dated report.

use std::fs;
use std::process::Command;

use anyhow::{Context as _, Result, bail};

use crate::firmware::{root, target_directory};
use crate::report;
use crate::toolchain::run as run_command;

/// Simulated hours when nothing else is said.
const HOURS: f64 = 24.0;

/// Runs `[--hours N] [--record]`.
pub fn run(arguments: &[&str]) -> Result<()> {
    let (hours, record) = parse(arguments)?;
    let occasion = report::occasion();
    let figures = target_directory().join("soak.md");
    run_command(
        Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()))
            .current_dir(root())
            .args(["test", "--locked", "--release", "--package", "haptic", "--test", "soak"])
            .env("HAPTIC_SOAK_SECONDS", format!("{:.0}", hours * 3600.0))
            .env("HAPTIC_SOAK_REPORT", &figures),
    )?;
    let text = fs::read_to_string(&figures).with_context(|| format!("cannot read {}", figures.display()))?;
    println!("{text}");
    if record {
        let heading = format!("# Soak\n\n{}. `cargo xtask soak --hours {hours} --record`\n\n", occasion);
        report::write("soak.md", &(heading + &text))?;
    }
    Ok(())
}

fn parse(arguments: &[&str]) -> Result<(f64, bool)> {
    let (mut hours, mut record) = (HOURS, false);
    let mut rest = arguments.iter();
    while let Some(argument) = rest.next() {
        match *argument {
            "--record" => record = true,
            "--hours" => {
                let number = rest.next().and_then(|number| number.parse().ok());
                // A twentieth of an hour: what the test needs to know what is usual.
                hours = number.filter(|hours| (0.05..=1000.0).contains(hours)).context("--hours takes 0.05 to 1000")?;
            }
            other => bail!("unknown option {other}; there are --hours N and --record"),
        }
    }
    Ok((hours, record))
}
