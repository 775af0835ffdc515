//! Sessions of programs: replies, forces, and motors that go off when the session ends.

use crate::common::strict::{LossyWire, strict_board};
use crate::common::{board, json, shipped_device, type_lines};
use haptic_bridge::board::protocol::{ForceDone, ForceRequest, HostContact};
use haptic_bridge::render::scene::Scene;
use haptic_bridge::safety::fault::{Fault, State};
use haptic_host::latency::measure;
use haptic_host::link::{Board, FADE_S, FORCE_PATIENCE, HOLD_S, LinkError, PATIENCE, Session, fields};
use haptic_sim::{BoardOptions, Hand, HandSettings, Intent, NoisyWire, SharedBoard, Waypoint};
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;

/// Returns a simulated board with a five-bar in free space, and a session on it.
fn board_and_session() -> (SharedBoard, Session) {
    let (shared, board) = board(&shipped_device("coupled-five-bar"), BoardOptions::default());
    let mut session = Session::of(board);
    session.set_scene(&Scene { task: 2, ..Scene::default() }).unwrap();
    (shared, session)
}

/// Returns a session over a wire that loses messages, and the number of next messages to lose.
fn lossy_session() -> (Session, Arc<AtomicU32>) {
    LossyWire::session(&board(&shipped_device("coupled-five-bar"), BoardOptions::default()).0)
}

#[test]
fn a_lost_frame_delays_one_force_by_its_timeout() {
    let (mut session, loses) = lossy_session();
    for patience in [FORCE_PATIENCE, Duration::from_millis(5)] {
        session.wait_for_forces(patience);
        loses.store(u32::MAX, Ordering::Relaxed);
        let start = session.now();
        let error = session.read_state().unwrap_err();
        assert!(matches!(error, LinkError::Unanswered { waited } if waited == patience), "{error}");
        let waited = session.now() - start;
        assert!(waited >= patience && waited < patience + Duration::from_millis(2), "{waited:?} of {patience:?}");
        loses.store(0, Ordering::Relaxed);
        assert_eq!(session.read_state().unwrap().done, ForceDone::Looked);
    }
}

#[test]
fn damaged_frames_stop_no_motor_and_lost_rows_are_counted() {
    let (shared, _session) = board_and_session();
    NoisyWire::check_telemetry(shared.wire(), 40_000);
}

#[test]
fn a_request_survives_a_stall_but_not_a_silent_board() {
    let (mut session, loses) = lossy_session();
    loses.store(u32::MAX, Ordering::Relaxed);
    let start = session.now();
    assert!(matches!(session.read_state(), Err(LinkError::Unanswered { waited }) if waited == PATIENCE));
    assert!(session.now() - start < PATIENCE + FORCE_PATIENCE);
    loses.store(0, Ordering::Relaxed);
    // A board that loses two messages replies after 0.2 s.
    loses.store(2, Ordering::Relaxed);
    assert_eq!(session.read_state().unwrap().done, ForceDone::Looked);
}

#[test]
fn reading_the_state_keeps_a_watching_board_armed() {
    let (shared, mut session) = strict_board();
    session.arm().unwrap();
    for _ in 0..8 {
        shared.lock().run(0.4);
        session.read_state().unwrap();
    }
    assert_eq!((session.read_state().unwrap().state, session.fault()), (State::Armed, None));
    shared.lock().run(0.6);
    assert_eq!(session.read_state().unwrap().state, State::Fault);
    assert_eq!(session.fault().unwrap().fault, Fault::HostLost);
    session.clear().unwrap();
    session.arm().unwrap();
    assert_eq!((session.read_state().unwrap().state, session.fault()), (State::Armed, None));
}

