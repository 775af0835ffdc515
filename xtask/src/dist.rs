//! Release files for users without a compiler, for this kind of computer: an archive of the tool with its files, a
//! wheel for Python that also contains the tool, and their checksums. The files contain no paths or times of this
//! computer.

mod archive;
mod check;
mod licenses;
mod wheel;

use std::env;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Instant;

use anyhow::{Context as _, Result, ensure};

pub use check::check;

use crate::paths::{root, target_directory};
use crate::toolchain::{cargo, host, run, rust_flags};
use crate::tools::{self, Tool};
use crate::{images, playground};

/// Time stamp of every file in archive and wheel, s since 1970: 1980-01-01, the earliest time that a wheel can store.
const FILE_TIME: u64 = 315_532_800;

pub struct ReleaseFiles {
    pub archive: PathBuf,
    pub wheel: PathBuf,
}

/// Builds tool, firmware, page and wheel, and writes the release files into an empty target/dist.
pub fn make() -> Result<ReleaseFiles> {
    tools::check(&[Tool::Chip, Tool::Browsers, Tool::Python])?;
    let version = version()?;
    images::build_all()?;
    let page = playground::build()?;
    let began = Instant::now();
    run(make_portable(cargo().current_dir(root()).args(["build", "--release", "--locked", "--package", "haptic"])))?;
    let tool = target_directory().join("release").join(format!("haptic{}", env::consts::EXE_SUFFIX));
    println!("{}: {}, built in {} s", tool.display(), megabytes(&tool)?, began.elapsed().as_secs());

    let place = target_directory().join("dist");
    create_empty(&place)?;
    let archive = archive::write_archive(&place, &format!("haptic-{version}-{}", host()?), &tool, &page)?;
    let wheel = wheel::write_wheel(&place, &tool)?;
    let mut sums = String::new();
    for file in [&archive, &wheel] {
        let bytes = fs::read(file).with_context(|| format!("cannot read {}", file.display()))?;
        let name = file.file_name().unwrap_or_default().display();
        sums += &format!("{}  {name}\n", images::sha256(&bytes));
        println!("{}: {}", file.display(), megabytes(file)?);
    }
    write(&place.join("SHA256SUMS"), sums.as_bytes())?;
    Ok(ReleaseFiles { archive, wheel })
}

/// Makes the result of a build independent of the computer and the day.
fn make_portable(command: &mut Command) -> &mut Command {
    command.env("CARGO_ENCODED_RUSTFLAGS", rust_flags().join("\x1f")).env("SOURCE_DATE_EPOCH", FILE_TIME.to_string())
}

/// Returns the version of tool, wheel and firmware, which are released together.
fn version() -> Result<String> {
    let version = images::declared_version("Cargo.toml", &["workspace", "package"])?;
    for (path, table) in [("firmware/Cargo.toml", "package"), ("clients/python/pyproject.toml", "project")] {
        let other = images::declared_version(path, &[table])?;
        ensure!(other == version, "{path} has version {other}, the workspace {version}: they are released together");
    }
    Ok(version)
}

fn megabytes(file: &Path) -> Result<String> {
    let bytes = fs::metadata(file).with_context(|| format!("cannot read {}", file.display()))?.len();
    Ok(format!("{:.1} MB", 1e-6 * bytes as f64))
}

fn create_empty(folder: &Path) -> Result<()> {
    if folder.exists() {
        fs::remove_dir_all(folder).with_context(|| format!("cannot empty {}", folder.display()))?;
    }
    fs::create_dir_all(folder).with_context(|| format!("cannot make {}", folder.display()))
}

fn write(path: &Path, bytes: &[u8]) -> Result<()> {
    fs::write(path, bytes).with_context(|| format!("cannot write {}", path.display()))
}

fn output(command: &mut Command) -> Result<String> {
    let name = command.get_program().display().to_string();
    let output = command.output().with_context(|| format!("cannot run {name}"))?;
    ensure!(output.status.success(), "{name}: {}", String::from_utf8_lossy(&output.stderr).trim());
    String::from_utf8(output.stdout).with_context(|| format!("{name}: its output is not UTF-8"))
}

#[cfg(test)]
mod tests {
    #[test]
    fn tool_wheel_and_firmware_have_the_same_version() {
        super::version().unwrap();
    }
}
