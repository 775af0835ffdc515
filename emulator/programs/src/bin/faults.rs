//! `faults`: brings every fault about on the emulated chip and writes docs/results/faults.csv, then what lying sensors
//! and broken motors do at three control rates into broken.csv beside it. `faults lying` does the second alone,
//! `faults FAULT …` brings the faults of those codes or names about and only prints what came of them, `faults list`
//! says how each is brought about, or why it cannot be. `cargo xtask faults` calls it.
//!
//! Exit code 1: a table could not be written. Exit code 2: there is no such fault.

use std::io;
use std::process::ExitCode;

use haptic_bridge::safety::fault::Fault;
use haptic_emulator::inject::{how, provoke, table};
use haptic_emulator::{campaign, results};

fn main() -> ExitCode {
    let named: Vec<String> = std::env::args().skip(1).collect();
    if named == ["list"] {
        Fault::ALL.iter().for_each(|fault| println!("{} {}: {}", fault.code(), fault.name(), how(*fault)));
        return ExitCode::SUCCESS;
    }
    let lying_alone = named == ["lying"];
    if !named.is_empty() && !lying_alone {
        let find = |named: &String| {
            let is = |fault: &&Fault| fault.name() == named || fault.code().to_string() == *named;
            Fault::ALL
                .iter()
                .find(is)
                .ok_or_else(|| format!("no fault has the code or name {named:?}: see `faults list`"))
        };
        let faults: Result<Vec<&Fault>, String> = named.iter().map(find).collect();
        return match faults {
            Ok(faults) => {
                faults.iter().for_each(|fault| println!("{}: {:?}", fault.name(), provoke(**fault)));
                ExitCode::SUCCESS
            }
            Err(error) => {
                eprintln!("faults: {error}");
                ExitCode::from(2)
            }
        };
    }
    match run(lying_alone) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("faults: a table cannot be written: {error}");
            ExitCode::from(1)
        }
    }
}

fn run(lying_alone: bool) -> io::Result<()> {
    if !lying_alone {
        let outcomes: Vec<_> = Fault::ALL
            .iter()
            .map(|fault| {
                let outcome = provoke(*fault);
                println!("{}: {outcome:?}", fault.name());
                (*fault, outcome)
            })
            .collect();
        std::fs::write(results("faults"), table(&outcomes))?;
    }
    std::fs::write(results("broken"), campaign::table())
}
