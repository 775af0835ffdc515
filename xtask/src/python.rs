//! The package for Python: built as the tests are, and tried in an environment of its own.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context as _, Result};
use serde::Deserialize;

use crate::paths::{root, target_directory};
use crate::toolchain::{Use, cargo, run};
use crate::tools;

/// The parts of clients/python/pyproject.toml that are used here.
#[derive(Deserialize)]
struct Manifest {
    #[serde(rename = "build-system")]
    build: Build,
    project: Project,
}

/// What builds the package.
#[derive(Deserialize)]
struct Build {
    requires: Vec<String>,
}

#[derive(Deserialize)]
struct Project {
    dependencies: Vec<String>,
    #[serde(rename = "optional-dependencies")]
    optional: Optional,
}

/// pytest, and what the package is held against.
#[derive(Deserialize)]
struct Optional {
    test: Vec<String>,
    peers: Vec<String>,
}

/// Runs the tests of clients/python/; further arguments go to pytest.
pub fn test(arguments: &[String]) -> Result<()> {
    tools::provide(&[Use::Python])?;
    let package = root().join("python");
    // Together, so that the library is built once.
    run(cargo().current_dir(root()).args(["build", "--locked", "--package", "haptic", "--package", "haptic-python"]))?;
    let built = target_directory().join("debug");
    let place = target_directory().join("python");
    let inside = place.join("haptic_bridge");
    fs::create_dir_all(&inside)?;
    for entry in fs::read_dir(package.join("package/haptic_bridge"))? {
        let path = entry?.path();
        if let (true, Some(name)) = (path.is_file(), path.file_name()) {
            fs::copy(&path, inside.join(name))?;
        }
    }
    fs::copy(built.join("lib_native.so"), inside.join("_native.abi3.so")).context("no lib_native.so")?;
    let project = manifest()?.project;
    let wanted = [project.dependencies, project.optional.test, project.optional.peers].concat();
    let python = environment(&place.join("environment"), &wanted)?;
    let mut tests = Command::new(python);
    tests.current_dir(&package).env("PYTHONPATH", &place).env("PYTHONDONTWRITEBYTECODE", "1");
    tests.env("HAPTIC_TOOL", built.join("haptic"));
    run(tests.args(["-m", "pytest", "-q", "-p", "no:cacheprovider"]).args(arguments))
}

fn manifest() -> Result<Manifest> {
    let text = fs::read_to_string(root().join("clients/python/pyproject.toml"))?;
    toml::from_str(&text).context("clients/python/pyproject.toml")
}

/// Returns an interpreter with what builds the package, and what opens and closes wheels.
pub fn with_build_tools(place: &Path) -> Result<PathBuf> {
    environment(place, &[manifest()?.build.requires, vec!["wheel>=0.45,<1".into()]].concat())
}

/// Returns an interpreter with these packages and no other; it is set up again when they have changed.
pub fn environment(place: &Path, wanted: &[String]) -> Result<PathBuf> {
    let python = place.join(if cfg!(windows) { "Scripts/python.exe" } else { "bin/python" });
    let note = place.join("wanted");
    if fs::read_to_string(&note).is_ok_and(|had| had == wanted.join("\n")) {
        return Ok(python);
    }
    run(Command::new("python3").args(["-m", "venv", "--clear"]).arg(place))?;
    run(Command::new(&python).args(["-m", "pip", "install", "--quiet", "--disable-pip-version-check"]).args(wanted))?;
    fs::write(note, wanted.join("\n"))?;
    Ok(python)
}
