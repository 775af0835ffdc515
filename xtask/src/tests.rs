//! The whole test run: what plain `cargo test` covers, then the images, then the emulated board.

use std::env;
use std::process::Command;

use anyhow::Result;

use crate::toolchain::run;
use crate::{firmware, no_panic};

fn cargo() -> Command {
    Command::new(env::var_os("CARGO").unwrap_or_else(|| "cargo".into()))
}

/// Every test there is, cheapest first.
pub fn all(install: bool) -> Result<()> {
    run(cargo().current_dir(firmware::root()).args(["test", "--locked", "--workspace"]))?;
    firmware::size(install)?;
    no_panic::prove(install)?;
    board(&[], install)
}

/// The tests of the real images on the emulated chip: a workspace of its own, which declares a newer compiler than it needs.
/// Further arguments go to `cargo test`.
pub fn board(arguments: &[&str], install: bool) -> Result<()> {
    firmware::build_all(install)?;
    run(cargo()
        .current_dir(firmware::root().join("tests/board"))
        .args(["test", "--locked", "--ignore-rust-version", "--release"])
        .args(arguments))
}
