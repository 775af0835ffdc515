//! The complete control step in hard cases: a hit at 10 m/s on a wall of 1e6 N/m, and a press into this wall. Every
//! device also has motors behind gears of 1:50 with encoders of 65,536 counts.

use super::devices;
use super::singular::Random;
use haptic_bridge::control::compiled::BoardMath;
use haptic_bridge::math::{Libm, Math, Real};
use haptic_bridge::model::description::{Description, Encoder};
use haptic_bridge::model::device::Device;
use haptic_bridge::model::mechanism::{AnyMechanism, Mechanism};
use haptic_bridge::render::controller::{Controller, FULL_REGULARITY, PARALLEL_REGULARITY, Step};
use haptic_bridge::render::scene::{FeedForward, Plane, Scene, Surface, Wall};
use nalgebra::SVector;

#[derive(Clone, Debug)]
pub struct Row {
    pub device: &'static str,
    /// True if the motors are behind gears of 1:50.
    pub geared: bool,
    /// Largest torque error of the hit, as a share of the hit's largest torque.
    pub hit_error: f64,
    /// Largest wall force of the hit, N.
    pub force: f64,
    /// Largest estimated speed along the normal, m/s.
    pub speed: f64,
    /// Smallest wall force, N. It must not be negative, because a wall never pulls.
    pub smallest_force: f64,
    /// Error of the wall force at rest, at penetrations of up to 1 mm, N.
    pub rest_error: f64,
}

pub const RATE_HZ: f64 = 20_000.0;
/// Stiffness of the wall, N/m.
const WALL_STIFFNESS: f64 = 1e6;
/// Speed of the hit, m/s.
const HIT_SPEED: f64 = 10.0;
/// Counts per turn of encoders that resolve penetrations in micrometres.
const COUNTS_PER_TURN: f64 = 1_048_576.0;
/// Motor turns per joint turn of a geared device.
const GEAR_RATIO: f64 = 50.0;
/// Counts per motor turn of a geared device.
const MOTOR_COUNTS: f64 = 65_536.0;

/// Returns the device with an encoder of [`COUNTS_PER_TURN`] at every joint. Without a home, count 0 is angle 0.
pub fn with_encoders(device: &Description) -> Description {
    let mut device = Description { home: None, ..*device };
    for joint in &mut device.joints {
        joint.encoder = Some(Encoder { counts_per_turn: COUNTS_PER_TURN, offset: 0.0, inverted: false });
    }
    device
}

/// Returns the device of [`with_encoders`] with gears of [`GEAR_RATIO`] before its motors and encoders.
pub fn with_gears(device: &Description) -> Description {
    let mut device = with_encoders(device);
    for joint in &mut device.joints {
        joint.inertia *= GEAR_RATIO * GEAR_RATIO;
        let encoder = joint.encoder.as_mut().expect("every joint has an encoder");
        encoder.counts_per_turn = GEAR_RATIO * MOTOR_COUNTS;
    }
    device
}

/// Returns the encoder counts of joint angles in rad.
pub fn counts<const N: usize>(q: &SVector<f64, N>) -> [i32; N] {
    counts_of(q, COUNTS_PER_TURN)
}

fn counts_of<const N: usize>(q: &SVector<f64, N>, counts_per_turn: f64) -> [i32; N] {
    core::array::from_fn(|i| (q[i] * counts_per_turn / std::f64::consts::TAU).round() as i32)
}

/// Returns a scene with one plane wall through `point` (m) that faces along `normal`, and with all terms on.
pub fn scene<T: Real>(
    task: usize,
    point: [f64; 3],
    normal: [f64; 3],
    stiffness: f64,
    damping: f64,
    feed_forward: FeedForward,
) -> Scene<T> {
    let r = T::from_f64;
    let wall = Wall {
        surface: Surface::Plane(Plane { point: point.map(r), normal: normal.map(r) }),
        stiffness: r(stiffness),
        damping: r(damping),
        feed_forward,
        washout_hz: r(2.0),
        damping_compensation: true,
        bilateral: false,
    };
    Scene {
        task: task as u8,
        rate_hz: r(RATE_HZ),
        cutoff_hz: r(500.0),
        walls: [wall].into_iter().collect(),
        ..Scene::default()
    }
}

pub fn controller<T: Real, K: Math<T>, M: Mechanism<T, N>, const N: usize>(
    mechanism: M,
    device: &Description,
    scene: &Scene<T>,
) -> Controller<T, M, K, N> {
    let device = Device::<T>::new("hard", device).expect("a sound device");
    Controller::new(mechanism, &device, scene).expect("a sound scene")
}

/// Returns the task-space entries of a vector, padded with zeros.
pub fn pad_to_three<const N: usize>(v: &SVector<f64, N>, task: usize) -> [f64; 3] {
    core::array::from_fn(|i| if i < task.min(N) { v[i] } else { 0.0 })
}