#[test]
fn overlapping_forces_are_replied_to_in_order() {
    let (_shared, mut session) = armed_session();
    let request = |sequence| ForceRequest { sequence, hold: 0.02, force: [0.1, 0.0, 0.0], ..ForceRequest::default() };
    let mut under_way = std::collections::VecDeque::new();
    for sequence in 1..=50 {
        under_way.push_back((sequence, session.send_force(&request(sequence)).unwrap()));
        if under_way.len() == 2 {
            let (sequence, sent) = under_way.pop_front().unwrap();
            let answer = session.force_answer(sent).unwrap();
            assert_eq!((answer.sequence, answer.done), (sequence, ForceDone::Taken));
        }
    }
    // Replies can be read in any order, and unread replies have no effect on the next ones.
    let sent: Vec<_> = (51..=70).map(|sequence| session.send_force(&request(sequence)).unwrap()).collect();
    assert_eq!(session.force_answer(sent[19]).unwrap().sequence, 70);
    assert_eq!(session.force_answer(sent[18]).unwrap().sequence, 69);
}

#[test]
fn reading_telemetry_loses_no_replies_of_forces() {
    let (_shared, mut session) = armed_session();
    session.start_stream(fields("tip").unwrap(), 4).unwrap();
    for sequence in 1..=20 {
        let request = ForceRequest { sequence, hold: 0.02, force: [0.1, 0.0, 0.0], ..ForceRequest::default() };
        let sent = session.send_force(&request).unwrap();
        assert!(!session.rows(Duration::from_millis(40)).unwrap().is_empty());
        assert_eq!(session.force_answer(sent).unwrap().sequence, sequence);
    }
    assert_eq!(session.losses().missing, 0);
}

#[test]
fn a_lost_force_does_not_delay_overlapping_forces() {
    let (mut session, loses) = lossy_session();
    let request = |sequence| ForceRequest { sequence, ..ForceRequest::default() };
    loses.store(u32::MAX, Ordering::Relaxed);
    let lost_force = session.send_force(&request(1)).unwrap();
    loses.store(0, Ordering::Relaxed);
    let next_force = session.send_force(&request(2)).unwrap();
    let start = session.now();
    assert!(matches!(session.force_answer(lost_force), Err(LinkError::Unanswered { .. })));
    assert_eq!(session.force_answer(next_force).unwrap().sequence, 2);
    assert!(session.now() - start < Duration::from_millis(2), "{:?}", session.now() - start);
}

/// Returns an armed session after the torque ramp.
fn armed_session() -> (SharedBoard, Session) {
    let (shared, mut session) = board_and_session();
    session.arm().unwrap();
    shared.lock().run(0.6);
    (shared, session)
}

#[test]
fn a_session_that_is_dropped_leaves_the_motors_off() {
    let (shared, mut session) = armed_session();
    assert_eq!(session.force([0.1, 0.0, 0.0]).unwrap().done, ForceDone::Taken);
    assert_eq!(shared.lock().status().state, State::Armed);
    drop(session);
    assert_eq!(shared.lock().status().state, State::Disarmed);
}

#[test]
fn only_the_arming_tool_holds_the_key_and_a_late_press_fails() {
    let (shared, mut session) = board_and_session();
    session.set_scene(&Scene { task: 2, rate_hz: 1_000.0, cutoff_hz: 50.0, ..Scene::default() }).unwrap();
    let mut other_board = Board::over(shared.wire(), "sim").unwrap();
    let hold = |board: &mut Board| {
        for _ in 0..6 {
            board.rows(Duration::from_millis(100)).unwrap();
            board.hold_key(board.step()).unwrap();
        }
        shared.lock().status().state
    };
    session.keep_alive();
    other_board.keep_alive();
    session.rows(Duration::from_millis(60)).unwrap();
    let step = session.step();
    session.arm_held(step).unwrap();
    assert_eq!(hold(&mut session), State::Armed);
    assert_eq!(hold(&mut other_board), State::Fault);
    session.clear().unwrap();
    let step = session.step();
    shared.lock().run(0.6);
    let error = session.arm_held(step).unwrap_err();
    assert!(error.to_string().contains("press it again"), "{error}");
    assert!(!shared.lock().status().state.drives());
}

