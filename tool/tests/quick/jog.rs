//! A joint that is moved while a key is held: how far it goes, what ends it, and that the motors are off then.

use crate::common::sim::{Sim, haptic};
use crate::common::strict::strict;
use haptic_bridge::render::scene::{Scene, Spring};
use haptic_bridge::safety::fault::{Fault, State};
use haptic_host::device_file::DeviceFile;
use haptic_host::error::{Blame, Failure};
use haptic_host::link::{Board, Session};
use haptic_predict::jog::{Ended, Jog, Jogged, Key, Plan, run};
use haptic_sim::{BoardOptions, Hand, HandSettings, Intent, SHIPPED_DEVICE, SharedBoard, Waypoint, ready_board};
use predicates::str::contains;

const JOG: Jog = Jog { joint: 0, by: 0.1, speed: 0.2, share: 0.2 };

/// A five-bar in free space, changed before it is there; its joints go from 0.6 to 2.5 rad.
fn device(change: impl FnOnce(&mut DeviceFile)) -> (SharedBoard, Session) {
    let mut file = DeviceFile::parse(SHIPPED_DEVICE, "coupled-five-bar.toml").unwrap();
    file.description.joints[..2].iter_mut().for_each(|joint| joint.limits = Some((0.6, 2.5)));
    change(&mut file);
    let shared = SharedBoard::new(ready_board(&file, BoardOptions::default()).unwrap());
    let mut session = Session::of(Board::over(shared.wire(), "sim").unwrap());
    session.home().unwrap();
    (shared, session)
}

/// A key that is down from the third look on, for so many of them.
fn held(looks: usize) -> impl FnMut(u32) -> Option<Key> {
    let mut look = 0;
    move |step| {
        look += 1;
        (look > 2).then(|| if look - 2 <= looks { Key::Down(step) } else { Key::Up })
    }
}

/// Moves the joint; the motors are off afterwards, whatever happened.
fn jogged(shared: &SharedBoard, session: &mut Session, jog: Jog, mut key: impl FnMut(u32) -> Option<Key>) -> Jogged {
    let plan = Plan::new(session, jog).unwrap();
    let done = run(session, &plan, |step| Ok(key(step)));
    let board = shared.lock();
    assert!(!board.status().state.drives(), "{done:?}: {:?}", board.status());
    drop(board);
    done
}

#[test]
fn a_joint_goes_its_way_slowly_and_the_other_motor_does_nothing() {
    for counts in [2000.0, 20_000.0] {
        for (joint, by) in [(0, 0.1), (0, -0.3), (1, -0.1), (1, 0.2)] {
            let (shared, mut session) = device(|file| {
                file.description.joints.iter_mut().filter_map(|joint| joint.encoder.as_mut()).for_each(|encoder| {
                    encoder.counts_per_turn = counts;
                });
            });
            let (start, mut down) = (shared.lock().device().q(), held(usize::MAX / 2));
            let (mut fastest, mut other) = (0.0_f64, 0.0_f64);
            let done = jogged(&shared, &mut session, Jog { joint, by, ..JOG }, |step| {
                let board = shared.lock();
                fastest = fastest.max(board.device().qd()[joint].abs());
                other = other.max(board.device().currents()[1 - joint].abs());
                drop(board);
                down(step)
            });
            assert_eq!(done.ended, Ok(Ended::Arrived));
            let (told, moved) = (done.moved.unwrap(), shared.lock().device().q()[joint] - start[joint]);
            assert!((moved - by).abs() < 0.006 && (told - moved).abs() < 0.004, "{told} and {moved} of {by} rad");
            assert!(fastest < 2.0 * JOG.speed, "{fastest} rad/s");
            // Its own movement's back-EMF is all that the current loop has to hold down.
            assert!(other < 0.01, "{other} A");
            assert_eq!(session.status().unwrap().state, State::Disarmed);
        }
    }
}

