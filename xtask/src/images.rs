//! Makes the images that the tool contains: update files, each with a file of its version, protocol and SHA-256. The
//! next build of the tool includes the images that `cargo xtask images` has made.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context as _, Result, bail, ensure};
use sha2::{Digest as _, Sha256};

use crate::dfu;
use crate::firmware::{BOARDS, build};
use crate::image::Image;
use crate::paths::{root, target_directory};
use crate::toolchain::run;

/// Folder from which crates/flash/build.rs reads the images, relative to the root.
const IMAGES_FOLDER: &str = "crates/flash/images";

/// Builds every image and writes it into crates/flash/images.
pub fn build_all() -> Result<()> {
    let place = root().join(IMAGES_FOLDER);
    fs::create_dir_all(&place).with_context(|| format!("cannot make {}", place.display()))?;
    let (version, protocol) = (version()?, protocol()?);
    for board in BOARDS {
        let image = Image::read(&build(board)?)?;
        let file = dfu::file(&image.segments, board);
        let sum = sha256(&file);
        write(&place.join(board).with_extension("dfu"), &file)?;
        let about = format!("version = {version:?}\nprotocol = {protocol}\nsha256 = {sum:?}\n");
        write(&place.join(board).with_extension("toml"), about.as_bytes())?;
        println!("{board}: {} bytes, version {version}, protocol {protocol}, SHA-256 {sum}", file.len());
    }
    println!("a build of the tool now includes them: cargo build --release --package haptic");
    Ok(())
}

fn write(path: &Path, bytes: &[u8]) -> Result<()> {
    // Does not write an unchanged file, whose time stamp would cause a build of the tool.
    if fs::read(path).is_ok_and(|present| present == bytes) {
        return Ok(());
    }
    fs::write(path, bytes).with_context(|| format!("cannot write {}", path.display()))
}

pub fn sha256(bytes: &[u8]) -> String {
    Sha256::digest(bytes).iter().map(|byte| format!("{byte:02x}")).collect()
}

fn version() -> Result<String> {
    declared_version("firmware/Cargo.toml", &["package"])
}

/// Reads the version from a table of a manifest. `path` is relative to the root.
pub fn declared_version(path: &str, table: &[&str]) -> Result<String> {
    let text = fs::read_to_string(root().join(path)).with_context(|| format!("cannot read {path}"))?;
    let manifest: toml::Value = toml::from_str(&text).with_context(|| format!("bad manifest {path}"))?;
    let found = table.iter().chain(&["version"]).try_fold(&manifest, |value, key| value.get(*key));
    Ok(found.and_then(toml::Value::as_str).with_context(|| format!("{path} has no version"))?.into())
}

/// Reads the version of the protocol from the library's source.
fn protocol() -> Result<u16> {
    let path = root().join("src/board/protocol.rs");
    let text = fs::read_to_string(&path).with_context(|| format!("cannot read {}", path.display()))?;
    let number = text.lines().find_map(|line| line.strip_prefix("pub const PROTOCOL: u16 = ")?.strip_suffix(';'));
    number.and_then(|number| number.parse().ok()).with_context(|| format!("{} has no PROTOCOL", path.display()))
}

/// Builds this commit's images in two clean checkouts at paths of different lengths. Fails if a byte differs.
pub fn compare_checkouts() -> Result<()> {
    let place = target_directory().join("twice");
    if place.exists() {
        fs::remove_dir_all(&place).with_context(|| format!("cannot remove {}", place.display()))?;
    }
    let checkouts = [place.join("a"), place.join("a-longer-name/and-deeper/b")];
    for checkout in &checkouts {
        run(Command::new("git").args(["clone", "--quiet", "--no-local"]).arg(root()).arg(checkout))?;
        let mut command = Command::new("cargo");
        command.args(["run", "--quiet", "--locked", "--package", "xtask", "--", "images"]);
        command.current_dir(checkout).env("CARGO_TARGET_DIR", checkout.join("target"));
        run(&mut command)?;
    }
    let images = |checkout: &PathBuf, board: &str| {
        let path = checkout.join(IMAGES_FOLDER).join(board).with_extension("dfu");
        fs::read(&path).with_context(|| format!("cannot read {}", path.display()))
    };
    for board in BOARDS {
        let (one, other) = (images(&checkouts[0], board)?, images(&checkouts[1], board)?);
        ensure!(!one.is_empty(), "{board}: an empty image");
        if let Some(at) = one.iter().zip(&other).position(|(one, other)| one != other) {
            bail!(
                "{board}: byte {at} of the update file differs between {} and {}",
                checkouts[0].display(),
                checkouts[1].display()
            );
        }
        ensure!(one.len() == other.len(), "{board}: the images have {} and {} bytes", one.len(), other.len());
        println!("{board}: both images are equal, SHA-256 {}", sha256(&one));
    }
    fs::remove_dir_all(&place).with_context(|| format!("cannot remove {}", place.display()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn version_and_protocol_are_found_in_the_sources() {
        assert!(version().unwrap().split('.').count() == 3);
        assert!(protocol().unwrap() >= 10);
    }

    #[test]
    fn the_sha256_agrees_with_its_standard() {
        // The example "abc" of FIPS 180-4.
        assert_eq!(sha256(b"abc"), "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
    }
}
