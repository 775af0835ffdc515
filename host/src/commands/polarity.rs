//! `haptic polarity`: lets the board move each joint a little, to see that motors and encoders agree.

use super::port::Port;
use haptic::error::{Failure, print};
use haptic_bridge::safety::fault::State;
use std::io::{BufRead, IsTerminal};
use std::time::Duration;

/// Check that every motor turns its joint the way its encoder counts (moves the device)
///
/// Each joint in turn gets a small, slowly growing torque until it has moved about a degree. A real board arms only
/// after this check has passed with its device.
#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    port: Port,
    /// Do not ask before the device moves
    #[arg(long)]
    yes: bool,
}

/// Asks, starts the check and waits for its end.
pub fn run(args: Args) -> Result<(), Failure> {
    let mut board = args.port.open()?;
    if board.details()?.real && !args.yes {
        confirm("each joint will be moved by a small torque; is the device free to move and are hands off it? [y/N] ")?;
    }
    board.keep_alive();
    board.check_polarity()?;
    loop {
        // Waiting for telemetry is waiting: there is none, and a simulated board's time passes meanwhile.
        board.rows(Duration::from_millis(100))?;
        let status = board.status()?;
        match (status.state, status.fault) {
            (State::CheckingPolarity, _) => {}
            (_, Some(record)) => {
                let axis = record.axis.map_or(String::new(), |axis| format!(" (joint {axis})"));
                return Err(Failure::impossible(format!("{}{axis}", record.fault)).remedy(record.fault.remedy()));
            }
            _ if status.polarity => return print("every motor turns its joint the right way\n"),
            _ => return Err(Failure::impossible("the check was ended from outside").remedy("start it again")),
        }
    }
}

fn confirm(question: &str) -> Result<(), Failure> {
    if !std::io::stdin().is_terminal() {
        return Err(Failure::impossible("the device would move and nobody can be asked").remedy("repeat with --yes"));
    }
    eprint!("{question}");
    let mut answer = String::new();
    let read = std::io::stdin().lock().read_line(&mut answer);
    match read {
        Ok(_) if answer.trim().eq_ignore_ascii_case("y") => Ok(()),
        _ => Err(Failure::impossible("not confirmed").remedy("nothing was moved")),
    }
}
