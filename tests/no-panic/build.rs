//! The four entry points are kept; everything they do not reach is dropped.

fn main() {
    let kept = [
        "--entry=control_step",
        "--undefined=carrier_render",
        "--undefined=carrier_crest",
        "--undefined=carrier_generally",
        "--undefined=carrier_notes",
        "--undefined=carrier_sums",
    ];
    for argument in kept.into_iter().chain(["--gc-sections", "--nmagic"]) {
        println!("cargo:rustc-link-arg={argument}");
    }
}
