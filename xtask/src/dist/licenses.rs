//! The licenses of all crates that are linked into the release files, which must be distributed with them.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;

use anyhow::{Context as _, Result, ensure};
use serde::Deserialize;

use super::{output, write};
use crate::paths::root;
use crate::toolchain::{BROWSERS, TARGET, cargo, host};

/// Output of `cargo metadata`.
#[derive(Deserialize)]
struct Metadata {
    packages: Vec<Package>,
    resolve: Resolve,
}

#[derive(Deserialize)]
struct Package {
    id: String,
    name: String,
    version: String,
    license: Option<String>,
    repository: Option<String>,
    manifest_path: String,
    /// Registry of the package; `None` for packages of this repository.
    source: Option<String>,
}

#[derive(Deserialize)]
struct Resolve {
    nodes: Vec<Node>,
}

#[derive(Deserialize)]
struct Node {
    id: String,
    deps: Vec<Dependency>,
}

#[derive(Deserialize)]
struct Dependency {
    pkg: String,
    dep_kinds: Vec<Kind>,
}

/// Kind of a dependency: null if it is linked, otherwise `dev` or `build`.
#[derive(Deserialize)]
struct Kind {
    kind: Option<String>,
}

/// Writes the licenses of this project and of all dependencies into a folder.
pub fn write_into(folder: &Path) -> Result<()> {
    for name in ["LICENSE-MIT", "LICENSE-APACHE"] {
        fs::copy(root().join(name), folder.join(name)).with_context(|| format!("cannot copy {name}"))?;
    }
    write(&folder.join("LICENSES-OTHERS.txt"), dependency_licenses()?.as_bytes())
}

/// Returns the license texts, each with the names of its crates.
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

/// A crate with its licenses.
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
    let metadata: Metadata =
        serde_json::from_str(&output(command.arg(root().join(manifest)))?).context("cargo metadata")?;
    let nodes: BTreeMap<&str, &Node> = metadata.resolve.nodes.iter().map(|node| (node.id.as_str(), node)).collect();
    let ours = |found: &&Package| found.source.is_none() && packages.contains(&found.name.as_str());
    let mut open: Vec<&str> = metadata.packages.iter().filter(ours).map(|found| found.id.as_str()).collect();
    ensure!(open.len() == packages.len(), "{manifest} does not have all of {}", packages.join(", "));
    let mut seen = BTreeSet::new();
    while let Some(id) = open.pop() {
        if seen.insert(id) {
            let needs = nodes.get(id).into_iter().flat_map(|node| &node.deps);
            let needs = needs.filter(|need| need.dep_kinds.iter().any(|kind| kind.kind.is_none()));
            open.extend(needs.map(|need| need.pkg.as_str()));
        }
    }
    let others = metadata.packages.iter().filter(|found| found.source.is_some() && seen.contains(found.id.as_str()));
    others
        .map(|found| {
            let name = format!("{} {}", found.name, found.version);
            let license = found.license.clone().with_context(|| format!("{name} names no license"))?;
            let repository = found.repository.clone().unwrap_or_default();
            Ok(Crate { name, license, repository, texts: texts(Path::new(&found.manifest_path))? })
        })
        .collect()
}

/// Reads the license files in the folder of a manifest.
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
