//! Two toy motor stages run in the shipped control loop, because any `Stage` may be between a joint's torque and its
//! motor. Limits, fault checks and the thermal budget hold for them as for a brushed motor.

use crate::rig::{COUNTS_PER_TURN, device, hardware, limits, paddle, rules, scene, wall};
use haptic_bridge::control::compiled::BoardMath;
use haptic_bridge::control::frame::Samples;
use haptic_bridge::control::joints::Currents;
use haptic_bridge::control::program::Program;
use haptic_bridge::control::{Command, ControlLoop};
use haptic_bridge::drive::stage::{Bridge, Stage, Supply};
use haptic_bridge::math::Math;
use haptic_bridge::model::catalogue::MAX_JOINTS;
use haptic_bridge::model::motor::Motor;
use haptic_bridge::safety::fault::{Fault, State};

/// An amplifier that closes the current loop itself and receives only a set-point.
#[derive(Clone, Copy, Debug, Default)]
struct SetPoint {
    torque_constant: f32,
    /// Current at a set-point of 1, A.
    full_scale: f32,
    max_current: f32,
    target: f32,
}

impl Stage for SetPoint {
    type Sample = ();
    type Drive = f32;

    fn new(motor: &Motor<f32>, _: &Bridge, max_current: f32) -> Self {
        let mut stage =
            Self { torque_constant: motor.torque_constant, full_scale: motor.max_current, ..Self::default() };
        stage.limit(max_current);
        stage
    }
    fn limit(&mut self, max_current: f32) {
        self.max_current = max_current.min(self.full_scale);
    }
    fn max_current(&self) -> f32 {
        self.max_current
    }
    fn max_torque(&self) -> f32 {
        self.max_current * self.torque_constant
    }
    fn torque_of(&self, current: f32) -> f32 {
        current * self.torque_constant
    }
    fn target_current(&self) -> f32 {
        self.target
    }
    fn command(&mut self, torque: f32) {
        self.target = (torque / self.torque_constant).clamp(-self.max_current, self.max_current);
    }
    fn drive(&mut self, _: &Supply, (): (), _: f32, _: bool) -> f32 {
        self.target / self.full_scale
    }
    fn duty(drive: f32) -> f32 {
        drive
    }
    fn rest(&mut self) {
        self.target = 0.0;
    }
    fn inherit(&mut self, other: &Self) {
        self.target = other.target;
    }
}

/// Samples of a three-phase motor: two currents (A), and the rotor's electrical angle (rad).
#[derive(Clone, Copy, Debug, Default)]
struct Phases {
    currents: [f32; 2],
    angle: f32,
}

/// A synchronous motor with a proportional current loop in the rotor's frame and a current perpendicular to the field.
#[derive(Clone, Copy, Debug, Default)]
struct FieldOriented {
    set_point: SetPoint,
    resistance: f32,
}

impl Stage for FieldOriented {
    type Sample = Phases;
    type Drive = [f32; 3];

    fn new(motor: &Motor<f32>, bridge: &Bridge, max_current: f32) -> Self {
        Self { set_point: SetPoint::new(motor, bridge, max_current), resistance: motor.resistance }
    }
    fn limit(&mut self, max_current: f32) {
        self.set_point.limit(max_current);
    }
    fn max_current(&self) -> f32 {
        self.set_point.max_current()
    }
    fn max_torque(&self) -> f32 {
        self.set_point.max_torque()
    }
    fn torque_of(&self, current: f32) -> f32 {
        self.set_point.torque_of(current)
    }
    fn target_current(&self) -> f32 {
        self.set_point.target_current()
    }
    fn command(&mut self, torque: f32) {
        self.set_point.command(torque);
    }
    fn drive(&mut self, supply: &Supply, phases: Phases, _: f32, _: bool) -> [f32; 3] {
        let (sin, cos) = BoardMath::sin_cos(phases.angle);
        let [a, b] = phases.currents;
        // Amplitude-invariant Clarke and Park transforms.
        let beta = (a + 2.0 * b) / 3.0_f32.sqrt();
        let (direct, across) = (cos * a + sin * beta, cos * beta - sin * a);
        let control = |target: f32, current: f32| self.resistance * (target + (target - current)) * supply.inverse;
        let (direct, across) = (control(0.0, direct), control(self.set_point.target, across));
        let (alpha, beta) = (cos * direct - sin * across, sin * direct + cos * across);
        let half = 0.5 * 3.0_f32.sqrt() * beta;
        [alpha, half - 0.5 * alpha, -half - 0.5 * alpha]
    }
    fn duty([a, b, c]: [f32; 3]) -> f32 {
        ((a * a + b * b + c * c) / 1.5).sqrt()
    }
    fn rest(&mut self) {
        self.set_point.rest();
    }
    fn inherit(&mut self, other: &Self) {
        self.set_point.inherit(&other.set_point);
    }
}

