//! Injected errors: wrong device files, wires and sensors, the board's reactions, and the effects on a hand.

use super::forces::MotorTipForce;
use super::plane_wall;
use super::prelude::*;
use haptic_bridge::model::description::Joint;
use haptic_bridge::model::motor::{Motor, Winding};
use haptic_bridge::safety::fault::FaultRecord;
use haptic_bridge::safety::limits::GENTLE_FORCE;
use haptic_sim::{BoardFaults, BrokenPhase, Hand, Random, SimulatedBoard};
use std::f64::consts::TAU;

/// Function that injects an error, and the time at which the error begins.
pub enum Injection {
    /// The error exists from power-on. The function changes the true device and wires, not the board's device file.
    Always(fn(&mut Description, &mut BoardFaults)),
    /// The error begins while a hand presses against a wall.
    InContact(fn(&mut SimulatedBoard, &Description)),
    /// Like `InContact`, with an error of a three-phase motor drawn from this seed. The board knows the electrical
    /// angles without a check.
    DrawnInContact(u64),
}

/// An injected error, as the tables of docs/results/lies.csv name it.
pub struct InjectedError {
    pub what: &'static str,
    pub injection: Injection,
}

const fn permanent_error(what: &'static str, error: fn(&mut Description, &mut BoardFaults)) -> InjectedError {
    InjectedError { what, injection: Injection::Always(error) }
}

const fn contact_error(what: &'static str, error: fn(&mut SimulatedBoard, &Description)) -> InjectedError {
    InjectedError { what, injection: Injection::InContact(error) }
}

pub const INJECTED_ERRORS: [InjectedError; 43] = [
    permanent_error("torque constant twice the file's", |wired, _| scale_motor_constants(&mut wired.joints, 2.0)),
    permanent_error("torque constant half the file's", |wired, _| scale_motor_constants(&mut wired.joints, 0.5)),
    permanent_error("torque constant 1.15 of the file's", |wired, _| scale_motor_constants(&mut wired.joints, 1.15)),
    permanent_error("a gear of 10 that the file forgets", |wired, _| scale_motor_constants(&mut wired.joints, 10.0)),
    permanent_error("counts per line instead of per edge", |wired, _| scale_counts_per_turn(wired, 4.0)),
    permanent_error("counts per edge instead of per line", |wired, _| scale_counts_per_turn(wired, 0.25)),
    permanent_error("first two motors swapped", |_, broken| broken.motors.swap(0, 1)),
    permanent_error("first two encoders swapped", |_, broken| broken.swapped_at = Some([0; 2])),
    permanent_error("leads of the first motor swapped", |_, broken| broken.reversed[0] = true),
    permanent_error("first encoder backward", |_, broken| broken.share[0] = Some((0, -1.0))),
    permanent_error("resistance twice the file's", |wired, _| scale_windings(wired, 2.0, 1.0)),
    permanent_error("resistance half the file's", |wired, _| scale_windings(wired, 0.5, 1.0)),
    permanent_error("inductance half the file's", |wired, _| scale_windings(wired, 1.0, 0.5)),
    permanent_error("inertias twice the file's", |wired, _| scale_inertias(wired, 2.0)),
    permanent_error("inertias half the file's", |wired, _| scale_inertias(wired, 0.5)),
    permanent_error("current sensors show 45 %", |_, broken| broken.sensor_gain = [0.45; 4]),
    permanent_error("current sensors show two thirds", |_, broken| broken.sensor_gain = [0.67; 4]),
    permanent_error("first current sensor shows two thirds", |_, broken| broken.sensor_gain[0] = 0.67),
    permanent_error("current sensors show 150 %", |_, broken| broken.sensor_gain = [1.5; 4]),
    permanent_error("first current sensor backward", |_, broken| broken.sensor_gain[0] = -1.0),
    permanent_error("first current sensor shows nothing", |_, broken| broken.sensor_gain[0] = 0.0),
    permanent_error("first current sensor 0.3 A off its zero", |_, broken| broken.sensor_offset[0] = 0.3),
    contact_error("first current sensor 8 A too high", |board, _| board.faults_mut().sensor_offset[0] = 8.0),
    contact_error("first current sensor 0.5 A too low", |board, _| board.faults_mut().sensor_offset[0] = -0.5),
    contact_error("current sensors begin to show half", |board, _| board.faults_mut().sensor_gain = [0.5; 4]),
    contact_error("first current sensor freezes", |board, _| {
        board.faults_mut().sensor_frozen[0] = Some(board.device().currents()[0]);
    }),
    contact_error("first winding opens", |board, _| board.faults_mut().open[0] = true),
    contact_error("first bridge stuck at 40 %", |board, _| board.faults_mut().stuck_on[0] = Some(0.4)),
    contact_error("first encoder dead", |board, _| scale_encoder_motion(board, 0.0)),
    contact_error("first encoder begins to count backward", |board, _| scale_encoder_motion(board, -1.0)),
    contact_error("first encoder loses one count in ten", |board, _| scale_encoder_motion(board, 0.9)),
    contact_error("first encoder drifts by 1.9 rad/s", |board, device| {
        let rate = 1.9 * counts_per_radian(device) / board.carrier_hz();
        board.faults_mut().drift[0] = Some((board.readings(), rate));
    }),
    contact_error("first encoder shakes by 8 counts", |board, _| board.faults_mut().shake[0] = 8),
    contact_error("first encoder leaps by 0.4 rad", |board, device| {
        board.faults_mut().count_offset[0] = (0.4 * counts_per_radian(device)) as i32;
    }),
    contact_error("first two encoders change places", |board, _| {
        let [first, second, _] = board.device().counts();
        board.faults_mut().swapped_at = Some([first, second]);
    }),
    contact_error("first motor: a phase opens", |board, _| break_phase(board, BrokenPhase::Open(1))),
    contact_error("first motor: a phase is shorted", |board, _| break_phase(board, BrokenPhase::Shorted(1))),
    contact_error("first motor: rotor slips by 90 electrical degrees", |board, _| slip(board, TAU / 4.0)),
    contact_error("first motor: rotor slips by 180 electrical degrees", |board, _| slip(board, TAU / 2.0)),
    permanent_error("first motor: two pole pairs more than in the file", |wired, _| add_pole_pairs(wired, 2)),
    contact_error("first motor: two phases change places", |board, _| board.faults_mut().reversed[0] = true),
    contact_error("bus shows half", |board, _| board.faults_mut().bus_reading = Some(12.0)),
    contact_error("bus shows twice", |board, _| board.faults_mut().bus_reading = Some(48.0)),
];

