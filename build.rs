//! Link arguments for the firmware binary.
fn main() {}
