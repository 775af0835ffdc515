//! Sets the name of the shared library, so that a linked program does not store its path and loads the version of its
//! header: HB_VERSION.

fn main() {
    println!("cargo:rerun-if-changed=build.rs");
    if std::env::var("CARGO_CFG_TARGET_OS").is_ok_and(|os| os == "linux") {
        println!("cargo:rustc-cdylib-link-arg=-Wl,-soname,libhapticbridge.so.2");
    }
}
