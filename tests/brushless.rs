//! The stage of a three-phase motor makes the quadrature current of the commanded torque, and no direct current.
//!
//! The motor is written in its stator's frame: each phase is a resistance, an inductance and a sinusoidal back-EMF
//! between its leg and the neutral point.

use haptic_bridge::drive::motor_stage::{MotorDrive, MotorStage};
use haptic_bridge::drive::stage::{Bridge, Frame, MAX_DUTY, Stage, Supply};
use haptic_bridge::math::BinaryAngle;
use haptic_bridge::model::motor::{Motor, Winding};
use std::f64::consts::TAU;

const CARRIER_HZ: f32 = 20_000.0;
const BUS_VOLTS: f32 = 24.0;
const COUNTS_PER_TURN: f64 = 16_384.0;
const POLE_PAIRS: u8 = 7;
/// Electrical angle of the rotor at count zero, rad.
const OFFSET: f64 = 1.0;

fn motor() -> Motor<f32> {
    Motor {
        torque_constant: 0.09,
        resistance: 2.5,
        inductance: 1.0e-3,
        back_emf: 0.06,
        max_current: 3.0,
        winding: Winding::ThreePhase { pole_pairs: POLE_PAIRS, ratio: 1.0 },
        verified: true,
    }
}

/// A motor that turns at a constant speed, its board and its stage.
struct Rig {
    stage: MotorStage,
    motor: Motor<f32>,
    dead_time: f64,
    /// Leg of each phase.
    wiring: [usize; 3],
    /// Joint angle (rad) and speed (rad/s).
    angle: f64,
    speed: f64,
    /// Currents of the phases, A.
    currents: [f64; 3],
    legs: [f64; 3],
}

/// Returns the electrical angle of the rotor, rad.
fn electrical(motor: &Motor<f32>, angle: f64) -> f64 {
    f64::from(motor.electrical_ratio().unwrap()) * angle + OFFSET
}

impl Rig {
    fn new(exchanged: bool, speed: f64, dead_time: f64) -> Self {
        let bridge = Bridge {
            carrier_hz: CARRIER_HZ,
            dead_time: dead_time as f32,
            bandwidth_hz: 1000.0,
            current_sensed: true,
            legs: 3,
        };
        let motor = motor();
        let mut stage = MotorStage::new(&motor, &bridge, 10.0);
        stage.set_encoder((TAU / COUNTS_PER_TURN) as f32);
        // Seen through exchanged phases, the angle has the other sign.
        let electrical = if exchanged { -OFFSET } else { OFFSET };
        stage.align(BinaryAngle::from_radians(electrical), 0, exchanged);
        let wiring = if exchanged { [0, 2, 1] } else { [0, 1, 2] };
        Self { stage, motor, dead_time, wiring, angle: 0.0, speed, currents: [0.0; 3], legs: [0.5; 3] }
    }

    /// Advances the motor by half a carrier period.
    fn advance(&mut self) {
        const STEPS: usize = 50;
        let h = 0.5 / f64::from(CARRIER_HZ) / STEPS as f64;
        let [r, l, k] = [self.motor.resistance, self.motor.inductance, self.motor.back_emf].map(f64::from);
        for _ in 0..STEPS {
            let lost = self.dead_time * f64::from(CARRIER_HZ * BUS_VOLTS);
            let legs: [f64; 3] = std::array::from_fn(|i| {
                self.legs[self.wiring[i]] * f64::from(BUS_VOLTS)
                    - lost * self.currents[i] / (self.currents[i].abs() + 1e-3)
            });
            let neutral = legs.iter().sum::<f64>() / 3.0;
            let at = electrical(&self.motor, self.angle + 0.5 * h * self.speed);
            for (i, (current, leg)) in self.currents.iter_mut().zip(legs).enumerate() {
                // The field of a phase is the cosine of the rotor's angle from the phase, and its EMF the derivative.
                let emf = -k * self.speed * (at - TAU / 3.0 * i as f64).sin();
                let rate = |current: f64| (leg - neutral - emf - r * current) / l;
                let middle = *current + 0.5 * h * rate(*current);
                *current += h * rate(middle);
            }
            self.angle += h * self.speed;
        }
    }

