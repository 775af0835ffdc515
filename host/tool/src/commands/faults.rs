//! `haptic faults`: what went wrong since the board started, in plain words.

use super::answer::Json;
use super::port::{Port, fault_in_words};
use haptic_host::digits::print_json;
use haptic_host::error::{Failure, print};
use serde_json::json;

/// List the faults since the board started, each with its remedy
#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    port: Port,
    #[command(flatten)]
    json: Json,
}

/// Asks and reports.
pub fn run(args: Args) -> Result<(), Failure> {
    let mut board = args.port.open()?;
    let faults = board.faults()?;
    let latched = board.status()?.fault;
    if args.json.asked() {
        let list: Vec<_> = faults
            .iter()
            .map(|record| {
                json!({ "code": record.fault.code(), "name": record.fault.name(), "what": record.fault.what(),
                        "remedy": record.fault.remedy(), "axis": record.axis, "value": record.value,
                        "step": record.step, "latched": latched == Some(*record) })
            })
            .collect();
        return print_json(json!({ "faults": list }));
    }
    if faults.is_empty() && latched.is_none() {
        return print("no faults since the board started\n");
    }
    let rate = board.details()?.rate_hz;
    let mut report = String::new();
    for record in &faults {
        let mark = if latched == Some(*record) { "latched  " } else { "cleared  " };
        report.push_str(&format!("{mark}{}\n", fault_in_words(record, rate)));
    }
    if latched.is_some() {
        report.push_str("`haptic clear` clears the latched fault once its cause is gone\n");
    }
    print(&report)
}