fn motors(wired: &mut Description) -> impl Iterator<Item = &mut Motor<f64>> {
    wired.joints.iter_mut().filter_map(|joint| joint.motor.as_mut())
}

/// Multiplies torque constant and back-EMF of these joints' motors by a factor.
pub fn scale_motor_constants(joints: &mut [Joint], factor: f64) {
    for motor in joints.iter_mut().filter_map(|joint| joint.motor.as_mut()) {
        motor.torque_constant *= factor;
        motor.back_emf *= factor;
    }
}

fn scale_windings(wired: &mut Description, resistance: f64, inductance: f64) {
    for motor in motors(wired) {
        motor.resistance *= resistance;
        motor.inductance *= inductance;
    }
}

fn scale_inertias(wired: &mut Description, factor: f64) {
    wired.joints.iter_mut().for_each(|joint| joint.inertia *= factor);
    for link in &mut wired.links {
        link.mass *= factor;
        link.inertia *= factor;
        link.inertia_axial *= factor;
        link.inertia_transverse *= factor;
    }
    wired.handle_mass *= factor;
}

pub fn scale_counts_per_turn(wired: &mut Description, factor: f64) {
    wired.joints.iter_mut().filter_map(|joint| joint.encoder.as_mut()).for_each(|it| it.counts_per_turn *= factor);
}

fn scale_encoder_motion(board: &mut SimulatedBoard, share: f64) {
    board.faults_mut().share[0] = Some((board.device().counts()[0], share));
}

/// Returns true if the error concerns only three-phase motors.
pub fn needs_phases(error: &InjectedError) -> bool {
    error.what.starts_with("first motor: ")
}

fn break_phase(board: &mut SimulatedBoard, broken: BrokenPhase) {
    if let Some(motor) = board.device_mut().three_phase_mut(0) {
        motor.break_phase(broken);
    }
}

/// Turns the first motor's rotor on its shaft by an electrical angle, rad.
fn slip(board: &mut SimulatedBoard, angle: f64) {
    if let Some(motor) = board.device_mut().three_phase_mut(0) {
        motor.slip(angle);
    }
}

fn add_pole_pairs(wired: &mut Description, more: u8) {
    if let Some(Winding::ThreePhase { pole_pairs, .. }) = wired.joints[0].motor.as_mut().map(|motor| &mut motor.winding)
    {
        *pole_pairs += more;
    }
}

fn counts_per_radian(device: &Description) -> f64 {
    device.joints[0].encoder.map_or(0.0, |encoder| encoder.counts_per_turn) / TAU
}

