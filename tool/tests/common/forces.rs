//! Force of the motors at the tip in random scenes with random motions.

use super::prelude::*;
use super::{board, plane_wall};
use haptic_bridge::safety::limits::GENTLE_FORCE;
use haptic_sim::{Hand, SimulatedBoard};
use std::collections::VecDeque;
use std::ops::Range;

/// Returns one of these values at random.
pub fn pick_one<T: Copy>(draw: &mut Random, of: &[T]) -> T {
    of[(draw.uniform() * of.len() as f64) as usize]
}

/// Runs every shipped device with each seed. Describes the runs that push harder than 1.1 times the limit.
pub fn runs_beyond_limit(seeds: Range<u64>) -> Vec<String> {
    let devices = super::all_shipped_devices();
    let pushes = seeds.flat_map(|seed| devices.iter().map(move |file| largest_push(file, seed)));
    pushes.filter(|(most, _)| *most > 1.1 * f64::from(GENTLE_FORCE)).map(|(_, what)| what).collect()
}

/// Runs a random scene with a random motion. Returns the largest force of the motors at the tip, N, and a description.
fn largest_push(file: &DeviceFile, seed: u64) -> (f64, String) {
    let mut draw = Random::new(seed);
    let weighs = file.description.gravity != [0.0; 3];
    let support = if weighs { Support::Held } else { Support::None };
    let options = BoardOptions { support, ..BoardOptions::default() };
    let (shared, mut board) = board(file, options);
    let mut rules: Rules = board.rules().unwrap();
    rules.limits.tip_force = GENTLE_FORCE;
    rules.host_action = HostAction::Ignore;
    board.set_rules(&rules).unwrap();
    let (tip, task) = (shared.lock().device().tip(), file.spec().task);
    let rate = pick_one(&mut draw, &[200.0, 1_000.0, 4_000.0, 20_000.0, 40_000.0]);
    let feed_forward = pick_one(&mut draw, &[FeedForward::Off, FeedForward::Full, FeedForward::Washout]);
    let mut scene = Scene {
        task: task as u8,
        rate_hz: rate as f32,
        cutoff_hz: (rate * 0.2_f64.min(500.0 / rate)) as f32,
        gravity_compensation: weighs,
        ..Scene::default()
    };
    let walls = pick_one(&mut draw, &[0, 1, 1, 2]);
    let stiffness = 10f64.powf(draw.between(2.0, 4.0));
    let damping = draw.between(0.0, 0.01) * stiffness;
    for _ in 0..walls {
        let mut normal: [f64; 3] = core::array::from_fn(|axis| if axis < task { draw.between(-1.0, 1.0) } else { 0.0 });
        let size = normal.iter().map(|along| along * along).sum::<f64>().sqrt().max(1e-3);
        normal.iter_mut().for_each(|along| *along /= size);
        let gap = draw.between(1e-3, 6e-3);
        let point = core::array::from_fn(|axis| (tip[axis] - gap * normal[axis]) as f32);
        let plane = plane_wall(point, normal.map(|along| along as f32), stiffness as f32, damping as f32);
        scene.walls.push(Wall { feed_forward, ..plane }).unwrap();
    }
    let what = format!(
        "{} seed {seed}: {rate} Hz, {walls} walls, {stiffness:.0} N/m, {damping:.1} N s/m, {feed_forward:?}",
        file.name
    );
    board.set_scene(&scene).unwrap_or_else(|error| panic!("{what}: {error}"));
    board.arm().unwrap_or_else(|error| panic!("{what}: {error}"));
    // A hand moves the tip to random places, slowly or as fast as an arm can, up to 10 mm further into the first wall.
    let reach = draw.between(0.002, 0.03);
    let pace = draw.between(0.02, 0.3);
    let press = draw.between(0.0, 0.01);
    let into = match scene.walls.first().map(|wall| wall.surface) {
        Some(Surface::Plane(plane)) => plane.normal.map(|along| -press * f64::from(along)),
        _ => [0.0; 3],
    };
    let path = (0..40)
        .map(|nth| Waypoint {
            time: f64::from(nth) * pace,
            value: core::array::from_fn(|axis| {
                let about = if axis < task { into[axis] + draw.between(-reach, reach) } else { 0.0 };
                tip[axis] + if nth > 0 { about } else { 0.0 }
            }),
        })
        .collect();
    {
        let mut board = shared.lock();
        let now = board.time();
        let settings = HandSettings { seed, ..HandSettings::default() };
        board.device_mut().set_hand(Hand::new(settings, Intent::Follow(path), tip, now));
        board.run(0.6);
    }
    let mut board = shared.lock();
    let (mut push, mut most) = (MotorTipForce::new(&file.description, &board), 0.0_f64);
    while board.time() < 1.4 {
        board.carrier();
        most = most.max(push.add_period(&board).unwrap_or(0.0));
    }
    let state = board.status();
    (most, format!("{what}: {most:.2} N, {:?} {:?}", state.state, state.fault.map(|record| record.fault)))
}

/// Force of the motors at the tip of a simulated device, without the part that carries the weight, as a mean over 2 ms.
/// The force is computed from the true currents, angles and torque constants, not from the board's measurements.
pub struct MotorTipForce {
    truth: Description,
    mechanism: AnyMechanism<f32>,
    window: VecDeque<f64>,
    sum: f64,
    length: usize,
}

impl MotorTipForce {
    /// Starts a measurement on a board whose true device is `truth`.
    pub fn new(truth: &Description, board: &SimulatedBoard) -> Self {
        let mechanism = AnyMechanism::new(truth).unwrap();
        let length = (2e-3 * board.carrier_hz()) as usize;
        Self { truth: *truth, mechanism, window: VecDeque::new(), sum: 0.0, length }
    }

    /// Adds one carrier period. Returns the mean force, N, after the first 2 ms.
    pub fn add_period(&mut self, board: &SimulatedBoard) -> Option<f64> {
        let device = board.device();
        let (q, currents, weight) = (device.q(), device.currents(), device.plant().gravity());
        // While the motors are off, they do not carry the weight.
        let carried = self.truth.gravity != [0.0; 3] && board.status().state == State::Armed;
        let torque = core::array::from_fn(|i| {
            let constant = self.truth.joints[i].motor.map_or(0.0, |motor| motor.torque_constant);
            (constant * currents[i] - if carried { weight[i] } else { 0.0 }) as f32
        });
        let leverage = self.mechanism.leverage::<Libm>(&q.map(|angle| angle as f32));
        let force = f64::from(leverage.force_squared(&torque)).sqrt();
        self.window.push_back(force);
        self.sum += force;
        (self.window.len() > self.length).then(|| {
            self.sum -= self.window.pop_front().unwrap_or(0.0);
            self.sum / self.length as f64
        })
    }
}
