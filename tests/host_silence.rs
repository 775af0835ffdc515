//! A silent host, to which the board reacts as the rules say, and a dead man's key, which acts under all rules.

use crate::rig::{RATE_HZ, Rig, far_wall, paddle};
use haptic_bridge::control::{Beat, Command, HostAction, KEY_SECONDS, Press, Rules};
use haptic_bridge::render::scene::Scene;
use haptic_bridge::safety::fault::{Fault, State};
use haptic_bridge::safety::refusal::Refusal;
use std::collections::VecDeque;

#[test]
fn a_fault_replaces_the_entry_of_a_silent_host() {
    let mut rig = Rig::armed_with_rules(|rules| rules.host_action = HostAction::Hold);
    rig.run(0.6);
    assert_eq!((rig.state(), rig.fault()), (State::Armed, Some(Fault::HostLost)));
    rig.shown_current = Some(9.0);
    rig.step();
    assert_eq!((rig.state(), rig.fault()), (State::Fault, Some(Fault::OverCurrent)));
}

#[test]
fn a_silent_host_has_no_effect_unless_the_rules_say_so() {
    let mut rig = Rig::armed_paddle();
    rig.run(5.0);
    assert_eq!((rig.state(), rig.fault()), (State::Armed, None));
}

#[test]
fn a_heartbeat_keeps_the_motors_on() {
    let mut rig = Rig::armed_with_rules(|rules| rules.host_action = HostAction::Disarm);
    for _ in 0..20 {
        rig.execute(Command::Beat(Beat::Here)).unwrap();
        rig.run(0.4);
    }
    assert_eq!(rig.state(), State::Armed);
}

#[test]
fn clearing_restarts_the_time_of_a_silent_host() {
    let mut rig = Rig::armed_with_rules(|rules| rules.host_action = HostAction::Hold);
    rig.run(0.6);
    rig.execute(Command::Clear).unwrap();
    rig.run(0.3);
    assert_eq!((rig.state(), rig.fault()), (State::Armed, None), "clearing is a sign of life");
    rig.run(0.3);
    assert_eq!(rig.fault(), Some(Fault::HostLost));
    rig.execute(Command::Disarm).unwrap();
    assert!(rig.execute(Command::Arm).is_err(), "arming waits until the fault is cleared");
}

impl Rig {
    pub fn beat(&mut self, beat: Beat) {
        self.execute(Command::Beat(beat)).expect("never refused");
    }

    /// Returns the message of a tool whose key is pressed at this step.
    pub fn press(&self) -> Press {
        Press { holder: 1, seen: self.control_loop.steps() }
    }

    /// Presses the key for `tenths` tenths of a second, with a message at the start of each. Returns the last message.
    pub fn hold_key(&mut self, tenths: u32) -> Press {
        let mut press = self.press();
        for _ in 0..tenths {
            press = self.press();
            self.beat(Beat::Held(press));
            self.run(0.1);
        }
        press
    }
}

/// Returns a rig that was armed with a key and has the longest host time, and the last message of the key.
fn armed_with_key(action: HostAction) -> (Rig, Press) {
    let host_seconds = Rules::HOST_SECONDS.1;
    let mut rig = Rig::armed_with_rules(|rules| (rules.host_action, rules.host_seconds) = (action, host_seconds));
    let press = rig.hold_key(20);
    assert_eq!((rig.state(), rig.fault()), (State::Armed, None), "{action:?}");
    (rig, press)
}

#[test]
fn motors_go_off_without_new_messages_of_the_key() {
    type Sender = fn(&Rig, Press) -> Option<Beat>;
    // A queue or thread that no longer reads the key repeats the last message or sends an earlier message.
    let same: Sender = |_, last| Some(Beat::Held(last));
    let earlier: Sender = |_, last| Some(Beat::Held(Press { seen: last.seen - 10, ..last }));
    // A key has one holder, so messages of other holders and of tools without a key do not count.
    let another: Sender = |rig, _| Some(Beat::Held(Press { holder: 2, ..rig.press() }));
    let keyless: Sender = |_, _| Some(Beat::Here);
    let silence: Sender = |_, _| None;
    for (name, action) in HostAction::ALL {
        for senders in [[same; 3], [another; 3], [keyless; 3], [silence; 3], [same, earlier, another]] {
            let (mut rig, last) = armed_with_key(action);
            for tenth in 0..4 {
                senders[tenth % 3](&rig, last).into_iter().for_each(|beat| rig.beat(beat));
                rig.run(0.1);
            }
            assert_eq!(rig.state(), State::Armed, "{name}");
            senders[1](&rig, last).into_iter().for_each(|beat| rig.beat(beat));
            rig.run(0.01);
            assert_eq!((rig.state(), rig.fault()), (State::Fault, Some(Fault::KeyReleased)), "{name}");
        }
    }
}

