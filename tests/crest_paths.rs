//! The fast paths give the same numbers as the general ones: a crest in one pass against the same crest piece by piece,
//! and a current loop far from its limits against the one for any time.

use crate::rig::{self, device, five_bar, hardware, paddle, scene, wall};
use haptic_bridge::control::compiled::{self, BoardControlLoop, Legs};
use haptic_bridge::control::frame::Samples;
use haptic_bridge::control::host_force::ForceRequest;
use haptic_bridge::control::joints::Currents;
use haptic_bridge::control::program::Program;
use haptic_bridge::control::{Beat, Command, ControlLoop, HostAction, Rules};
use haptic_bridge::drive::brushed::Axis;
use haptic_bridge::drive::carrier::Carrier;
use haptic_bridge::drive::stage::{Bridge, Stage, Supply};
use haptic_bridge::model::catalogue::{Kind, MAX_GEOMETRY, MAX_JOINTS};
use haptic_bridge::model::description::Description;
use haptic_bridge::model::motor::Motor;
use haptic_bridge::render::scene::{FeedForward, Plane, Scene, Surface, VelocityTerms, Wall};
use haptic_bridge::render::velocity::{Coefficients, Estimator};
use haptic_bridge::safety::fault::{Fault, State};
use std::collections::BTreeSet;

/// Numbers drawn in turn.
struct Drawn(u64);

impl Drawn {
    /// From 0 to 1.
    fn share(&mut self) -> f32 {
        // Xorshift64 (Marsaglia 2003).
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0 >> 40) as f32 / (1 << 24) as f32
    }

    fn between(&mut self, least: f32, most: f32) -> f32 {
        least + (most - least) * self.share()
    }

    /// About as often as once in `rarity`.
    fn once_in(&mut self, rarity: f32) -> bool {
        self.share() * rarity < 1.0
    }

    fn below(&mut self, end: usize) -> usize {
        (self.share() * end as f32) as usize % end
    }

    fn of<T: Copy>(&mut self, values: &[T]) -> T {
        values[self.below(values.len())]
    }
}

const WILD: [f32; 8] = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, f32::MAX, -0.0, 1.0e-40, 1.0e3, -1.0e3];

/// Every how many crests all of a control loop is told.
const ASKED: u32 = 50;

/// All of a value as text, where two floats are the same only if their bits are, or if neither is a number.
fn told(value: &impl core::fmt::Debug) -> String {
    format!("{value:?}")
}

#[test]
fn a_current_loop_far_from_its_limits_is_the_general_one() {
    let mut drawn = Drawn(17);
    let (mut easy, mut hard) = ([0; 2], [0; 2]);
    for _ in 0..400 {
        let motor = Motor {
            torque_constant: drawn.of(&[0.05, -0.02, 0.3, 0.0]),
            resistance: drawn.between(0.05, 5.0),
            inductance: drawn.of(&[0.0, 1.0e-5, 2.0e-4, 1.0e-3, 5.0e-3]),
            back_emf: drawn.between(-0.1, 0.3),
            max_current: drawn.between(0.0, 20.0),
            verified: true,
        };
        let bridge = Bridge {
            carrier_hz: drawn.between(20_000.0, 50_000.0),
            dead_time: drawn.between(0.0, 500.0e-9),
            bandwidth_hz: drawn.between(100.0, 2_000.0),
            current_sensed: !drawn.once_in(5.0),
        };
        let mut axis = Axis::new(&motor, &bridge, drawn.between(0.0, 15.0));
        let mut current = 0.0;
        for _ in 0..400 {
            if drawn.once_in(4.0) {
                if drawn.once_in(100.0) {
                    axis.limit(drawn.between(0.0, 15.0));
                }
                let most = 1.5 * axis.max_torque();
                axis.command(if drawn.once_in(200.0) { drawn.of(&WILD) } else { drawn.between(-most, most) });
            }
            let wild = drawn.once_in(300.0);
            let sample = if wild { drawn.of(&WILD) } else { current + drawn.between(-0.1, 0.1) };
            let speed = if drawn.once_in(300.0) { drawn.of(&WILD) } else { drawn.between(-30.0, 30.0) };
            let supply =
                Supply::of(if drawn.once_in(10.0) { drawn.between(1.0, 10.0) } else { drawn.between(20.0, 50.0) });
            let (mut soon, mut whole, late) = (axis, axis, drawn.once_in(10.0));
            let duty = whole.drive(&supply, sample, speed, late);
            match soon.drive_easily(&supply, sample, speed, late) {
                Some(other) => {
                    easy[usize::from(late)] += 1;
                    assert_eq!((told(&other), told(&soon)), (told(&duty), told(&whole)), "from {axis:?}");
                }
                None => {
                    hard[usize::from(late)] += 1;
                    assert_eq!(told(&soon), told(&axis), "it changed what it left alone");
                }
            }
            axis = whole;
            axis.settle(supply.volts, speed, speed, speed);
            current += 0.5 * (axis.asked() - current);
            if wild {
                axis.rest();
            }
        }
    }
    let enough = easy[0] > 20_000 && hard[0] > 5_000 && easy[1] > 5_000 && hard[1] > 2_000;
    assert!(enough, "{easy:?} easy ones in time and late, {hard:?} others");
}

