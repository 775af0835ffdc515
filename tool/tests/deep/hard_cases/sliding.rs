//! Velocity terms from estimated velocities: a tip slides along a wall, and the f32 step receives only counts.
//!
//! The reference uses the true joint velocities. It computes the velocity terms from M and J by central differences in
//! 106 bits (Lagrange's equations), independently of the closed forms.

use super::double_double::{DoubleDouble, Series};
use super::rows::routes::inverse;
use super::rows::singular::{Random, cast};
use super::rows::steps::{RATE_HZ, controller, pad_to_three, scene, with_encoders};
use crate::common::prelude::*;
use haptic_bridge::control::compiled::BoardMath;
use nalgebra::{SMatrix, SVector};

/// Counts per turn: as on many shipped devices, and as in the other tables.
pub const COUNTS_PER_TURN: [f64; 2] = [20_000.0, 1_048_576.0];
/// Speed of the tip along the wall, m/s.
const SLIDING_SPEED: f64 = 0.5;
/// Number of slides per row.
const SLIDES_PER_ROW: usize = 10;
/// Control steps until the estimator has settled.
const SETTLING_STEPS: u32 = 600;
/// Control steps of a slide. The last 20 ms are compared.
const STEPS_PER_SLIDE: u32 = 1_000;

/// A row of docs/hard-cases/velocity-terms.csv.
#[derive(Clone, Debug)]
pub struct Row {
    pub device: &'static str,
    pub terms: VelocityTerms,
    /// Largest torque of the velocity terms, as a share of the largest torque.
    pub size: f64,
    /// Error of f32 against f64 with the same counts, as a share of the largest torque.
    pub rounding: f64,
    /// Error of f32 with encoder counts against true angles and velocities, for each of [`COUNTS_PER_TURN`], as a share
    /// of the largest torque.
    pub estimated: [f64; 2],
}

/// Computes the torques for the wall force f along n with and without the velocity terms, from true velocities.
fn exact_torques<M: Mechanism<DoubleDouble, N>, const N: usize>(
    m: &M,
    q: &SVector<DoubleDouble, N>,
    qd: &SVector<DoubleDouble, N>,
    n: &SVector<DoubleDouble, N>,
    f: DoubleDouble,
    terms: VelocityTerms,
) -> [SVector<DoubleDouble, N>; 2] {
    let pose = |q: &SVector<DoubleDouble, N>| m.pose::<Series>(q);
    let (mass, jacobian) = (m.mass(&pose(q)), m.jacobian(&pose(q)));
    // The error of a central difference in 106 bits is 1e-20 of the third derivative.
    let h = DoubleDouble::from(1e-10);
    let slope = |along: &SVector<DoubleDouble, N>, of: &dyn Fn(&M::Pose) -> SMatrix<DoubleDouble, N, N>| {
        (of(&pose(&(q + along * h))) - of(&pose(&(q - along * h)))) / (h + h)
    };
    // Lagrange: c = Ṁ q̇ - ½ ∂(q̇ᵀ M q̇)/∂q.
    let mut c = slope(qd, &|p| m.mass(p)) * qd;
    for i in 0..N {
        let unit = SVector::from_fn(|k, _| DoubleDouble::from(if k == i { 1.0 } else { 0.0 }));
        c[i] -= qd.dot(&(slope(&unit, &|p| m.mass(p)) * qd)) * 0.5.into();
    }
    let back = inverse(&jacobian);
    let b = c - mass * (back * (slope(qd, &|p| m.jacobian(p)) * qd));
    let e = back * n;
    let me = mass * e;
    let inertia = e.dot(&me);
    let off = me * (f / inertia);
    match terms {
        VelocityTerms::Off => [off, off],
        VelocityTerms::Paper => [me * ((f - e.dot(&b)) / inertia) + b, off],
        VelocityTerms::Rendered => [off + b, off],
    }
}

