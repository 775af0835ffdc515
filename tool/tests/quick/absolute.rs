//! Absolute encoders on the simulated board: no homing, a rendered wall, disturbed frames.

use haptic_bridge::safety::fault::{Fault, State};
use haptic_bridge::safety::refusal::Refusal;
use haptic_host::device_file::DeviceFile;
use haptic_host::link::Board;
use haptic_host::scene_file::SceneFile;
use haptic_sim::{BoardOptions, Hand, HandSettings, Intent, Options, SharedBoard, SimulatedBoard, Waypoint};
use std::time::Duration;

/// Returns a paddle with these keys of the encoder and this first key of the motor.
fn paddle(encoder: &str, ratio: &str) -> DeviceFile {
    let text = format!(
        "name = \"paddle\"\nmechanism = \"paddle\"\ngravity = [0.0, 0.0]\n[geometry]\nlength = 0.08\n[[joint]]\n\
         inertia = 6e-5\nviscous = 2e-4\ncoulomb = 3e-3\nlimits = [-0.8, 0.8]\n[joint.encoder]\n{encoder}\n\
         [joint.motor]\n{ratio}\ntorque_constant = 0.08\nresistance = 5.0\ninductance = 0.002\n\
         max_current = 1.5\nverified = true\n[home]\nq = [0.0]\n"
    );
    DeviceFile::parse(&text, "paddle.toml").expect("a valid file")
}

/// Returns a strict board that was just switched on with the device of `file` at `start` (rad).
fn switched_on(file: &DeviceFile, start: f64) -> (SharedBoard, Board) {
    let device = Options { start: Some([start, 0.0, 0.0]), ..Options::default() };
    let options = BoardOptions { strict: true, device, ..BoardOptions::default() };
    let mut board = SimulatedBoard::new(&file.description, options).expect("a device that can be simulated");
    board.load("paddle", &file.description, None).expect("a device that the board accepts");
    let shared = SharedBoard::new(board);
    let board = Board::over(shared.wire(), "sim").expect("a connection");
    shared.lock().run(0.01);
    (shared, board)
}

/// Runs for `seconds` with a live host.
fn run(shared: &SharedBoard, board: &mut Board, seconds: f64) {
    for _ in 0..(10.0 * seconds) as u32 {
        shared.lock().run(0.1);
        board.rows(Duration::ZERO).expect("a connection");
    }
}

/// Loads a wall at `surface` (m), checks the polarity and arms.
fn arm(shared: &SharedBoard, board: &mut Board, surface: f64) {
    let text = format!("[[wall]]\npoint = [{surface}]\nnormal = [1.0]\nstiffness = 400.0\ndamping = 1.0\n");
    let scene =
        SceneFile::parse(&text, "scene", 1).expect("a valid scene").scene().expect("a scene of the board's size");
    board.set_scene(&scene).expect("the board takes the scene");
    board.check_polarity().expect("the check starts without homing");
    board.keep_alive();
    while shared.lock().status().state == State::CheckingPolarity {
        run(shared, board, 0.1);
    }
    board.arm().expect("the device is ready");
    run(shared, board, 0.6);
}

#[test]
fn an_absolute_encoder_needs_no_homing_and_renders_a_wall() {
    // Half a turn of the magnet lies within the paddle's range, and the encoder may count backward.
    for encoder in [
        "kind = \"as5047\"\nat = \"joint\"\noffset = 3.0",
        "kind = \"as5048\"\nat = \"joint\"\noffset = -0.4\ninverted = true",
    ] {
        let (shared, mut board) = switched_on(&paddle(encoder, ""), 0.3);
        let status = board.status().expect("a reply");
        assert!(status.homed && (status.q[0] - 0.3).abs() < 4e-4, "{encoder}: {status:?}");
        let start = shared.lock().device().tip();
        arm(&shared, &mut board, start[0] - 0.003);
        {
            let mut simulated = shared.lock();
            let now = simulated.device().time();
            let push = [(0.0, 0.0), (0.3, -1.0), (10.0, -1.0)];
            let push = push.map(|(time, force)| Waypoint { time, value: [force, 0.0, 0.0] });
            let hand = Hand::new(HandSettings::default(), Intent::Push(push.to_vec()), start, now);
            simulated.device_mut().set_hand(hand);
        }
        run(&shared, &mut board, 2.0);
        let simulated = shared.lock();
        assert_eq!(simulated.status().state, State::Armed, "{:?}", simulated.status().fault);
        let (depth, force) = (start[0] - 0.003 - simulated.device().tip()[0], simulated.device().torque()[0] / 0.08);
        assert!((force - 1.0).abs() < 0.05 && (depth * 400.0 - force).abs() < 0.03, "{encoder}: {depth} m, {force} N");
    }
}