/// Returns true if the feed-forward acts in full at this pose.
fn is_usable<M: Mechanism<f64, N>, const N: usize>(m: &M, q: &SVector<f64, N>) -> bool {
    let r = m.regularity(&m.pose::<Libm>(q));
    r.serial.min(r.parallel / PARALLEL_REGULARITY) > 2.0 * FULL_REGULARITY
}

/// Returns the joint angles of a straight run against `n` at [`HIT_SPEED`], from 2 cm outside the surface to 1 cm
/// inside, and a point of the surface. Returns `None` if the run leaves the regular workspace.
fn run_up<M: Mechanism<f64, N>, const N: usize>(
    m: &M,
    start: &SVector<f64, N>,
    n: &SVector<f64, N>,
) -> Option<(Vec<SVector<f64, N>>, SVector<f64, N>)> {
    let mut q = *start;
    let mut run = Vec::new();
    let (steps, fine) = ((0.03 / HIT_SPEED * RATE_HZ) as usize, 50);
    for _ in 0..steps {
        run.push(q);
        for _ in 0..fine {
            q += m.inverse(&m.pose::<Libm>(&q), &(n * (-HIT_SPEED / RATE_HZ / fine as f64)));
        }
        if !is_usable(m, &q) {
            return None;
        }
    }
    // Between two steps, so that f32 and f64 touch it in the same step.
    let surface = m.tip(&m.pose::<Libm>(start)) - n * (0.02 + 0.4 * HIT_SPEED / RATE_HZ);
    Some((run, surface))
}

fn row<A, B, const N: usize>(double: A, board: B, name: &'static str, device: &Description, geared: bool) -> Row
where
    A: Mechanism<f64, N>,
    B: Mechanism<f32, N>,
{
    let task = A::SPEC.task;
    let mut random = Random(3);
    let mut row = Row {
        device: name,
        geared,
        hit_error: 0.0,
        force: 0.0,
        speed: 0.0,
        smallest_force: f64::INFINITY,
        rest_error: 0.0,
    };
    let counts = |q: &SVector<f64, N>| counts_of(q, if geared { GEAR_RATIO * MOTOR_COUNTS } else { COUNTS_PER_TURN });
    let mut runs = 0;
    while runs < 10 {
        let (start, n): (SVector<f64, N>, SVector<f64, N>) = (random.pose(&double), random.normal(task));
        let n = n / n.dot(&n).sqrt();
        if !is_usable(&double, &start) {
            continue;
        }
        let Some((run, surface)) = run_up(&double, &start, &n) else { continue };
        runs += 1;
        let (p, normal) = (pad_to_three(&surface, task), pad_to_three(&n, task));
        let full = FeedForward::Full;
        let mut exact =
            controller::<f64, Libm, _, N>(double, device, &scene(task, p, normal, WALL_STIFFNESS, 100.0, full));
        let mut found =
            controller::<f32, BoardMath, _, N>(board, device, &scene(task, p, normal, WALL_STIFFNESS, 100.0, full));
        let (mut worst, mut largest) = (0.0_f64, 0.0_f64);
        for q in &run {
            let (a, b): (Step<f64, N>, Step<f32, N>) = (exact.step(&counts(q)), found.step(&counts(q)));
            worst = worst.max((a.torque - b.torque.map(f64::from)).amax());
            largest = largest.max(a.torque.amax());
            row.force = row.force.max(a.wall_force);
            row.speed = row.speed.max(-a.normal_velocity);
            row.smallest_force = row.smallest_force.min(a.wall_force).min(f64::from(b.wall_force));
        }
        row.hit_error = row.hit_error.max(worst / largest);

        // The same wall at rest without damping, with a new controller at every penetration up to 1 mm.
        let off = FeedForward::Off;
        for depth in (0..100).map(|k| 1e-5 * f64::from(k)) {
            let mut q = start;
            for _ in 0..200 {
                let missing = surface - n * depth - double.tip(&double.pose::<Libm>(&q));
                q += double.inverse(&double.pose::<Libm>(&q), &missing);
            }
            let a = controller::<f64, Libm, _, N>(double, device, &scene(task, p, normal, WALL_STIFFNESS, 0.0, off))
                .step(&counts(&q));
            let b =
                controller::<f32, BoardMath, _, N>(board, device, &scene(task, p, normal, WALL_STIFFNESS, 0.0, off))
                    .step(&counts(&q));
            row.rest_error = row.rest_error.max((a.wall_force - f64::from(b.wall_force)).abs());
        }
    }
    row
}

pub fn all_rows() -> Vec<Row> {
    let rows = |(name, device): (&'static str, Description)| {
        [with_encoders(&device), with_gears(&device)].into_iter().zip([false, true]).map(move |(device, geared)| {
            let mechanism = AnyMechanism::<f64>::new(&device).expect("a sound device");
            haptic_bridge::with_mechanism!(mechanism, m => row(m, m.cast::<f32>(), name, &device, geared))
        })
    };
    devices().into_iter().flat_map(rows).collect()
}
