//! Prints the tables in docs/claims/: `cargo run --package figures --bin claims`.

#[allow(dead_code, reason = "the test asserts more than the page shows")]
#[path = "../../../../tool/tests/deep/claims/page.rs"]
mod page;

fn main() {
    print!("{}", page::tables());
}
