//! Sets the soname of the shared library, whose number is HB_VERSION, so that a linked program stores this name instead
//! of a path.

fn main() {
    println!("cargo:rerun-if-changed=build.rs");
    if std::env::var("CARGO_CFG_TARGET_OS").is_ok_and(|os| os == "linux") {
        println!("cargo:rustc-cdylib-link-arg=-Wl,-soname,libhapticbridge.so.3");
    }
}
