//! Entry points that need more than one cargo call.
fn main() {}
