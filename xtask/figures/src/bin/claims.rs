//! Prints the tables in docs/claims/: `cargo run --package figures --bin claims`.

#[allow(dead_code, reason = "only the test uses the rest")]
#[path = "../../../../tool/tests/deep/claims/page.rs"]
mod page;

fn main() {
    print!("{}", page::tables());
}
