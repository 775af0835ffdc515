//! Both entry points are kept; everything they do not reach is dropped.

fn main() {
    for argument in ["--entry=control_step", "--undefined=carrier_step", "--gc-sections", "--nmagic"] {
        println!("cargo:rustc-link-arg={argument}");
    }
}
