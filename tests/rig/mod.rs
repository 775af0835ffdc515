//! A control loop with a device and a scene for tests of the safety logic, without hardware and with one call per step.
#![allow(dead_code, reason = "every test file uses a part")]

use crate::common::bilateral_wall;
use haptic_bridge::control::compiled::BoardMath;
use haptic_bridge::control::frame::{Outputs, Samples};
use haptic_bridge::control::joints::{Counts, Currents, Torques};
use haptic_bridge::control::program::{Hardware, Program};
use haptic_bridge::control::{Beat, Command, ControlLoop, HostAction, Rules};
use haptic_bridge::drive::motor_stage::MotorStage;
use haptic_bridge::drive::stage::{Bridge, Stage as _};
use haptic_bridge::math::Libm;
use haptic_bridge::model::catalogue::{Kind, MAX_GEOMETRY, MAX_JOINTS, MAX_LINKS};
use haptic_bridge::model::description::{Description, Encoder, Homing, Joint, Link};
use haptic_bridge::model::device::Device;
use haptic_bridge::model::mechanism::AnyMechanism;
use haptic_bridge::model::motor::{Motor, Winding};
use haptic_bridge::render::scene::{FeedForward, Plane, Scene, Spring, Surface, Wall};
use haptic_bridge::safety::fault::{Fault, State};
use haptic_bridge::safety::limits::Limits;
use haptic_bridge::safety::refusal::Refusal;

pub mod board;
pub mod statics;

pub type BoxedProgram = Box<Program<BoardMath>>;

/// Control rate of the scenes in this module, Hz.
pub const RATE_HZ: f32 = 2_000.0;
/// Control rates at which limits and checks are tested, Hz.
pub const RATES_HZ: [f32; 3] = [200.0, 1_000.0, 20_000.0];
pub const COUNTS_PER_TURN: f64 = 60_000.0;

/// Returns a board with three axes and all sensors.
pub fn hardware() -> Hardware {
    Hardware {
        axes: 3,
        encoders: 3,
        real: true,
        bus_sensed: true,
        bridge: Bridge {
            carrier_hz: 20_000.0,
            dead_time: 200.0e-9,
            bandwidth_hz: 1_000.0,
            current_sensed: true,
            legs: 2,
        },
        timer_hz: 168_000_000,
    }
}

/// Returns rules with limits that a test can reach, and no reaction to a silent host.
pub fn rules() -> Rules {
    Rules { limits: limits(), host_action: HostAction::Ignore, ..Rules::default() }
}

pub fn limits() -> Limits {
    Limits {
        torque: [0.3; MAX_JOINTS],
        current: [3.0; MAX_JOINTS],
        continuous_current: [1.0; MAX_JOINTS],
        speed: [20.0; MAX_JOINTS],
        power: 2.0,
        bus_min: 10.0,
        bus_max: 28.0,
        tip_force: 1.0e3,
    }
}

fn joint() -> Joint {
    Joint {
        inertia: 1.0e-4,
        limits: Some((-1.0, 1.0)),
        encoder: Some(Encoder { counts_per_turn: COUNTS_PER_TURN, offset: 0.0, inverted: false }),
        motor: Some(Motor {
            torque_constant: 0.1,
            resistance: 2.0,
            inductance: 1.0e-3,
            back_emf: 0.1,
            max_current: 3.0,
            winding: Winding::Brushed,
            verified: true,
        }),
        ..Joint::default()
    }
}

/// Returns a paddle of 0.1 m without gravity, so that 1 rad is 0.1 m and 1 N is 0.1 N m.
pub fn paddle() -> Description {
    let mut geometry = [0.0; MAX_GEOMETRY];
    geometry[0] = 0.1;
    Description {
        kind: Kind::Paddle,
        gravity: [0.0; 3],
        geometry,
        links: [Link::default(); MAX_LINKS],
        joints: [joint(), Joint::default(), Joint::default()],
        handle_mass: 0.0,
        sensed: [None; 3],
        home: Some([0.0; MAX_JOINTS]),
        homing: Homing::Hand,
    }
}

/// Returns the paddle with two encoders without motors, of 1000 counts per turn. The second is inverted, and at 0.5 rad
/// in the home pose.
pub fn sensing_paddle() -> Description {
    let first = Encoder { counts_per_turn: 1_000.0, offset: 0.0, inverted: false };
    Description { sensed: [Some(first), Some(Encoder { offset: 0.5, inverted: true, ..first }), None], ..paddle() }
}

