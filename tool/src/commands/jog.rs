//! `haptic jog`: one joint moved a little, while somebody holds a key.

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
/// The joint is pushed harder and harder until it moves, at most with a share of its torque limit, and then kept at its
/// speed. The motors go off when it has gone its way, when Space is let go or another key pressed, when the joint moves
/// twice as fast as asked or the other way, when another joint moves by itself, when it stands against something, and
/// half a second after the last Space that reached the board. All of the board's limits apply. Its scene must be free
/// space.
#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    port: Port,
    /// Which joint, from 0
    #[arg(long, value_name = "J", value_parser = clap::value_parser!(u8).range(0..=2))]
    joint: u8,
    /// How far, rad; negative for the other way, at most 1
    #[arg(long, value_name = "RAD", default_value_t = 0.1)]
    by: f64,
    /// How fast, rad/s; at most 1
    #[arg(long, value_name = "RAD/S", default_value_t = 0.2)]
    speed: f64,
    /// Largest push, as a share of the joint's torque limit; at most 0.5
    #[arg(long, value_name = "SHARE", default_value_t = 0.2)]
    share: f64,
}

/// Says what will happen, moves the joint while the key is held, and says how far it went.
pub fn run(args: Args) -> Result<(), Failure> {
    // On --port sim time does not wait for anybody who holds a key.
    let mut board = args.port.open_to_stay()?;
    let wanted = Jog { joint: args.joint.into(), by: args.by, speed: args.speed, share: args.share };
    let plan = Plan::new(&mut board, wanted)?;
    if !std::io::stdin().is_terminal() {
        return Err(Failure::wrong("a jog needs a terminal, in which somebody holds Space"));
    }
    let stop = interrupt::watch();
    // Only now, for a session turns off what it finds on.
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
