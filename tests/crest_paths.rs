//! The fast paths compute the same numbers as the general paths. The tests compare a crest in one pass with the same
//! crest stage by stage, and the fast current loop with the general current loop.

use crate::rig::{self, device, five_bar, hardware, paddle, scene, wall};
use haptic_bridge::control::compiled::{self, BoardControlLoop, Legs};
use haptic_bridge::control::frame::Samples;
use haptic_bridge::control::host_force::ForceRequest;
use haptic_bridge::control::joints::Currents;
use haptic_bridge::control::program::{Hardware, Program};
use haptic_bridge::control::{Beat, Command, ControlLoop, HostAction, Rules};
use haptic_bridge::drive::brushed::Axis;
use haptic_bridge::drive::carrier::Carrier;
use haptic_bridge::drive::stage::{Bridge, Stage, Supply};
use haptic_bridge::model::catalogue::{Kind, MAX_GEOMETRY, MAX_JOINTS};
use haptic_bridge::model::description::Description;
use haptic_bridge::model::motor::{Motor, Winding};
use haptic_bridge::render::scene::{FeedForward, Plane, Scene, Surface, VelocityTerms, Wall};
use haptic_bridge::render::velocity::{Coefficients, Estimator};
use haptic_bridge::safety::fault::{Fault, State};
use std::collections::BTreeSet;

/// A generator of random numbers, xorshift64 (Marsaglia 2003).
struct Random(u64);

impl Random {
    /// Draws a number from 0 to 1.
    fn unit_number(&mut self) -> f32 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0 >> 40) as f32 / (1 << 24) as f32
    }

    fn uniform(&mut self, low: f32, high: f32) -> f32 {
        low + (high - low) * self.unit_number()
    }

    fn one_chance_in(&mut self, rarity: f32) -> bool {
        self.unit_number() * rarity < 1.0
    }

    /// Returns a random number from 0 to `end` - 1.
    fn index_below(&mut self, end: usize) -> usize {
        (self.unit_number() * end as f32) as usize % end
    }

    fn choose<T: Copy>(&mut self, values: &[T]) -> T {
        values[self.index_below(values.len())]
    }
}

const INVALID_NUMBERS: [f32; 8] = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, f32::MAX, -0.0, 1.0e-40, 1.0e3, -1.0e3];

/// Number of crests between two comparisons of complete control loops.
const COMPARISON_INTERVAL: u32 = 50;

/// Returns a value as text. The texts of two floats are equal only if their bits are equal or both are NaN.
fn as_text(value: &impl core::fmt::Debug) -> String {
    format!("{value:?}")
}

