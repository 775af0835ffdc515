//! The time that each format, view and interface adds to a build of the tool: cargo's timings of a clean build, summed
//! over the crates that only this part needs.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;

use anyhow::{Context as _, Result, ensure};
use serde_json::Value;

use crate::paths::{root, target_directory};
use crate::toolchain::{cargo, run};

/// Dependencies of the tool by purpose.
const PARTS: &[(&str, &[&str])] = &[
    ("PNG pictures", &["resvg", "dejavu"]),
    ("command line, help, manual", &["clap", "clap_complete", "clap_mangen", "indicatif", "ctrlc"]),
    ("`haptic view --terminal`", &["ratatui"]),
    ("recordings (MCAP)", &["mcap"]),
    ("`haptic view`, `serve --haply`", &["tungstenite", "getrandom"]),
    ("the board's link", &["postcard-rpc", "postcard", "cobs", "serialport"]),
    ("device and scene files", &["toml", "serde_json"]),
];

/// Builds the tool from nothing in a separate directory and prints a table in Markdown.
pub fn print() -> Result<()> {
    let fresh = target_directory().join("build-times");
    if fresh.exists() {
        fs::remove_dir_all(&fresh).with_context(|| format!("cannot empty {}", fresh.display()))?;
    }
    run(cargo()
        .current_dir(root())
        .args(["build", "--release", "--locked", "--package", "haptic", "--timings", "--target-dir"])
        .arg(&fresh))?;
    let report = fresh.join("cargo-timings/cargo-timing.html");
    let page = fs::read_to_string(&report).with_context(|| format!("cannot read {}", report.display()))?;
    let seconds = durations(&page)?;
    let graph = Graph::read()?;
    let total: f64 = seconds.values().sum();
    println!("| part | crates that only it needs | seconds of one core |\n|---|--:|--:|");
    for (part, crates) in PARTS {
        let own = graph.only_needed_by(crates);
        let spent: f64 = own.iter().filter_map(|name| seconds.get(name)).sum();
        println!("| {part} | {} | {spent:.0} |", own.len());
    }
    let ours: f64 = seconds.iter().filter(|(name, _)| is_ours(name)).map(|(_, seconds)| seconds).sum();
    println!("| this repository's own code | | {ours:.0} |\n| all of it | {} | {total:.0} |", seconds.len());
    Ok(())
}

/// Returns true if a crate belongs to this repository.
fn is_ours(name: &str) -> bool {
    name == "haptic" || name.starts_with("haptic-")
}

/// Reads the seconds of every crate from the list of units in cargo's report.
fn durations(page: &str) -> Result<BTreeMap<String, f64>> {
    let list = page.split_once("UNIT_DATA = ").and_then(|(_, rest)| rest.split_once("];")).map(|(list, _)| list);
    let list = list.context("cargo's report has no list of units")?;
    let units: Vec<Value> = serde_json::from_str(&format!("{list}]")).context("cargo's list of units is not JSON")?;
    let mut seconds = BTreeMap::new();
    for unit in &units {
        let (name, spent) = (unit["name"].as_str(), unit["duration"].as_f64());
        *seconds.entry(name.context("a unit without a name")?.to_owned()).or_default() +=
            spent.context("a unit without a duration")?;
    }
    Ok(seconds)
}

/// Dependencies between crates, by name; two versions of a crate are one.
struct Graph(BTreeMap<String, BTreeSet<String>>);

impl Graph {
    fn read() -> Result<Self> {
        let output = cargo()
            .current_dir(root())
            .args([
                "tree",
                "--locked",
                "--package",
                "haptic",
                "--edges",
                "normal,build",
                "--prefix",
                "depth",
                "--no-dedupe",
            ])
            .output()
            .context("cannot run cargo tree")?;
        ensure!(output.status.success(), "cargo tree failed ({})", output.status);
        let mut graph: BTreeMap<String, BTreeSet<String>> = BTreeMap::new();
        let mut above: Vec<String> = Vec::new();
        for line in String::from_utf8_lossy(&output.stdout).lines() {
            let digits = line.bytes().take_while(u8::is_ascii_digit).count();
            let Ok(depth) = line[..digits].parse::<usize>() else { continue };
            let name = line[digits..].split_whitespace().next().unwrap_or_default().to_owned();
            above.truncate(depth);
            if let Some(parent) = above.last() {
                graph.entry(parent.clone()).or_default().insert(name.clone());
            }
            above.push(name);
        }
        Ok(Self(graph))
    }

    /// Returns the crates that the tool needs if this repository's crates did not depend on the crates in `except`.
    fn reached(&self, except: &[&str]) -> BTreeSet<&str> {
        let mut found = BTreeSet::new();
        let mut open = vec!["haptic"];
        while let Some(name) = open.pop() {
            if !found.insert(name) {
                continue;
            }
            let needs = self.0.get(name).into_iter().flatten().map(String::as_str);
            open.extend(needs.filter(|need| !is_ours(name) || !except.contains(need)));
        }
        found
    }

    /// Returns the crates that the tool would no longer need without these.
    fn only_needed_by(&self, crates: &[&str]) -> BTreeSet<String> {
        let without = self.reached(crates);
        self.reached(&[]).difference(&without).map(|name| (*name).to_owned()).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn crates_that_another_part_needs_are_not_counted() {
        let needs = |names: &[&str]| names.iter().map(|name| (*name).to_owned()).collect();
        let graph = Graph(BTreeMap::from([
            ("haptic".into(), needs(&["a", "b"])),
            ("a".into(), needs(&["shared", "own"])),
            ("b".into(), needs(&["shared"])),
        ]));
        assert_eq!(graph.only_needed_by(&["a"]), needs(&["a", "own"]));
    }

    #[test]
    fn units_of_one_crate_are_added() {
        let page = r#"x const UNIT_DATA = [{"name":"a","duration":1.5},{"name":"a","duration":0.25}]; y"#;
        assert_eq!(durations(page).unwrap(), BTreeMap::from([("a".into(), 1.75)]));
    }
}
