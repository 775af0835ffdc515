//! The four entry points are kept; everything they do not reach is dropped.

fn main() {
    let kept =
        ["--entry=control_step", "--undefined=carrier_guard", "--undefined=carrier_sums", "--undefined=carrier_step"];
    for argument in kept.into_iter().chain(["--gc-sections", "--nmagic"]) {
        println!("cargo:rustc-link-arg={argument}");
    }
}