/// An armed paddle with a motor stage of type `S` and its tip 1 cm deep in a wall.
struct PressedRig<S: Stage> {
    control_loop: ControlLoop<Box<Program<BoardMath, S>>, S>,
    samples: Samples,
}

impl<S: Stage> PressedRig<S> {
    fn pressed_into_wall(stiffness: f32) -> Self {
        let control_loop = ControlLoop::new(hardware(), rules());
        let mut rig = Self { control_loop, samples: Samples { bus_voltage: 24.0, ..Samples::default() } };
        let scene = scene(1, &[wall(-0.005, stiffness)]);
        let program = Program::new(&hardware(), &limits(), &device(&paddle()), &scene, false);
        rig.execute(Command::Program(Box::new(program.expect("a program that fits"))));
        rig.run(100);
        rig.execute(Command::Home);
        rig.execute(Command::PolarityKnown);
        rig.run(100);
        rig.execute(Command::Arm);
        rig.run(1_200);
        let target = (-0.15 / std::f64::consts::TAU * COUNTS_PER_TURN) as i32;
        while self::State::Armed == rig.control_loop.status().state && rig.samples.counts[0] > target {
            rig.samples.counts[0] -= 5;
            rig.run(1);
        }
        rig
    }

    fn execute(&mut self, command: Command<Box<Program<BoardMath, S>>>) {
        assert_eq!(self.control_loop.execute(command).0, Ok(()));
    }

    fn run(&mut self, steps: u32) {
        for _ in 0..steps {
            // The measured current equals the commanded current.
            self.samples.currents = Currents(self.control_loop.frame().motors.torque.map(|torque| torque / 0.1));
            // Ten carrier periods of 20 kHz make one control step at 2 kHz.
            for _ in 0..10 {
                self.control_loop.guard(&self.samples);
                self.control_loop.check_slow_faults(&self.samples);
            }
            self.control_loop.control(&self.samples);
        }
    }
}

#[test]
fn an_amplifier_gets_the_current_of_the_walls_torque() {
    // 1 cm at 250 N/m and an arm of 0.1 m is 0.25 N m, or 2.5 A of 3 A.
    let mut rig = PressedRig::<SetPoint>::pressed_into_wall(250.0);
    let drives = rig.control_loop.duties(24.0, &[(); MAX_JOINTS], false);
    assert!((drives[0] - 2.5 / 3.0).abs() < 0.01, "{drives:?}");
    rig.execute(Command::Disarm);
    assert_eq!(rig.control_loop.duties(24.0, &[(); MAX_JOINTS], false), [0.0; MAX_JOINTS]);
}

#[test]
fn limits_and_the_thermal_budget_hold_for_an_amplifier() {
    let mut rig = PressedRig::<SetPoint>::pressed_into_wall(1.0e6);
    let limit = limits().torque[0];
    assert!(
        (rig.control_loop.frame().motors.torque[0] - limit).abs() < 1.0e-6,
        "{:?}",
        rig.control_loop.frame().motors.torque
    );
    // 3 A use up the budget of (3² - 1²) A² in 4 s. The count alternates so that the encoder does not look stuck.
    for step in 0..8_400 {
        rig.samples.counts[0] += if step % 2 == 0 { 1 } else { -1 };
        rig.run(1);
    }
    assert_eq!(rig.control_loop.status().fault.map(|record| record.fault), Some(Fault::ThermalBudget));
    assert_eq!(rig.control_loop.duties(24.0, &[(); MAX_JOINTS], false), [0.0; MAX_JOINTS]);
}

#[test]
fn a_field_oriented_motor_has_its_voltage_across_the_field() {
    let mut rig = PressedRig::<FieldOriented>::pressed_into_wall(250.0);
    for angle in [0.0_f32, 1.0, 2.5, -2.0] {
        let current = rig.control_loop.frame().motors.torque[0] / 0.1;
        // 2.5 A flow perpendicular to the field.
        let phase = |shift: f32| -current * (angle - shift).sin();
        let third = std::f32::consts::TAU / 3.0;
        let mut phases = [Phases::default(); MAX_JOINTS];
        phases[0] = Phases { currents: [phase(0.0), phase(third)], angle };
        let drives = rig.control_loop.duties(24.0, &phases, false);
        let expected = [0.0, third, -third].map(|shift| 2.0 * phase(shift) / 24.0);
        for (drive, expected) in drives[0].iter().zip(expected) {
            assert!((drive - expected).abs() < 1.0e-5, "{angle} rad: {:?}, expected {expected:?}", drives[0]);
        }
        assert!((rig.control_loop.frame().motors.duty[0] - 2.0 * current / 24.0).abs() < 1.0e-5);
    }
    assert_eq!(rig.control_loop.status().state, State::Armed);
}
