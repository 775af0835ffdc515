//! The control interrupt under the clock: docs/results/timing.csv holds what it takes, and it takes no more.

use haptic_emulator::cases::CASES;
use haptic_emulator::results;
use haptic_emulator::stages::STAGES;
use haptic_emulator::timing::recorded;

/// Largest growth of a period over the recorded one before someone has to look at it and run `cargo xtask timing`.
const GROWTH: f64 = 1.03;

fn takes_what_is_recorded(nth: usize) {
    let case = CASES[nth];
    let text = std::fs::read_to_string(results("timing")).expect("docs/results/timing.csv is there");
    let (longest, valley) = recorded(&text, &case).expect("the case is in the table");
    let timing = case.measure();
    println!("{}: {timing:?}", case.name());
    assert!(timing.periods > 200, "{timing:?}");
    assert!(timing.unnamed.is_empty(), "emulator/src/stages.rs gives these to no stage: {:#?}", timing.unnamed);
    // In contact, with the feed-forward in full, a step does something of everything.
    for ((stage, _), mean) in STAGES.iter().zip(&timing.stages).filter(|((stage, _), _)| stage.starts_with("step: ")) {
        assert!(*mean > 0.0, "{stage} is not there: {timing:?}");
    }
    let allowed = |recorded: u64| (recorded as f64 * GROWTH) as u64;
    assert!(timing.longest <= allowed(longest), "{}: {longest} recorded, {timing:?}", case.name());
    assert!(timing.valley <= allowed(valley), "{}: {valley} recorded, {timing:?}", case.name());
}

#[test]
fn a_step_of_a_five_bar_in_contact_takes_no_more_than_is_recorded() {
    takes_what_is_recorded(0);
}

#[test]
fn a_step_of_a_five_bar_in_a_corner_takes_no_more_than_is_recorded() {
    takes_what_is_recorded(1);
}

#[test]
fn a_step_of_three_joints_in_contact_takes_no_more_than_is_recorded() {
    takes_what_is_recorded(2);
}

#[test]
fn a_step_of_a_turret_in_contact_takes_no_more_than_is_recorded() {
    takes_what_is_recorded(4);
}
