//! A three-phase motor on the simulated board: alignment in the polarity check, wrong pole pairs, and a rendered wall.

use crate::common::injected::{board_with_error, run_check};
use crate::common::plane_wall;
use crate::common::prelude::*;
use crate::common::shipped_device;
use haptic_bridge::model::motor::Winding;
use haptic_bridge::safety::fault::Fault;
use haptic_sim::{BoardFaults, Hand};

/// Returns a checked board with the gimbal paddle, whose rotor has this electrical angle (rad) at joint angle zero.
fn checked(
    electrical_zero: f64,
    error: impl FnOnce(&mut Description, &mut BoardFaults),
) -> (SharedBoard, Board, Option<(Fault, f32)>) {
    let file = shipped_device("gimbal-paddle");
    let device = Options { electrical_zero: [electrical_zero, 0.0, 0.0], ..Options::default() };
    let (shared, mut board, _) = board_with_error(&file.name, &file.description, device, true, error);
    let fault = run_check(&shared, &mut board, |_| ()).err().map(|record| (record.fault, record.value));
    (shared, board, fault)
}

#[test]
fn the_check_finds_any_electrical_angle_and_either_direction() {
    for (electrical_zero, is_reversed) in
        [(0.0, false), (2.5, true), (-2.2, false), (3.1, true), (-0.8, true), (1.2, false)]
    {
        let (.., fault) = checked(electrical_zero, |_, wires| wires.reversed[0] = is_reversed);
        assert_eq!(fault, None, "{electrical_zero} rad, reversed: {is_reversed}");
    }
}

#[test]
fn a_wrong_number_of_pole_pairs_is_refused_with_the_number_found() {
    for pole_pairs in [7, 9, 10, 12, 14, 22] {
        let (.., fault) = checked(1.0, |wired, _| {
            wired.joints[0].motor.as_mut().unwrap().winding = Winding::ThreePhase { pole_pairs, ratio: 1.0 };
        });
        let Some((Fault::PolePairs, found)) = fault else { panic!("{pole_pairs}: {fault:?}") };
        assert!((found - f32::from(pole_pairs)).abs() < 0.5, "{found} of {pole_pairs}");
    }
}

#[test]
fn a_wall_on_a_three_phase_motor_is_as_stiff_as_its_gain() {
    let (shared, mut board, fault) = checked(1.0, |_, wires| wires.reversed[0] = true);
    assert_eq!(fault, None);
    shared.lock().run(0.5);
    let tip = shared.lock().device().tip();
    let surface = (tip[0] - 0.005) as f32;
    let mut scene = Scene { task: 1, rate_hz: 20_000.0, ..Scene::default() };
    scene.walls.push(plane_wall([surface, 0.0, 0.0], [1.0, 0.0, 0.0], 300.0, 0.5)).unwrap();
    board.set_scene(&scene).unwrap();
    board.arm().unwrap();
    let mut board = shared.lock();
    let now = board.time();
    let push = [0.0, 0.3, 10.0].map(|time| Waypoint { time, value: [if time > 0.0 { -0.5 } else { 0.0 }, 0.0, 0.0] });
    board.device_mut().set_hand(Hand::new(HandSettings::default(), Intent::Push(push.to_vec()), tip, now));
    board.run(3.0);
    assert_eq!(board.status().state, State::Armed, "{:?}", board.status().fault);
    // Friction holds up to 0.002 N m / 0.08 m.
    let (depth, force) = (f64::from(surface) - board.device().tip()[0], board.device().torque()[0] / 0.08);
    assert!((force - 0.5).abs() < 0.03, "{force} N");
    assert!((depth * 300.0 - force).abs() < 0.05 * force, "{depth} m at {force} N");
}
