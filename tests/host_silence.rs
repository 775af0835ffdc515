//! A host that falls silent, and what the rules say about it; a dead man's key that a host tells of, of which they say
//! nothing.

use crate::rig::Rig;
use haptic_bridge::safety::fault::{Fault, State};
use haptic_bridge::servo::{Beat, Command, HostAction, Rules};

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
        rig.execute(Command::Beat(Beat::Here)).unwrap();
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

impl Rig {
    fn beat(&mut self, beat: Beat) {
        self.execute(Command::Beat(beat)).expect("never refused");
    }

    /// Lets so many tenths of a second pass, with a beat in each.
    fn beating(&mut self, tenths: u32, beat: impl Fn(u32) -> Beat) {
        for tenth in 0..tenths {
            self.beat(beat(tenth));
            self.run(0.1);
        }
    }
}

/// However long the rules let a host be silent.
fn held(action: HostAction) -> Rig {
    let host_seconds = Rules::HOST_SECONDS.1;
    let mut rig = Rig::armed_with(|rules| (rules.host_action, rules.host_seconds) = (action, host_seconds));
    // Counters wrap.
    rig.beating(20, |tenth| Beat::Held(tenth.wrapping_sub(10)));
    assert_eq!((rig.state(), rig.fault()), (State::Armed, None), "{action:?}");
    rig
}

#[test]
fn motors_that_a_key_holds_go_off_when_its_counter_stands_still_whatever_the_rules_say_of_hosts() {
    for (name, action) in HostAction::ALL {
        // The same number again and again is what a queue or a thread says that has lost sight of the key; beats of
        // tools without a key neither feed it nor let it go; and silence is silence.
        for beats in
            [[Some(Beat::Held(9)); 3], [Some(Beat::Here); 3], [None; 3], [Some(Beat::Held(9)), Some(Beat::Here), None]]
        {
            let mut rig = held(action);
            for tenth in 0..4 {
                beats[tenth % 3].into_iter().for_each(|beat| rig.beat(beat));
                rig.run(0.1);
            }
            assert_eq!(rig.state(), State::Armed, "{name}, {beats:?}");
            beats[1].into_iter().for_each(|beat| rig.beat(beat));
            rig.run(0.11);
            assert_eq!((rig.state(), rig.fault()), (State::Fault, Some(Fault::KeyReleased)), "{name}, {beats:?}");
        }
    }
}

#[test]
fn a_key_may_stand_still_no_longer_than_a_host_may_be_silent() {
    let mut rig = Rig::armed_with(|rules| rules.host_seconds = 0.2);
    rig.beating(5, Beat::Held);
    rig.run(0.11);
    assert_eq!(rig.fault(), Some(Fault::KeyReleased));
}

#[test]
fn a_key_that_is_let_go_of_disarms_and_leaves_no_fault() {
    let mut rig = held(HostAction::Disarm);
    rig.beat(Beat::Released);
    assert_eq!((rig.state(), rig.fault()), (State::Disarmed, None));
    // The key belongs to that arming: the next one, without a key, has none to lose.
    rig.execute(Command::Arm).unwrap();
    rig.run(2.0);
    assert_eq!((rig.state(), rig.fault()), (State::Armed, None));
}

#[test]
fn a_key_that_was_told_of_just_before_arming_holds_from_the_first_step_on() {
    let mut rig = Rig::armed();
    rig.execute(Command::Disarm).unwrap();
    rig.beat(Beat::Held(1));
    rig.run(0.1);
    rig.execute(Command::Arm).unwrap();
    rig.run(0.39);
    assert_eq!(rig.state(), State::Armed);
    rig.run(0.02);
    assert_eq!(rig.fault(), Some(Fault::KeyReleased));
    // One that is older says nothing of who arms now.
    rig.execute(Command::Clear).unwrap();
    rig.beat(Beat::Held(2));
    rig.run(0.6);
    rig.execute(Command::Arm).unwrap();
    rig.run(2.0);
    assert_eq!((rig.state(), rig.fault()), (State::Armed, None));
}
