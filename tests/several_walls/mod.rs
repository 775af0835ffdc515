//! Walls that meet at an angle (docs/model.md section 2). The loops and bounds are independent of the code under test,
//! except for the torques of the feed-forward. Simulated devices that press sets of walls are in
//! tool/tests/deep/ranges/sets_of_walls.rs.

mod continuity;
mod linear;
mod springs;

use crate::common::{FINE_COUNTS, device_file, fine_counts, with_fine_encoders};
use haptic_bridge::control::compiled::BoardMath;
use haptic_bridge::math::{FineTable, Libm, Math, Real};
use haptic_bridge::model::catalogue::Spec;
use haptic_bridge::model::description::Description;
use haptic_bridge::model::device::Device;
use haptic_bridge::model::inertia::Inertia;
use haptic_bridge::model::mechanism::{AnyMechanism, Mechanism};
use haptic_bridge::model::principal::Pull;
use haptic_bridge::render::controller::{Controller, Push};
use haptic_bridge::render::scene::Scene;
use haptic_bridge::with_mechanism;
use nalgebra::{Complex, SVector};

struct Linkage {
    name: &'static str,
    description: Description,
    mechanism: AnyMechanism<f64>,
}

impl Linkage {
    fn spec(&self) -> Spec {
        self.description.kind.spec()
    }
}

fn device(name: &'static str) -> Linkage {
    let description = device_file::shipped_device(name);
    Linkage { name, description, mechanism: AnyMechanism::new(&description).expect("a sound device") }
}

#[derive(Clone, Copy)]
enum Precision {
    /// Precision of the board.
    F32,
    F64,
}

/// Returns the unit vector at `angle`, rad.
fn unit_vector(angle: f64) -> Vec<f64> {
    vec![angle.cos(), angle.sin()]
}

fn normalized(v: &[f64]) -> Vec<f64> {
    let length = v.iter().map(|x| x * x).sum::<f64>().sqrt();
    v.iter().map(|x| x / length).collect()
}

/// Computes the joint torques for walls (normal, stiffness, force) at rest, without the device's weight.
fn torque(device: &Linkage, q: &[f64], walls: &[(Vec<f64>, f64, f64)], precision: Precision) -> Vec<f64> {
    torque_with_flags(device, q, walls, &vec![true; walls.len()], precision)
}

/// Like [`torque`]. Only walls whose flag in `with` is true have the feed-forward.
fn torque_with_flags(
    device: &Linkage,
    q: &[f64],
    walls: &[(Vec<f64>, f64, f64)],
    with: &[bool],
    precision: Precision,
) -> Vec<f64> {
    fn compute<T: Real, K: Math<T>, M: Mechanism<T, N>, const N: usize>(
        m: &M,
        q: &[f64],
        walls: &[(Vec<f64>, f64, f64)],
        with: &[bool],
    ) -> Vec<f64> {
        let vector = |v: &[f64]| SVector::<T, N>::from_fn(|i, _| T::from_f64(v.get(i).copied().unwrap_or(0.0)));
        let pose = m.pose::<K>(&vector(q));
        let mut force = SVector::zeros();
        let mut pulls = Vec::new();
        for ((normal, stiffness, newtons), feed_forward) in walls.iter().zip(with) {
            let (normal, stiffness) = (vector(normal), T::from_f64(*stiffness));
            force += normal * T::from_f64(*newtons);
            pulls.push(Pull { normal, across: false, stiffness, feed_forward: *feed_forward });
        }
        let torque = |force| Inertia::new::<K, M>(m, &pose, &SVector::zeros(), &pulls, &force).torque;
        (torque(force) - torque(SVector::zeros())).iter().map(|torque| torque.to_f64()).collect()
    }
    match precision {
        Precision::F64 => with_mechanism!(&device.mechanism, m => compute::<f64, FineTable, _, _>(m, q, walls, with)),
        Precision::F32 => {
            let mechanism = AnyMechanism::<f32>::new(&device.description).expect("a sound device");
            with_mechanism!(&mechanism, m => compute::<f32, BoardMath, _, _>(m, q, walls, with))
        }
    }
}

fn pad_to_three(v: &[f64]) -> [f64; 3] {
    core::array::from_fn(|i| v.get(i).copied().unwrap_or(0.0))
}

/// Returns the largest absolute value of the modes.
fn largest_norm(modes: &[Complex<f64>]) -> f64 {
    modes.iter().map(|mode| mode.norm()).fold(0.0, f64::max)
}

/// A function from the tip position (m) to a scene and a push of the host.
type SceneBuilder<'a> = &'a dyn Fn([f64; 3]) -> (Scene<f64>, Option<Push<f64>>);

/// Computes the torques of the board's first step in the scene for the tip position.
fn first_step(file: &Linkage, q: &[f64], scene: SceneBuilder<'_>) -> Vec<f64> {
    fn run<M: Mechanism<f64, N>, const N: usize>(m: M, file: &Linkage, q: &[f64], scene: SceneBuilder<'_>) -> Vec<f64> {
        let counts = fine_counts(&SVector::<f64, N>::from_column_slice(q));
        let q = SVector::from_fn(|i, _| f64::from(counts[i]) * std::f64::consts::TAU / FINE_COUNTS);
        let tip = m.tip(&m.pose::<Libm>(&q));
        let (scene, push) = scene(core::array::from_fn(|i| if i < M::SPEC.task { tip[i] } else { 0.0 }));
        let scene = Scene { task: M::SPEC.task as u8, gravity_compensation: false, ..scene };
        let device = Device::new("device", &with_fine_encoders(file.description)).expect("a sound device");
        let mut controller = Controller::<f64, M, Libm, N>::new(m, &device, &scene).expect("a sound scene");
        controller.set_push(push.as_ref());
        controller.step(&counts).torque.iter().copied().collect()
    }
    with_mechanism!(file.mechanism, m => run(m, file, q, scene))
}

/// A generator of pseudo-random numbers that are the same on every machine.
struct Random(u64);

impl Random {
    fn uniform(&mut self, low: f64, high: f64) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        low + (high - low) * ((self.0 >> 11) as f64 / (1_u64 << 53) as f64)
    }

    fn direction(&mut self, task: usize) -> Vec<f64> {
        loop {
            let v: Vec<f64> = (0..task).map(|_| self.uniform(-1.0, 1.0)).collect();
            let square: f64 = v.iter().map(|x| x * x).sum();
            if (0.01..1.0).contains(&square) {
                return normalized(&v);
            }
        }
    }

    /// Draws 2 to 4 walls (normal, stiffness), near one normal if `set` is odd. The stiffness is spread over `decades`.
    fn walls(&mut self, task: usize, set: usize, decades: f64) -> Vec<(Vec<f64>, f64)> {
        let base = self.direction(task);
        let wall = |_| {
            let normal = if set.is_multiple_of(2) { self.direction(task) } else { self.direction_near(&base, 0.5) };
            (normal, 10_f64.powf(self.uniform(0.0, decades)))
        };
        (0..2 + set % 3).map(wall).collect()
    }

    /// Draws a unit vector within `angle` (rad) of `n`.
    fn direction_near(&mut self, n: &[f64], angle: f64) -> Vec<f64> {
        loop {
            let side = self.direction(n.len());
            let v: Vec<f64> = n.iter().zip(&side).map(|(a, b)| a + angle.tan() * b).collect();
            let v = normalized(&v);
            if v.iter().zip(n).map(|(a, b)| a * b).sum::<f64>() >= angle.cos() {
                return v;
            }
        }
    }
}
