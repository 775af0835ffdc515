//! Every fault is caused in the release image. It must be latched and listed, turn the bridges off within a control
//! period of its detection, and be cleared only on request. docs/results/faults.csv contains the results.

use haptic_bridge::safety::fault::Fault;
use haptic_emulator::inject::{provoke, row};
use haptic_emulator::results;

/// Causes every fourth fault, starting with `first`, because four tests run in parallel.
fn check_every_fourth_fault(first: usize) {
    let text = std::fs::read_to_string(results("faults")).expect("docs/results/faults.csv exists");
    for fault in Fault::ALL.iter().skip(first).step_by(4) {
        let outcome = provoke(*fault);
        println!("{}: {outcome:?}", fault.name());
        let periods = outcome.as_ref().and_then(|outcome| outcome.periods_from_detection);
        assert!(periods.unwrap_or(0) <= 1, "{}: bridges off {periods:?} periods after its detection", fault.name());
        let row = row(*fault, outcome.as_ref());
        assert!(text.contains(&row), "run `cargo xtask faults`: the table lacks\n{row}");
    }
}

#[test]
fn faults_1_5_9_turn_the_motors_off() {
    check_every_fourth_fault(0);
}

#[test]
fn faults_2_6_10_turn_the_motors_off() {
    check_every_fourth_fault(1);
}

#[test]
fn faults_3_7_11_turn_the_motors_off() {
    check_every_fourth_fault(2);
}

#[test]
fn faults_4_8_12_turn_the_motors_off() {
    check_every_fourth_fault(3);
}
