//! Tests the Python package in a separate virtual environment.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context as _, Result};
use serde::Deserialize;

use crate::paths::{root, target_directory};
use crate::toolchain::{cargo, run};
use crate::tools::{self, Tool};

/// The parts of clients/python/pyproject.toml that this program uses.
#[derive(Deserialize)]
struct Manifest {
    #[serde(rename = "build-system")]
    build: Build,
    project: Project,
}

#[derive(Deserialize)]
struct Build {
    requires: Vec<String>,
}

#[derive(Deserialize)]
struct Project {
    dependencies: Vec<String>,
    #[serde(rename = "optional-dependencies")]
    optional: OptionalRequirements,
}

/// Requirements of the tests, and packages for comparisons.
#[derive(Deserialize)]
struct OptionalRequirements {
    test: Vec<String>,
    peers: Vec<String>,
}

/// Runs the tests of clients/python/; further arguments go to pytest.
pub fn test(arguments: &[String]) -> Result<()> {
    tools::check(&[Tool::Python])?;
    let package = root().join("clients/python");
    // Uses one cargo call, so that the library is built only once.
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
    let requirements = [project.dependencies, project.optional.test, project.optional.peers].concat();
    let python = environment(&place.join("environment"), &requirements)?;
    let mut tests = Command::new(python);
    tests.current_dir(&package).env("PYTHONPATH", &place).env("PYTHONDONTWRITEBYTECODE", "1");
    tests.env("HAPTIC_TOOL", built.join("haptic"));
    run(tests.args(["-m", "pytest", "-q", "-p", "no:cacheprovider"]).args(arguments))
}

fn manifest() -> Result<Manifest> {
    let text = fs::read_to_string(root().join("clients/python/pyproject.toml"))?;
    toml::from_str(&text).context("clients/python/pyproject.toml")
}

/// Returns an interpreter with the build requirements of the package and the `wheel` program.
pub fn with_build_tools(place: &Path) -> Result<PathBuf> {
    environment(place, &[manifest()?.build.requires, vec!["wheel>=0.45,<1".into()]].concat())
}

/// Returns an interpreter with exactly these packages. The environment is created again if the list has changed.
pub fn environment(place: &Path, requirements: &[String]) -> Result<PathBuf> {
    let python = place.join(if cfg!(windows) { "Scripts/python.exe" } else { "bin/python" });
    let note = place.join("wanted");
    if fs::read_to_string(&note).is_ok_and(|present| present == requirements.join("\n")) {
        return Ok(python);
    }
    run(Command::new("python3").args(["-m", "venv", "--clear"]).arg(place))?;
    run(Command::new(&python)
        .args(["-m", "pip", "install", "--quiet", "--disable-pip-version-check"])
        .args(requirements))?;
    fs::write(note, requirements.join("\n"))?;
    Ok(python)
}
