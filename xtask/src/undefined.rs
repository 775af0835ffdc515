//! Tests for undefined behaviour, which only dependencies can cause, because library and tool have no `unsafe` code.

use std::process::Command;

use anyhow::{Result, bail};

use crate::paths;
use crate::toolchain::{cargo, host, run};

/// Runs the library's tests with the address sanitizer. Further arguments go to `cargo test`.
pub fn sanitize(arguments: &[String]) -> Result<()> {
    let mut test = cargo();
    test.current_dir(paths::root()).args(["test", "--locked", "--package", "haptic-bridge", "--lib", "--tests"]);
    // Uses a separate directory, because everything is compiled again. With `--target` the flag does not apply to build
    // scripts.
    test.args(["--target", &host()?, "--target-dir"]).arg(paths::target_directory().join("sanitize"));
    test.env("RUSTC_BOOTSTRAP", "1").env("RUSTFLAGS", "-Zsanitizer=address").env_remove("CARGO_ENCODED_RUSTFLAGS");
    run(test.args(arguments))
}

/// Prefixes of the names of the library's tests that run under Miri, a thousand times slower than without Miri. Tests
/// in double precision are excluded, because they use assembly on a PC, which Miri cannot run.
const MIRI_TESTS: [&str; 18] = [
    "settings::another_key",
    "settings::another_version",
    "settings::entries_are",
    "settings::every_key",
    "settings::every_setting",
    "settings::the_checksum",
    "settings::the_largest",
    "telemetry::",
    "service::a_fault_with_an_invalid_value",
    "service::a_flash_failure",
    "service::the_tests_of_requests_cover",
    "service::a_frame_without_a_request",
    "service::saved_settings",
    "service::reading_requests",
    "control_loop::motors_stay_off",
    "control_loop::a_device_in_motion",
    "control_loop::a_device_that_is_not",
    "control_loop::a_device_whose",
];

/// Runs tests of the library under Miri, which detects undefined behaviour in the `unsafe` code of dependencies. The
/// tests cover the link, the settings, requests, and the control step in single precision.
pub fn miri() -> Result<()> {
    // Removes the inherited variable, because it names another toolchain.
    let miri = || {
        let mut command = Command::new("rustup");
        command.current_dir(paths::root()).env_remove("RUSTUP_TOOLCHAIN").args(["run", "nightly", "cargo", "miri"]);
        command
    };
    if !miri().arg("--version").output().is_ok_and(|output| output.status.success()) {
        bail!("Miri is missing; install it with: rustup toolchain install nightly --component miri,rust-src");
    }
    let mut test = miri();
    test.args(["test", "--locked", "--package", "haptic-bridge", "--test", "library", "--target-dir"]);
    test.arg(paths::target_directory().join("miri")).arg("--").args(MIRI_TESTS);
    // Tests may read files and the clock, floats round as on a processor, and each property has few cases.
    test.env("MIRIFLAGS", "-Zmiri-disable-isolation -Zmiri-deterministic-floats").env("PROPTEST_CASES", "4");
    run(&mut test)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_tests_for_miri_exist() {
        for name in MIRI_TESTS {
            let (file, test) = name.split_once("::").unwrap();
            let path = paths::root().join(format!("tests/{file}.rs"));
            let text = std::fs::read_to_string(&path).unwrap();
            assert!(text.contains(&format!("\nfn {test}")), "no test in {} begins with {test}", path.display());
        }
    }
}