#[test]
fn a_board_that_asks_for_what_a_real_one_asks_for_lets_a_homed_device_be_moved() {
    let (shared, mut session) = strict();
    let done = jogged(&shared, &mut session, JOG, held(usize::MAX / 2));
    assert_eq!(done.ended, Ok(Ended::Arrived));
    assert!((done.moved.unwrap() - JOG.by).abs() < 0.006, "{:?}", done.moved);
    assert_eq!(shared.lock().status().state, State::Disarmed);
}

#[test]
fn a_key_that_is_let_go_ends_it_and_so_does_one_that_nobody_hears_of() {
    let (shared, mut session) = device(|_| {});
    let done = jogged(&shared, &mut session, Jog { by: -0.3, ..JOG }, held(90));
    assert_eq!(done.ended, Ok(Ended::Released));
    assert!((-0.2..-0.02).contains(&done.moved.unwrap()), "{done:?}");
    assert_eq!(session.status().unwrap().state, State::Disarmed);
    // Whoever watches the key hangs: the board lets go by itself.
    let mut down = held(1);
    let done = jogged(&shared, &mut session, JOG, |step| down(step).filter(|key| matches!(key, Key::Down(_))));
    assert!(done.moved.unwrap().abs() < 0.01, "{done:?}");
    let said = done.ended.unwrap_err().to_string();
    assert!(said.contains(&Fault::KeyReleased.to_string()), "{said}");
    session.clear().unwrap();
    // Nobody presses it.
    let plan = Plan::new(&mut session, JOG).unwrap();
    let done = run(&mut session, &plan, |_| Ok(Some(Key::End)));
    assert_eq!((done.ended, done.moved), (Ok(Ended::Stopped), None));
}

#[test]
fn a_motor_that_turns_the_other_way_is_off_before_the_joint_has_gone_far() {
    for by in [0.1, -0.1] {
        let (shared, mut session) = device(|_| {});
        shared.lock().broken_mut().reversed[0] = true;
        let done = jogged(&shared, &mut session, Jog { by, ..JOG }, held(usize::MAX / 2));
        let ended = done.ended.unwrap();
        assert!(matches!(ended, Ended::Backward | Ended::TooFast), "{ended:?}");
        assert!(ended.in_words().is_err() && done.moved.unwrap().abs() < 0.1, "{:?}", done.moved);
    }
}

#[test]
fn a_joint_that_runs_away_and_one_that_moves_by_itself_end_it() {
    // A hand pulls at the tip. Where the joint asked for sticks, the other one alone gives way.
    for (coulomb, expected) in [(0.005, Ended::TooFast), (5.0, Ended::Other(1))] {
        let (shared, mut session) = device(|file| file.description.joints[0].coulomb = coulomb);
        {
            let mut board = shared.lock();
            let (tip, now) = (board.device().tip(), board.time());
            let push = Intent::Push(vec![
                Waypoint { time: 0.8, value: [0.0; 3] },
                Waypoint { time: 0.9, value: [-2.0, 0.0, 0.0] },
            ]);
            board.device_mut().set_hand(Hand::new(HandSettings::default(), push, tip, now));
        }
        let done = jogged(&shared, &mut session, JOG, held(usize::MAX / 2));
        let ended = done.ended.unwrap();
        assert_eq!(ended, expected);
        assert!(ended.in_words().is_err() && done.moved.unwrap().abs() < 0.1, "{:?}", done.moved);
    }
}

#[test]
fn a_joint_that_stands_against_something_is_told_in_words() {
    let (shared, mut session) = device(|file| file.description.joints[0].coulomb = 0.5);
    let done = jogged(&shared, &mut session, JOG, held(usize::MAX / 2));
    assert_eq!(done.ended, Ok(Ended::Stuck));
    assert!(done.moved.unwrap().abs() < 0.001, "{:?}", done.moved);
    let said = Ended::Stuck.in_words().unwrap_err().to_string();
    assert!(said.contains("stands against something, or friction is more"), "{said}");
    // 0.2 of 2 N m is less than its friction, and 0.5 is more.
    let done = jogged(&shared, &mut session, Jog { share: 0.4, ..JOG }, held(usize::MAX / 2));
    assert_eq!(done.ended, Ok(Ended::Arrived));
}

