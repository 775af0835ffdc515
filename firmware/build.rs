//! Passes the linker its arguments and memory.x, the chip's memory, from the root of the repository.

use std::{env, fs, path::PathBuf};

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    println!("cargo::rerun-if-changed=../memory.x");
    let out = PathBuf::from(env::var_os("OUT_DIR").expect("cargo sets OUT_DIR"));
    fs::copy("../memory.x", out.join("memory.x")).expect("memory.x can be copied to OUT_DIR");
    println!("cargo::rustc-link-search={}", out.display());
    // --nmagic: sections are not aligned to pages, which flash lacks. link.x is from cortex-m-rt, defmt.x from defmt.
    for argument in ["--nmagic", "-Tlink.x", "-Tdefmt.x"] {
        println!("cargo::rustc-link-arg-bin=haptic-firmware={argument}");
    }
    // The linker keeps the entry points of `no-panic` and drops everything that they do not reach.
    for name in ["render", "angles", "crest", "generally", "notes", "sums"] {
        println!("cargo::rustc-link-arg-bin=no-panic=--undefined=carrier_{name}");
    }
    for argument in ["--entry=control_step", "--gc-sections", "--nmagic"] {
        println!("cargo::rustc-link-arg-bin=no-panic={argument}");
    }
}
