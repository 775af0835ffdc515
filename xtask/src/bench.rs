//! Counts the instructions of every variant of the control step on the emulated chip, and stores them in
//! crates/predict/src/bench/counts.json or compares them with this file.

use std::collections::BTreeMap;
use std::fs;
use std::path::PathBuf;
use std::process::Stdio;

use anyhow::{Context as _, Result, bail, ensure};
use serde_json::{Value, json};

use crate::paths::{root, target_directory};
use crate::report;
use crate::toolchain::{TARGET, cargo, chip_cargo, haptic_emulator, run};
use crate::tools::{self, Tool};

const BINARY: &str = "haptic-counting";
/// Largest allowed ratio of a variant's instructions to the stored count.
const MAX_GROWTH: f64 = 1.01;

fn counts_file() -> PathBuf {
    root().join("crates/predict/src/bench/counts.json")
}

fn image() -> Result<PathBuf> {
    tools::check(&[Tool::Chip])?;
    let mut command = chip_cargo();
    command.current_dir(root().join("firmware")).arg("--target-dir").arg(target_directory());
    run(command.args(["--locked", "--package", BINARY, "--profile", "firmware"]))?;
    Ok(target_directory().join(TARGET).join("firmware").join(BINARY))
}

/// Counts the instructions of every variant on the emulated chip, in the image's order.
fn count() -> Result<Vec<(String, u64)>> {
    let image = image()?;
    let output =
        haptic_emulator("count").arg(image).stderr(Stdio::inherit()).output().context("cannot run the counter")?;
    ensure!(output.status.success(), "the counter failed ({})", output.status);
    let text = String::from_utf8(output.stdout).context("the counter's output is not text")?;
    let variant = |line: &str| {
        let (instructions, name) = line.split_once(' ')?;
        Some((name.to_string(), instructions.parse().ok()?))
    };
    let counted: Option<Vec<_>> = text.lines().map(variant).collect();
    counted.filter(|counted| !counted.is_empty()).context("the counter printed no counts")
}

/// Counts the instructions of all variants, stores the counts, and writes the report.
pub fn refresh() -> Result<()> {
    let counted = count()?;
    let variants: Vec<String> = counted
        .iter()
        .map(|(name, instructions)| format!("    {}", json!({"name": name, "instructions": instructions})))
        .collect();
    let text = format!("{{\n  \"target\": \"cortex-m4f\",\n  \"variants\": [\n{}\n  ]\n}}\n", variants.join(",\n"));
    let file = counts_file();
    fs::write(&file, text).with_context(|| format!("cannot write {}", file.display()))?;
    println!("{}: {} variants", file.display(), counted.len());
    report::record("counts", "cargo xtask bench")?;
    run(cargo().current_dir(root()).args([
        "run",
        "--quiet",
        "--locked",
        "--package",
        "haptic",
        "--",
        "bench",
        "--report",
        "docs/results",
        "--force",
    ]))
}

/// Counts the instructions of all variants. Fails if a count is over 1 % above the stored count, or if variants change.
pub fn check() -> Result<()> {
    let stored: Value =
        serde_json::from_str(&fs::read_to_string(counts_file()).context("counts.json cannot be read")?)?;
    let stored: BTreeMap<&str, u64> = stored["variants"]
        .as_array()
        .context("counts.json lists no variants")?
        .iter()
        .filter_map(|variant| Some((variant["name"].as_str()?, variant["instructions"].as_u64()?)))
        .collect();
    let counted = count()?;
    let mut wrong = Vec::new();
    let mut less = 0;
    for (name, now) in &counted {
        match stored.get(name.as_str()) {
            None => wrong.push(format!("{name}: not in counts.json")),
            Some(then) if *now as f64 > *then as f64 * MAX_GROWTH => {
                wrong.push(format!("{name}: {then} before, {now} now"))
            }
            Some(then) => less += usize::from(now < then),
        }
    }
    for name in stored.keys().filter(|name| counted.iter().all(|(other, _)| other != *name)) {
        wrong.push(format!("{name}: no longer counted"));
    }
    if !wrong.is_empty() {
        bail!(
            "instructions of the control step grew by more than 1 %, or the variants changed:\n  {}\n\
             if this is intended, store the new counts with `cargo xtask bench`",
            wrong.join("\n  ")
        );
    }
    println!("{} variants within 1 % of counts.json, of which {less} are lower", counted.len());
    Ok(())
}
