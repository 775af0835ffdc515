//! Undefined behaviour, which only the `unsafe` of dependencies could bring into library and tool: they have none.

use std::process::Command;

use anyhow::{Result, bail};

use crate::paths;
use crate::toolchain::{cargo, host, run};

/// The library's tests under the address sanitizer, which watches memory. The switch is one of the compiler's unstable
/// ones. Further arguments go to `cargo test`.
pub fn sanitize(arguments: &[String]) -> Result<()> {
    let mut test = cargo();
    test.current_dir(paths::root()).args(["test", "--locked", "--package", "haptic-bridge", "--lib", "--tests"]);
    // A directory of its own, because everything is compiled again; with a target named, the flag does not reach build
    // scripts.
    test.args(["--target", &host()?, "--target-dir"]).arg(paths::target_directory().join("sanitize"));
    test.env("RUSTC_BOOTSTRAP", "1").env("RUSTFLAGS", "-Zsanitizer=address").env_remove("CARGO_ENCODED_RUSTFLAGS");
    run(test.args(arguments))
}

/// The tests under Miri, which is a thousand times slower than the processor: test files, and the beginnings of the
/// names of their tests; an empty list means all. Double precision is not among them: on a PC it goes through assembly,
/// which Miri does not read.
const UNDER_MIRI: [(&str, &[&str]); 4] = [
    (
        "settings",
        &[
            "an_entry_of",
            "another_version",
            "entries_written",
            "every_key",
            "every_setting",
            "the_checksum",
            "the_largest",
        ],
    ),
    ("telemetry", &[]),
    (
        "service",
        &[
            "a_fault_is_news",
            "a_flash_that_fails",
            "the_table",
            "what_is_no_request",
            "what_is_saved",
            "what_only_asks",
        ],
    ),
    ("control", &["a_board_starts", "a_device_in_motion", "a_device_that_is_not", "a_device_whose"]),
];

/// Tests of the library under Miri, which sees undefined behaviour of any kind in the dependencies' `unsafe`: the link,
/// the settings, requests, the control step in single precision.
pub fn miri() -> Result<()> {
    // As rustup runs it: what a cargo call inherits names another toolchain.
    let miri = || {
        let mut command = Command::new("rustup");
        command.current_dir(paths::root()).env_remove("RUSTUP_TOOLCHAIN").args(["run", "nightly", "cargo", "miri"]);
        command
    };
    if !miri().arg("--version").output().is_ok_and(|output| output.status.success()) {
        bail!("Miri is missing: rustup toolchain install nightly --component miri,rust-src");
    }
    for (file, tests) in UNDER_MIRI {
        let mut test = miri();
        test.args(["test", "--locked", "--package", "haptic-bridge", "--test", file, "--target-dir"]);
        test.arg(paths::target_directory().join("miri")).arg("--").args(tests);
        // Files are read and time passes; sums are rounded as they are elsewhere; a property is tried a few times.
        test.env("MIRIFLAGS", "-Zmiri-disable-isolation -Zmiri-deterministic-floats").env("PROPTEST_CASES", "4");
        run(&mut test)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_miri_is_to_run_is_there() {
        for (file, tests) in UNDER_MIRI {
            let path = paths::root().join(format!("tests/{file}.rs"));
            let text = std::fs::read_to_string(&path).unwrap();
            for test in tests {
                assert!(text.contains(&format!("\nfn {test}")), "no test in {} begins with {test}", path.display());
            }
        }
    }
}
