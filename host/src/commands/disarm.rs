//! `haptic disarm`: motors off.

use super::port::{Port, fault_in_words};
use haptic::error::{Failure, print};

/// Switch the motors off; the device then moves freely (and falls, if it has weight)
#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    port: Port,
}

/// Disarms, and says so when a fault stays latched.
pub fn run(args: Args) -> Result<(), Failure> {
    let mut board = args.port.open()?;
    board.disarm()?;
    let mut report = "disarmed: the motors are off\n".to_string();
    if let Some(record) = board.status()?.fault {
        let rate = board.details()?.rate_hz;
        report.push_str(&format!("a fault is latched: {}\n", fault_in_words(&record, rate)));
    }
    print(&report)
}
