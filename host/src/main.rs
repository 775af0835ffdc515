//! The `haptic` command.
fn main() {}