fn at_rest() -> Samples {
    Samples { bus_voltage: 24.0, ..Samples::default() }
}

/// Rate of the scenes here, Hz, of which every crest is a control step.
const RATE: f32 = 2_000.0;

/// A board whose crests take one pass where they may, and one that takes them all piece by piece.
struct Pair {
    servos: [BoardControlLoop; 2],
    legs: [Legs; 2],
    carrier: Carrier,
    crests: u32,
}

impl Pair {
    fn new(description: &Description, scene: &Scene<f32>, rules: Rules) -> Self {
        let control_loop = || {
            let program = Program::new(&hardware(), &rules.limits, &device(description), scene, false);
            let mut control_loop: BoardControlLoop = ControlLoop::new(hardware(), rules);
            let program = Box::leak(Box::new(program.expect("a program that fits")));
            control_loop.execute(Command::Program(program)).0.expect("it may be loaded");
            control_loop
        };
        let carrier = Carrier::for_rate(hardware().timer_hz, 20_000.0);
        Self { servos: [control_loop(), control_loop()], legs: [Legs::default(); 2], carrier, crests: 0 }
    }

    /// The same command to both.
    fn ask(&mut self, command: impl Fn() -> Command<compiled::BoardProgram>) {
        let [one, other] = self.servos.each_mut().map(|control_loop| control_loop.execute(command()).0);
        assert_eq!(one, other);
    }

    /// Homes at rest, and stands there.
    fn home(&mut self) {
        for homes in [true, false] {
            for _ in 0..40 {
                self.crest(&at_rest(), true);
            }
            self.ask(|| if homes { Command::Home } else { Command::PolarityKnown });
        }
    }

    fn both(&mut self, act: impl Fn(&mut BoardControlLoop)) {
        self.servos.iter_mut().for_each(act);
    }

    /// A crest and its valley, with a control step that is `due`, or not.
    fn crest(&mut self, seen: &Samples, due: bool) {
        self.crests += 1;
        let ticks = self.carrier.ticks();
        if due {
            self.both(|control_loop| compiled::render(control_loop, &seen.counts));
        }
        let ([one, other], [legs, other_legs]) = (&mut self.servos, &mut self.legs);
        let drives = if due {
            compiled::crest(one, seen, &ticks, legs)
        } else {
            compiled::crest_generally(one, seen, due, &ticks, legs)
        };
        let others = compiled::crest_generally(other, seen, due, &ticks, other_legs);
        assert_eq!((drives, &legs), (others, &other_legs), "{seen:?} {:?} {:?}", one.status(), other.status());
        // A usual step leaves it to the valley to note what it saw.
        self.both(|control_loop| compiled::note(control_loop, seen, None));
        self.agree(seen);
        let [one, other] = self.servos.each_mut().map(|control_loop| compiled::check_slow_faults(control_loop, seen));
        assert_eq!(one, other, "at the valley after {seen:?}");
        self.agree(seen);
    }

