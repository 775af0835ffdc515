//! What tests of both runs need: the files that ship, and the tool as a person types it.
#![allow(dead_code, unused_imports, reason = "every run uses its own part")]

pub mod bodies;
#[cfg(unix)]
pub mod documents;
pub mod domains;
pub mod drawn;
pub mod forces;
pub mod lies;
pub mod page;
pub mod sim;
pub mod socket;
pub mod strict;
pub mod tuned;

use assert_cmd::Command;
use haptic_host::device_file::DeviceFile;
use serde_json::Value;
use std::path::{Path, PathBuf};

/// The repository.
pub fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..").canonicalize().unwrap()
}

/// A file that ships, by its path in devices/.
pub fn file(name: &str) -> String {
    root().join("devices").join(name).display().to_string()
}

/// The device and scene files in a folder of devices/.
pub fn files(folder: &str) -> Vec<PathBuf> {
    let mut files: Vec<_> = std::fs::read_dir(file(folder)).unwrap().map(|entry| entry.unwrap().path()).collect();
    files.retain(|path| path.extension().is_some_and(|extension| extension == "toml"));
    files.sort();
    files
}

/// A device that ships.
pub fn shipped(name: &str) -> DeviceFile {
    DeviceFile::load(file(&format!("{name}.toml"))).unwrap()
}

/// Every device that ships.
pub fn all_shipped() -> Vec<DeviceFile> {
    files("").into_iter().map(|path| DeviceFile::load(path).unwrap()).collect()
}

/// The tool, with these arguments, in the repository.
pub fn haptic(arguments: &[&str]) -> Command {
    let mut command = Command::cargo_bin("haptic").unwrap();
    command.current_dir(root()).args(arguments).env_remove("HAPTIC_PORT");
    command
}

/// The document that it prints.
pub fn json(arguments: &[&str]) -> Value {
    serde_json::from_slice(&haptic(arguments).arg("--json").assert().success().get_output().stdout).unwrap()
}

/// Sends a signal to a process, by the name that a shell's own `kill` gives it: the program `kill` is not everywhere.
pub fn signal(child: &std::process::Child, name: &str) {
    let line = format!("kill -{name} {}", child.id());
    assert!(std::process::Command::new("sh").args(["-c", &line]).status().unwrap().success());
}
