//! `haptic board list`: the boards that are connected.

use super::answer::Json;
use haptic_host::digits::print_json;
use haptic_host::error::{Failure, on_one_line, print};
use haptic_host::link::boards;
use serde_json::json;

/// List the boards that are connected
#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    json: Json,
}

/// Finds boards by their USB identifiers, without opening any port.
pub fn run(args: Args) -> Result<(), Failure> {
    let (boards, others) = boards();
    if args.json.is_requested() {
        let boards: Vec<_> = boards
            .iter()
            .map(|board| json!({ "port": board.path, "serial": board.serial, "board": board.kind }))
            .collect();
        return print_json(json!({ "boards": boards, "other_serial_ports": others }));
    }
    let mut report = String::new();
    for board in &boards {
        let [kind, serial] = [&board.kind, &board.serial].map(|name| on_one_line(name));
        report.push_str(&format!("{}  {kind}  serial number {serial}\n", board.path));
    }
    if boards.is_empty() {
        report.push_str("no boards found\n");
        if !others.is_empty() {
            report.push_str(&format!("other serial ports: {}\n", others.join(", ")));
        }
        report.push_str("without a board: `haptic demo`; `haptic sim`; `--port sim`, a simulated board that exists only during one command\n");
    }
    print(&report)
}
