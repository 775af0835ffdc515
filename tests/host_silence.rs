//! A host that falls silent, and what the rules say about it; a dead man's key that a host tells of, of which they say
//! nothing.

use crate::rig::{RATE, Rig, paddle, quiet};
use haptic_bridge::control::{Beat, Command, HostAction, KEY_SECONDS, Press, Rules};
use haptic_bridge::render::scene::Scene;
use haptic_bridge::safety::fault::{Fault, State};
use haptic_bridge::safety::refusal::Refusal;
use std::collections::VecDeque;

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

    /// A tool's message of its key that is down, told at this very step.
    fn press(&self) -> Press {
        Press { holder: 1, seen: self.control_loop.steps() }
    }

    /// Lets so many tenths of a second pass, the key seen down at the beginning of each; what was said of it last.
    fn holding(&mut self, tenths: u32) -> Press {
        let mut press = self.press();
        for _ in 0..tenths {
            press = self.press();
            self.beat(Beat::Held(press));
            self.run(0.1);
        }
        press
    }
}

/// However long the rules let a host be silent.
fn held(action: HostAction) -> (Rig, Press) {
    let host_seconds = Rules::HOST_SECONDS.1;
    let mut rig = Rig::armed_with(|rules| (rules.host_action, rules.host_seconds) = (action, host_seconds));
    let press = rig.holding(20);
    assert_eq!((rig.state(), rig.fault()), (State::Armed, None), "{action:?}");
    (rig, press)
}

#[test]
fn motors_that_a_key_holds_go_off_when_it_is_not_seen_again_whatever_the_rules_say_of_hosts() {
    type Says = fn(&Rig, Press) -> Option<Beat>;
    // The messages of a queue or a thread that has lost sight of the key: the same again, or an earlier sight.
    let same: Says = |_, last| Some(Beat::Held(last));
    let earlier: Says = |_, last| Some(Beat::Held(Press { seen: last.seen - 10, ..last }));
    // One key has one holder, and tools without a key neither feed it nor let it go.
    let another: Says = |rig, _| Some(Beat::Held(Press { holder: 2, ..rig.press() }));
    let nobody: Says = |_, _| Some(Beat::Here);
    let silence: Says = |_, _| None;
    for (name, action) in HostAction::ALL {
        for says in [[same; 3], [another; 3], [nobody; 3], [silence; 3], [same, earlier, another]] {
            let (mut rig, last) = held(action);
            for tenth in 0..4 {
                says[tenth % 3](&rig, last).into_iter().for_each(|beat| rig.beat(beat));
                rig.run(0.1);
            }
            assert_eq!(rig.state(), State::Armed, "{name}");
            says[1](&rig, last).into_iter().for_each(|beat| rig.beat(beat));
            rig.run(0.01);
            assert_eq!((rig.state(), rig.fault()), (State::Fault, Some(Fault::KeyReleased)), "{name}");
        }
    }
}

#[test]
fn a_key_may_be_silent_no_longer_than_a_host() {
    let mut rig = Rig::armed_with(|rules| rules.host_seconds = 0.2);
    rig.holding(5);
    rig.run(0.11);
    assert_eq!(rig.fault(), Some(Fault::KeyReleased));
}

#[test]
fn a_key_that_is_let_go_of_disarms_and_leaves_no_fault() {
    let (mut rig, _) = held(HostAction::Disarm);
    rig.beat(Beat::Released);
    assert_eq!((rig.state(), rig.fault()), (State::Disarmed, None));
    // The key belongs to that arming: the next one, without a key, has none to lose.
    rig.holding(1);
    rig.execute(Command::Arm).unwrap();
    rig.run(2.0);
    assert_eq!((rig.state(), rig.fault()), (State::Armed, None));
}

/// A disarmed board, ready to arm.
fn ready() -> Rig {
    let mut rig = Rig::armed();
    rig.execute(Command::Disarm).unwrap();
    rig
}

/// A tool that is stopped, or a link that stands still, between the press and the request.
#[test]
fn a_press_that_comes_late_does_not_arm_and_one_that_arms_holds_from_when_it_was_seen() {
    let mut rig = ready();
    let press = rig.press();
    rig.run(0.4);
    rig.execute(Command::ArmHeld(press)).unwrap();
    rig.run(0.09);
    assert_eq!(rig.state(), State::Armed);
    rig.run(0.02);
    assert_eq!(rig.fault(), Some(Fault::KeyReleased));

    let refused = Err(Refusal::KeyTooOld);
    let mut rig = ready();
    let press = rig.press();
    rig.run(0.51);
    assert_eq!(rig.execute(Command::ArmHeld(press)), refused);
    // Telling of it again makes it no younger.
    rig.beat(Beat::Held(press));
    assert_eq!(rig.execute(Command::ArmHeld(press)), refused);
    assert_eq!(rig.execute(Command::ArmHeld(Press { seen: rig.press().seen + 1, ..press })), refused, "not yet been");
    // The duration of steps at another rate is unknown.
    let press = rig.press();
    rig.run(0.1);
    rig.load(&paddle(), &Scene { rate_hz: 2.0 * RATE, ..quiet() }, true).unwrap();
    rig.settle();
    assert_eq!(rig.execute(Command::ArmHeld(press)), refused);
    assert!(rig.motors_off());
    rig.execute(Command::ArmHeld(rig.press())).unwrap();
    rig.holding(10);
    assert_eq!(rig.state(), State::Armed);
}

/// A link that is slow both ways. What its user sees is as old as the way there, what the board hears of the key as old as
/// the way there and back.
#[test]
fn motors_are_off_half_a_second_after_a_key_was_let_go_however_slow_the_link_is() {
    let steps = |seconds: f32| (seconds * RATE) as u32;
    // One way, s, at first and from a second after arming on.
    for (at_first, later) in [(0.0, 0.0), (0.1, 0.1), (0.1, 0.2), (0.0, 0.26), (0.05, 2.0), (0.26, 0.26), (2.0, 2.0)] {
        let mut rig = ready();
        let began = rig.control_loop.steps();
        let (let_go, mut armed, mut off) = (began + steps(3.0), None, None);
        let mut under_way = VecDeque::new();
        while rig.control_loop.steps() < let_go + steps(5.0) {
            let now = rig.control_loop.steps();
            let way = if now < began + steps(1.0) { at_first } else { later };
            if now < let_go && (now - began).is_multiple_of(steps(0.02)) {
                under_way.push_back((now + steps(way), Press { holder: 1, seen: now.saturating_sub(steps(way)) }));
            }
            while let Some((_, press)) = under_way.pop_front_if(|(due, _)| *due <= now) {
                match armed {
                    None if rig.execute(Command::ArmHeld(press)).is_ok() => armed = Some(now),
                    None => assert!(rig.motors_off()),
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
            assert!(off <= let_go + steps(KEY_SECONDS) + 1, "{case}: {} steps late", off - let_go);
            assert_eq!(off > let_go, 2.0 * later < KEY_SECONDS, "{case}: a link that is fast enough holds them on");
        }
        assert_eq!((armed.is_some(), rig.motors_off()), (off.is_some(), true), "{case}");
    }
}
