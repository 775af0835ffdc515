//! Homing by index marks and by stops. tool/tests/quick/homing.rs pushes simulated devices against their stops.

use crate::rig::{COUNTS_PER_TURN, Rig, far_wall, hardware, paddle, paddle_with_stop, rules};
use core::f64::consts::TAU;
use haptic_bridge::control::Command;
use haptic_bridge::model::description::{Description, Homing};
use haptic_bridge::safety::fault::{Fault, State};
use haptic_bridge::safety::refusal::Refusal;

/// True joint angle at count 0, rad.
const START: f64 = -0.2;
/// True angle of an index mark, rad.
const MARK: f64 = 0.3;
const TURN: i32 = COUNTS_PER_TURN as i32;

/// Returns a rig whose file says that an index mark is at `offset` (rad), with this number of counts between two marks.
fn rig_with_index(offset: f64, period: i32) -> Rig {
    let mut description = Description { homing: Homing::Index, ..paddle() };
    description.joints[0].encoder.as_mut().expect("an encoder").offset = offset;
    let mut rules = rules();
    rules.index_period[0] = period;
    let mut rig = Rig::without_device(hardware(), rules);
    rig.execute(Command::Rules(rules)).expect("rules");
    rig.load(&description, &far_wall(), false).expect("a program that fits");
    rig.settle();
    rig
}

/// Turns the joint to the true angle `angle` (rad) at `speed` (rad/s).
fn turn_to(rig: &mut Rig, angle: f64, speed: f64) {
    rig.turn(0, angle - START, speed);
}

/// Turns the joint to its mark at `speed` (rad/s).
fn pass_mark(rig: &mut Rig, speed: f64) {
    turn_to(rig, MARK - 0.02, 1.0);
    turn_to(rig, MARK, speed);
    rig.marks = Some([Some(rig.samples.counts[0]), None, None]);
    // The step of the pulse is as fast as those before it.
    rig.samples.counts[0] += (speed / TAU * COUNTS_PER_TURN / f64::from(rig.rate)) as i32;
    rig.step();
}

fn angle_error(rig: &mut Rig) -> f64 {
    rig.step();
    let shown = f64::from(rig.control_loop.status().q[0]);
    (shown - START - f64::from(rig.samples.counts[0]) * TAU / COUNTS_PER_TURN).abs()
}

#[test]
fn an_index_mark_homes_a_joint_that_passes_it_slowly() {
    let mut rig = rig_with_index(MARK, TURN);
    for command in [|| Command::Home, || Command::CheckPolarity, || Command::Arm] {
        assert_eq!(rig.execute(command()), Err(Refusal::IndexUnseen(0)));
    }
    pass_mark(&mut rig, 10.0);
    assert_eq!(rig.execute(Command::Home), Err(Refusal::IndexUnseen(0)), "a fast pulse is late");
    turn_to(&mut rig, 0.0, 1.0);
    pass_mark(&mut rig, 0.2);
    rig.execute(Command::Home).expect("homed");
    let error = angle_error(&mut rig);
    assert!(rig.control_loop.status().homed && error < 1.1 * TAU / COUNTS_PER_TURN, "{error} rad");
    // Lost counts show at the next pass of the mark, and need the mark again.
    turn_to(&mut rig, MARK + 0.01, 0.2);
    rig.marks = Some([Some(rig.samples.counts[0]), None, None]);
    rig.step();
    assert_eq!((rig.fault(), rig.control_loop.status().homed), (Some(Fault::IndexMismatch), false));
    rig.execute(Command::Clear).unwrap();
    assert_eq!(rig.execute(Command::Home), Err(Refusal::IndexUnseen(0)));
}

#[test]
fn limits_settle_the_turn_of_an_index_mark_or_homing_is_refused() {
    // The encoder turns ten times in a turn of the joint, so its marks are 0.63 rad apart.
    let mut rig = rig_with_index(MARK - TAU / 10.0, TURN / 10);
    pass_mark(&mut rig, 0.2);
    assert_eq!(rig.execute(Command::Home), Err(Refusal::IndexAmbiguous(0)));
    turn_to(&mut rig, -0.95, 1.0);
    turn_to(&mut rig, 0.95, 1.0);
    rig.execute(Command::Home).expect("homed");
    assert!(angle_error(&mut rig) < 1.1 * TAU / COUNTS_PER_TURN);
    // The only mark of this encoder is elsewhere than the file says.
    let mut rig = rig_with_index(MARK + 0.6, TURN);
    pass_mark(&mut rig, 0.2);
    turn_to(&mut rig, 0.95, 1.0);
    assert_eq!(rig.execute(Command::Home), Err(Refusal::IndexOutside(0)));
    assert_eq!(rig.execute(Command::Home), Err(Refusal::IndexUnseen(0)), "a wrong mark is forgotten");
    assert_eq!(rig_with_index(MARK, 0).execute(Command::Home), Err(Refusal::NoIndexPeriod(0)));
}

#[test]
fn homing_by_stops_needs_polarity_and_a_held_key() {
    let mut rig = Rig::without_device(hardware(), rules());
    rig.load(&paddle_with_stop(), &far_wall(), false).unwrap();
    rig.settle();
    let find = |rig: &mut Rig| rig.execute(Command::FindStops(rig.press()));
    assert_eq!(find(&mut rig), Err(Refusal::NotHomed));
    rig.execute(Command::Home).expect("at rest");
    assert!(!rig.control_loop.status().homed);
    assert_eq!(find(&mut rig), Err(Refusal::PolarityUnchecked));
    rig.execute(Command::PolarityKnown).unwrap();
    assert_eq!(rig.execute(Command::Arm), Err(Refusal::StopsUntouched));
    let old = rig.press();
    rig.run(0.6);
    assert_eq!(rig.execute(Command::FindStops(old)), Err(Refusal::KeyTooOld));
    find(&mut rig).expect("ready");
    rig.hold_key(3);
    assert_eq!(rig.state(), State::Homing);
    rig.run(0.35);
    assert_eq!(rig.state(), State::Homing);
    rig.run(0.1);
    assert_eq!((rig.fault(), rig.control_loop.status().homed), (Some(Fault::KeyReleased), false));
    assert!(rig.motors_are_off());
    rig.execute(Command::Clear).unwrap();
    assert_eq!(rig.execute(Command::Arm), Err(Refusal::StopsUntouched));
}
