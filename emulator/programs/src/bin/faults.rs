//! `faults`: brings every fault about on the emulated chip and writes docs/results/faults.md, then what lying sensors
//! and broken motors do at three control rates into its second part. `faults lying` does the second alone,
//! `faults FAULT …` brings the faults of those codes or names about and only prints what came of them, `faults list`
//! says how each is brought about, or why it cannot be. `cargo xtask faults` calls it.
//!
//! Exit code 1: the document could not be read or written. Exit code 2: there is no such fault.

use std::io;
use std::process::ExitCode;

use haptic_bridge::safety::fault::Fault;
use virtual_board::campaign::{self, HEADING};
use virtual_board::inject::{document, how, provoke, table};

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
            eprintln!("faults: {}: {error}", document().display());
            ExitCode::from(1)
        }
    }
}

/// The document's two parts, the second from its heading on.
fn parts() -> io::Result<(String, String)> {
    let text = std::fs::read_to_string(document())?;
    let at = text.find(HEADING).unwrap_or(text.len());
    Ok((text[..at].to_owned(), text[at..].to_owned()))
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
        std::fs::write(document(), table(&outcomes) + &parts()?.1)?;
    }
    let lying = campaign::table();
    std::fs::write(document(), parts()?.0 + &lying)
}
