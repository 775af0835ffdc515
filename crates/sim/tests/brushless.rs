//! A three-phase motor on the simulated board: alignment in the polarity check, wrong wiring, and a rendered wall.

use haptic_bridge::model::description::Description;
use haptic_bridge::model::motor::Winding;
use haptic_bridge::safety::fault::{Fault, State};
use haptic_host::device_file::DeviceFile;
use haptic_host::link::Board;
use haptic_host::scene_file::SceneFile;
use haptic_sim::{BoardOptions, Hand, HandSettings, Intent, Options, SharedBoard, SimulatedBoard, Waypoint};
use std::time::Duration;

const PADDLE: &str = r#"
name = "gimbal-paddle"
mechanism = "paddle"
gravity = [0.0, 0.0]

[geometry]
length = 0.08

[[joint]]
inertia = 6.0e-5
viscous = 0.0002
coulomb = 0.003
limits = [-0.8, 0.8]
transmission = "rigid"

[joint.encoder]
counts_per_turn = 16384

[joint.motor]
kind = "brushless"
pole_pairs = 7
torque_constant = 0.0827
resistance = 5.0
inductance = 0.002
max_current = 1.5
verified = true

[home]
q = [0.0]
"#;

fn description() -> Description {
    DeviceFile::parse(PADDLE, "gimbal-paddle.toml").expect("a valid file").description
}

/// Runs the polarity check of a strict board whose device is `wired`, and returns the fault.
fn checked(wired: &Description, electrical_zero: f64, is_reversed: bool) -> (SharedBoard, Board, Option<(Fault, f32)>) {
    let device = Options { electrical_zero: [electrical_zero, 0.0, 0.0], ..Options::default() };
    let mut options = BoardOptions { strict: true, device, ..BoardOptions::default() };
    options.faults.reversed[0] = is_reversed;
    let mut board = SimulatedBoard::new(wired, options).expect("a device that can be simulated");
    board.load("gimbal-paddle", &description(), None).expect("a device that the board accepts");
    let shared = SharedBoard::new(board);
    let mut board = Board::over(shared.wire(), "sim").expect("a connection");
    board.home().expect("the device rests");
    board.check_polarity().expect("the check starts");
    board.keep_alive();
    for _ in 0..1200 {
        shared.lock().run(0.1);
        board.rows(Duration::ZERO).expect("a connection");
        let status = board.status().expect("a reply");
        if status.polarity || status.fault.is_some() {
            break;
        }
    }
    let status = board.status().expect("a reply");
    assert!(status.polarity != status.fault.is_some(), "{status:?}");
    (shared, board, status.fault.map(|fault| (fault.fault, fault.value)))
}

#[test]
fn the_check_finds_any_electrical_angle_and_either_direction() {
    for (electrical_zero, is_reversed) in
        [(0.0, false), (1.0, false), (2.5, true), (-0.8, true), (-2.2, false), (3.1, true)]
    {
        let (shared, _, fault) = checked(&description(), electrical_zero, is_reversed);
        assert_eq!(fault, None, "{electrical_zero} rad, reversed: {is_reversed}");
        println!("{electrical_zero} {is_reversed}: {} s", shared.lock().time());
    }
}

#[test]
fn a_wrong_number_of_pole_pairs_is_refused_with_the_number_found() {
    for pole_pairs in [4, 6, 8, 11] {
        let mut wired = description();
        wired.joints[0].motor.as_mut().expect("a motor").winding = Winding::ThreePhase { pole_pairs, ratio: 1.0 };
        let (_, _, fault) = checked(&wired, 1.0, false);
        let Some((Fault::PolePairs, found)) = fault else { panic!("{pole_pairs}: {fault:?}") };
        assert!((found - f32::from(pole_pairs)).abs() < 0.5, "{found} of {pole_pairs}");
    }
}

#[test]
fn a_wall_on_a_three_phase_motor_is_as_stiff_as_its_gain() {
    let (shared, mut board, fault) = checked(&description(), 1.0, true);
    assert_eq!(fault, None);
    let text = "rate_hz = 20000\n[[wall]]\npoint = [-0.01]\nnormal = [1.0]\nstiffness = 400.0\ndamping = 1.0\n";
    let scene =
        SceneFile::parse(text, "scene", 1).expect("a valid scene").scene().expect("a scene of the board's size");
    board.set_scene(&scene).expect("the board takes the scene");
    let now = shared.lock().time();
    let push = [0.0, 0.3, 10.0].map(|time| Waypoint { time, value: [if time > 0.0 { -1.0 } else { 0.0 }, 0.0, 0.0] });
    board.arm().expect("the device is ready");
    {
        let mut simulated = shared.lock();
        let tip = simulated.device().tip();
        let hand = Hand::new(HandSettings::default(), Intent::Push(push.to_vec()), tip, now);
        simulated.device_mut().set_hand(hand);
    }
    board.keep_alive();
    for _ in 0..30 {
        shared.lock().run(0.1);
        board.rows(Duration::ZERO).expect("a connection");
    }
    let simulated = shared.lock();
    assert_eq!(simulated.status().state, State::Armed, "{:?}", simulated.status().fault);
    // Friction holds up to 0.003 N m / 0.08 m.
    let (depth, force) = (-0.01 - simulated.device().tip()[0], simulated.device().torque()[0] / 0.08);
    assert!((force - 1.0).abs() < 0.05, "{force} N");
    assert!((depth * 400.0 - force).abs() < 0.02 * force, "{depth} m at {force} N");
}