#[test]
fn the_fast_current_loop_equals_the_general_one() {
    let mut random = Random(17);
    let (mut easy, mut hard) = ([0; 2], [0; 2]);
    for _ in 0..400 {
        let motor = Motor {
            torque_constant: random.choose(&[0.05, -0.02, 0.3, 0.0]),
            resistance: random.uniform(0.05, 5.0),
            inductance: random.choose(&[0.0, 1.0e-5, 2.0e-4, 1.0e-3, 5.0e-3]),
            back_emf: random.uniform(-0.1, 0.3),
            max_current: random.uniform(0.0, 20.0),
            winding: Winding::Brushed,
            verified: true,
        };
        let bridge = Bridge {
            carrier_hz: random.uniform(20_000.0, 50_000.0),
            dead_time: random.uniform(0.0, 500.0e-9),
            bandwidth_hz: random.uniform(100.0, 2_000.0),
            current_sensed: !random.one_chance_in(5.0),
            legs: 2,
        };
        let mut axis = Axis::new(&motor, &bridge, random.uniform(0.0, 15.0));
        let mut current = 0.0;
        for _ in 0..400 {
            if random.one_chance_in(4.0) {
                if random.one_chance_in(100.0) {
                    axis.limit(random.uniform(0.0, 15.0));
                }
                let bound = 1.5 * axis.max_torque();
                axis.command(if random.one_chance_in(200.0) {
                    random.choose(&INVALID_NUMBERS)
                } else {
                    random.uniform(-bound, bound)
                });
            }
            let is_invalid = random.one_chance_in(300.0);
            let sample = if is_invalid { random.choose(&INVALID_NUMBERS) } else { current + random.uniform(-0.1, 0.1) };
            let speed =
                if random.one_chance_in(300.0) { random.choose(&INVALID_NUMBERS) } else { random.uniform(-30.0, 30.0) };
            let supply = Supply::of(if random.one_chance_in(10.0) {
                random.uniform(1.0, 10.0)
            } else {
                random.uniform(20.0, 50.0)
            });
            let (mut fast, mut general, late) = (axis, axis, random.one_chance_in(10.0));
            let duty = general.drive(&supply, sample, speed, late);
            match fast.drive_in_range(&supply, sample, speed, late) {
                Some(other) => {
                    easy[usize::from(late)] += 1;
                    assert_eq!((as_text(&other), as_text(&fast)), (as_text(&duty), as_text(&general)), "from {axis:?}");
                }
                None => {
                    hard[usize::from(late)] += 1;
                    assert_eq!(as_text(&fast), as_text(&axis), "the fast path declined but changed the axis");
                }
            }
            axis = general;
            axis.settle(supply.volts, speed, speed, speed);
            current += 0.5 * (axis.target_current() - current);
            if is_invalid {
                axis.rest();
            }
        }
    }
    let enough = easy[0] > 20_000 && hard[0] > 5_000 && easy[1] > 5_000 && hard[1] > 2_000;
    assert!(enough, "{easy:?} fast steps in time and late, {hard:?} general steps");
}

fn samples_at_rest() -> Samples {
    Samples { bus_voltage: 24.0, ..Samples::default() }
}

/// Control rate of the scenes in this file, Hz. Every crest has a control step.
const RATE_HZ: f32 = 2_000.0;

/// Two boards. The first runs crests in one pass where possible, the second runs every crest stage by stage.
struct BoardPair {
    control_loops: [BoardControlLoop; 2],
    legs: [Legs; 2],
    carrier: Carrier,
    crests: u32,
}

impl BoardPair {
    fn new(description: &Description, scene: &Scene<f32>, rules: Rules) -> Self {
        // A simulated board assumes the alignment of three-phase motors.
        let hardware = Hardware { real: !has_phases(description), ..hardware() };
        let control_loop = || {
            let program = Program::new(&hardware, &rules.limits, &device(description), scene, false);
            let mut control_loop: BoardControlLoop = ControlLoop::new(hardware, rules);
            let program = Box::leak(Box::new(program.expect("a program that fits")));
            control_loop.execute(Command::Program(program)).0.expect("the board accepts a program");
            control_loop
        };
        let carrier = Carrier::for_rate(hardware.timer_hz, 20_000.0);
        Self { control_loops: [control_loop(), control_loop()], legs: [Legs::default(); 2], carrier, crests: 0 }
    }

    fn execute(&mut self, command: impl Fn() -> Command<compiled::BoardProgram>) {
        let [one, other] = self.control_loops.each_mut().map(|control_loop| control_loop.execute(command()).0);
        assert_eq!(one, other);
    }

    /// Homes both boards at rest and sets the polarity as known.
    fn home(&mut self) {
        for homes in [true, false] {
            for _ in 0..40 {
                self.crest(&samples_at_rest(), true);
            }
            self.execute(|| if homes { Command::Home } else { Command::PolarityKnown });
        }
    }

    fn apply_to_both(&mut self, act: impl Fn(&mut BoardControlLoop)) {
        self.control_loops.iter_mut().for_each(act);
    }

