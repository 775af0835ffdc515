//! `haptic board save`: keeps device, scene, gains and rules over a power cycle.

use super::port::OnBoard;
use haptic_bridge::safety::refusal::Refusal;
use haptic_host::error::Failure;
use haptic_host::link::BoardError;
use serde_json::json;

/// Keep device, scene, gains and rules in the board's flash
///
/// The motors must be off: the processor stops for up to a second while flash is erased.
#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    on: OnBoard,
}

pub fn run(args: Args) -> Result<(), Failure> {
    let mut board = args.on.open_to_stay()?;
    if board.status()?.state.drives() {
        return Err(BoardError::Refused(Refusal::Armed).into());
    }
    haptic_host::tell!("writing flash: the board pauses for up to a second");
    board.save()?;
    let (device, scene) = (board.device()?.is_some(), board.scene()?.is_some());
    let words = match (device, scene) {
        (true, true) => "saved: the board starts with this device and scene from now on\n",
        (true, false) => "saved: the board starts with this device from now on; it has no scene\n",
        (false, _) => {
            "saved: rules and name; the board has no device or scene, and a device or scene that was saved before stays saved\n"
        }
    };
    let (info, mut saved) = (board.info(), vec!["rules", "name"]);
    saved
        .extend([("device", device), ("scene", scene)].into_iter().filter(|(_, loaded)| *loaded).map(|(name, _)| name));
    args.on.answer(json!({ "saved": true, "settings": saved, "board": info.board, "serial": info.serial }), words)
}
