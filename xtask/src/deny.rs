//! What may be linked: deny.toml, for every workspace here. Licences, sources and advisories are checked by this file
//! from what cargo knows and xtask/advisories.toml says, which takes seconds and no network; the advisories of the day
//! and the rest by cargo-deny, where it is installed.

use std::path::Path;
use std::process::{Command, Stdio};

use anyhow::{Context as _, Result, ensure};
use semver::{Version, VersionReq};
use serde::Deserialize;
use serde::de::DeserializeOwned;

use crate::paths::root;
use crate::toolchain::{cargo, run as run_command};

/// Where every dependency comes from, as cargo names it.
const REGISTRY: &str = "registry+https://github.com/rust-lang/crates.io-index";

const WORKSPACES: [&str; 3] = [".", "firmware", "fuzz"];

/// Licences, sources and known advisories, then cargo-deny or how to get it.
pub fn run() -> Result<()> {
    check()?;
    let there = Command::new("cargo-deny").arg("--version").stdout(Stdio::null()).status();
    if !there.is_ok_and(|status| status.success()) {
        println!("newer advisories are not checked: `cargo install cargo-deny --locked` installs what knows them");
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

/// Licences, sources and known advisories of everything that the lock files name.
pub fn check() -> Result<()> {
    let rules: Rules = read("deny.toml")?;
    let database: Database = read("xtask/advisories.toml")?;
    for workspace in WORKSPACES {
        let packages = packages(&root().join(workspace))?;
        let mut wrong = Vec::new();
        for package in &packages {
            wrong.extend(rules.fault(package));
            wrong.extend(database.faults(package, &rules.advisories.ignore));
        }
        ensure!(wrong.is_empty(), "{workspace}: {}", wrong.join("; "));
        println!(
            "{workspace}: licences, sources and advisories until {} of {} packages are as deny.toml allows",
            database.until,
            packages.len()
        );
    }
    Ok(())
}

fn read<T: DeserializeOwned>(name: &str) -> Result<T> {
    let text = std::fs::read_to_string(root().join(name)).with_context(|| format!("cannot read {name}"))?;
    toml::from_str(&text).with_context(|| name.to_owned())
}

/// The parts of deny.toml that are used here.
#[derive(Deserialize)]
struct Rules {
    licenses: Licenses,
    advisories: Ignored,
}

#[derive(Deserialize)]
struct Licenses {
    allow: Vec<String>,
}

#[derive(Deserialize)]
struct Ignored {
    ignore: Vec<Exception>,
}

/// An advisory that is known and does not stop us.
#[derive(Deserialize)]
struct Exception {
    id: String,
}

/// advisories.toml.
#[derive(Deserialize)]
struct Database {
    until: toml::value::Datetime,
    crates: Vec<String>,
    advisory: Vec<Advisory>,
}

#[derive(Deserialize)]
struct Advisory {
    id: String,
    package: String,
    title: String,
    /// Versions that it does not concern.
    sound: Vec<VersionReq>,
}

/// A package that a lock file names, as `cargo metadata` tells.
#[derive(Deserialize)]
struct Package {
    name: String,
    version: Version,
    /// Where it comes from; nothing for those of this repository.
    source: Option<String>,
    license: Option<String>,
}

impl Database {
    /// What is known against a package and not among the exceptions; that it was not looked up is also against it.
    /// Nothing with those of this repository.
    fn faults(&self, package: &Package, ignored: &[Exception]) -> Vec<String> {
        let Package { name, version, source, .. } = package;
        if source.is_none() {
            return Vec::new();
        }
        if !self.crates.contains(name) {
            return vec![format!("{name} is not in xtask/advisories.toml, which says how it gets there")];
        }
        let known = self.advisory.iter().filter(|advisory| {
            advisory.package == *name
                && !advisory.sound.iter().any(|versions| versions.matches(version))
                && !ignored.iter().any(|exception| exception.id == advisory.id)
        });
        known.map(|advisory| format!("{name} {version}: {} ({})", advisory.title, advisory.id)).collect()
    }
}

/// What cargo knows of every package that a workspace's lock file names.
fn packages(workspace: &Path) -> Result<Vec<Package>> {
    #[derive(Deserialize)]
    struct Metadata {
        packages: Vec<Package>,
    }
    let mut metadata = cargo();
    metadata.current_dir(workspace).args(["metadata", "--locked", "--format-version", "1"]).stderr(Stdio::inherit());
    let output = metadata.output().context("cannot run cargo")?;
    ensure!(output.status.success(), "cargo metadata failed in {}", workspace.display());
    Ok(serde_json::from_slice::<Metadata>(&output.stdout)?.packages)
}

impl Rules {
    /// What is wrong with where a package comes from or with its licence; nothing with those of this repository.
    fn fault(&self, package: &Package) -> Option<String> {
        let name = &package.name;
        let source = package.source.as_deref()?;
        if source != REGISTRY {
            return Some(format!("{name} comes from {source}"));
        }
        match package.license.as_deref() {
            Some(licence) if permits(licence, &self.licenses.allow) => None,
            Some(licence) => Some(format!("{name} is under {licence}")),
            None => Some(format!("{name} names no licence")),
        }
    }
}

/// Whether a licence expression (SPDX; a slash is an old OR) can be met by allowed licences alone. What cannot be read
/// is not.
fn permits(expression: &str, allowed: &[String]) -> bool {
    let spaced = expression.replace('/', " OR ").replace('(', " ( ").replace(')', " ) ");
    let mut words: Vec<&str> = spaced.split_whitespace().rev().collect();
    either(&mut words, allowed) == Some(true) && words.is_empty()
}

fn either(words: &mut Vec<&str>, allowed: &[String]) -> Option<bool> {
    let mut met = both(words, allowed)?;
    while words.pop_if(|word| *word == "OR").is_some() {
        met |= both(words, allowed)?;
    }
    Some(met)
}

fn both(words: &mut Vec<&str>, allowed: &[String]) -> Option<bool> {
    let mut met = one(words, allowed)?;
    while words.pop_if(|word| *word == "AND").is_some() {
        met &= one(words, allowed)?;
    }
    Some(met)
}

fn one(words: &mut Vec<&str>, allowed: &[String]) -> Option<bool> {
    let word = words.pop()?;
    if word == "(" {
        let met = either(words, allowed)?;
        return (words.pop()? == ")").then_some(met);
    }
    if words.pop_if(|word| *word == "WITH").is_some() {
        let exception = words.pop()?;
        return Some(allowed.contains(&format!("{word} WITH {exception}")));
    }
    Some(allowed.iter().any(|name| name == word))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_licence_is_met_by_one_of_several_or_by_all_that_are_asked() {
        let allowed = ["MIT", "Unicode-3.0", "Apache-2.0 WITH LLVM-exception"].map(String::from);
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

    fn package(source: Option<&str>, license: Option<&str>) -> Package {
        Package {
            name: "stray".into(),
            version: Version::new(1, 2, 3),
            source: source.map(String::from),
            license: license.map(String::from),
        }
    }

    #[test]
    fn a_package_from_elsewhere_or_without_a_licence_is_named() {
        let rules: Rules = toml::from_str("licenses.allow = [\"MIT\"]\nadvisories.ignore = []").unwrap();
        assert_eq!(rules.fault(&package(None, None)), None);
        assert_eq!(rules.fault(&package(Some(REGISTRY), Some("MIT"))), None);
        assert!(rules.fault(&package(Some(REGISTRY), None)).is_some_and(|wrong| wrong.contains("stray")));
        assert!(rules.fault(&package(Some(REGISTRY), Some("GPL-2.0"))).is_some());
        assert!(rules.fault(&package(Some("git+https://example.org/stray"), Some("MIT"))).is_some());
    }

    #[test]
    fn a_version_that_an_advisory_concerns_is_named_unless_it_is_an_exception() {
        let database = |crates: &str, sound: &str| -> Database {
            let advisory = format!("id = \"R-1\"\npackage = \"stray\"\ntitle = \"bites\"\nsound = [{sound}]");
            toml::from_str(&format!("until = 2026-01-01\ncrates = [{crates}]\n[[advisory]]\n{advisory}")).unwrap()
        };
        let stray = package(Some(REGISTRY), Some("MIT"));
        let exception = [Exception { id: "R-1".into() }];
        for sound in ["\">= 1.2.3\"", "\"< 1.0.0\", \">= 1.2.0, < 2.0.0\"", "\"^1.1\""] {
            assert!(database("\"stray\"", sound).faults(&stray, &[]).is_empty(), "{sound}");
        }
        for sound in ["", "\">= 1.2.4\"", "\"< 1.0.0\", \">= 2.0.0\""] {
            let database = database("\"stray\"", sound);
            assert_eq!(database.faults(&stray, &[]), ["stray 1.2.3: bites (R-1)"], "{sound}");
            assert!(database.faults(&stray, &exception).is_empty());
        }
        assert!(database("\"other\"", "\">= 1.0.0\"").faults(&stray, &[])[0].contains("not in"));
        assert!(database("\"other\"", "").faults(&package(None, None), &[]).is_empty());
    }

    #[test]
    fn the_rules_and_the_advisories_can_be_read() {
        let rules: Rules = read("deny.toml").unwrap();
        assert!(rules.licenses.allow.iter().any(|name| name == "MIT"));
        assert!(toml::from_str::<Rules>("[licenses]\n[advisories]\nignore = []").is_err());
        let database: Database = read("xtask/advisories.toml").unwrap();
        assert!(database.advisory.iter().all(|advisory| database.crates.contains(&advisory.package)));
        for exception in &rules.advisories.ignore {
            assert!(database.advisory.iter().any(|advisory| advisory.id == exception.id), "{}", exception.id);
        }
    }
}
