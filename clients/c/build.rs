//! Gives the shared library its name, so that a program that was linked with it does not remember where it lay, and asks for
//! the version whose header it was compiled with: HB_VERSION.

fn main() {
    println!("cargo:rerun-if-changed=build.rs");
    if std::env::var("CARGO_CFG_TARGET_OS").is_ok_and(|os| os == "linux") {
        println!("cargo:rustc-cdylib-link-arg=-Wl,-soname,libhapticbridge.so.2");
    }
}