    fn agree(&self, seen: &Samples) {
        let [one, other] = self
            .servos
            .each_ref()
            .map(|control_loop| (control_loop.frame(), control_loop.status(), *control_loop.heat()));
        // Text takes long; but it tells zeros of either sign apart, and compares NaN as equal.
        if one != other || self.crests.is_multiple_of(ASKED) {
            assert_eq!(told(&one), told(&other), "{seen:?}");
        }
    }

    fn state(&self) -> State {
        self.servos[0].status().state
    }

    /// Tells if the next crest takes one pass, as far as the control loop knows beforehand, and if it does so after a step that
    /// the limits cut.
    fn is_usual(&self) -> [bool; 2] {
        let told = told(&self.servos[0]);
        let usual = !told.contains(" usual: 0,");
        let steady = told.contains(" steady: 0,");
        [usual && steady, usual && !steady && told.contains(" in_force: true,")]
    }
}

/// Devices of one, two and three joints.
fn devices() -> [Description; 3] {
    let mut geometry = [0.0; MAX_GEOMETRY];
    geometry[..3].copy_from_slice(&[0.1, 0.1, 0.05]);
    let joints = [five_bar().joints[0]; 3];
    let arm = Description { kind: Kind::Serial3r, geometry, joints, home: Some([0.3, 0.6, 0.5]), ..five_bar() };
    let heavy = Description { gravity: [0.0, -9.81, 0.0], ..five_bar() };
    [paddle(), heavy, arm]
}

/// The disturbance of an episode.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Trouble {
    Nothing,
    Current,
    Bus,
    LowBus,
    Imbalance,
    Jump,
    Speed,
    Range,
    Power,
    Mark,
    Told,
    Push,
    Disarm,
    Silence,
    Mismatch,
    Check,
    Velocity,
    Stretch,
    Weight,
}

const TROUBLES: [Trouble; 19] = [
    Trouble::Nothing,
    Trouble::Current,
    Trouble::Bus,
    Trouble::LowBus,
    Trouble::Imbalance,
    Trouble::Jump,
    Trouble::Speed,
    Trouble::Range,
    Trouble::Power,
    Trouble::Mark,
    Trouble::Told,
    Trouble::Push,
    Trouble::Disarm,
    Trouble::Silence,
    Trouble::Mismatch,
    Trouble::Check,
    Trouble::Velocity,
    Trouble::Stretch,
    Trouble::Weight,
];

fn drawn_scene(description: &Description, trouble: Trouble, drawn: &mut Drawn) -> Scene<f32> {
    let task = if description.kind == Kind::Paddle { 1 } else { 2 };
    // A scene without walls tells its position at home.
    let mut bare = Pair::new(description, &scene(task, &[]), rig::rules());
    bare.home();
    let tip = bare.servos[0].status().tip;
    let walls: Vec<Wall<f32>> = (0..drawn.below(3).max(usize::from(trouble == Trouble::Weight)))
        .map(|_| {
            let point = [tip[0] + drawn.between(-0.002, -0.0002), tip[1], 0.0];
            let feed_forward = drawn.of(&[FeedForward::Off, FeedForward::Full, FeedForward::Washout]);
            let surface = Surface::Plane(Plane { point, normal: [1.0, 0.0, 0.0] });
            let damping = drawn.between(0.0, 2.0);
            Wall { surface, feed_forward, damping, ..wall(0.0, drawn.of(&[100.0, 1_000.0, 5_000.0])) }
        })
        .collect();
    let velocity_terms = if drawn.once_in(2.0) { VelocityTerms::default() } else { VelocityTerms::Off };
    let gravity_compensation = trouble == Trouble::Weight || drawn.once_in(2.0);
    Scene { rate_hz: RATE, velocity_terms, gravity_compensation, ..scene(task, &walls) }
}

