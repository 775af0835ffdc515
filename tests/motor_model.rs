//! The motor's model finds wrong current sensors and open windings, and accepts warm windings, missing sensors and
//! encoders at rest.

use crate::rig::{RATES_HZ, Rig, at_rate, far_wall, hardware, paddle, rules, scene, wall};
use haptic_bridge::control::Command;
use haptic_bridge::safety::fault::{Fault, State};

/// Returns the fault, if the bridges turn off within 50 ms, and the largest current of motor 0 until then, A.
fn largest_current_and_fault(rig: &mut Rig) -> (f32, Option<Fault>) {
    let mut largest_current = 0.0_f32;
    for _ in 0..(0.05 * rig.rate) as u32 {
        rig.step();
        largest_current = largest_current.max(rig.peak_current);
        if rig.state() == State::Fault {
            break;
        }
    }
    (largest_current, rig.fault())
}

#[test]
fn a_wrong_current_sensor_does_not_let_the_motor_pass_its_limit() {
    for rate in RATES_HZ {
        for shown in [0.0_f32, 1.0, -2.0] {
            let mut rig = Rig::pressed_paddle_in(&at_rate(rate, scene(1, &[wall(-0.005, 250.0)])));
            rig.shown_current = Some(shown);
            let (largest_current, fault) = largest_current_and_fault(&mut rig);
            assert_eq!(fault, Some(Fault::MotorModel), "{shown} A at {rate} Hz");
            // 1.5 times the limit of 3 A, plus 1 A, is the bound of measured currents.
            assert!(largest_current < 5.5, "{shown} A at {rate} Hz: {largest_current} A");
        }
    }
}

#[test]
fn an_open_winding_is_found_when_it_should_carry_current() {
    for rate in RATES_HZ {
        let mut rig = Rig::pressed_paddle_in(&at_rate(rate, scene(1, &[wall(-0.005, 250.0)])));
        rig.resistance = f32::INFINITY;
        let (_, fault) = largest_current_and_fault(&mut rig);
        assert_eq!(fault, Some(Fault::MotorModel), "{rate} Hz");
    }
}

#[test]
fn a_sound_motor_never_trips() {
    // Hot and cold windings hit and leave walls at speed, at every rate.
    for rate in RATES_HZ {
        for resistance in [1.7, 2.0, 2.8] {
            let mut rig = Rig::homed_paddle(&at_rate(rate, scene(1, &[wall(-0.005, 250.0)])));
            rig.resistance = resistance;
            rig.arm();
            for (angle, speed) in [(-0.15, 8.0), (0.5, 8.0), (-0.12, 15.0), (-0.14, 0.5), (0.2, 15.0)] {
                rig.turn(0, angle, speed);
            }
            assert_eq!(rig.fault(), None, "{resistance} ohm at {rate} Hz");
        }
    }
}

#[test]
fn a_press_at_a_low_torque_limit_is_not_an_encoder_stall() {
    // The torque limit is a tenth of the motor's torque, so a long press at the limit does not prove a lost encoder.
    let mut rules = rules();
    rules.limits.torque = [0.03; 3];
    let mut rig = Rig::new(&paddle(), &scene(1, &[wall(-0.005, 10_000.0)]), hardware(), rules);
    rig.arm();
    rig.turn(0, -0.15, 1.0);
    rig.run(6.0);
    assert_eq!((rig.state(), rig.fault()), (State::Armed, None));
}

#[test]
fn a_warm_winding_pressed_against_a_wall_does_not_trip() {
    // Copper at 100 °C has 1.35 times the data sheet's 2 ohm.
    let mut rig = Rig::homed_paddle(&scene(1, &[wall(-0.005, 250.0)]));
    rig.resistance = 2.7;
    rig.arm();
    rig.turn(0, -0.15, 1.0);
    rig.run(1.0);
    assert_eq!((rig.state(), rig.fault()), (State::Armed, None));
    assert!((rig.currents[0] - 2.5).abs() < 0.05, "the loop must still make 2.5 A: {:?}", rig.currents);
}

#[test]
fn unmeasured_voltages_and_currents_are_ignored() {
    let mut board = hardware();
    board.bus_sensed = false;
    board.bridge.current_sensed = false;
    let mut rig = Rig::new(&paddle(), &far_wall(), board, rules());
    rig.samples.bus_voltage = f32::NAN;
    rig.shown_current = Some(f32::NAN);
    rig.arm();
    rig.run(0.2);
    assert_eq!((rig.state(), rig.fault()), (State::Armed, None));
}

#[test]
fn a_board_without_bus_voltage_reports_no_lost_encoder() {
    let mut board = hardware();
    board.bus_sensed = false;
    let mut rig = Rig::new(&paddle(), &far_wall(), board, rules());
    rig.samples.bus_voltage = 0.0;
    rig.shown_current = Some(2.0);
    rig.execute(Command::Arm).unwrap();
    rig.run(0.5);
    assert_eq!((rig.state(), rig.fault()), (State::Armed, None));
}
