//! Saved settings survive a reset, and the largest session leaves stack free.

use haptic_emulator::boards::BoardKind;
use haptic_emulator::rig::Rig;
use haptic_emulator::run::SECOND;
use haptic_host::backup::{Backup, restore};

/// A wall beyond the home pose of the pantograph, at 20 kHz.
pub const WALL: &str = "[[wall]]\npoint = [0.0, 0.13]\nnormal = [0.0, -1.0]\nstiffness = 2000.0\ndamping = 4.0\n";

#[test]
fn settings_survive_a_reset() {
    for kind in BoardKind::ALL {
        let mut rig = Rig::with_device(kind, "pantograph-mk2", |_| ());
        rig.load(WALL);
        rig.tool.set_name(&"left hand".try_into().expect("a short name")).expect("the board takes a name");
        let (device, scene) =
            (rig.tool.device().expect("the board replies"), rig.tool.scene().expect("the board replies"));
        rig.tool.save().expect("the settings are written");

        let mut rig = rig.restart();
        let details = rig.tool.details().expect("the board replies");
        assert_eq!(details.name.as_str(), "left hand");
        assert!(details.damage.is_empty(), "{:?}", details.damage);
        assert_eq!(rig.tool.device().expect("the board replies"), device);
        assert_eq!(rig.tool.scene().expect("the board replies"), scene);
        assert!(!rig.tool.status().expect("the board replies").homed, "a reset loses the home");
    }
}

#[test]
fn unsaved_changes_are_lost_in_a_reset() {
    let mut rig = Rig::with_device(BoardKind::OdriveV3, "pantograph-mk2", |_| ());
    rig.load(WALL);
    rig.run(SECOND / 10);
    let mut rig = rig.restart();
    assert_eq!(rig.tool.device().expect("the board replies"), None);
}

/// A restored backup needs the most stack, because the board decodes, checks and compiles everything at once.
#[test]
fn a_restored_backup_of_three_joints_leaves_stack_free() {
    let mut rig = Rig::with_device(BoardKind::HBridgeF405, "serial-3r", |_| ());
    rig.load(&"[[wall]]\npoint = [0.0, 9.0]\nnormal = [0.0, -1.0]\nstiffness = 2000.0\n".repeat(3));
    rig.tool.save().expect("the board saves");
    let backup = Backup::read(&mut rig.tool).expect("the board replies");
    let ready = backup.prepared_settings().expect("everything is readable");
    restore(&mut rig.tool, &ready).expect("the board takes its own backup");
    let details = rig.tool.details().expect("the board replies");
    assert_eq!(details.walls, 3);
    assert!(details.stack_free >= 8 * 1024, "{} of 52 KB were never used", details.stack_free);
    assert!(rig.while_stopped(|stopped| stopped.resets().is_empty()), "{}", rig.post_mortem());
}