#[derive(Clone, Copy, Debug)]
pub enum Outcome {
    /// The polarity check ended with this fault.
    Refused(FaultRecord),
    /// Fault that turned the motors off, and time, s, since the error began (since arming for a permanent error).
    Detected(FaultRecord, f64, EffectsOnHand),
    /// The board reported no fault.
    Missed(EffectsOnHand),
}

/// Largest effects of an error on a hand.
#[derive(Clone, Copy, Debug, Default)]
pub struct EffectsOnHand {
    /// Largest force of the motors at the tip, as a mean over 2 ms, N.
    pub push: f64,
    /// Largest current of a motor, A.
    pub current: f64,
    /// Largest speed of a joint, rad/s.
    pub speed: f64,
}

/// Injects an error of a three-phase motor, at a random time of the next 0.4 s.
fn draw_phase_error(board: &mut SimulatedBoard, device: &Description, seed: u64) {
    let mut draw = Random::new(seed);
    board.run(draw.between(0.0, 0.4));
    let phase = (3.0 * draw.uniform()) as usize;
    match (8.0 * draw.uniform()) as usize {
        0 => break_phase(board, BrokenPhase::Open(phase)),
        1 => break_phase(board, BrokenPhase::Shorted(phase)),
        2 => board.faults_mut().sensor_gain[phase % 2] = 0.0,
        3 => scale_encoder_motion(board, 0.0),
        4 => {
            let rate = draw.between(-6.0, 6.0) * counts_per_radian(device) / board.carrier_hz();
            board.faults_mut().drift[0] = Some((board.readings(), rate));
        }
        5 => scale_encoder_motion(board, draw.between(0.3, 3.0)),
        6 => board.faults_mut().reversed[0] = true,
        _ => slip(board, draw.between(30.0, 180.0).to_radians() * if phase == 0 { -1.0 } else { 1.0 }),
    }
}

/// Returns a homed strict board with the correct `file`, and the true device, which has the injected error.
fn homed_board(file: &DeviceFile, error: &InjectedError) -> (SharedBoard, Board, Description) {
    let strict = !matches!(error.injection, Injection::DrawnInContact(_));
    board_with_error(&file.name, &file.description, Options::default(), strict, |wired, broken| {
        if let Injection::Always(error) = error.injection {
            error(wired, broken);
        }
    })
}

/// Like [`homed_board`] with any description and error.
pub fn board_with_error(
    name: &str,
    description: &Description,
    device: Options,
    strict: bool,
    error: impl FnOnce(&mut Description, &mut BoardFaults),
) -> (SharedBoard, Board, Description) {
    let mut device_file = *description;
    let home = device_file.home.unwrap();
    for (joint, home) in device_file.joints.iter_mut().zip(home) {
        joint.motor.iter_mut().for_each(|motor| motor.verified = true);
        joint.limits = Some((home - 1.5, home + 1.5));
    }
    let mut wired = device_file;
    let mut options = BoardOptions { device, strict, support: Support::Held, ..BoardOptions::default() };
    error(&mut wired, &mut options.faults);
    let mut simulated = SimulatedBoard::new(&wired, options).unwrap();
    simulated.load(name, &device_file, None).unwrap();
    let shared = SharedBoard::new(simulated);
    let mut board = Board::over(shared.wire(), "sim").unwrap();
    let mut rules = board.rules().unwrap();
    (rules.host_action, rules.limits.tip_force) = (HostAction::Ignore, GENTLE_FORCE);
    board.set_rules(&rules).unwrap();
    board.home_at_rest().unwrap();
    (shared, board, wired)
}

/// Runs the polarity check and calls `to_see` after every carrier period.
pub fn run_check(
    shared: &SharedBoard,
    board: &mut Board,
    mut to_see: impl FnMut(&SimulatedBoard),
) -> Result<(), FaultRecord> {
    if let Err(error) = board.check_polarity() {
        return Err(shared.lock().status().fault.unwrap_or_else(|| panic!("{error}")));
    }
    let mut board = shared.lock();
    let end_s = board.time() + 60.0;
    while board.status().state == State::CheckingPolarity {
        assert!(board.time() < end_s, "the check does not end");
        board.carrier();
        to_see(&board);
    }
    let status = board.status();
    match (status.polarity, status.fault) {
        (true, None) => Ok(()),
        (_, Some(record)) => Err(record),
        other => panic!("{other:?}"),
    }
}

/// Runs the polarity check and returns its fault.
pub fn check_fault(file: &DeviceFile, error: &InjectedError) -> Result<(), FaultRecord> {
    let (shared, mut board, _) = homed_board(file, error);
    run_check(&shared, &mut board, |_| ())
}

