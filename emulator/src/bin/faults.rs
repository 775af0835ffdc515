//! `faults`: brings every fault about on the emulated chip and writes docs/results/faults.md, together with
//! what lying sensors and broken motors do at three control rates. `cargo xtask faults` calls it.
//!
//! Exit code 1: the table could not be written.

use std::process::ExitCode;

use haptic_bridge::safety::fault::Fault;
use virtual_board::campaign;
use virtual_board::inject::{document, provoke, table};

fn main() -> ExitCode {
    let outcomes: Vec<_> = Fault::ALL
        .iter()
        .map(|fault| {
            let outcome = provoke(*fault);
            println!("{}: {outcome:?}", fault.name());
            (*fault, outcome)
        })
        .collect();
    match std::fs::write(document(), table(&outcomes) + &campaign::table()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("faults: {}: {error}", document().display());
            ExitCode::from(1)
        }
    }
}
