//! The power goes within the flash operations of a save, on the release image: afterwards the board boots, has the old
//! or the new scene and everything else, and the next save works. tests/power_cut.rs does the same with a model of the
//! flash alone, in many more states of it.

use haptic_bridge::board::protocol::SceneData;
use haptic_emulator::boards::BoardKind;
use haptic_emulator::image::SETTINGS;
use haptic_emulator::rig::Rig;
use haptic_emulator::run::MILLISECOND;

/// More flash operations than any save has.
const FOREVER: u64 = 1 << 40;

/// Gives the board a wall and saves; whether the board says that it is saved.
fn save(rig: &mut Rig, stiffness: u32) -> bool {
    rig.set_scene(&format!("[[wall]]\npoint = [0.0, 0.13]\nnormal = [0.0, -1.0]\nstiffness = {stiffness}\n"));
    rig.tool.save().is_ok()
}

/// A board with everything that can be saved in its flash.
fn saved() -> Rig {
    let mut rig = Rig::with_device(BoardKind::OdriveV3, "pantograph-mk2", |_| ());
    rig.load("");
    rig.tool.set_name(&"left hand".try_into().expect("a short name")).expect("the board takes a name");
    assert!(save(&mut rig, 500));
    rig
}

/// The scene of a board that has all the rest.
fn scene(rig: &mut Rig) -> SceneData {
    let details = rig.tool.details().expect("the board answers");
    assert!(details.damage.is_empty(), "{:?}", details.damage);
    assert_eq!(details.name.as_str(), "left hand");
    assert!(rig.tool.device().expect("the board answers").is_some(), "the device is lost");
    rig.tool.scene().expect("the board answers").expect("a scene")
}

/// The board started with those words in its settings' sectors.
fn started_with(words: &[u32], rig: Rig) -> Rig {
    let words = words.to_vec();
    rig.with(move |stopped| stopped.set_flash(SETTINGS.start, &words));
    rig.run(MILLISECOND);
    rig.restarted()
}

/// Lets the power go within the flash operation of that number from now on.
fn cut(rig: &Rig, operation: u64) {
    rig.with(move |stopped| stopped.hardware().chip.flash.hook.cut = Some(operation));
}

/// Operations that are left until it goes.
fn left(rig: &Rig) -> Option<u64> {
    rig.with(|stopped| stopped.hardware().chip.flash.hook.cut)
}

/// Cuts the power within every `step`th operation of a save that changes the scene. Answers how many it has.
fn cut_within(step: usize, mut rig: Rig) -> u64 {
    let flash = rig.with(|stopped| stopped.flash(SETTINGS));
    let old = scene(&mut rig);
    cut(&rig, FOREVER);
    assert!(save(&mut rig, 600));
    let operations = FOREVER - left(&rig).expect("it was set");
    let new = scene(&mut rig);
    assert_ne!(old, new);
    let mut found_new = 0;
    for operation in (1..=operations).step_by(step) {
        rig = started_with(&flash, rig);
        assert_eq!(scene(&mut rig), old);
        cut(&rig, operation);
        // Without power the answer may be anything.
        save(&mut rig, 600);
        assert_eq!(left(&rig), Some(0), "the power never went in operation {operation} of {operations}");
        rig = rig.restarted();
        let found = scene(&mut rig);
        assert!(found == old || found == new, "after a cut in operation {operation} of {operations}: {found:?}");
        found_new += u32::from(found == new);
        if operation % 5 == 1 {
            assert!(save(&mut rig, 700), "the save after a cut in operation {operation} of {operations}");
        }
    }
    println!("{operations} operations, new {found_new} times");
    operations
}

/// Every fifth operation, which no pattern of the entries keeps in step with; each one is cut on a PC
/// (tests/power_cut.rs).
#[test]
fn a_power_cut_within_a_save_leaves_the_old_or_the_new_scene() {
    assert!(cut_within(5, saved()) > 20);
}

#[test]
fn a_power_cut_within_a_save_that_erases_a_sector_leaves_the_old_or_the_new_scene() {
    let mut rig = saved();
    let erased = |rig: &Rig| rig.with(|stopped| stopped.hardware().chip.flash.hook.erased.len());
    // Up to where the next save finds its sector full: more saves than anyone would try without this.
    let mut before = Vec::new();
    for nth in 0..400 {
        before = rig.with(|stopped| stopped.flash(SETTINGS));
        assert!(save(&mut rig, 500 + nth % 2), "save {nth}");
        if erased(&rig) > 0 {
            break;
        }
    }
    assert_eq!(erased(&rig), 1);
    assert!(rig.with(|stopped| stopped.resets().is_empty()), "the board restarted");
    assert!(cut_within(37, started_with(&before, rig)) > 100);
}
