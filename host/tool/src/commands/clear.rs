//! `haptic clear`: clears a latched fault.

use super::answer::Json;
use super::port::{Port, state_in_words};
use haptic_bridge::servo::Status;
use haptic_host::error::Failure;
use haptic_host::link::Board;
use serde_json::json;

/// Clear a latched fault, after its cause has been removed
///
/// Says which joints are outside their limits: the board does not arm before they are moved back.
#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    port: Port,
    #[command(flatten)]
    json: Json,
}

/// Clears; the motors stay off.
pub fn run(args: Args) -> Result<(), Failure> {
    let mut board = args.port.open()?;
    let before = board.status()?.fault;
    board.clear()?;
    let status = board.status()?;
    let outside = outside_limits(&mut board, &status)?;
    let cleared = before.map(|record| record.fault.name());
    let done = cleared.map_or("no fault was latched".into(), |name| format!("cleared {name}"));
    let mut said = format!("{done}; the board is {}\n", state_in_words(status.state));
    for joint in &outside {
        said.push_str(&format!(
            "joint {joint} is outside its limits, at {:.3} rad: move it back by hand, or the board will not arm\n",
            status.q[*joint]
        ));
    }
    let document = json!({ "cleared": cleared, "state": format!("{:?}", status.state), "outside_limits": outside });
    args.json.answer(document, &said)
}

/// The joints that stand outside their limits, where the board knows their angles.
fn outside_limits(board: &mut Board, status: &Status) -> Result<Vec<usize>, Failure> {
    let known = status.homed || !board.details()?.real;
    let Some(device) = board.device()?.filter(|_| known) else { return Ok(Vec::new()) };
    let joints = device.joints[..device.axes()].iter().zip(status.q).enumerate();
    let outside = joints.filter(|(_, (joint, q))| joint.limits.is_some_and(|(low, high)| !(low..=high).contains(q)));
    Ok(outside.map(|(index, _)| index).collect())
}
