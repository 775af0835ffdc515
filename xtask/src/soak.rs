//! The soaks, with their figures as dated reports: host/tests/soak.rs on the simulated board, or the release image on
//! the emulated chip (emulator/src/soak.rs), for as long as is wanted.

use std::fs;

use anyhow::{Context as _, Result, bail};

use crate::firmware::{root, target_directory};
use crate::toolchain::{cargo, run as run_command};
use crate::{report, tests};

/// Simulated hours when nothing else is said: on the simulated board, and on the emulated chip.
const HOURS: (f64, f64) = (24.0, 1.0);

/// Runs `[--chip] [--hours N] [--record]`.
pub fn run(arguments: &[&str], install: bool) -> Result<()> {
    let chip = arguments.contains(&"--chip");
    let (hours, record) = parse(arguments, if chip { HOURS.1 } else { HOURS.0 })?;
    let occasion = report::occasion();
    let figures = target_directory().join("soak.md");
    if chip {
        tests::measure("soak", &[&hours.to_string(), &figures.to_string_lossy()], install)?;
    } else {
        run_command(
            cargo()
                .current_dir(root())
                .args(["test", "--locked", "--release", "--package", "haptic", "--test", "soak"])
                .env("HAPTIC_SOAK_SECONDS", format!("{:.0}", hours * 3600.0))
                .env("HAPTIC_SOAK_REPORT", &figures),
        )?;
    }
    let text = fs::read_to_string(&figures).with_context(|| format!("cannot read {}", figures.display()))?;
    println!("{text}");
    if record {
        let (name, what, option) =
            if chip { ("soak-chip.md", "Soak on the emulated chip", " --chip") } else { ("soak.md", "Soak", "") };
        let heading = format!("# {what}\n\n{occasion}. `cargo xtask soak{option} --hours {hours} --record`\n\n");
        report::write(name, &(heading + &text))?;
    }
    Ok(())
}

fn parse(arguments: &[&str], usual: f64) -> Result<(f64, bool)> {
    let (mut hours, mut record) = (usual, false);
    let mut rest = arguments.iter();
    while let Some(argument) = rest.next() {
        match *argument {
            "--chip" => {}
            "--record" => record = true,
            "--hours" => {
                let number = rest.next().and_then(|number| number.parse().ok());
                // A twentieth of an hour: what the test needs to know what is usual.
                hours = number.filter(|hours| (0.05..=1000.0).contains(hours)).context("--hours takes 0.05 to 1000")?;
            }
            other => bail!("unknown option {other}; there are --chip, --hours N and --record"),
        }
    }
    Ok((hours, record))
}