    /// Returns direct and quadrature current, A.
    fn rotor_currents(&self) -> [f64; 2] {
        let at = electrical(&self.motor, self.angle);
        let sum = |f: fn(f64) -> f64| {
            let parts = (0..3).map(|i| self.currents[i] * f(at - TAU / 3.0 * i as f64));
            2.0 / 3.0 * parts.sum::<f64>()
        };
        [sum(f64::cos), -sum(f64::sin)]
    }

    /// Runs one carrier period from crest to crest.
    fn period(&mut self) {
        let count = (self.angle / TAU * COUNTS_PER_TURN).floor() as i32;
        let [u, v, _] = self.wiring.map(|phase| self.currents[phase] as f32);
        let (current, _) = self.stage.read(0.5 * (u - v), u + v, count);
        let speed = self.speed as f32;
        let drive = self.stage.drive(&Supply::of(BUS_VOLTS), current, speed, false);
        self.stage.settle(BUS_VOLTS, speed, speed, speed);
        self.advance();
        let MotorDrive::ThreePhase { legs, .. } = drive else { panic!("{drive:?}") };
        let ends = (0.5 - 0.5 * MAX_DUTY - 1e-6, 0.5 + 0.5 * MAX_DUTY + 1e-6);
        assert!(legs.iter().all(|leg| (ends.0..ends.1).contains(leg)), "{legs:?}");
        self.legs = legs.map(f64::from);
        self.advance();
    }
}

#[test]
fn the_quadrature_current_follows_the_torque_at_any_speed_and_direction() {
    for (exchanged, dead_time) in [(false, 0.0), (true, 0.0), (false, 300e-9)] {
        for speed in [0.0, 10.0, -40.0] {
            let mut rig = Rig::new(exchanged, speed, dead_time);
            for torque in [0.09, -0.18] {
                rig.stage.command(torque);
                for _ in 0..200 {
                    rig.period();
                }
                let [direct, quadrature] = rig.rotor_currents();
                let wanted = f64::from(torque / 0.09);
                assert!(
                    (quadrature - wanted).abs() < 0.02 && direct.abs() < 0.03,
                    "{exchanged} {speed} {dead_time}: {quadrature} A for {wanted} A, direct {direct} A"
                );
            }
        }
    }
}

#[test]
fn a_step_is_complete_after_one_carrier_period_without_overshoot() {
    let mut rig = Rig::new(false, 0.0, 0.0);
    rig.stage.command(0.02);
    // The voltage applies from the valley in the first period to the valley in the second.
    rig.period();
    rig.period();
    let [direct, quadrature] = rig.rotor_currents();
    let wanted = 0.02 / 0.09;
    assert!(
        (quadrature / wanted - 1.0).abs() < 0.06 && direct.abs() < 0.01,
        "{quadrature} A of {wanted} A, {direct} A"
    );
}

#[test]
fn the_direct_axis_keeps_its_voltage_when_the_bus_ends() {
    // 24 V/√3 less the margin is 12.7 V; the back-EMF of 190 rad/s is 11.4 V.
    let mut rig = Rig::new(false, 190.0, 0.0);
    rig.stage.command(0.27);
    for _ in 0..2000 {
        rig.period();
    }
    let [direct, quadrature] = rig.rotor_currents();
    assert!(direct.abs() < 0.1 && quadrature < 1.5 && quadrature > 0.0, "{direct} A, {quadrature} A");
}

#[test]
fn a_motor_without_a_known_frame_receives_no_voltage() {
    let mut rig = Rig::new(false, 0.0, 0.0);
    rig.stage.set_frame(Frame::Unknown);
    rig.stage.command(0.09);
    for _ in 0..10 {
        rig.period();
    }
    assert_eq!(rig.currents, [0.0; 3]);
}

#[test]
fn a_fixed_frame_pulls_the_rotor_by_the_cosine_of_its_angle() {
    for turn in [0.0, 0.7, 2.0, -1.2] {
        let mut rig = Rig::new(false, 0.0, 0.0);
        rig.stage.set_frame(Frame::Fixed(BinaryAngle::from_radians(OFFSET + turn)));
        rig.stage.command(0.09);
        for _ in 0..100 {
            rig.period();
        }
        assert!((rig.rotor_currents()[1] - turn.cos()).abs() < 0.01, "{turn}: {:?}", rig.rotor_currents());
    }
}