#[test]
fn an_encoder_on_the_motor_needs_homing_unless_the_limits_settle_its_turn() {
    let encoder = "kind = \"as5047\"\noffset = 0.1";
    // A turn of the motor is 2.1 rad of the joint, 0.6 rad, and less than what a hand misses by.
    let (_, mut board) = switched_on(&paddle(encoder, "ratio = 3.0"), -0.5);
    let status = board.status().expect("a reply");
    assert!(status.homed && (status.q[0] + 0.5).abs() < 4e-4, "{status:?}");
    let (_, mut board) = switched_on(&paddle(encoder, "ratio = 10.0"), 0.1);
    assert!(!board.status().expect("a reply").homed);
    let refused = board.check_polarity().expect_err("the turn is unknown");
    assert!(refused.to_string().contains(&Refusal::NotHomed.to_string()), "{refused}");
    board.home().expect("the device rests");
    let status = board.status().expect("a reply");
    assert!(status.homed && (status.q[0] - 0.1).abs() < 4e-4, "a hand's error stays: {status:?}");
}

#[test]
fn two_disturbed_frames_are_tolerated_and_the_third_turns_the_motors_off() {
    let (shared, mut board) = switched_on(&paddle("kind = \"as5047\"\nat = \"joint\"", ""), 0.2);
    arm(&shared, &mut board, -0.06);
    // At 15 rad/s the paddle moves by 7.5e-4 rad in a period.
    shared.lock().device_mut().push([1.2, 0.0, 0.0]);
    shared.lock().run(0.01);
    for frames in [1, 2, 2, 2] {
        let mut simulated = shared.lock();
        let now = simulated.readings();
        simulated.faults_mut().frames[0] = Some((now + 5, frames));
        let (before, period) = (simulated.time(), 1.0 / simulated.carrier_hz());
        simulated.run_until(before + (4.5 + frames as f64) * period);
        let status = simulated.status();
        assert_eq!((status.state, status.fault), (State::Armed, None), "{frames}");
        // The crest was a period ago, and its angle is from the valley before.
        let late = 1.5 * period * simulated.device().qd()[0];
        let error = f64::from(status.q[0]) - simulated.device().q()[0] + late;
        assert!(error.abs() < 5e-4, "{frames} frames: {error} rad");
        simulated.run(5.0 * period);
    }
    {
        let mut simulated = shared.lock();
        let now = simulated.readings();
        simulated.faults_mut().frames[0] = Some((now + 5, 3));
        simulated.run(0.0002);
        assert_eq!(simulated.status().state, State::Armed);
        simulated.run(0.0003);
        let status = simulated.status();
        assert_eq!((status.state, status.fault.map(|fault| fault.fault)), (State::Fault, Some(Fault::EncoderFrames)));
        simulated.device_mut().place([0.2, 0.0, 0.0]);
        simulated.run(0.01);
    }
    // The encoder is intact again and tells the angle.
    board.clear().expect("the fault is over");
    let status = board.status().expect("a reply");
    assert!(status.homed && status.polarity, "{status:?}");
    // An angle that no motion explains is disturbed too, and its parity is right.
    board.arm().expect("the device is ready");
    run(&shared, &mut board, 0.6);
    let mut simulated = shared.lock();
    simulated.faults_mut().count_offset[0] = 500;
    simulated.run(0.002);
    let fault = simulated.status().fault.map(|fault| fault.fault);
    assert_eq!((simulated.status().state, fault), (State::Fault, Some(Fault::EncoderFrames)));
}

#[test]
fn a_silent_encoder_is_neither_homed_nor_armed() {
    let file = paddle("kind = \"as5047\"", "ratio = 10.0");
    let (shared, mut board) = switched_on(&file, 0.0);
    shared.lock().faults_mut().frames[0] = Some((0, u64::MAX));
    board.set_device(&file.device().expect("a device of the board's size")).expect("the board takes the device");
    shared.lock().run(0.01);
    let silent = Refusal::EncoderSilent(0).to_string();
    for refused in [board.home().expect_err("no angle"), board.check_polarity().expect_err("no angle")] {
        assert!(refused.to_string().contains(&silent), "{refused}");
    }
}
