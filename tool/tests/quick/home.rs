//! Homing: by hand the measured pose is exactly home, even with a coarse encoder; by index marks; by stops.

use crate::common::forces::MotorTipForce;
use crate::common::prelude::*;
use crate::common::sim::Sim;
use crate::common::{shipped_device, shipped_path};
use haptic_bridge::model::description::Homing;
use haptic_bridge::safety::refusal::Refusal;
use haptic_host::link::BoardError;
use haptic_sim::{Hand, SimulatedBoard};
use std::f64::consts::TAU;
use std::time::Duration;

#[test]
fn a_coarse_encoder_reads_exactly_home() {
    let sim = Sim::start(&[&shipped_path("capstan-pantograph.toml")]);
    sim.run(&["home"]).success();
    let info = sim.json(&["info"]);
    for (read, declared) in info["q"].as_array().unwrap().iter().zip([2.897_247, 0.244_346]) {
        // One count is 8.9e-3 rad. The tolerance covers only single precision, 3e-7 of an angle of 3 rad.
        assert!((read.as_f64().unwrap() - declared).abs() < 2e-6, "{read} is not {declared}");
    }
}

/// Returns a strict board whose device is homed by `homing`, with limits near home. The device starts off its home pose,
/// and every encoder at 0.
fn strict_board(name: &str, homing: fn([f64; 3]) -> Homing<f64>) -> (SharedBoard, Board, Description) {
    let file = shipped_device(name);
    let mut device = file.description;
    let home = device.home.unwrap();
    for (joint, home) in device.joints.iter_mut().zip(home).take(file.spec().joints) {
        joint.motor.as_mut().unwrap().verified = true;
        joint.limits = Some((home - 0.4, home + 0.4));
        joint.encoder.as_mut().unwrap().offset = home - 0.2;
    }
    device.homing = homing(home);
    let start = [home[0] + 0.05, home[1] - 0.04, home[2]];
    let options = Options { start: Some(start), substep: 25e-6, ..Options::default() };
    let options = BoardOptions { device: options, strict: true, support: Support::Held, ..BoardOptions::default() };
    let mut simulated = SimulatedBoard::new(&device, options).unwrap();
    simulated.load(name, &device, None).unwrap();
    let shared = SharedBoard::new(simulated);
    let mut board = Board::over(shared.wire(), "sim").unwrap();
    let mut rules = board.rules().unwrap();
    rules.host_action = HostAction::Ignore;
    let turn = |i: usize| device.joints[i].encoder.map_or(0, |encoder| encoder.counts_per_turn as i32);
    rules.index_period = core::array::from_fn(turn);
    board.set_rules(&rules).unwrap();
    (shared, board, device)
}

/// Returns the largest error of the board's joint angles, rad.
fn angle_error(shared: &SharedBoard, board: &mut Board) -> f64 {
    shared.lock().run(0.01);
    let shown = board.status().unwrap().q;
    let board = shared.lock();
    let (q, joints) = (board.device().q(), board.device().joints());
    shown.iter().zip(q).take(joints).fold(0.0, |most: f64, (shown, q)| most.max((f64::from(*shown) - q).abs()))
}

#[test]
fn an_index_mark_passed_by_hand_homes_within_two_counts() {
    let (shared, mut board, device) = strict_board("pantograph-mk2", |_| Homing::Index);
    assert!(matches!(board.home(), Err(BoardError::Refused(Refusal::IndexUnseen(0)))));
    let start = shared.lock().device().q();
    // A person moves both joints by 0.3 rad in 0.75 s.
    for step in 0..=15_000 {
        let moved = 0.3 * f64::from(step) / 15_000.0;
        let mut board = shared.lock();
        board.device_mut().place([start[0] - moved, start[1] - moved, 0.0]);
        board.control_period();
    }
    board.home().unwrap();
    let error = angle_error(&shared, &mut board);
    let count = TAU / device.joints[0].encoder.unwrap().counts_per_turn;
    assert!(board.status().unwrap().homed && error <= 2.0 * count, "{} counts", error / count);
}

/// Stops of both directions, a little beyond the limits.
fn stops(home: [f64; 3]) -> Homing<f64> {
    Homing::Stop([home[0] + 0.42, home[1] - 0.43, 0.0])
}

/// Declares the rough home pose, checks the polarity, and pushes the joints to their stops. Returns the largest force of
/// the motors at the tip, N.
fn push_to_stops(shared: &SharedBoard, board: &mut Board, device: &Description, hand: bool) -> f64 {
    board.home_at_rest().unwrap();
    assert!(!board.status().unwrap().homed);
    board.check_polarity().unwrap();
    board.wait_for_polarity().unwrap().require_pass().unwrap();
    board.keep_alive();
    board.rows(Duration::from_millis(500)).unwrap();
    if hand {
        let mut board = shared.lock();
        let (tip, now) = (board.device().tip(), board.time());
        board.device_mut().set_hand(Hand::new(HandSettings::default(), Intent::Lead(tip), tip, now));
    }
    let seen = board.step();
    board.find_stops(seen).unwrap();
    let (mut push, mut most) = (MotorTipForce::new(device, &shared.lock()), 0.0_f64);
    while board.status().unwrap().state == State::Homing {
        for _ in 0..2_000 {
            let mut board = shared.lock();
            board.carrier();
            most = most.max(push.add_period(&board).unwrap_or(0.0));
        }
        board.rows(Duration::ZERO).unwrap();
        let seen = board.step();
        board.hold_key(seen).unwrap();
    }
    most
}

#[test]
fn stops_home_a_device_and_push_no_harder_than_half_a_newton() {
    for name in ["hapkit-paddle", "pantograph-mk2"] {
        let (shared, mut board, device) = strict_board(name, stops);
        let most = push_to_stops(&shared, &mut board, &device, false);
        let (status, error) = (board.status().unwrap(), angle_error(&shared, &mut board));
        assert!(status.homed && error < 0.01, "{name}: {error} rad, {:?}", status.fault);
        assert!(most < 0.525, "{name}: {most} N");
    }
}

#[test]
fn a_hand_in_the_way_is_no_stop() {
    for name in ["hapkit-paddle", "pantograph-mk2"] {
        let (shared, mut board, device) = strict_board(name, stops);
        let most = push_to_stops(&shared, &mut board, &device, true);
        let status = board.status().unwrap();
        assert_eq!(
            (status.fault.map(|record| record.fault), status.homed),
            (Some(Fault::StopMissing), false),
            "{name}"
        );
        assert!(most < 0.525, "{name}: {most} N");
    }
}