/// Largest effects of a polarity check.
#[derive(Clone, Copy, Debug, Default)]
pub struct CheckMotion {
    /// Largest force of the motors at the tip, as a mean over 2 ms, N.
    pub push: f64,
    /// Largest rotation of a joint from its start, rad.
    pub travel: f64,
}

/// Runs the polarity check and measures its effects.
pub fn measure_check(file: &DeviceFile, error: &InjectedError) -> (Result<(), FaultRecord>, CheckMotion) {
    measure_motion(homed_board(file, error))
}

/// Like [`measure_check`] with any description and error, and with only two integration steps per carrier period.
pub fn measure_any_check(
    name: &str,
    description: &Description,
    error: impl FnOnce(&mut Description, &mut BoardFaults),
) -> (Result<(), FaultRecord>, CheckMotion) {
    measure_motion(board_with_error(name, description, Options { substep: 25e-6, ..Options::default() }, true, error))
}

fn measure_motion(
    (shared, mut board, wired): (SharedBoard, Board, Description),
) -> (Result<(), FaultRecord>, CheckMotion) {
    let mut push = MotorTipForce::new(&wired, &shared.lock());
    let start = shared.lock().device().q();
    let mut motion = CheckMotion::default();
    let result = run_check(&shared, &mut board, |board| {
        motion.push = motion.push.max(push.add_period(board).unwrap_or(0.0));
        let turn_angles = board.device().q().into_iter().zip(start).map(|(q, start)| (q - start).abs());
        motion.travel = turn_angles.fold(motion.travel, f64::max);
    });
    (result, motion)
}

/// Runs an injected error while a hand presses a wall of 1000 N/m at 1 kHz with 4 N and moves back and forth along it.
pub fn outcome(file: &DeviceFile, error: &InjectedError) -> Outcome {
    let (shared, mut board, wired) = homed_board(file, error);
    match error.injection {
        Injection::DrawnInContact(_) => {}
        _ => {
            if let Err(record) = run_check(&shared, &mut board, |_| ()) {
                return Outcome::Refused(record);
            }
        }
    }
    shared.lock().run(0.5);
    let (tip, task) = (shared.lock().device().tip(), file.spec().task);
    let [normal, along] =
        [[[1.0, 0.0, 0.0], [0.0; 3]], [[0.6, 0.8, 0.0], [0.8, -0.6, 0.0]], [[0.6, 0.64, 0.48], [0.8, -0.48, -0.36]]]
            [task - 1];
    let at = |outward: f64, aside: f64| {
        core::array::from_fn(|axis| tip[axis] + outward * normal[axis] + aside * along[axis])
    };
    let mut scene = Scene {
        task: task as u8,
        rate_hz: 1_000.0,
        cutoff_hz: 200.0,
        gravity_compensation: wired.gravity != [0.0; 3],
        ..Scene::default()
    };
    let single = |values: [f64; 3]| values.map(|along| along as f32);
    let plane = plane_wall(single(at(-2e-3, 0.0)), single(normal), 1_000.0, 1.0);
    scene.walls.push(Wall { feed_forward: FeedForward::Washout, ..plane }).unwrap();
    board.set_scene(&scene).unwrap();
    board.arm().unwrap();
    let mut board = shared.lock();
    let now = board.time();
    let mut path = vec![Waypoint { time: 0.0, value: tip }];
    path.extend((1..40).map(|nth| Waypoint {
        time: 0.6 + 0.2 * f64::from(nth),
        value: at(-0.022, if nth % 2 == 0 { 8e-3 } else { -8e-3 }),
    }));
    board.device_mut().set_hand(Hand::new(HandSettings::default(), Intent::Follow(path), tip, now));
    if !matches!(error.injection, Injection::Always(_)) {
        board.run(1.25);
        assert_eq!(board.status().state, State::Armed, "{}: {:?}", file.name, board.status());
    }
    match error.injection {
        Injection::Always(_) => {}
        Injection::InContact(error) => error(&mut board, &wired),
        Injection::DrawnInContact(seed) => draw_phase_error(&mut board, &wired, seed),
    }
    let start_s = board.time();
    let (mut push, mut harm) = (MotorTipForce::new(&wired, &board), EffectsOnHand::default());
    while board.time() < start_s + 2.0 {
        board.carrier();
        let device = board.device();
        let most = |values: [f64; 3]| values.iter().fold(0.0, |most: f64, value| most.max(value.abs()));
        harm.current = harm.current.max(most(device.currents()));
        harm.speed = harm.speed.max(most(device.qd()));
        harm.push = harm.push.max(push.add_period(&board).unwrap_or(0.0));
        if let Some(record) = board.status().fault {
            return Outcome::Detected(record, board.time() - start_s, harm);
        }
    }
    Outcome::Missed(harm)
}