/// Returns a five-bar whose elbows stretch at joint angles well within its limits.
pub fn five_bar() -> Description {
    let link = Link { mass: 0.02, com: 0.03, inertia: 1.0e-5, ..Default::default() };
    let joint = Joint { limits: Some((-3.2, 3.2)), ..joint() };
    Description {
        kind: Kind::FiveBar,
        gravity: [0.0; 3],
        geometry: [0.05, 0.07, 0.07, 0.09, 0.09, 1.0, 0.0, 0.0],
        links: [link; MAX_LINKS],
        joints: [joint, joint, Joint::default()],
        handle_mass: 0.01,
        sensed: [None; 3],
        home: Some([2.4, 0.7, 0.0]),
        homing: Homing::Hand,
    }
}

/// A device that starts at home and is moved by its motors: M q̈ = τ - B q̇, with B = 2 mN m s/rad in every joint.
pub struct Body {
    mechanism: AnyMechanism<f32>,
    home: [f64; MAX_JOINTS],
    joints: usize,
    q: [f64; MAX_JOINTS],
    pub qd: [f64; MAX_JOINTS],
}

impl Body {
    pub fn new(description: &Description) -> Self {
        let home = description.home.unwrap_or_default();
        let joints = description.kind.spec().joints;
        let mechanism = AnyMechanism::new(description).expect("a device that moves");
        Self { mechanism, home, joints, q: home, qd: [0.0; MAX_JOINTS] }
    }

    /// Runs one control step in which every motor makes `factor` times the torque of its file.
    pub fn step(&mut self, rig: &mut Rig, factor: f64) {
        let q = self.q.map(|angle| angle as f32);
        let inertia = self.mechanism.inertia::<Libm>(&q);
        let mass = nalgebra::Matrix3::from_fn(|i, j| match (i < self.joints, j < self.joints) {
            (true, true) => f64::from(inertia[i][j]),
            _ => f64::from(u8::from(i == j)),
        });
        let torque = nalgebra::Vector3::from_fn(|i, _| {
            if i < self.joints { factor * 0.1 * f64::from(rig.currents[i]) - 2.0e-3 * self.qd[i] } else { 0.0 }
        });
        let accelerated = mass.lu().solve(&torque).expect("a mass matrix");
        for i in 0..self.joints {
            self.qd[i] += accelerated[i] / f64::from(rig.rate);
            self.q[i] += self.qd[i] / f64::from(rig.rate);
            rig.samples.counts[i] =
                ((self.q[i] - self.home[i]) / core::f64::consts::TAU * COUNTS_PER_TURN).round() as i32;
        }
        rig.step();
    }

    /// Runs until the polarity check waits for the second joint.
    pub fn run_first_joint_check(&mut self, rig: &mut Rig) {
        let (mut pushed, mut waits) = (false, 0);
        while waits < 50 {
            self.step(rig, 1.0);
            let idle = rig.torques() == Torques::default();
            pushed |= !idle;
            waits = if pushed && idle { waits + 1 } else { 0 };
            assert_eq!(rig.state(), State::CheckingPolarity, "{:?}", rig.fault());
        }
    }

    pub fn run_check(&mut self, rig: &mut Rig, factor: f64) {
        for _ in 0..(20.0 * rig.rate) as u32 {
            if rig.state() != State::CheckingPolarity {
                return;
            }
            self.step(rig, factor);
        }
        panic!("the check does not end");
    }
}

/// Returns a plane wall that faces +x, with its surface at `x` (m).
pub fn wall(x: f32, stiffness: f32) -> Wall<f32> {
    let plane = Surface::Plane(Plane { point: [x, 0.0, 0.0], normal: [1.0, 0.0, 0.0] });
    Wall { feed_forward: FeedForward::Off, bilateral: false, ..bilateral_wall(plane, stiffness.into()) }
}

pub fn scene(task: u8, walls: &[Wall<f32>]) -> Scene<f32> {
    Scene { task, rate_hz: RATE_HZ, cutoff_hz: 200.0, walls: walls.iter().copied().collect(), ..Scene::default() }
}

/// Returns a scene with a spring to a point (m) and no walls.
pub fn spring_scene(task: u8, point: [f32; 3], stiffness: f32) -> Scene<f32> {
    let spring = Spring { point, direction: [0.0; 3], stiffness, damping: 0.0 };
    Scene { springs: [spring].into_iter().collect(), ..scene(task, &[]) }
}

/// Returns the scene with another control rate, Hz.
pub fn at_rate(rate_hz: f32, scene: Scene<f32>) -> Scene<f32> {
    Scene { rate_hz, cutoff_hz: 0.2 * rate_hz, ..scene }
}

/// Returns a scene with a stiff wall at -0.05 m, which the paddle at home does not touch.
pub fn far_wall() -> Scene<f32> {
    scene(1, &[wall(-0.05, 1_000.0)])
}