    /// Runs a crest and its valley, with a control step if it is `due`.
    fn crest(&mut self, samples: &Samples, due: bool) {
        self.crests += 1;
        let ticks = self.carrier.ticks();
        if due {
            self.apply_to_both(|control_loop| compiled::render(control_loop, &samples.counts));
        }
        let ([one, other], [legs, other_legs]) = (&mut self.control_loops, &mut self.legs);
        // A crest replaces the currents of three-phase motors.
        let (mut seen, mut others_seen) = (*samples, *samples);
        let drives = if due {
            compiled::crest(one, &mut seen, &ticks, legs)
        } else {
            compiled::crest_of_any_kind(one, &mut seen, due, &ticks, legs)
        };
        let others = compiled::crest_of_any_kind(other, &mut others_seen, due, &ticks, other_legs);
        assert_eq!((drives, &legs), (others, &other_legs), "{samples:?} {:?} {:?}", one.status(), other.status());
        // After a crest in one pass the valley records the samples.
        let samples = &seen;
        self.apply_to_both(|control_loop| compiled::note(control_loop, samples, None));
        self.assert_equal(samples);
        let [one, other] =
            self.control_loops.each_mut().map(|control_loop| compiled::check_slow_faults(control_loop, samples));
        assert_eq!(one, other, "at the valley after {samples:?}");
        self.assert_equal(samples);
    }

    fn assert_equal(&self, samples: &Samples) {
        let [one, other] = self
            .control_loops
            .each_ref()
            .map(|control_loop| (control_loop.frame(), control_loop.status(), *control_loop.heat()));
        // Texts are slow to compare, but they distinguish 0 from -0 and treat NaN as equal to NaN.
        if one != other || self.crests.is_multiple_of(COMPARISON_INTERVAL) {
            assert_eq!(as_text(&one), as_text(&other), "{samples:?}");
        }
    }

    fn state(&self) -> State {
        self.control_loops[0].status().state
    }

    /// Returns two flags. The first is true if the control loop plans the next crest in one pass. The second is true if
    /// the crest takes one pass although a limit reduced the last torques.
    fn one_pass_flags(&self) -> [bool; 2] {
        let text = as_text(&self.control_loops[0]);
        let usual = !text.contains(" one_pass_joints: 0,");
        let steady = text.contains(" steady: 0,");
        [usual && steady, usual && !steady && text.contains(" in_force: true,")]
    }
}

/// Pole pairs of three-phase motors.
const POLE_PAIRS: u8 = 5;

fn has_phases(description: &Description) -> bool {
    description.joints[0].motor.is_some_and(|motor| motor.winding != Winding::Brushed)
}

/// Returns half the difference and the sum of the currents of a three-phase motor's first two legs at a count, for this
/// quadrature current.
fn leg_currents(quadrature: f32, count: i32) -> (f32, f32) {
    let angle = f32::from(POLE_PAIRS) * count as f32 * (core::f32::consts::TAU / 60_000.0);
    let [alpha, beta] = [-angle.sin() * quadrature, angle.cos() * quadrature];
    let (u, v) = (alpha, 0.75_f32.sqrt() * beta - 0.5 * alpha);
    (0.5 * (u - v), u + v)
}

