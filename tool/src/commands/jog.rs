//! `haptic jog`: moves one joint a little while a key is held.

use super::interrupt;
use super::port::Port;
use haptic_host::error::{Failure, print};
use haptic_host::link::Session;
use haptic_predict::jog::{Ended, Jog, Jogged, Key, Plan, run as jog};
use haptic_show::monitor::{HeldKey, in_raw_terminal};
use haptic_show::view::message::FromPage;
use std::io::IsTerminal;

/// Move one joint a little, slowly, while Space is held
///
/// The torque grows until the joint moves, at most to a share of its torque limit, and then keeps its speed. The motors
/// go off at the end of the movement, when Space is released or another key pressed, when the joint moves twice as fast
/// as requested or in the other direction, when another joint moves by itself, when the joint meets an obstacle, and
/// half a second after the last Space that reached the board. All of the board's limits apply. Its scene must be free
/// space.
#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    port: Port,
    /// Joint, from 0
    #[arg(long, value_name = "J", value_parser = clap::value_parser!(u8).range(0..=2))]
    joint: u8,
    /// Angle of the movement, rad, at most 1; negative for the other direction
    #[arg(long, value_name = "RAD", default_value_t = 0.1)]
    by: f64,
    /// Speed, rad/s; at most 1
    #[arg(long, value_name = "RAD/S", default_value_t = 0.2)]
    speed: f64,
    /// Largest torque, as a share of the joint's torque limit; at most 0.5
    #[arg(long, value_name = "SHARE", default_value_t = 0.2)]
    share: f64,
}

/// Announces the movement, moves the joint while the key is held, and reports how far it went.
pub fn run(args: Args) -> Result<(), Failure> {
    // A board on --port sim cannot be used, because its time does not wait for a key.
    let mut board = args.port.open_to_stay()?;
    let request = Jog { joint: args.joint.into(), by: args.by, speed: args.speed, share: args.share };
    let plan = Plan::new(&mut board, request)?;
    if !std::io::stdin().is_terminal() {
        return Err(Failure::wrong("a jog needs a terminal, for the Space key"));
    }
    let stop = interrupt::watch();
    // The session begins last, because it turns off motors that are on.
    let mut session = Session::of(board);
    print(&format!("{}\nhold Space: it moves; let go, or press another key: motors off; q ends\n", plan.in_words()))?;
    let mut held = HeldKey::default();
    let key = |step| {
        Ok(match held.listen(step)? {
            _ if stop.is_set() => Some(Key::End),
            None => Some(Key::End),
            Some(Some(FromPage::Arm { seen } | FromPage::Hold { seen })) => Some(Key::Down(seen)),
            Some(Some(FromPage::Release {})) => Some(Key::Up),
            Some(_) => None,
        })
    };
    let Jogged { ended, moved } = in_raw_terminal(|| jog(&mut session, &plan, key)).map_err(Failure::impossible)?;
    let off = if ended.is_ok() { "disarmed: the motors are off; " } else { "" };
    match moved {
        Some(moved) => print(&format!("{off}joint {} moved by {moved:+.4} rad\n", args.joint))?,
        None => print(&format!("{off}nothing was moved\n"))?,
    }
    match ended.map(Ended::in_words)? {
        Ok(words) => print(&format!("{words}\n")),
        Err(failure) => Err(failure),
    }
}