pub fn device(description: &Description) -> Device<f32> {
    Device::new("test", description).expect("a sound device")
}

/// The control loop, its inputs at the next step, and its outputs at the last step.
pub struct Rig {
    pub control_loop: ControlLoop<BoxedProgram>,
    pub samples: Samples,
    /// Index pulses that arrive before the next step.
    pub marks: Option<[Option<i32>; MAX_JOINTS]>,
    /// Fault that the firmware reports at the next step.
    pub reported_fault: Option<(Fault, Option<u8>, f32)>,
    pub outputs: Outputs,
    pub duties: [f32; MAX_JOINTS],
    pub hardware: Hardware,
    pub rules: Rules,
    /// Reading of the current sensor of axis 0 instead of the true current, A.
    pub shown_current: Option<f32>,
    /// The motors' currents, A.
    pub currents: [f32; MAX_JOINTS],
    /// Resistance of the motors' windings, ohm.
    pub resistance: f32,
    /// Difference between the two sensors of each current, A.
    pub imbalance: [f32; MAX_JOINTS],
    /// Largest current of motor 0 in the last step, A.
    pub peak_current: f32,
    pub rate: f32,
}

impl Rig {
    pub fn without_device(hardware: Hardware, rules: Rules) -> Self {
        let samples = Samples { bus_voltage: 24.0, ..Samples::default() };
        let control_loop = ControlLoop::new(hardware, rules);
        Self {
            control_loop,
            samples,
            marks: None,
            reported_fault: None,
            outputs: Outputs::default(),
            duties: [0.0; MAX_JOINTS],
            hardware,
            rules,
            shown_current: None,
            currents: [0.0; MAX_JOINTS],
            resistance: 2.0,
            imbalance: [0.0; MAX_JOINTS],
            peak_current: 0.0,
            rate: RATE_HZ,
        }
    }

    /// Creates a disarmed board with a paddle and this scene, homed and with known polarity.
    pub fn homed_paddle(scene: &Scene<f32>) -> Self {
        Self::new(&paddle(), scene, hardware(), rules())
    }

    /// Like [`Rig::homed_paddle`], with any device, board and rules.
    pub fn new(description: &Description, scene: &Scene<f32>, hardware: Hardware, rules: Rules) -> Self {
        let mut rig = Self::without_device(hardware, rules);
        rig.prepare(description, scene);
        rig
    }

    /// Loads a device and a scene, homes, and sets the polarity as known.
    pub fn prepare(&mut self, description: &Description, scene: &Scene<f32>) {
        self.load(description, scene, false).expect("a program that fits");
        self.settle();
        self.execute(Command::Home).expect("a device at rest can be homed");
        self.settle();
        self.execute(Command::PolarityKnown).expect("the command is never refused");
    }

    /// Creates an armed paddle that presses 1 cm deep into a wall. 250 N/m need 2.5 A of the allowed 3 A.
    pub fn pressed_paddle(stiffness: f32) -> Self {
        Self::pressed_paddle_in(&scene(1, &[wall(-0.005, stiffness)]))
    }

    /// Like [`Rig::pressed_paddle`], in a scene with a wall at -0.005 m.
    pub fn pressed_paddle_in(scene: &Scene<f32>) -> Self {
        let mut rig = Self::homed_paddle(scene);
        rig.press_wall();
        rig
    }

    /// Arms and turns the paddle 1 cm deep into a wall at -0.005 m.
    pub fn press_wall(&mut self) {
        self.arm();
        self.turn(0, -0.15, 1.0);
    }

    /// Creates an armed paddle at home in the scene [`far_wall`], after the ramp.
    pub fn armed_paddle() -> Self {
        Self::armed_with_rules(|_| ())
    }

    pub fn armed_with_rules(change: impl Fn(&mut Rules)) -> Self {
        let mut rules = rules();
        change(&mut rules);
        let mut rig = Self::new(&paddle(), &far_wall(), hardware(), rules);
        rig.arm();
        rig
    }

    /// Arms and waits for the end of the ramp.
    pub fn arm(&mut self) {
        self.execute(Command::Arm).expect("the board is ready to arm");
        for _ in 0..(0.6 * self.rate) as u32 {
            self.execute(Command::Beat(Beat::Here)).expect("never refused");
            self.step();
        }
        assert_eq!(self.state(), State::Armed, "{:?}", self.control_loop.status().fault);
    }

    pub fn load(&mut self, description: &Description, scene: &Scene<f32>, same_device: bool) -> Result<(), Refusal> {
        self.rate = scene.rate_hz;
        let device = device(description);
        let program = Program::new(&self.hardware, &self.rules.limits, &device, scene, same_device)?;
        self.execute(Command::Program(Box::new(program)))
    }

