//! Sensors that lie and motors that are broken, in the release image at the slowest rate and in the middle of a control
//! period, where a control step alone would be late: `cargo xtask faults` tries them at every rate and ten instants.

use haptic_emulator::campaign::{CASES, Campaign};

#[test]
fn what_has_to_be_seen_is_seen_before_a_motor_runs_away() {
    let mut campaign = Campaign::at(200);
    let has_to_be_seen: Vec<_> = CASES.iter().filter(|case| case.seen).collect();
    assert!(has_to_be_seen.len() >= 8, "only {} cases have to be seen", has_to_be_seen.len());
    for case in has_to_be_seen {
        let outcome = campaign.run(case, 5);
        println!("{}: {outcome:?}", case.what);
        assert!(outcome.fault.is_some(), "{}: nobody saw it: {outcome:?}", case.what);
        // The limit of 3 A, half of it and an ampere are what a current that is seen may reach; twice the limit and an
        // ampere is that and what a winding gains in the crests that it takes to find a sensor out.
        assert!(outcome.peaks.current < 7.0 || case.what.contains("stuck at 40"), "{}: {outcome:?}", case.what);
        assert!(outcome.after < 25_000_000, "{}: {outcome:?}", case.what);
    }
}