fn row_of<A, B, C, const N: usize>(
    (double, board, reference): (A, B, C),
    name: &'static str,
    device: &Description,
    terms: VelocityTerms,
) -> Row
where
    A: Mechanism<f64, N>,
    B: Mechanism<f32, N>,
    C: Mechanism<DoubleDouble, N>,
{
    let task = A::SPEC.task;
    let mut random = Random(19);
    let mut row = Row { device: name, terms, size: 0.0, rounding: 0.0, estimated: [0.0; 2] };
    let mut runs = 0;
    while runs < SLIDES_PER_ROW {
        let start: SVector<f64, N> = random.pose(&double);
        let (n, mut t): (SVector<f64, N>, SVector<f64, N>) = (random.normal(task), random.normal(task));
        let pose = double.pose::<Libm>(&start);
        let r = double.regularity(&pose);
        if r.serial.min(r.parallel) < 0.4 || n.norm() < 0.1 {
            continue;
        }
        let n: SVector<f64, N> = cast(&cast::<f64, f32, N>(&(n / n.norm())));
        t -= n * n.dot(&t);
        let qd = double.inverse(&pose, &(t / t.norm() * SLIDING_SPEED));
        // The feed-forward acts in full along the complete path.
        let regular = |k: u32| {
            let q = start + qd * (f64::from(STEPS_PER_SLIDE) / RATE_HZ * f64::from(k) / 10.0);
            let r = double.regularity(&double.pose::<Libm>(&q));
            r.serial.min(r.parallel) > 0.2
        };
        if !(0..=10).all(regular) {
            continue;
        }
        runs += 1;
        // 1 m deep in a wall of 5 N/m: the force hardly changes, and rounding hardly changes the depth.
        let surface = double.tip(&pose) + n;
        for (index, counts_per_turn) in COUNTS_PER_TURN.into_iter().enumerate() {
            let mut device = with_encoders(device);
            for joint in &mut device.joints {
                joint.encoder.as_mut().expect("every joint has an encoder").counts_per_turn = counts_per_turn;
                joint.viscous = 0.0;
            }
            device.gravity = [0.0; 3];
            let (p, normal) = (pad_to_three(&surface, task), pad_to_three(&n, task));
            let mut scene_f64 = scene::<f64>(task, p, normal, 5.0, 0.0, FeedForward::Full);
            scene_f64.velocity_terms = terms;
            let mut scene_f32 = scene::<f32>(task, p, normal, 5.0, 0.0, FeedForward::Full);
            scene_f32.velocity_terms = terms;
            let mut exact = controller::<f64, Libm, _, N>(double, &device, &scene_f64);
            let mut found = controller::<f32, BoardMath, _, N>(board, &device, &scene_f32);
            let (mut largest, mut size, mut rounding, mut estimated) = (0.0_f64, 0.0_f64, 0.0_f64, 0.0_f64);
            for step in 0..STEPS_PER_SLIDE {
                let q = start + qd * (f64::from(step) / RATE_HZ);
                let counts = q.map(|x| (x / std::f64::consts::TAU * counts_per_turn).round() as i32).into();
                let (a, b) = (exact.step(&counts), found.step(&counts));
                let torque: SVector<f64, N> = cast(&b.torque);
                if step < SETTLING_STEPS || step % 40 != 0 {
                    continue;
                }
                let place = double.tip(&double.pose::<Libm>(&q));
                let force = (0..task).map(|i| n[i] * (surface[i] - place[i])).sum::<f64>() * 5.0;
                let right = exact_torques(&reference, &cast(&q), &cast(&qd), &cast(&n), force.into(), terms);
                let [right, without]: [SVector<f64, N>; 2] = right.map(|torque| cast(&torque));
                largest = largest.max(right.amax());
                size = size.max((right - without).amax());
                rounding = rounding.max((a.torque - torque).amax());
                estimated = estimated.max((right - torque).amax());
            }
            row.size = row.size.max(size / largest);
            row.rounding = row.rounding.max(rounding / largest);
            row.estimated[index] = row.estimated[index].max(estimated / largest);
        }
    }
    row
}

/// Returns the rows of every mechanism with more than one direction and velocity terms, for every choice of the terms.
pub fn all_rows() -> Vec<Row> {
    super::several_directions()
    .filter(|(name, _)| !name.starts_with("paddles"))
    .flat_map(|(name, device)| {
        // Leave out the weight, which would add the same torque to both results.
        let mut device = with_encoders(&device);
        device.gravity = [0.0; 3];
        in_three_precisions!(&device, (a, b, c) => VelocityTerms::ALL.map(|(_, terms)| row_of((a, b, c), name, &device, terms)))
    })
    .collect()
}
