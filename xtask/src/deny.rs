//! What may be linked: deny.toml, for every workspace here. Licences and sources are checked by this file from what
//! cargo knows, which takes seconds and no network; advisories and the rest by cargo-deny, where it is installed.

use std::path::Path;
use std::process::{Command, Stdio};

use anyhow::{Context as _, Result, bail, ensure};
use serde_json::Value;

use crate::firmware::root;
use crate::toolchain::run as run_command;

const WORKSPACES: [&str; 4] = [".", "fuzz", "tests/board", "tests/no-panic"];

/// Licences and sources, then cargo-deny or how to get it.
pub fn run() -> Result<()> {
    check()?;
    let there = Command::new("cargo-deny").arg("--version").stdout(Stdio::null()).status();
    if !there.is_ok_and(|status| status.success()) {
        println!("advisories are not checked: cargo-deny is missing; `cargo install cargo-deny --locked` installs it");
        return Ok(());
    }
    for workspace in WORKSPACES {
        let manifest = root().join(workspace).join("Cargo.toml");
        let mut deny = Command::new("cargo-deny");
        deny.arg("--manifest-path").arg(manifest).args(["check", "--config"]).arg(root().join("deny.toml"));
        run_command(&mut deny)?;
    }
    Ok(())
}

/// Licences and sources of everything that the lock files name.
pub fn check() -> Result<()> {
    let rules = std::fs::read_to_string(root().join("deny.toml")).context("cannot read deny.toml")?;
    let allowed = allowed(&rules)?;
    let allowed: Vec<&str> = allowed.iter().map(String::as_str).collect();
    for workspace in WORKSPACES {
        let packages = packages(&root().join(workspace))?;
        let mut wrong = Vec::new();
        for package in &packages {
            wrong.extend(fault(package, &allowed));
        }
        ensure!(wrong.is_empty(), "{workspace}: {}", wrong.join("; "));
        println!("{workspace}: licences and sources of {} packages are as deny.toml allows", packages.len());
    }
    Ok(())
}

/// The licences that deny.toml allows.
fn allowed(rules: &str) -> Result<Vec<String>> {
    let rules: toml::Table = rules.parse().context("deny.toml")?;
    let list = rules.get("licenses").and_then(|licenses| licenses.get("allow")).and_then(toml::Value::as_array);
    let list = list.context("deny.toml allows no licences")?;
    Ok(list.iter().filter_map(|name| name.as_str().map(String::from)).collect())
}

/// What cargo knows of every package that a workspace's lock file names.
fn packages(workspace: &Path) -> Result<Vec<Value>> {
    let mut metadata = Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
    metadata.current_dir(workspace).args(["metadata", "--locked", "--format-version", "1"]).stderr(Stdio::inherit());
    let output = metadata.output().context("cannot run cargo")?;
    if !output.status.success() {
        bail!("cargo metadata failed in {}", workspace.display());
    }
    let mut document: Value = serde_json::from_slice(&output.stdout)?;
    match document["packages"].take() {
        Value::Array(packages) => Ok(packages),
        _ => bail!("cargo metadata named no packages"),
    }
}

/// What is wrong with a package; nothing with those of this repository.
fn fault(package: &Value, allowed: &[&str]) -> Option<String> {
    let name = package["name"].as_str().unwrap_or_default();
    let source = package["source"].as_str()?;
    if source != "registry+https://github.com/rust-lang/crates.io-index" {
        return Some(format!("{name} comes from {source}"));
    }
    match package["license"].as_str() {
        Some(licence) if permits(licence, allowed) => None,
        Some(licence) => Some(format!("{name} is under {licence}")),
        None => Some(format!("{name} names no licence")),
    }
}

/// Whether a licence expression (SPDX; a slash is an old OR) can be met by allowed licences alone. What cannot be read
/// is not.
fn permits(expression: &str, allowed: &[&str]) -> bool {
    let spaced = expression.replace('/', " OR ").replace('(', " ( ").replace(')', " ) ");
    let mut words: Vec<&str> = spaced.split_whitespace().rev().collect();
    either(&mut words, allowed) == Some(true) && words.is_empty()
}

fn either(words: &mut Vec<&str>, allowed: &[&str]) -> Option<bool> {
    let mut met = both(words, allowed)?;
    while words.pop_if(|word| *word == "OR").is_some() {
        met |= both(words, allowed)?;
    }
    Some(met)
}

fn both(words: &mut Vec<&str>, allowed: &[&str]) -> Option<bool> {
    let mut met = one(words, allowed)?;
    while words.pop_if(|word| *word == "AND").is_some() {
        met &= one(words, allowed)?;
    }
    Some(met)
}

fn one(words: &mut Vec<&str>, allowed: &[&str]) -> Option<bool> {
    let word = words.pop()?;
    if word == "(" {
        let met = either(words, allowed)?;
        return (words.pop()? == ")").then_some(met);
    }
    if words.pop_if(|word| *word == "WITH").is_some() {
        let exception = words.pop()?;
        return Some(allowed.contains(&format!("{word} WITH {exception}").as_str()));
    }
    Some(allowed.contains(&word))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_licence_is_met_by_one_of_several_or_by_all_that_are_asked() {
        let allowed = ["MIT", "Unicode-3.0", "Apache-2.0 WITH LLVM-exception"];
        for met in ["MIT", "MIT OR GPL-3.0-only", "GPL-2.0/MIT", "(MIT OR Apache-2.0) AND Unicode-3.0"] {
            assert!(permits(met, &allowed), "{met}");
        }
        assert!(permits("Apache-2.0 WITH LLVM-exception", &allowed));
        for unmet in
            ["GPL-3.0-only", "Apache-2.0", "MIT AND GPL-2.0", "Apache-2.0 WITH other", "", "MIT MIT", "(MIT", "MIT OR"]
        {
            assert!(!permits(unmet, &allowed), "{unmet}");
        }
    }

    #[test]
    fn a_package_from_elsewhere_or_without_a_licence_is_named() {
        let package = |source: Option<&str>, licence: Option<&str>| serde_json::json!({ "name": "stray", "source": source, "license": licence });
        let registry = Some("registry+https://github.com/rust-lang/crates.io-index");
        assert_eq!(fault(&package(None, None), &["MIT"]), None);
        assert_eq!(fault(&package(registry, Some("MIT")), &["MIT"]), None);
        assert!(fault(&package(registry, None), &["MIT"]).is_some_and(|wrong| wrong.contains("stray")));
        assert!(fault(&package(registry, Some("GPL-2.0")), &["MIT"]).is_some());
        assert!(fault(&package(Some("git+https://example.org/stray"), Some("MIT")), &["MIT"]).is_some());
    }

    #[test]
    fn the_rules_can_be_read() {
        let rules = std::fs::read_to_string(root().join("deny.toml")).unwrap();
        assert!(allowed(&rules).unwrap().iter().any(|name| name == "MIT"));
        assert!(allowed("[licenses]").is_err());
    }
}
