//! Common parts of dated reports: the date, the commit and the folder.

use std::fs;
use std::process::Command;
use std::time::{SystemTime, UNIX_EPOCH};

use anyhow::{Context as _, Result};

use crate::paths::root;
use crate::shown;
use crate::toolchain::{cargo, run};

/// Writes `docs/results/NAME` and prints its path.
pub fn write(name: &str, text: &str) -> Result<()> {
    let path = root().join("docs/results").join(name);
    fs::write(&path, text).with_context(|| format!("cannot write {}", path.display()))?;
    println!("docs/results/{name} is written");
    Ok(())
}

/// Draws the figures of docs/results.md with the program in xtask/figures.
pub fn figures(cases: &[String]) -> Result<()> {
    let program = ["run", "--quiet", "--locked", "--release", "--package", "figures", "--"];
    run(cargo().current_dir(root()).args(program).args(cases))?;
    if cases.is_empty() { record("ranges", "cargo xtask figures") } else { Ok(()) }
}

/// Records in docs/results/made.csv that `command` has just made the figures called `name`, with commit and compiler,
/// and updates the documents' tables.
pub fn record(name: &str, command: &str) -> Result<()> {
    let path = root().join("docs/results/made.csv");
    let compiler =
        Command::new(std::env::var_os("RUSTC").unwrap_or_else(|| "rustc".into())).arg("--version").output()?;
    let line =
        format!("{name},{command},\"{}\",{}", date_and_commit(), String::from_utf8_lossy(&compiler.stdout).trim());
    let head = "figures,command,made,compiler";
    let present = fs::read_to_string(&path).unwrap_or_default();
    let others = present.lines().skip(1).filter(|other| other.split(',').next() != Some(name));
    let mut lines: Vec<&str> = others.chain([line.as_str()]).collect();
    lines.sort_unstable();
    lines.insert(0, head);
    write("made.csv", &(lines.join("\n") + "\n"))?;
    shown::refresh()
}

/// Returns the date and the commit, as in "2026-01-31, commit 0123abc".
pub fn date_and_commit() -> String {
    let seconds = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_secs());
    let (year, month, day) = calendar_date(seconds / 86_400);
    let commit = Command::new("git").current_dir(root()).args(["describe", "--always", "--dirty=, changed"]).output();
    let commit = commit.ok().filter(|output| output.status.success());
    let commit =
        commit.map_or_else(|| "unknown".into(), |output| String::from_utf8_lossy(&output.stdout).trim().to_string());
    format!("{year}-{month:02}-{day:02}, commit {commit}")
}

/// Converts days since 1970-01-01 to year, month and day (Hinnant, "chrono-compatible low-level date algorithms").
fn calendar_date(day: u64) -> (u64, u64, u64) {
    let shifted = day + 719_468;
    let (era, day_of_era) = (shifted / 146_097, shifted % 146_097);
    let year_of_era = (day_of_era - day_of_era / 1460 + day_of_era / 36_524 - day_of_era / 146_096) / 365;
    let day_of_year = day_of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let from_march = (5 * day_of_year + 2) / 153;
    let month = if from_march < 10 { from_march + 3 } else { from_march - 9 };
    (400 * era + year_of_era + u64::from(month <= 2), month, day_of_year - (153 * from_march + 2) / 5 + 1)
}

#[cfg(test)]
mod tests {
    #[test]
    fn days_are_converted_to_calendar_dates() {
        assert_eq!(super::calendar_date(0), (1970, 1, 1));
        assert_eq!(super::calendar_date(19_782), (2024, 2, 29));
        assert_eq!(super::calendar_date(20_513), (2026, 3, 1));
    }
}
