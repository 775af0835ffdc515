//! Tests for undefined behaviour. Library and tool have no `unsafe` of their own, so only dependencies can cause it.

use std::process::Command;

use anyhow::{Result, bail};

use crate::paths;
use crate::toolchain::{cargo, host, run};

/// Runs the library's tests under the address sanitizer, an unstable option of the compiler. Further arguments go to
/// `cargo test`.
pub fn sanitize(arguments: &[String]) -> Result<()> {
    let mut test = cargo();
    test.current_dir(paths::root()).args(["test", "--locked", "--package", "haptic-bridge", "--lib", "--tests"]);
    // A separate directory, because everything is compiled again. With `--target` the flag does not apply to build
    // scripts.
    test.args(["--target", &host()?, "--target-dir"]).arg(paths::target_directory().join("sanitize"));
    test.env("RUSTC_BOOTSTRAP", "1").env("RUSTFLAGS", "-Zsanitizer=address").env_remove("CARGO_ENCODED_RUSTFLAGS");
    run(test.args(arguments))
}

/// Tests for Miri, which is a thousand times slower than the processor: test files, and prefixes of the names of their
/// tests; an empty list means all. Tests in double precision are left out, because on a PC they use assembly, which
/// Miri cannot run.
const UNDER_MIRI: [(&str, &[&str]); 4] = [
    (
        "settings",
        &["another_key", "another_version", "entries_are", "every_key", "every_setting", "the_checksum", "the_largest"],
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
    ("control_loop", &["a_board_starts", "a_device_in_motion", "a_device_that_is_not", "a_device_whose"]),
];

/// Runs tests of the library under Miri, which finds undefined behaviour of any kind in the dependencies' `unsafe`: the
/// link, the settings, requests, and the control step in single precision.
pub fn miri() -> Result<()> {
    // Without the inherited variable, which names another toolchain.
    let miri = || {
        let mut command = Command::new("rustup");
        command.current_dir(paths::root()).env_remove("RUSTUP_TOOLCHAIN").args(["run", "nightly", "cargo", "miri"]);
        command
    };
    if !miri().arg("--version").output().is_ok_and(|output| output.status.success()) {
        bail!("Miri is missing; install it with: rustup toolchain install nightly --component miri,rust-src");
    }
    for (file, tests) in UNDER_MIRI {
        let mut test = miri();
        test.args(["test", "--locked", "--package", "haptic-bridge", "--test", file, "--target-dir"]);
        test.arg(paths::target_directory().join("miri")).arg("--").args(tests);
        // Tests may read files and the clock, sums round as on a processor, and a property has few cases.
        test.env("MIRIFLAGS", "-Zmiri-disable-isolation -Zmiri-deterministic-floats").env("PROPTEST_CASES", "4");
        run(&mut test)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_tests_for_miri_exist() {
        for (file, tests) in UNDER_MIRI {
            let path = paths::root().join(format!("tests/{file}.rs"));
            let text = std::fs::read_to_string(&path).unwrap();
            for test in tests {
                assert!(text.contains(&format!("\nfn {test}")), "no test in {} begins with {test}", path.display());
            }
        }
    }
}