#[test]
fn a_force_accelerates_the_tip_and_ends_with_its_lease() {
    for (x, y) in [(0.5, 0.0), (0.0, 0.5), (-0.4, -0.3)] {
        let (shared, mut session) = armed_session();
        let from = session.read_state().unwrap().tip;
        session.force([x, y, 0.0]).unwrap();
        shared.lock().run(f64::from(HOLD_S) / 2.0);
        let tip_state = session.read_state().unwrap();
        assert_eq!((tip_state.done, tip_state.share, tip_state.force), (ForceDone::Looked, 1.0, [x, y, 0.0]));
        let along = (tip_state.tip[0] - from[0]) * x + (tip_state.tip[1] - from[1]) * y;
        assert!(along > 0.0, "{tip_state:?}, from {from:?}");
        let lease_s = f64::from(HOLD_S + FADE_S) * 1.1;
        shared.lock().run(lease_s);
        let after = session.read_state().unwrap();
        assert_eq!((after.age, after.torque), (None, [0.0; 3]));
    }
}

#[test]
fn an_age_counts_from_the_state_that_was_sent() {
    let (shared, mut session) = armed_session();
    session.read_state().unwrap();
    shared.lock().run(0.01);
    let answer = session.force([0.1, 0.0, 0.0]).unwrap();
    // The age is 0.01 s plus the two control periods of the request.
    let age = f64::from(answer.age.unwrap());
    assert!((age - 0.0101).abs() < 1.0e-4, "{age}");
}

#[test]
fn a_contact_sent_every_millisecond_acts_like_a_wall() {
    let (shared, mut session) = armed_session();
    let tip = session.read_state().unwrap().tip;
    let floor =
        HostContact { point: [tip[0], tip[1] - 0.005, 0.0], normal: [0.0, 1.0, 0.0], stiffness: 1000.0, damping: 5.0 };
    let push =
        Intent::Push(vec![Waypoint { time: 0.0, value: [0.0; 3] }, Waypoint { time: 0.3, value: [0.0, -4.0, 0.0] }]);
    {
        let mut board = shared.lock();
        let (at, now) = (board.device().tip(), board.time());
        board.device_mut().set_hand(Hand::new(HandSettings::default(), push, at, now));
    }
    let mut last = None;
    for _ in 0..1_500 {
        last = Some(session.push([0.0; 3], Some(floor)).unwrap());
        shared.lock().run(0.001);
    }
    let answer = last.unwrap();
    // 4 N on 1000 N/m are 4 mm, but joint friction (0.005 N m on 0.1 m arms) may hold a part of the force.
    let depth = floor.point[1] - answer.tip[1];
    assert!((depth - 0.004).abs() < 0.000_3, "{depth} m");
    assert!((answer.force[1] - 4.0).abs() < 0.3, "{answer:?}");
    assert_eq!(session.status().unwrap().state, State::Armed);
}

#[test]
fn an_exchange_with_a_simulated_board_takes_two_steps() {
    let (_, mut session) = board_and_session();
    let latency = measure(&mut session, 100, || false).unwrap();
    // The board replies after two control periods at 20 kHz, by its own clock.
    for spread in [&latency.round_trip, &latency.age] {
        for time in [spread.min, spread.median, spread.p99, spread.max] {
            assert!((time - 1.0e-4).abs() < 1.0e-9, "{spread:?}");
        }
        assert_eq!(spread.histogram.iter().map(|bin| bin.count).sum::<usize>(), spread.count);
    }
    assert_eq!((latency.round_trip.count, latency.age.count), (100, 99));
    assert!((latency.per_second - 1.0e4).abs() < 1.0, "{}", latency.per_second);
    assert_eq!(measure(&mut session, 100, || true).unwrap().round_trip.count, 2, "must stop after the smallest number");
    session.start_stream(fields("q").unwrap(), 1).unwrap();
    assert_eq!(measure(&mut session, 10, || false).unwrap().round_trip.count, 10, "must also work during telemetry");
    assert!(!session.rows(Duration::from_millis(10)).unwrap().is_empty());
}

#[test]
fn the_command_prints_histograms_or_json() {
    type_lines(
        "board latency --port sim --exchanges 50 => 50 exchanges, 10000 a second, on sim | round trip: median 0.100 ms
        2: board latency --port sim --exchanges 1 => --exchanges",
        &[],
    );
    let json = json(&["board", "latency", "--port", "sim", "--exchanges", "50"]);
    assert_eq!((&json["round_trip"]["count"], &json["age"]["count"]), (&50.into(), &49.into()));
}