#[test]
fn a_key_may_not_be_silent_longer_than_a_host() {
    let mut rig = Rig::armed_with_rules(|rules| rules.host_seconds = 0.2);
    rig.hold_key(5);
    rig.run(0.11);
    assert_eq!(rig.fault(), Some(Fault::KeyReleased));
}

#[test]
fn a_released_key_disarms_without_a_fault() {
    let (mut rig, _) = armed_with_key(HostAction::Disarm);
    rig.beat(Beat::Released);
    assert_eq!((rig.state(), rig.fault()), (State::Disarmed, None));
    // The key belongs to one arming, so the next arming without a key does not need it.
    rig.hold_key(1);
    rig.execute(Command::Arm).unwrap();
    rig.run(2.0);
    assert_eq!((rig.state(), rig.fault()), (State::Armed, None));
}

fn disarmed_rig() -> Rig {
    let mut rig = Rig::armed_paddle();
    rig.execute(Command::Disarm).unwrap();
    rig
}

/// A stopped tool or a slow link can delay the request after the press.
#[test]
fn a_press_counts_from_its_step_and_an_old_press_does_not_arm() {
    let mut rig = disarmed_rig();
    let press = rig.press();
    rig.run(0.4);
    rig.execute(Command::ArmHeld(press)).unwrap();
    rig.run(0.09);
    assert_eq!(rig.state(), State::Armed);
    rig.run(0.02);
    assert_eq!(rig.fault(), Some(Fault::KeyReleased));

    let refused = Err(Refusal::KeyTooOld);
    let mut rig = disarmed_rig();
    let press = rig.press();
    rig.run(0.51);
    assert_eq!(rig.execute(Command::ArmHeld(press)), refused);
    // A repeated message does not make the press newer.
    rig.beat(Beat::Held(press));
    assert_eq!(rig.execute(Command::ArmHeld(press)), refused);
    assert_eq!(rig.execute(Command::ArmHeld(Press { seen: rig.press().seen + 1, ..press })), refused, "in the future");
    // After a change of the control rate the age of the press is unknown.
    let press = rig.press();
    rig.run(0.1);
    rig.load(&paddle(), &Scene { rate_hz: 2.0 * RATE_HZ, ..far_wall() }, true).unwrap();
    rig.settle();
    assert_eq!(rig.execute(Command::ArmHeld(press)), refused);
    assert!(rig.motors_are_off());
    rig.execute(Command::ArmHeld(rig.press())).unwrap();
    rig.hold_key(10);
    assert_eq!(rig.state(), State::Armed);
}

/// The link delays both directions. The tool sees the board one delay late, and the board sees the key two delays late.
#[test]
fn motors_are_off_half_a_second_after_a_release_on_any_link() {
    let steps = |seconds: f32| (seconds * RATE_HZ) as u32;
    // Delay in each direction, in the first second and later, s.
    for (at_first, later) in [(0.0, 0.0), (0.1, 0.1), (0.1, 0.2), (0.0, 0.26), (0.05, 2.0), (0.26, 0.26), (2.0, 2.0)] {
        let mut rig = disarmed_rig();
        let began = rig.control_loop.steps();
        let (released, mut armed, mut off) = (began + steps(3.0), None, None);
        let mut in_transit = VecDeque::new();
        while rig.control_loop.steps() < released + steps(5.0) {
            let now = rig.control_loop.steps();
            let delay = if now < began + steps(1.0) { at_first } else { later };
            if now < released && (now - began).is_multiple_of(steps(0.02)) {
                in_transit.push_back((now + steps(delay), Press { holder: 1, seen: now.saturating_sub(steps(delay)) }));
            }
            while let Some((_, press)) = in_transit.pop_front_if(|(due, _)| *due <= now) {
                match armed {
                    None if rig.execute(Command::ArmHeld(press)).is_ok() => armed = Some(now),
                    None => assert!(rig.motors_are_off()),
                    Some(_) => rig.beat(Beat::Held(press)),
                }
            }
            rig.step();
            if armed.is_some() && rig.state() != State::Armed {
                off = off.or(Some(rig.control_loop.steps()));
            }
        }
        let case = format!("{at_first} s, {later} s");
        assert_eq!(armed.is_some(), 2.0 * at_first < KEY_SECONDS, "{case}");
        if let Some(off) = off {
            assert!(off <= released + steps(KEY_SECONDS) + 1, "{case}: motors off {} steps late", off - released);
            assert_eq!(off > released, 2.0 * later < KEY_SECONDS, "{case}: a fast link must keep the motors on");
        }
        assert_eq!((armed.is_some(), rig.motors_are_off()), (off.is_some(), true), "{case}");
    }
}
