//! The control interrupt takes at most 3 % more instructions than docs/results/timing.csv records.

use haptic_emulator::cases::CASES;
use haptic_emulator::results;
use haptic_emulator::timing::recorded_lengths;

/// Largest ratio to the recorded instructions. If a test exceeds it, find the cause and run `cargo xtask timing`.
const MAX_INSTRUCTION_RATIO: f64 = 1.03;

fn stays_within_record(nth: usize) {
    let case = CASES[nth];
    let text = std::fs::read_to_string(results("timing")).expect("docs/results/timing.csv exists");
    let (longest, valley) = recorded_lengths(&text, &case).expect("the case is in the table");
    let timing = case.measure();
    println!("{}: {timing:?}", case.name());
    assert!(timing.steps > 200, "{timing:?}");
    let allowed = |recorded: u64| (recorded as f64 * MAX_INSTRUCTION_RATIO) as u64;
    assert!(timing.longest_step <= allowed(longest), "{}: longest step {longest} recorded: {timing:?}", case.name());
    assert!(timing.longest_valley <= allowed(valley), "{}: longest valley {valley} recorded: {timing:?}", case.name());
}

#[test]
fn a_step_of_a_five_bar_in_contact_stays_within_its_record() {
    stays_within_record(0);
}

#[test]
fn a_step_of_a_five_bar_in_a_corner_stays_within_its_record() {
    stays_within_record(1);
}

#[test]
fn a_step_of_three_joints_in_contact_stays_within_its_record() {
    stays_within_record(2);
}

#[test]
fn a_step_of_a_turret_in_contact_stays_within_its_record() {
    stays_within_record(4);
}

#[test]
fn a_step_of_two_three_phase_motors_in_contact_stays_within_its_record() {
    stays_within_record(5);
}
