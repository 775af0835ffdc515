//! Full load: every step's telemetry, settings that change, a link that cannot carry everything.

use haptic_bridge::board::telemetry::Fields;
use virtual_board::cases::CASES;
use virtual_board::load::run;

/// Every how many steps a row comes without a loss, see docs/results/timing.md.
const WHOLE: u32 = 4;

#[test]
fn in_a_minute_at_20_khz_no_period_is_missed_and_no_frame_lost_while_settings_change() {
    let mut rig = CASES[0].rig(20_000);
    let load = run(&mut rig, (Fields::USUAL, WHOLE), 20_000, 60_000);
    println!("{load:?}");
    assert!(load.in_time(), "{load:?}");
    assert_eq!((load.losses.missing, load.losses.garbled), (0, 0), "{load:?}");
    assert_eq!(load.losses.received, load.due, "{load:?}");
    // The stack was painted at start: of its 52 KB at least these have never been touched.
    assert!(load.stack_free >= 8 * 1024, "{load:?}");
}

#[test]
fn frames_that_the_link_cannot_carry_are_counted_one_by_one_and_the_loop_does_not_wait() {
    let mut rig = CASES[0].rig(20_000);
    let load = run(&mut rig, (Fields::ALL, 1), 20_000, 1_000);
    println!("{load:?}");
    assert!(load.in_time(), "{load:?}");
    assert!(load.losses.missing > 1_000, "nothing was lost: {load:?}");
    assert_eq!(load.losses.received + load.losses.missing, load.due, "{load:?}");
    assert_eq!(load.losses.batches_lost, 0, "what was numbered was sent: {load:?}");
    // Every loss is one that the board told of, beside what it dropped before the first row came.
    assert!(load.losses.missing <= load.losses.dropped_by_board, "{load:?}");
}

#[test]
fn three_joints_miss_no_period_whatever_is_lost_and_no_motor_is_taken_for_another() {
    // At 20 kHz every step comes too late for its valley, and at 10 kHz, of the same carrier, every other crest has one.
    for rate_hz in [20_000, 10_000] {
        let mut rig = CASES[2].rig(rate_hz);
        let load = run(&mut rig, (Fields::USUAL, 1), rate_hz, 1_000);
        println!("{load:?}");
        assert!(load.in_time(), "{load:?}");
        assert_eq!(load.losses.received + load.losses.missing, load.due, "{load:?}");
    }
}
