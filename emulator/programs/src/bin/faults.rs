//! `faults` causes every fault on the emulated chip and writes docs/results/faults.csv. Then it injects errors in
//! sensors and motors at three control rates and writes broken.csv. `faults lying` writes only broken.csv. `faults
//! FAULT …` only causes the faults with these codes or names and prints the results. `faults list` prints how each
//! fault is caused, or why it cannot be caused. `cargo xtask faults` runs this program.
//!
//! Exit codes: 1 if a table could not be written, 2 if there is no such fault.

use std::io;
use std::process::ExitCode;

use haptic_bridge::safety::fault::Fault;
use haptic_emulator::inject::{describe, provoke, table};
use haptic_emulator::{campaign, results};

fn main() -> ExitCode {
    let named: Vec<String> = std::env::args().skip(1).collect();
    if named == ["list"] {
        Fault::ALL.iter().for_each(|fault| println!("{} {}: {}", fault.code(), fault.name(), describe(*fault)));
        return ExitCode::SUCCESS;
    }
    let is_only_campaign = named == ["lying"];
    if !named.is_empty() && !is_only_campaign {
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
    match run(is_only_campaign) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("faults: a table cannot be written: {error}");
            ExitCode::from(1)
        }
    }
}

fn run(is_only_campaign: bool) -> io::Result<()> {
    if !is_only_campaign {
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
