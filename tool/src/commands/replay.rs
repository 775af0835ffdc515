//! `haptic replay`: plays a recording's counts into the simulated board's control code, and compares the torques.

use super::answer::Json;
use super::port::counted;
use haptic_host::digits::print_json;
use haptic_host::error::{Failure, print};
use haptic_show::recorder::Recording;
use haptic_show::replay::{Difference, replay};
use std::path::PathBuf;

/// Play a recording's encoder counts into the simulated board and compare the torques, bit for bit
///
/// Device, scene and rules are the recording's own. The recording must hold every control step from before the motors
/// were switched on, with q, torque, counts and state, as `haptic record --arm` writes it. A difference means that
/// something acted that is not in the recording: changed gains, a force from the host, another firmware.
#[derive(clap::Args)]
pub struct Args {
    /// Recording: .mcap or .csv
    file: PathBuf,
    #[command(flatten)]
    json: Json,
}

fn describe(difference: &Difference) -> String {
    let Difference { step, time_s, joint, recorded, replayed, unit, steps_of_precision } = difference;
    let precision = counted(steps_of_precision, "step");
    format!(
        "step {step}, {time_s:.4} s, joint {joint}: recorded {recorded} {unit}, replayed {replayed} {unit} ({precision} of single precision)"
    )
}

pub fn run(args: Args) -> Result<(), Failure> {
    let recording = Recording::load(&args.file)?;
    let result = replay(&recording)?;
    if args.json.is_requested() {
        print_json(&result)?;
    } else {
        let mut text = format!("{} played, {} of them with the motors on\n", counted(result.rows, "row"), result.armed);
        if let (Some(first), Some(largest)) = (&result.first, &result.largest) {
            text.push_str(&format!("first difference: {}\n", describe(first)));
            text.push_str(&format!("largest difference: {}\n", describe(largest)));
        }
        if result.is_same() {
            text.push_str("the same torques, to the bit\n");
        }
        print(&text)?;
    }
    if result.differing > 0 {
        let rows = format!("{} of {}", result.differing, counted(result.rows, "row"));
        return Err(Failure::impossible(format!("the torques differ in {rows}")).remedy(
            "record again without changing gains or sending forces, with the firmware of this tool's version",
        ));
    }
    match result.stopped {
        Some(why) => Err(Failure::impossible(why)),
        None => Ok(()),
    }
}