    pub fn execute(&mut self, command: Command<BoxedProgram>) -> Result<(), Refusal> {
        self.control_loop.execute(command).0
    }

    /// Runs one control step. The currents of the windings follow the duties of every carrier period.
    pub fn step(&mut self) {
        let first = self.control_loop.frame().step == 0;
        let before = if first { self.samples.counts } else { self.control_loop.frame().counts };
        self.peak_current = 0.0;
        let carrier = self.rate.max(20_000.0);
        let carriers = (carrier / self.rate) as u32;
        for nth in 1..=carriers {
            let mut measured = self.currents;
            measured[0] = self.shown_current.unwrap_or(measured[0]);
            // The joint turns evenly between two samples. A control step is due at the last crest.
            let counts = Counts::from_fn(|i| {
                let moved = i64::from(self.samples.counts[i].wrapping_sub(before[i]));
                before[i].wrapping_add((moved * i64::from(nth) / i64::from(carriers)) as i32)
            });
            let (bus_voltage, imbalance) = (self.samples.bus_voltage, Currents(self.imbalance));
            let measured = Currents(measured);
            let crest = Samples { counts, bus_voltage, currents: measured, imbalance, late: false };
            let due = nth == carriers;
            if due {
                self.samples.currents = measured;
                if let Some((fault, axis, value)) = self.reported_fault.take() {
                    self.control_loop.trip(fault, axis, value);
                }
                if let Some(marks) = self.marks.take() {
                    self.control_loop.mark(marks);
                }
            }
            let (at_crest, duties) = self.control_loop.crest(&crest, &measured, due);
            self.outputs = self.control_loop.check_slow_faults(&crest);
            // Bridges that are turned off at the valley never apply the duties of the crest.
            let applied = self.outputs.bridges || !at_crest.bridges;
            self.duties = if applied { duties.map(MotorStage::duty) } else { [0.0; MAX_JOINTS] };
            for (i, current) in self.currents.iter_mut().enumerate() {
                let turned = self.samples.counts[i].wrapping_sub(before[i]) as f32 * core::f32::consts::TAU;
                let voltage = self.duties[i] * 24.0 - 0.1 * turned / COUNTS_PER_TURN as f32 * self.rate;
                *current += (voltage - self.resistance * *current) / 1.0e-3 / carrier;
                if !self.outputs.bridges || self.resistance.is_infinite() {
                    *current = 0.0;
                }
            }
            self.peak_current = self.peak_current.max(self.currents[0].abs());
        }
    }

    pub fn run(&mut self, seconds: f32) {
        for _ in 0..(seconds * self.rate).round() as u32 {
            self.step();
        }
    }

    /// Runs until the filters are at rest.
    pub fn settle(&mut self) {
        self.run(0.05);
    }

    /// Turns joint `i` at `speed` (rad/s) to `angle` (rad) from home.
    pub fn turn(&mut self, i: usize, angle: f64, speed: f64) {
        let target = (angle / core::f64::consts::TAU * COUNTS_PER_TURN).round() as i32;
        let max_counts = (speed / f64::from(self.rate) / core::f64::consts::TAU * COUNTS_PER_TURN).max(1.0) as i32;
        while self.samples.counts[i] != target && self.state() != State::Fault {
            self.samples.counts[i] += (target - self.samples.counts[i]).clamp(-max_counts, max_counts);
            self.step();
        }
    }

    /// Keeps joint 0 in place for `seconds` or until a fault. The encoder moves by one count so that it does not look
    /// stuck, and only the motor's heat can cause a fault.
    pub fn hold_in_place(&mut self, seconds: f32) {
        let there = self.samples.counts[0];
        for step in 0..(seconds * RATE_HZ) as i32 {
            self.samples.counts[0] = there + step % 2;
            self.step();
            if self.state() == State::Fault {
                break;
            }
        }
        self.samples.counts[0] = there;
    }

    pub fn state(&self) -> State {
        self.control_loop.status().state
    }

    pub fn torques(&self) -> Torques {
        self.control_loop.frame().motors.torque
    }

    pub fn fault(&self) -> Option<Fault> {
        self.control_loop.status().fault.map(|record| record.fault)
    }

    /// Returns true if the bridges are off and all duties and torques are zero.
    pub fn motors_are_off(&self) -> bool {
        !self.outputs.bridges && self.duties == [0.0; MAX_JOINTS] && self.torques() == Torques::default()
    }
}

/// Returns the paddle with its upper stop at 1.02 rad, beyond its limit of 1 rad.
pub fn paddle_with_stop() -> Description {
    Description { homing: Homing::Stop([1.02, 0.0, 0.0]), ..paddle() }
}
