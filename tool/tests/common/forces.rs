//! What really pushes at the tip, in scenes and motions that are drawn.

use haptic_bridge::control::{HostAction, Rules};
use haptic_bridge::math::Libm;
use haptic_bridge::model::description::Description;
use haptic_bridge::model::mechanism::AnyMechanism;
use haptic_bridge::render::scene::{FeedForward, Plane, Scene, Surface, Wall};
use haptic_bridge::safety::fault::State;
use haptic_bridge::safety::limits::GENTLE_FORCE;
use haptic_host::device_file::DeviceFile;
use haptic_host::link::Board;
use haptic_sim::{
    BoardOptions, Hand, HandSettings, Intent, Random, SharedBoard, SimulatedBoard, Support, Waypoint, ready_board,
};
use std::collections::VecDeque;
use std::ops::Range;

fn one<T: Copy>(draw: &mut Random, of: &[T]) -> T {
    of[(draw.uniform() * of.len() as f64) as usize]
}

/// What pushes harder than 1.1 times the limit, with every shipped device and each of these seeds.
pub fn too_hard(seeds: Range<u64>) -> Vec<String> {
    let devices = super::all_shipped();
    let drawn = seeds.flat_map(|seed| devices.iter().map(move |file| largest(file, seed)));
    drawn.filter(|(most, _)| *most > 1.1 * f64::from(GENTLE_FORCE)).map(|(_, what)| what).collect()
}

/// The largest mean over 2 ms of the force (N) that the motors of a device push with at the tip beyond its weight, in a
/// scene and a motion drawn by `seed`, and what was drawn.
fn largest(file: &DeviceFile, seed: u64) -> (f64, String) {
    let mut draw = Random::new(seed);
    let weighs = file.description.gravity != [0.0; 3];
    let options =
        BoardOptions { support: if weighs { Support::Held } else { Support::None }, ..BoardOptions::default() };
    let shared = SharedBoard::new(ready_board(file, options).unwrap());
    let mut board = Board::over(shared.wire(), "sim").unwrap();
    let mut rules: Rules = board.rules().unwrap();
    rules.limits.tip_force = GENTLE_FORCE;
    rules.host_action = HostAction::Ignore;
    board.set_rules(&rules).unwrap();

    let (tip, task) = (shared.lock().device().tip(), file.spec().task);
    let rate = one(&mut draw, &[200.0, 1_000.0, 4_000.0, 20_000.0, 40_000.0]);
    let feed_forward = one(&mut draw, &[FeedForward::Off, FeedForward::Full, FeedForward::Washout]);
    let mut scene = Scene {
        task: task as u8,
        rate_hz: rate as f32,
        cutoff_hz: (rate * 0.2_f64.min(500.0 / rate)) as f32,
        gravity_compensation: weighs,
        ..Scene::default()
    };
    let walls = one(&mut draw, &[0, 1, 1, 2]);
    let stiffness = 10f64.powf(draw.between(2.0, 4.0));
    let damping = draw.between(0.0, 0.01) * stiffness;
    for _ in 0..walls {
        let mut normal: [f64; 3] = core::array::from_fn(|axis| if axis < task { draw.between(-1.0, 1.0) } else { 0.0 });
        let size = normal.iter().map(|along| along * along).sum::<f64>().sqrt().max(1e-3);
        normal.iter_mut().for_each(|along| *along /= size);
        let gap = draw.between(1e-3, 6e-3);
        scene
            .walls
            .push(Wall {
                surface: Surface::Plane(Plane {
                    point: core::array::from_fn(|axis| (tip[axis] - gap * normal[axis]) as f32),
                    normal: normal.map(|along| along as f32),
                }),
                stiffness: stiffness as f32,
                damping: damping as f32,
                feed_forward,
                washout_hz: 2.0,
                damping_compensation: false,
                bilateral: false,
            })
            .unwrap();
    }
    let what = format!(
        "{} seed {seed}: {rate} Hz, {walls} walls, {stiffness:.0} N/m, {damping:.1} N s/m, {feed_forward:?}",
        file.name
    );
    board.set_scene(&scene).unwrap_or_else(|error| panic!("{what}: {error}"));
    board.arm().unwrap_or_else(|error| panic!("{what}: {error}"));
    // Somebody moves the tip about, from slow to as fast as an arm is, and more or less into the first wall.
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
    let (mut push, mut most) = (Push::of(&file.description, &board), 0.0_f64);
    while board.time() < 1.4 {
        board.carrier();
        most = most.max(push.take(&board).unwrap_or(0.0));
    }
    let state = board.status();
    (most, format!("{what}: {most:.2} N, {:?} {:?}", state.state, state.fault.map(|record| record.fault)))
}

/// What the motors push with at the tip of a simulated device beyond what carries its weight: a mean over 2 ms. The
/// currents, the angles and the torque constants are those of the device itself and not what the board sees of them.
pub struct Push {
    truth: Description,
    mechanism: AnyMechanism<f32>,
    window: VecDeque<f64>,
    sum: f64,
    length: usize,
}

impl Push {
    /// Of a board whose device is in truth this one.
    pub fn of(truth: &Description, board: &SimulatedBoard) -> Self {
        let mechanism = AnyMechanism::new(truth).unwrap();
        let length = (2e-3 * board.carrier_hz()) as usize;
        Self { truth: *truth, mechanism, window: VecDeque::new(), sum: 0.0, length }
    }

    /// Takes what is, once each carrier period: the mean, N, once there are 2 ms of it.
    pub fn take(&mut self, board: &SimulatedBoard) -> Option<f64> {
        let device = board.device();
        let (q, currents, weight) = (device.q(), device.currents(), device.plant().gravity());
        // What falls when the motors have been turned off is the device, and nothing pushes.
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