#[test]
fn what_must_not_begin_is_refused_with_the_motors_off() {
    let (shared, mut session) = device(|_| {});
    let refused = |session: &mut Session, jog: Jog, blame: Blame, says: &str| {
        let failure: Failure = Plan::new(session, jog).unwrap_err();
        assert!(failure.to_string().contains(says) && failure.blame() == blame, "{failure}");
        assert_eq!(shared.lock().status().state, State::Disarmed);
    };
    for (jog, says) in [
        (Jog { joint: 2, ..JOG }, "the joints of coupled-five-bar are 0 to 1"),
        (Jog { by: 0.0, ..JOG }, "the way is"),
        (Jog { by: f64::NAN, ..JOG }, "the way is"),
        (Jog { by: -1.5, ..JOG }, "the way is"),
        (Jog { speed: 0.0, ..JOG }, "the speed is"),
        (Jog { speed: f64::INFINITY, ..JOG }, "the speed is"),
        (Jog { share: 0.6, ..JOG }, "the share"),
        (Jog { share: -0.1, ..JOG }, "the share"),
    ] {
        refused(&mut session, jog, Blame::Request, says);
    }
    // Home is at 2.3 and 0.84 rad.
    refused(&mut session, Jog { by: 0.21, ..JOG }, Blame::World, "its limits are 0.6 and 2.5");
    refused(&mut session, Jog { joint: 1, by: -0.25, ..JOG }, Blame::World, "its limits are 0.6 and 2.5");
    let mut rules = session.rules().unwrap();
    rules.limits.speed[0] = 0.3;
    session.set_rules(&rules).unwrap();
    refused(&mut session, JOG, Blame::Request, "the rules let joint 0 go 0.3");
    let mut scene = Scene { task: 2, ..Scene::default() };
    scene.springs.push(Spring { point: [0.0, 0.1, 0.0], direction: [0.0; 3], stiffness: 50.0, damping: 0.0 }).unwrap();
    session.set_scene(&scene).unwrap();
    refused(&mut session, Jog { joint: 1, ..JOG }, Blame::World, "free space");
    session.set_scene(&Scene { task: 2, ..Scene::default() }).unwrap();
    session.arm().unwrap();
    let failure = Plan::new(&mut session, Jog { speed: 0.1, ..JOG }).unwrap_err();
    assert!(failure.to_string().contains("the motors are on already"), "{failure}");
    session.disarm().unwrap();
    // Somebody moves the device between the plan and the key.
    let plan = Plan::new(&mut session, Jog { by: 0.15, speed: 0.1, ..JOG }).unwrap();
    shared.lock().device_mut().push([1.0, 0.0, 0.0]);
    shared.lock().run(0.1);
    let mut down = held(usize::MAX / 2);
    let done = run(&mut session, &plan, |step| Ok(down(step)));
    assert!(done.ended.unwrap_err().to_string().contains("its limits") && done.moved.is_none());
    assert_eq!(shared.lock().status().state, State::Disarmed);
}

#[test]
fn the_command_wants_a_terminal_and_says_what_is_wrong() {
    let sim = Sim::start(&[]);
    let typed = |words: &str| sim.run(&words.split(' ').collect::<Vec<_>>()).code(2);
    typed("jog --joint 0").stderr(contains("needs a terminal"));
    typed("jog --joint 0 --by 3").stderr(contains("the way is 3 rad"));
    typed("jog --joint 3").stderr(contains("--joint"));
    typed("jog").stderr(contains("--joint"));
    haptic(&["jog", "--joint", "0", "--port", "sim"]).assert().code(2).stderr(contains("run `haptic sim`"));
}
