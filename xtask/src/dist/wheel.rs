//! Makes the wheel: maturin builds the package in clients/python/, and the tool is added as a command.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context as _, Result, bail, ensure};

use super::{create_empty, licenses, make_portable};
use crate::paths::{root, target_directory};
use crate::python;
use crate::toolchain::run;

pub fn write_wheel(place: &Path, tool: &Path) -> Result<PathBuf> {
    let scratch = target_directory().join("wheel");
    let [built, inside] = ["built", "inside"].map(|name| scratch.join(name));
    create_empty(&built)?;
    create_empty(&inside)?;
    let python = python::with_build_tools(&scratch.join("environment"))?;
    let mut maturin = Command::new(&python);
    maturin.current_dir(root().join("clients/python")).args(["-m", "maturin", "build", "--release", "--locked"]);
    maturin.arg("--target-dir").arg(target_directory()).arg("--out").arg(&built);
    run(make_portable(&mut maturin))?;

    run(Command::new(&python).args(["-m", "wheel", "unpack", "--dest"]).arg(&inside).arg(only_entry(&built)?))?;
    let package = only_entry(&inside)?;
    let name = package.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let scripts = package.join(format!("{name}.data/scripts"));
    create_empty(&scripts)?;
    fs::copy(tool, scripts.join(tool.file_name().unwrap_or_default())).context("cannot copy the tool")?;
    let notices = package.join(format!("{name}.dist-info/licenses"));
    fs::create_dir_all(&notices).with_context(|| format!("cannot make {}", notices.display()))?;
    licenses::write_into(&notices)?;
    run(make_portable(Command::new(&python).args(["-m", "wheel", "pack", "--dest-dir"]).arg(place).arg(&package)))?;

    let wheel = place.join(only_entry(&built)?.file_name().unwrap_or_default());
    ensure!(wheel.exists(), "the tool changed the wheel's name");
    // maturin has checked the C library only for the package, not for the tool.
    check_c_library(&wheel.to_string_lossy(), &fs::read(tool)?)?;
    Ok(wheel)
}

fn only_entry(folder: &Path) -> Result<PathBuf> {
    let mut entries = fs::read_dir(folder).with_context(|| format!("cannot read {}", folder.display()))?;
    match (entries.next(), entries.next()) {
        (Some(entry), None) => Ok(entry?.path()),
        _ => bail!("{} must have exactly one entry", folder.display()),
    }
}

/// Checks that a program runs with the oldest C library that the name of the wheel allows (Linux only).
fn check_c_library(wheel: &str, program: &[u8]) -> Result<()> {
    if cfg!(target_os = "linux") {
        let tag = wheel.split("manylinux_2_").nth(1).and_then(|rest| rest.split('_').next()?.parse::<u32>().ok());
        let oldest = tag
            .with_context(|| format!("{wheel} names no version of the C library, so it does not run on every Linux"))?;
        let needed = needed_glibc(program);
        ensure!(needed <= oldest, "the tool needs glibc 2.{needed}, but the wheel's name allows 2.{oldest}");
    }
    Ok(())
}

/// Returns N of the newest version 2.N of the C library that a program needs, from its symbol versions.
fn needed_glibc(program: &[u8]) -> u32 {
    let name = b"GLIBC_2.";
    let places = program.windows(name.len()).enumerate().filter(|(_, window)| window == name);
    let number = |(at, _): (usize, _)| {
        let digits = program[at + name.len()..].iter().take_while(|byte| byte.is_ascii_digit());
        digits.take(4).fold(0, |number, digit| 10 * number + u32::from(digit - b'0'))
    };
    places.map(number).max().unwrap_or(0)
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use super::*;

    #[test]
    fn a_wheel_for_an_older_c_library_than_needed_is_refused() {
        let program = b"\x7fELF..GLIBC_2.2.5\0GLIBC_2.34\0GLIBC_2.17\0";
        assert_eq!(needed_glibc(program), 34);
        assert!(check_c_library("a-0.1.0-cp311-abi3-manylinux_2_34_x86_64.whl", program).is_ok());
        for name in ["a-0.1.0-cp311-abi3-manylinux_2_28_x86_64.whl", "a-0.1.0-cp311-abi3-linux_x86_64.whl"] {
            assert!(check_c_library(name, program).is_err(), "{name}");
        }
    }
}
