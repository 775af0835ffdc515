//! The bridges begin to drive at an extreme of the carrier. Between two extremes, a bridge with one channel and its
//! complement would apply the rest of the half period to the motor, and the current would rise by almost 1 A/µs.

use haptic_bridge::board::telemetry::Fields;
use haptic_bridge::safety::fault::Fault;
use haptic_emulator::cases::CASES;
use haptic_emulator::contact::{NearWall, scene};
use haptic_emulator::range::{BOARD, rigid_device};
use haptic_emulator::rig::Rig;
use haptic_emulator::run::{MILLISECOND, SECOND};
use haptic_sim::Support;

/// Largest current before any torque is commanded, A. The bridges switch on some ticks after the extreme.
const MAX_CURRENT_AMPERES: f64 = 0.2;

#[test]
fn no_current_flows_when_the_bridges_begin_to_drive() {
    // The windings of this device have 0.1 mH, so currents rise quickly.
    let test_device = rigid_device();
    for rate in [200, 1000, 7000, 20_000] {
        let mut rig = Rig::with_file(BOARD, test_device.file.clone(), |options| {
            options.start = test_device.file.description.home;
        });
        rig.load(&format!("rate_hz = {rate}\n"));
        rig.with_simulated(|device| device.set_support(Support::Held));
        rig.tool.home().expect("the device can be homed");
        // The pauses arm the board at different phases of carrier and step.
        for pause in [0, 3, 11] {
            rig.run(pause * MILLISECOND / 100);
            rig.while_stopped(|stopped| stopped.hardware().peaks = haptic_emulator::plant::Peaks::default());
            rig.tool.check_polarity().expect("the polarity check starts");
            // The torque ramps up only after the joint has rested.
            rig.run(20 * MILLISECOND);
            let (peak, driven) =
                rig.while_stopped(|stopped| (stopped.hardware().peaks.current, !stopped.hardware().bridges_float()));
            let status = rig.tool.status().expect("the board replies");
            assert!(driven && status.fault.is_none(), "not driven without a fault at {rate} Hz: {status:?}");
            assert!(peak < MAX_CURRENT_AMPERES, "a current of {peak} A at {rate} Hz");
            rig.tool.disarm().expect("the board disarms");
            rig.run(5 * MILLISECOND);
        }
    }
}

/// The rate is above the documented limit for three joints. Steps take longer while torque ramps up.
#[test]
fn arming_at_too_high_a_rate_causes_an_overrun() {
    let case = CASES[2];
    for gravity in [true, false] {
        let mut rig = Rig::with_device(case.board, case.device, |_| ());
        rig.prepare("rate_hz = 20000\n");
        rig.set_scene(&format!("rate_hz = 45000\ngravity_compensation = {gravity}\n"));
        rig.tool.arm().expect("the board arms");
        rig.run(SECOND);
        let floats = rig.while_stopped(|stopped| stopped.hardware().bridges_float());
        let status = rig.tool.status().expect("the board replies");
        let fault = status.fault.map(|record| record.fault);
        let expected = if floats { Some(Fault::ControlOverrun) } else { None };
        assert_eq!(fault, expected, "gravity {gravity}: {status:?}");
    }
}

/// The rates are the highest rates of docs/results/timing-rates.csv. Telemetry of every step is streamed.
#[test]
fn boards_arm_at_their_highest_rates_while_streaming() {
    for (case, rate_hz) in [(CASES[0], 30_000), (CASES[2], 30_000), (CASES[4], 30_000)] {
        let mut rig = Rig::with_device(case.board, case.device, |_| ());
        rig.prepare("rate_hz = 20000\n");
        let tip = rig.with_simulated(|device| device.tip());
        let task = rig.file.as_ref().map_or(2, |file| file.spec().task);
        let head = format!("rate_hz = {rate_hz}\ngravity_compensation = true\n");
        rig.set_scene(&scene(&head, tip, task, &[NearWall::with_normal([0.0, -1.0, 0.0])]));
        rig.tool.start_stream(Fields::USUAL, 1).expect("a stream starts");
        rig.run(20 * MILLISECOND);
        rig.arm();
        assert!(rig.while_stopped(|stopped| !stopped.hardware().bridges_float()), "{} at {rate_hz} Hz", case.name());
    }
}