/// One arming of a device, and what comes of it; how many of the crests that were asked about took one pass, and how many
/// one in which the limits cut.
fn episode(drawn: &mut Drawn, trouble: Trouble) -> ([u32; 2], Option<Fault>) {
    let mut description = drawn.of(&devices());
    if matches!(trouble, Trouble::Stretch | Trouble::Weight) {
        description = devices()[1];
    }
    let joints = description.joints.iter().take_while(|joint| joint.motor.is_some()).count();
    let mut rules = Rules { host_action: HostAction::Ignore, host_seconds: 0.05, ..rig::rules() };
    rules.limits.tip_force = drawn.of(&[1.0e3, 3.0]);
    rules.limits.torque = [drawn.of(&[0.3, 0.1, 0.03, 0.01, 0.003]); MAX_JOINTS];
    if trouble == Trouble::Stretch {
        rules.limits.torque = [0.003; MAX_JOINTS];
    }
    if trouble == Trouble::Weight {
        // About what its weight takes at home.
        rules.limits.torque = drawn.of(&[[0.0261, 0.0266, 0.0], [0.032; MAX_JOINTS]]);
    }
    if trouble == Trouble::Range {
        let home = description.home.expect("all have one");
        for (joint, home) in description.joints.iter_mut().zip(home).take(joints) {
            joint.limits = Some((home - 0.04, home + 0.04));
        }
    }
    if trouble == Trouble::Power {
        rules.limits.power = 0.02;
    }
    if trouble == Trouble::Silence {
        rules.host_action = drawn.of(&[HostAction::Hold, HostAction::Disarm]);
    }
    if trouble == Trouble::Mark {
        rules.index_period = [60_000; MAX_JOINTS];
    }
    let mut pair = Pair::new(&description, &drawn_scene(&description, trouble, drawn), rules);
    pair.home();
    let mut seen = at_rest();
    let checks = drawn.once_in(10.0);
    pair.ask(|| if checks { Command::CheckPolarity } else { Command::Arm });
    let (mut velocity, mut at, mut usual) = ([0.0_f32; MAX_JOINTS], [0.0_f32; MAX_JOINTS], [0; 2]);
    let (begins, axis) = (1_050 + drawn.below(600) as u32, drawn.below(joints));
    let mut fault = None;
    for crest in 0..1_800 {
        // Each joint wanders about its home.
        let motors = pair.servos[0].frame().motors;
        for i in 0..joints {
            velocity[i] = 0.98 * velocity[i] + drawn.between(-0.4, 0.4) - 2.0e-4 * at[i];
            at[i] += velocity[i];
            let moved = at[i].round() as i32 - seen.counts[i];
            seen.counts[i] += moved;
            // 2 ohms, 1 mH and 0.1 V s.
            let speed = moved as f32 * (core::f32::consts::TAU / 60_000.0 * 20_000.0);
            let current = &mut seen.currents[i];
            *current += (motors.duty[i] * seen.bus_voltage - 2.0 * *current - 0.1 * speed) * 50.0e-6 / 1.0e-3;
        }
        if crest % 20 == 0 && (trouble != Trouble::Silence || crest < begins) {
            pair.ask(|| Command::Beat(Beat::Here));
        }
        let mut shown = seen;
        let (now, on) = (crest == begins, crest >= begins);
        match trouble {
            Trouble::Nothing => {}
            Trouble::Current if now => shown.currents[axis] = drawn.of(&WILD),
            Trouble::Bus if now => shown.bus_voltage = drawn.of(&[f32::NAN, f32::INFINITY, -24.0, 5.0, 60.0]),
            Trouble::LowBus if on => seen.bus_voltage = 10.5,
            Trouble::Imbalance if now => shown.imbalance[axis] = drawn.of(&[f32::NAN, 5.0, -5.0]),
            Trouble::Jump if now => shown.counts[axis] = drawn.of(&[i32::MIN, i32::MAX, 100_000, 60, -60]),
            Trouble::Speed if on => at[axis] += drawn.between(8.0, 14.0),
            Trouble::Range if on => at[axis] += 5.0,
            // Both cranks outward, until the elbows are in line.
            Trouble::Stretch if crest > 1_050 => (velocity, at) = ([0.0; MAX_JOINTS], [at[0] + 7.0, at[1] - 7.0, 0.0]),
            Trouble::Velocity if now => {
                let rate = drawn.of(&[f32::NAN, f32::INFINITY]);
                let coefficients = Coefficients::new(Estimator::BackwardDifference, rate, 1.0);
                pair.ask(|| Command::Coefficients(coefficients.expect("it has no cutoff")));
            }
            Trouble::Mark if on && drawn.once_in(20.0) => {
                let count = shown.counts[axis] + drawn.of(&[0, 1, -3, 60_000]);
                let mut marks = [None; MAX_JOINTS];
                marks[axis] = Some(count);
                pair.both(|control_loop| control_loop.mark(marks));
            }
            Trouble::Told if now => pair.both(|control_loop| control_loop.trip(Fault::GateDriver, None, f32::NAN)),
            Trouble::Push | Trouble::Power | Trouble::Weight if on && crest % 30 == 0 => {
                let mut torque = [0.0; MAX_JOINTS];
                torque[axis] = drawn.between(-2.0, 2.0) * rules.limits.torque[axis];
                if trouble == Trouble::Weight {
                    // Of the weight, which alone is too much, it leaves what is not.
                    torque = [drawn.between(0.0, 0.02), drawn.between(-0.02, 0.0), 0.0];
                }
                let request =
                    ForceRequest { sequence: crest, hold: 0.01, fade: 0.01, torque, ..ForceRequest::default() };
                let [one, other] = pair.servos.each_mut().map(|control_loop| control_loop.force(&request));
                assert_eq!(told(&one), told(&other));
            }
            Trouble::Disarm if now => pair.ask(|| Command::Disarm),
            Trouble::Mismatch if on => shown.currents = Currents([drawn.between(-4.0, 4.0); MAX_JOINTS]),
            Trouble::Check if now => pair.ask(|| Command::CheckPolarity),
            _ => {}
        }
        if drawn.once_in(500.0) {
            pair.crest(&shown, false);
        }
        shown.late = drawn.once_in(20.0);
        if crest % ASKED == 0 {
            let is_usual = pair.is_usual();
            usual.iter_mut().zip(is_usual).for_each(|(sum, one)| *sum += u32::from(one));
        }
        pair.crest(&shown, true);
        fault = fault.or(pair.servos[0].status().fault.map(|record| record.fault));
        if crest > begins + 40 && pair.state() == State::Fault {
            pair.ask(|| Command::Clear);
            break;
        }
    }
    for _ in 0..40 {
        pair.crest(&seen, true);
    }
    (usual, fault)
}

#[test]
fn a_crest_in_one_pass_is_the_crest_piece_by_piece() {
    let mut drawn = Drawn(4);
    let (mut usual, mut cut, mut faults) = (0, 0, BTreeSet::new());
    for nth in 0..342 {
        let ([whole, part], fault) = episode(&mut drawn, TROUBLES[nth % TROUBLES.len()]);
        (usual, cut) = (usual + whole, cut + part);
        faults.extend(fault.map(Fault::name));
    }
    assert!(usual * ASKED > 80_000, "{usual} of every {ASKED}th crest took one pass");
    assert!(cut * ASKED > 20_000, "{cut} of every {ASKED}th crest took one pass and were cut");
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
