//! The licenses of all crates that are linked into the release files, which must be distributed with them.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;

use anyhow::{Context as _, Result, ensure};
use serde_json::Value;

use super::{output, write};
use crate::paths::root;
use crate::toolchain::{BROWSERS, TARGET, cargo, host};

/// Writes the licenses of this project and of all dependencies into a folder.
pub fn write_into(folder: &Path) -> Result<()> {
    for name in ["LICENSE-MIT", "LICENSE-APACHE"] {
        fs::copy(root().join(name), folder.join(name)).with_context(|| format!("cannot copy {name}"))?;
    }
    write(&folder.join("LICENSES-OTHERS.txt"), dependency_licenses()?.as_bytes())
}

fn dependency_licenses() -> Result<String> {
    let mut crates = linked_crates("Cargo.toml", &["haptic", "haptic-python"], &host()?)?;
    crates.extend(linked_crates("Cargo.toml", &["haptic-page"], BROWSERS)?);
    crates.extend(linked_crates("firmware/Cargo.toml", &["haptic-firmware"], TARGET)?);
    let mut list = String::from(
        "The tool, the firmware images in it, the page and the library for Python contain the crates below, each under\n\
         its own license, and Rust's standard library (MIT or Apache-2.0, https://github.com/rust-lang/rust).\n\
         Their unchanged sources: https://crates.io/crates/NAME/VERSION\n\n",
    );
    let mut texts: BTreeMap<String, Vec<String>> = BTreeMap::new();
    for Crate { name, license, repository, texts: own } in crates {
        list += &format!("{name}: {license}; {repository}\n");
        for text in own {
            texts.entry(text).or_default().push(name.clone());
        }
    }
    ensure!(texts.len() > 10, "the crates' license files were not found");
    for (text, names) in texts {
        list += &format!("\n{}\n{}\n\n{}\n", "-".repeat(80), names.join(", "), text.trim_end());
    }
    Ok(list)
}

#[derive(PartialEq, Eq, PartialOrd, Ord)]
struct Crate {
    name: String,
    license: String,
    repository: String,
    texts: Vec<String>,
}

/// Returns the crates of other projects that are linked into packages.
fn linked_crates(manifest: &str, packages: &[&str], target: &str) -> Result<BTreeSet<Crate>> {
    let mut command = cargo();
    command.args(["metadata", "--locked", "--format-version", "1", "--filter-platform", target, "--manifest-path"]);
    let metadata: Value =
        serde_json::from_str(&output(command.arg(root().join(manifest)))?).context("cargo metadata")?;
    let text = |value: &Value| value.as_str().unwrap_or_default().to_owned();
    let all = |value: &'_ Value| value.as_array().cloned().unwrap_or_default();
    let (all_packages, nodes) = (all(&metadata["packages"]), all(&metadata["resolve"]["nodes"]));
    // Packages of this repository have no source in the metadata.
    let ours = all_packages.iter().filter(|package| package["source"].is_null());
    let ours = ours.filter(|package| packages.iter().any(|name| package["name"] == *name));
    let mut open: Vec<String> = ours.map(|package| text(&package["id"])).collect();
    ensure!(open.len() == packages.len(), "{manifest} does not have all of {}", packages.join(", "));
    let mut seen = BTreeSet::new();
    while let Some(id) = open.pop() {
        let needs = nodes.iter().filter(|node| node["id"] == id.as_str()).flat_map(|node| all(&node["deps"]));
        // The kind of a linked dependency is null, other kinds are `dev` and `build`.
        let linked = needs.filter(|need| all(&need["dep_kinds"]).iter().any(|kind| kind["kind"].is_null()));
        let linked: Vec<String> = linked.map(|need| text(&need["pkg"])).collect();
        if seen.insert(id) {
            open.extend(linked);
        }
    }
    let others = all_packages.iter().filter(|package| !package["source"].is_null());
    others
        .filter(|package| seen.contains(&text(&package["id"])))
        .map(|package| {
            let name = format!("{} {}", text(&package["name"]), text(&package["version"]));
            let license = package["license"].as_str().with_context(|| format!("{name} names no license"))?.to_owned();
            let texts = texts(Path::new(&text(&package["manifest_path"])))?;
            Ok(Crate { name, license, repository: text(&package["repository"]), texts })
        })
        .collect()
}

fn texts(manifest: &Path) -> Result<Vec<String>> {
    let folder = manifest.parent().context("the manifest's path has no folder")?;
    let mut found = Vec::new();
    for entry in fs::read_dir(folder).with_context(|| format!("cannot read {}", folder.display()))? {
        let path = entry?.path();
        let name = path.file_name().unwrap_or_default().to_string_lossy().to_uppercase();
        if path.is_file() && ["LICENSE", "LICENCE", "COPYING", "NOTICE"].iter().any(|begin| name.starts_with(begin)) {
            found.push(String::from_utf8_lossy(&fs::read(&path)?).replace("\r\n", "\n"));
        }
    }
    found.sort();
    Ok(found)
}
