//! `haptic faults`: lists the faults since the board started; with `--clear` it clears the latched fault.

use super::port::{OnBoard, fault_in_words, state_in_words};
use haptic_bridge::control::Status;
use haptic_host::digits::print_json;
use haptic_host::error::{Failure, print};
use haptic_host::link::Board;
use serde_json::json;

/// List the faults since the board started, each with its remedy, or clear a latched one
///
/// Use --clear after the cause has been removed. Then joints outside their limits are listed: move them back, because
/// the board does not arm before.
#[derive(clap::Args)]
pub struct Args {
    /// Clear the latched fault instead
    #[arg(long)]
    clear: bool,
    #[command(flatten)]
    on: OnBoard,
}

pub fn run(args: Args) -> Result<(), Failure> {
    if args.clear {
        return clear(&args);
    }
    let mut board = args.on.open()?;
    let faults = board.faults()?;
    let latched = board.status()?.fault;
    if args.on.json.is_requested() {
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
        report.push_str("`haptic faults --clear` clears the latched fault once its cause is gone\n");
    }
    print(&report)
}

/// Clears the latched fault; the motors stay off.
fn clear(args: &Args) -> Result<(), Failure> {
    let mut board = args.on.open()?;
    let before = board.status()?.fault;
    board.clear()?;
    let status = board.status()?;
    let outside = outside_limits(&mut board, &status)?;
    let cleared = before.map(|record| record.fault.name());
    let done = cleared.map_or("no fault was latched".into(), |name| format!("cleared {name}"));
    let mut words = format!("{done}; the board is {}\n", state_in_words(status.state));
    for (joint, unit) in &outside {
        words.push_str(&format!(
            "joint {joint} is outside its limits, at {:.3} {unit}: move it back by hand, or the board will not arm\n",
            status.q[*joint]
        ));
    }
    let outside: Vec<usize> = outside.into_iter().map(|(joint, _)| joint).collect();
    let document = json!({ "cleared": cleared, "state": format!("{:?}", status.state), "outside_limits": outside });
    args.on.answer(document, &words)
}

/// Returns the joints outside their limits with the units of their travel, if the board knows it.
fn outside_limits(board: &mut Board, status: &Status) -> Result<Vec<(usize, &'static str)>, Failure> {
    let known = status.homed || !board.details()?.real;
    let Some(device) = board.device()?.filter(|_| known) else { return Ok(Vec::new()) };
    let joints = device.joints[..device.axes()].iter().zip(status.q).enumerate();
    let outside = joints.filter(|(_, (joint, q))| joint.limits.is_some_and(|(low, high)| !(low..=high).contains(q)));
    let units = device.mechanism.units();
    Ok(outside.map(|(index, _)| (index, units[index].travel)).collect())
}