fn devices() -> [Description; 3] {
    let mut geometry = [0.0; MAX_GEOMETRY];
    geometry[..3].copy_from_slice(&[0.1, 0.1, 0.05]);
    let joints = [five_bar().joints[0]; 3];
    let arm = Description { kind: Kind::Serial3r, geometry, joints, home: Some([0.3, 0.6, 0.5]), ..five_bar() };
    let heavy = Description { gravity: [0.0, -9.81, 0.0], ..five_bar() };
    [paddle(), heavy, arm]
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Disturbance {
    Nothing,
    Current,
    Bus,
    LowBus,
    Imbalance,
    CountJump,
    Speed,
    JointRange,
    Power,
    IndexMark,
    ReportedFault,
    Push,
    Disarm,
    SilentHost,
    WrongCurrent,
    PolarityCheck,
    Velocity,
    Stretch,
    Weight,
}

const DISTURBANCES: [Disturbance; 19] = [
    Disturbance::Nothing,
    Disturbance::Current,
    Disturbance::Bus,
    Disturbance::LowBus,
    Disturbance::Imbalance,
    Disturbance::CountJump,
    Disturbance::Speed,
    Disturbance::JointRange,
    Disturbance::Power,
    Disturbance::IndexMark,
    Disturbance::ReportedFault,
    Disturbance::Push,
    Disturbance::Disarm,
    Disturbance::SilentHost,
    Disturbance::WrongCurrent,
    Disturbance::PolarityCheck,
    Disturbance::Velocity,
    Disturbance::Stretch,
    Disturbance::Weight,
];

fn random_scene(description: &Description, kind: Disturbance, random: &mut Random) -> Scene<f32> {
    let task = if description.kind == Kind::Paddle { 1 } else { 2 };
    // A scene without walls reports the tip position at home.
    let mut bare = BoardPair::new(description, &scene(task, &[]), rig::rules());
    bare.home();
    let tip = bare.control_loops[0].status().tip;
    let walls: Vec<Wall<f32>> = (0..random.index_below(3).max(usize::from(kind == Disturbance::Weight)))
        .map(|_| {
            let point = [tip[0] + random.uniform(-0.002, -0.0002), tip[1], 0.0];
            let feed_forward = random.choose(&[FeedForward::Off, FeedForward::Full, FeedForward::Washout]);
            let surface = Surface::Plane(Plane { point, normal: [1.0, 0.0, 0.0] });
            let damping = random.uniform(0.0, 2.0);
            Wall { surface, feed_forward, damping, ..wall(0.0, random.choose(&[100.0, 1_000.0, 5_000.0])) }
        })
        .collect();
    let velocity_terms = if random.one_chance_in(2.0) { VelocityTerms::default() } else { VelocityTerms::Off };
    let gravity_compensation = kind == Disturbance::Weight || random.one_chance_in(2.0);
    Scene { rate_hz: RATE_HZ, velocity_terms, gravity_compensation, ..scene(task, &walls) }
}

/// Arms a random device and disturbs it. Returns the number of compared crests in one pass, the number of crests in one
/// pass with reduced torques, and the fault.
fn run_episode(random: &mut Random, kind: Disturbance, phases: bool) -> ([u32; 2], Option<Fault>) {
    let mut description = random.choose(&devices());
    if matches!(kind, Disturbance::Stretch | Disturbance::Weight) {
        description = devices()[1];
    }
    if phases {
        for motor in description.joints.iter_mut().filter_map(|joint| joint.motor.as_mut()) {
            motor.winding = Winding::ThreePhase { pole_pairs: POLE_PAIRS, ratio: 1.0 };
        }
    }
    let joints = description.joints.iter().take_while(|joint| joint.motor.is_some()).count();
    let mut rules = Rules { host_action: HostAction::Ignore, host_seconds: 0.05, ..rig::rules() };
    rules.limits.tip_force = random.choose(&[1.0e3, 3.0]);
    rules.limits.torque = [random.choose(&[0.3, 0.1, 0.03, 0.01, 0.003]); MAX_JOINTS];
    if kind == Disturbance::Stretch {
        rules.limits.torque = [0.003; MAX_JOINTS];
    }
    if kind == Disturbance::Weight {
        // These limits are close to the torques of the device's weight at home.
        rules.limits.torque = random.choose(&[[0.0261, 0.0266, 0.0], [0.032; MAX_JOINTS]]);
    }
    if kind == Disturbance::JointRange {
        let home = description.home.expect("every device here has a home");
        for (joint, home) in description.joints.iter_mut().zip(home).take(joints) {
            joint.limits = Some((home - 0.04, home + 0.04));
        }
    }
    if kind == Disturbance::Power {
        rules.limits.power = 0.02;
    }
    if kind == Disturbance::SilentHost {
        rules.host_action = random.choose(&[HostAction::Hold, HostAction::Disarm]);
    }
    if kind == Disturbance::IndexMark {
        rules.index_period = [60_000; MAX_JOINTS];
    }
    let mut pair = BoardPair::new(&description, &random_scene(&description, kind, random), rules);
    pair.home();
    let mut samples = samples_at_rest();
    let checks = random.one_chance_in(10.0);
    pair.execute(|| if checks { Command::CheckPolarity } else { Command::Arm });
    let (mut velocity, mut at, mut usual) = ([0.0_f32; MAX_JOINTS], [0.0_f32; MAX_JOINTS], [0; 2]);
    let (begins, axis) = (1_050 + random.index_below(600) as u32, random.index_below(joints));
    let (mut fault, mut quadrature) = (None, [0.0_f32; MAX_JOINTS]);
    for crest in 0..1_800 {
        // Every joint moves randomly near its home.
        let motors = pair.control_loops[0].frame().motors;
        for i in 0..joints {
            velocity[i] = 0.98 * velocity[i] + random.uniform(-0.4, 0.4) - 2.0e-4 * at[i];
            at[i] += velocity[i];
            let moved = at[i].round() as i32 - samples.counts[i];
            samples.counts[i] += moved;
            // The winding has 2 ohm and 1 mH, and the back-EMF is 0.1 V s/rad.
            let speed = moved as f32 * (core::f32::consts::TAU / 60_000.0 * 20_000.0);
            let current = &mut quadrature[i];
            *current += (motors.duty[i] * samples.bus_voltage - 2.0 * *current - 0.1 * speed) * 50.0e-6 / 1.0e-3;
            samples.currents[i] = *current;
            if phases {
                (samples.currents[i], samples.imbalance[i]) = leg_currents(*current, samples.counts[i]);
            }
        }
        if crest % 20 == 0 && (kind != Disturbance::SilentHost || crest < begins) {
            pair.execute(|| Command::Beat(Beat::Here));
        }
        let mut shown = samples;
        let (now, on) = (crest == begins, crest >= begins);
        match kind {
            Disturbance::Nothing => {}
            Disturbance::Current if now => shown.currents[axis] = random.choose(&INVALID_NUMBERS),
            Disturbance::Bus if now => shown.bus_voltage = random.choose(&[f32::NAN, f32::INFINITY, -24.0, 5.0, 60.0]),
            Disturbance::LowBus if on => samples.bus_voltage = 10.5,
            Disturbance::Imbalance if now => shown.imbalance[axis] = random.choose(&[f32::NAN, 5.0, -5.0]),
            Disturbance::CountJump if now => {
                shown.counts[axis] = random.choose(&[i32::MIN, i32::MAX, 100_000, 60, -60])
            }
            Disturbance::Speed if on => at[axis] += random.uniform(8.0, 14.0),
            Disturbance::JointRange if on => at[axis] += 5.0,
            // Both cranks turn outwards until the elbows are stretched.
            Disturbance::Stretch if crest > 1_050 => {
                (velocity, at) = ([0.0; MAX_JOINTS], [at[0] + 7.0, at[1] - 7.0, 0.0])
            }
            Disturbance::Velocity if now => {
                let rate = random.choose(&[f32::NAN, f32::INFINITY]);
                let coefficients = Coefficients::new(Estimator::BackwardDifference, rate, 1.0);
                pair.execute(|| Command::Coefficients(coefficients.expect("a backward difference has no cutoff")));
            }
            Disturbance::IndexMark if on && random.one_chance_in(20.0) => {
                let count = shown.counts[axis] + random.choose(&[0, 1, -3, 60_000]);
                let mut marks = [None; MAX_JOINTS];
                marks[axis] = Some(count);
                pair.apply_to_both(|control_loop| control_loop.mark(marks));
            }
            Disturbance::ReportedFault if now => {
                pair.apply_to_both(|control_loop| control_loop.trip(Fault::GateDriver, None, f32::NAN))
            }
            Disturbance::Push | Disturbance::Power | Disturbance::Weight if on && crest % 30 == 0 => {
                let mut torque = [0.0; MAX_JOINTS];
                torque[axis] = random.uniform(-2.0, 2.0) * rules.limits.torque[axis];
                if kind == Disturbance::Weight {
                    // The weight alone exceeds the limits, but weight and requested torque together are within them.
                    torque = [random.uniform(0.0, 0.02), random.uniform(-0.02, 0.0), 0.0];
                }
                let request =
                    ForceRequest { sequence: crest, hold: 0.01, fade: 0.01, torque, ..ForceRequest::default() };
                let [one, other] = pair.control_loops.each_mut().map(|control_loop| control_loop.force(&request));
                assert_eq!(as_text(&one), as_text(&other));
            }
            Disturbance::Disarm if now => pair.execute(|| Command::Disarm),
            Disturbance::WrongCurrent if on => shown.currents = Currents([random.uniform(-4.0, 4.0); MAX_JOINTS]),
            Disturbance::PolarityCheck if now => pair.execute(|| Command::CheckPolarity),
            _ => {}
        }
        if random.one_chance_in(500.0) {
            pair.crest(&shown, false);
        }
        shown.late = random.one_chance_in(20.0);
        if crest % COMPARISON_INTERVAL == 0 {
            let is_usual = pair.one_pass_flags();
            usual.iter_mut().zip(is_usual).for_each(|(sum, one)| *sum += u32::from(one));
        }
        pair.crest(&shown, true);
        fault = fault.or(pair.control_loops[0].status().fault.map(|record| record.fault));
        if crest > begins + 40 && pair.state() == State::Fault {
            pair.execute(|| Command::Clear);
            break;
        }
    }
    for _ in 0..40 {
        pair.crest(&samples, true);
    }
    (usual, fault)
}

#[test]
fn a_crest_in_one_pass_equals_the_crest_stage_by_stage() {
    let mut random = Random(4);
    let (mut usual, mut cut, mut faults) = (0, 0, BTreeSet::new());
    for nth in 0..342 {
        let ([one_pass, reduced], fault) = run_episode(&mut random, DISTURBANCES[nth % DISTURBANCES.len()], false);
        (usual, cut) = (usual + one_pass, cut + reduced);
        faults.extend(fault.map(Fault::name));
    }
    assert!(usual * COMPARISON_INTERVAL > 80_000, "only {usual} examined crests took one pass");
    assert!(cut * COMPARISON_INTERVAL > 20_000, "only {cut} examined crests took one pass with reduced torques");
    for fault in [
        Fault::NotFinite,
        Fault::OverCurrent,
        Fault::CurrentSensor,
        Fault::EncoderJump,
        Fault::SpeedLimit,
        Fault::JointLimit,
        Fault::PowerLimit,
        Fault::BusUnderVoltage,
        Fault::BusOverVoltage,
        Fault::IndexMismatch,
        Fault::HostLost,
        Fault::GateDriver,
        Fault::MotorModel,
        Fault::Singularity,
    ] {
        assert!(faults.contains(fault.name()), "no {} in {faults:?}", fault.name());
    }
}

#[test]
fn a_crest_with_three_phase_motors_in_one_pass_equals_the_crest_stage_by_stage() {
    let (mut random, mut usual) = (Random(5), 0);
    for nth in 0..114 {
        usual += run_episode(&mut random, DISTURBANCES[nth % DISTURBANCES.len()], true).0[0];
    }
    assert!(usual * COMPARISON_INTERVAL > 20_000, "only {usual} examined crests took one pass");
}
