//! Prints docs/hard-cases.md: `cargo run --release --example hard_cases > docs/hard-cases.md`.

#[allow(dead_code, reason = "the test asserts more than the page shows")]
#[path = "../tests/hard_cases/page.rs"]
mod page;

fn main() {
    print!("{}", page::Rows::compute().markdown());
}
