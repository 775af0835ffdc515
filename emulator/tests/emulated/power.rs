//! Power cuts within the flash operations of a save, on the release image. Afterwards the board must start with the old
//! or the new scene and all other settings, and the next save must work. tests/power_cut.rs tests many more states of
//! the flash, with a model of the flash only.

use haptic_bridge::board::protocol::SceneData;
use haptic_emulator::boards::BoardKind;
use haptic_emulator::image::SETTINGS_RANGE;
use haptic_emulator::rig::Rig;
use haptic_emulator::run::MILLISECOND;

/// A number of flash operations that no save reaches.
const MANY_OPERATIONS: u64 = 1 << 40;

/// Loads a wall of `stiffness` (N/m) and saves it. Returns true if the board confirms the save.
fn save(rig: &mut Rig, stiffness: u32) -> bool {
    rig.set_scene(&format!("[[wall]]\npoint = [0.0, 0.13]\nnormal = [0.0, -1.0]\nstiffness = {stiffness}\n"));
    rig.tool.save().is_ok()
}

fn saved_rig() -> Rig {
    let mut rig = Rig::with_device(BoardKind::OdriveV3, "pantograph-mk2", |_| ());
    rig.load("");
    rig.tool.set_name(&"left hand".try_into().expect("a short name")).expect("the board takes a name");
    assert!(save(&mut rig, 500));
    rig
}

/// Returns the scene of a board. Asserts that all other settings are kept.
fn scene(rig: &mut Rig) -> SceneData {
    let details = rig.tool.details().expect("the board replies");
    assert!(details.damage.is_empty(), "{:?}", details.damage);
    assert_eq!(details.name.as_str(), "left hand");
    assert!(rig.tool.device().expect("the board replies").is_some(), "the device is lost");
    rig.tool.scene().expect("the board replies").expect("a scene")
}

/// Restarts the board with `words` in the sectors of its settings.
fn restart_with(words: &[u32], rig: Rig) -> Rig {
    let words = words.to_vec();
    rig.while_stopped(move |stopped| stopped.set_flash(SETTINGS_RANGE.start, &words));
    rig.run(MILLISECOND);
    rig.restart()
}

/// Cuts the power within the flash operation number `operation`, counted from now.
fn cut_power_at(rig: &Rig, operation: u64) {
    rig.while_stopped(move |stopped| stopped.hardware().chip.flash.hook.operations_until_cut = Some(operation));
}

fn operations_left(rig: &Rig) -> Option<u64> {
    rig.while_stopped(|stopped| stopped.hardware().chip.flash.hook.operations_until_cut)
}

/// Cuts the power within every `step`th operation of a save that changes the scene. Returns the number of operations.
fn check_cuts(step: usize, mut rig: Rig) -> u64 {
    let flash = rig.while_stopped(|stopped| stopped.flash(SETTINGS_RANGE));
    let old = scene(&mut rig);
    cut_power_at(&rig, MANY_OPERATIONS);
    assert!(save(&mut rig, 600));
    let operations = MANY_OPERATIONS - operations_left(&rig).expect("a power cut is set");
    let new = scene(&mut rig);
    assert_ne!(old, new);
    let mut found_new = 0;
    for operation in (1..=operations).step_by(step) {
        rig = restart_with(&flash, rig);
        assert_eq!(scene(&mut rig), old);
        cut_power_at(&rig, operation);
        // Without power, the reply may be anything.
        save(&mut rig, 600);
        assert_eq!(operations_left(&rig), Some(0), "the power was not cut in operation {operation} of {operations}");
        rig = rig.restart();
        let after = scene(&mut rig);
        assert!(after == old || after == new, "after a cut in operation {operation} of {operations}: {after:?}");
        found_new += u32::from(after == new);
        if operation % 5 == 1 {
            assert!(save(&mut rig, 700), "the save after a cut in operation {operation} of {operations}");
        }
    }
    println!("{operations} operations, new {found_new} times");
    operations
}

/// Cuts every fifth operation, because no pattern of the entries has the period 5. tests/power_cut.rs cuts every
/// operation.
#[test]
fn a_power_cut_in_a_save_leaves_the_old_or_the_new_scene() {
    assert!(check_cuts(5, saved_rig()) > 20);
}

#[test]
fn a_power_cut_in_a_save_with_an_erase_leaves_old_or_new() {
    let mut rig = saved_rig();
    let erased = |rig: &Rig| rig.while_stopped(|stopped| stopped.hardware().chip.flash.hook.erased.len());
    // Saves until a save has erased a sector.
    let mut before = Vec::new();
    for nth in 0..400 {
        before = rig.while_stopped(|stopped| stopped.flash(SETTINGS_RANGE));
        assert!(save(&mut rig, 500 + nth % 2), "save {nth} failed");
        if erased(&rig) > 0 {
            break;
        }
    }
    assert_eq!(erased(&rig), 1);
    assert!(rig.while_stopped(|stopped| stopped.resets().is_empty()), "the board restarted");
    assert!(check_cuts(37, restart_with(&before, rig)) > 100);
}
