//! Force from the host: how often the board answers, with a wall at 20 kHz and telemetry running (docs/host-force.md).

use haptic_bridge::board::protocol::HostContact;
use haptic_bridge::board::telemetry::Fields;
use virtual_board::cases::CASES;
use virtual_board::exchange::run;

/// A plane beside the tip, so that requests carry all that they can.
const PLANE: HostContact = HostContact { point: [0.0; 3], normal: [0.0, 1.0, 0.0], stiffness: 300.0, damping: 1.0 };

/// What a stream leaves of the exchanges; the floors are a tenth below what was measured on 2026-11-24.
#[test]
fn every_force_is_taken_and_no_period_missed_however_often_a_host_pushes() {
    let case = CASES[0];
    let mut rig = case.rig(case.rate_hz);
    for (divider, contact, ahead, least) in [
        (0, None, 1, 2500.0),
        (20, None, 1, 2400.0),
        (20, Some(PLANE), 1, 1850.0),
        (4, None, 1, 1700.0),
        (0, None, 2, 3500.0),
        (20, None, 2, 3300.0),
        (20, Some(PLANE), 2, 2200.0),
        (4, None, 2, 1950.0),
    ] {
        let found = run(&mut rig, (Fields::USUAL, divider), case.rate_hz, 60, contact, ahead);
        println!(
            "{}, every {divider}th row, contact {}, {ahead} on their way: {found:?}",
            case.name(),
            contact.is_some()
        );
        assert!(found.per_second > least, "{found:?}");
        assert_eq!((found.not_taken, found.overruns, found.losses.missing), (0, 0, 0), "{found:?}");
        assert!(found.armed && found.steps.abs_diff(found.periods) <= 1, "{found:?}");
    }
}
