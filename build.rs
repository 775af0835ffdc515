//! Link arguments of the two images. They are emitted for the chip alone, so that tests and tools on a PC link as ever.

use std::{env, fs, path::PathBuf};

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    println!("cargo::rerun-if-changed=memory.x");
    if env::var("CARGO_CFG_TARGET_OS").as_deref() != Ok("none") {
        return;
    }
    let out = PathBuf::from(env::var_os("OUT_DIR").expect("cargo sets OUT_DIR"));
    fs::copy("memory.x", out.join("memory.x")).expect("memory.x can be copied to OUT_DIR");
    println!("cargo::rustc-link-search={}", out.display());
    // --nmagic: sections are not aligned to pages, which flash does not have. link.x is cortex-m-rt's, defmt.x defmt's.
    for argument in ["--nmagic", "-Tlink.x", "-Tdefmt.x"] {
        println!("cargo::rustc-link-arg-bin=haptic-bridge-firmware={argument}");
    }
    if env::var_os("CARGO_FEATURE_COUNTING_IMAGE").is_some() {
        for argument in ["--nmagic", "-Tlink.x"] {
            println!("cargo::rustc-link-arg-bin=haptic-bridge-counting={argument}");
        }
    }
}
