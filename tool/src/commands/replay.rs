//! `haptic replay`: a recording's counts into the simulated board's control code, torques beside torques.

use super::answer::Json;
use super::port::counted;
use haptic_host::digits::print_json;
use haptic_host::error::{Failure, print};
use haptic_show::recorder::Recording;
use haptic_show::replay::{Difference, replay};
use std::path::PathBuf;

/// Play a recording's encoder counts into the simulated board: the same torques to the bit, or where they differ
///
/// Device, scene and rules are the recording's own. It has to hold every control step from before the motors were
/// switched on, with q, torque, counts and state, as `haptic record --arm` writes it. A torque that differs means that
/// something acted which is not in the recording: gains changed meanwhile, a force from the host, another firmware.
#[derive(clap::Args)]
pub struct Args {
    /// A recording: .mcap or .csv
    file: PathBuf,
    #[command(flatten)]
    json: Json,
}

fn in_words(difference: &Difference) -> String {
    let Difference { step, time_s, joint, recorded, replayed, steps_of_precision } = difference;
    let precision = counted(steps_of_precision, "step");
    format!(
        "step {step}, {time_s:.4} s, joint {joint}: recorded {recorded} N m, replayed {replayed} N m ({precision} of single precision)"
    )
}

/// Reads, plays, says. Exit code 1 where anything differs.
pub fn run(args: Args) -> Result<(), Failure> {
    let recording = Recording::load(&args.file)?;
    let found = replay(&recording)?;
    if args.json.asked() {
        print_json(&found)?;
    } else {
        let mut text = format!("{} played, {} of them with the motors on\n", counted(found.rows, "row"), found.armed);
        if let (Some(first), Some(largest)) = (&found.first, &found.largest) {
            text.push_str(&format!("first difference: {}\n", in_words(first)));
            text.push_str(&format!("largest difference: {}\n", in_words(largest)));
        }
        if found.is_same() {
            text.push_str("the same torques, to the bit\n");
        }
        print(&text)?;
    }
    if found.differing > 0 {
        let rows = format!("{} of {}", found.differing, counted(found.rows, "row"));
        return Err(Failure::impossible(format!("the torques differ in {rows}"))
            .remedy("something acted that is not in the recording, or it was made by another firmware"));
    }
    match found.stopped {
        Some(why) => Err(Failure::impossible(why)),
        None => Ok(()),
    }
}
