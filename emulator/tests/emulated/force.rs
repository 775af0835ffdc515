//! Forces from the host: rate of the board's replies with a wall at 20 kHz and telemetry (docs/host-force.md).

use haptic_bridge::board::protocol::HostContact;
use haptic_bridge::board::telemetry::Fields;
use haptic_emulator::cases::CASES;
use haptic_emulator::exchange::run;

/// A plane that the tip does not touch, with which the requests have their full length.
const PLANE: HostContact = HostContact { point: [0.0; 3], normal: [0.0, 1.0, 0.0], stiffness: 300.0, damping: 1.0 };

/// The smallest accepted rates are 10 % below the rates measured on 2026-11-25.
#[test]
fn fast_force_requests_are_all_accepted_without_missed_periods() {
    let case = CASES[0];
    let mut rig = case.rig(case.rate_hz);
    for (divider, contact, ahead, least) in [
        (0, None, 1, 3560.0),
        (20, None, 1, 3490.0),
        (20, Some(PLANE), 1, 2900.0),
        (4, None, 1, 2970.0),
        (0, None, 2, 5940.0),
        (20, None, 2, 5760.0),
        (20, Some(PLANE), 2, 4290.0),
        (4, None, 2, 4830.0),
    ] {
        let result = run(&mut rig, (Fields::USUAL, divider), case.rate_hz, 60, contact, ahead);
        println!(
            "{}, every {divider}th row, contact {}, {ahead} requests on their way: {result:?}",
            case.name(),
            contact.is_some()
        );
        assert!(result.per_second > least, "{result:?}");
        assert_eq!((result.rejected, result.overruns, result.losses.missing), (0, 0, 0), "{result:?}");
        assert!(result.is_armed && result.steps.abs_diff(result.periods) <= 1, "{result:?}");
    }
}
