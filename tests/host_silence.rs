//! A host that falls silent, and what the rules say about it.

use crate::rig::Rig;
use haptic_bridge::safety::fault::{Fault, State};
use haptic_bridge::servo::{Command, HostAction};

#[test]
fn a_fault_while_the_host_is_only_listed_as_silent_is_told_as_itself() {
    let mut rig = Rig::armed_with(|rules| rules.host_action = HostAction::Hold);
    rig.run(0.6);
    assert_eq!((rig.state(), rig.fault()), (State::Armed, Some(Fault::HostLost)));
    rig.shown_current = Some(9.0);
    rig.step();
    assert_eq!((rig.state(), rig.fault()), (State::Fault, Some(Fault::OverCurrent)));
}

#[test]
fn a_silent_host_does_nothing_unless_the_rules_say_so() {
    let mut rig = Rig::armed();
    rig.run(5.0);
    assert_eq!((rig.state(), rig.fault()), (State::Armed, None));
}

#[test]
fn a_heartbeat_keeps_the_motors_on() {
    let mut rig = Rig::armed_with(|rules| rules.host_action = HostAction::Disarm);
    for _ in 0..20 {
        rig.execute(Command::HostAlive).unwrap();
        rig.run(0.4);
    }
    assert_eq!(rig.state(), State::Armed);
}

#[test]
fn a_silent_host_held_over_clears_and_comes_again_only_after_its_time() {
    let mut rig = Rig::armed_with(|rules| rules.host_action = HostAction::Hold);
    rig.run(0.6);
    rig.execute(Command::Clear).unwrap();
    rig.run(0.3);
    assert_eq!((rig.state(), rig.fault()), (State::Armed, None), "clearing is a sign of life");
    rig.run(0.3);
    assert_eq!(rig.fault(), Some(Fault::HostLost));
    rig.execute(Command::Disarm).unwrap();
    assert!(rig.execute(Command::Arm).is_err(), "arming waits until it is cleared");
}
