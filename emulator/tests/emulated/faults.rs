//! Failing gate drivers. injection.rs causes all other faults.

use haptic_bridge::safety::fault::{Fault, State};
use haptic_bridge::safety::refusal::Refusal;
use haptic_emulator::boards::BoardKind;
use haptic_emulator::rig::Rig;
use haptic_emulator::run::{MILLISECOND, SECOND};
use haptic_host::link::BoardError;
use haptic_sim::MotorInput;

use crate::session::WALL;

#[test]
fn the_fault_line_of_one_gate_driver_stops_both_axes() {
    let mut rig = Rig::with_device(BoardKind::OdriveV3, "pantograph-mk2", |_| ());
    rig.load(WALL);
    rig.home_and_arm();
    rig.while_stopped(|stopped| stopped.hardware().driver(1).latch_fault(1 << 2));
    rig.run(50 * MILLISECOND);
    let status = rig.tool.status().expect("the board replies");
    assert_eq!((status.state, status.fault.map(|record| record.fault)), (State::Fault, Some(Fault::GateDriver)));
    let motor_inputs = rig.while_stopped(|stopped| stopped.hardware().motor_inputs());
    assert_eq!(motor_inputs, [MotorInput::Floating; 3]);
    // The low level of EN_GATE has cleared the driver's fault, so the board can be armed again.
    rig.tool.clear().expect("the fault clears");
    rig.tool.arm().expect("the board arms");
    rig.run(SECOND);
    assert_eq!(rig.tool.status().expect("it replies").state, State::Armed);
}

/// Gate drivers without a supply would latch a fault, but a refused request does not reach them.
#[test]
fn refused_requests_do_not_reach_the_gate_drivers() {
    let mut rig = Rig::with_device(BoardKind::OdriveV3, "pantograph-mk2", |_| ());
    rig.load(WALL);
    rig.while_stopped(|stopped| stopped.hardware().driver(0).ignore_writes(true));
    for outcome in [rig.tool.arm(), rig.tool.check_polarity()] {
        assert!(matches!(outcome, Err(BoardError::Refused(Refusal::NotHomed))), "{outcome:?}");
    }
    let status = rig.tool.status().expect("it replies");
    assert_eq!((status.state, status.fault), (State::Disarmed, None));
}

#[test]
fn a_gate_driver_that_loses_its_settings_is_never_armed() {
    let mut rig = Rig::with_device(BoardKind::OdriveV3, "pantograph-mk2", |_| ());
    rig.load(WALL);
    rig.tool.home().expect("homed");
    rig.while_stopped(|stopped| stopped.hardware().driver(0).ignore_writes(true));
    let outcome = rig.tool.check_polarity();
    rig.run(SECOND / 2);
    let status = rig.tool.status().expect("it replies");
    let refused = matches!(outcome, Err(BoardError::Refused(_)));
    assert!(refused || status.state == State::Fault, "neither a refusal nor a fault: {outcome:?} {status:?}");
    assert!(!status.polarity);
    let motor_inputs = rig.while_stopped(|stopped| stopped.hardware().motor_inputs());
    assert_eq!(motor_inputs, [MotorInput::Floating; 3]);
}
