//! Two walls at a small angle or of very different stiffness. The control step in f32 is compared with the law of
//! docs/model.md section 2. The oracle computes the law in accelerations in the reference's numbers, with the
//! eigenvectors of two walls in closed form.

use super::routes::inverse;
use super::singular::{Random, cast};
use super::steps::{controller, counts, pad_to_three, scene, with_encoders};
use super::{Exact, ExactMath, devices};
use haptic_bridge::control::compiled::BoardMath;
use haptic_bridge::math::{Libm, Math, Real};
use haptic_bridge::model::description::Description;
use haptic_bridge::model::mechanism::Mechanism;
use haptic_bridge::render::scene::{FeedForward, Plane, Scene, Surface, VelocityTerms, Wall};
use nalgebra::SVector;

/// Angles between the walls, rad.
pub const ANGLES: [f64; 4] = [1e-4, 1e-3, 1e-2, 1e-1];
/// Ratios of the first wall's stiffness to the second wall's stiffness.
pub const RATIOS: [f64; 3] = [1.0, 1e2, 1e4];
const POSES_PER_ROW: usize = 40;

#[derive(Clone, Debug)]
pub struct Row {
    pub device: &'static str,
    /// Angle between the walls, rad.
    pub angle: f64,
    /// Largest torque error as a share of the largest torque, for each of [`RATIOS`].
    pub torque: [f64; 3],
    /// Smallest difference between the torque and Jᵀ F, as a share of the largest torque.
    pub smallest_shaping: f64,
}

/// Computes the joint torques M J⁻¹ A F for two walls (normal, stiffness, force) at rest.
fn reference_torques<M: Mechanism<Exact, N>, const N: usize>(
    m: &M,
    q: &SVector<Exact, N>,
    walls: &[(SVector<Exact, N>, Exact, Exact); 2],
) -> SVector<Exact, N> {
    let one = Exact::from_f64(1.0);
    let pose = m.pose::<ExactMath>(q);
    let (mass, back) = (m.mass(&pose), inverse(&m.jacobian(&pose)));
    let lambda = back.transpose() * mass * back;
    let mobility = inverse(&lambda);

    // K = k₁ n₁ n₁ᵀ + k₂ n₂ n₂ᵀ in the frame (a, b) of the plane that both normals span.
    let [(n1, k1, f1), (n2, k2, f2)] = *walls;
    let length = |v: &SVector<Exact, N>| ExactMath::sqrt(v.dot(v));
    let a = n1 / length(&n1);
    let rest = n2 - a * a.dot(&n2);
    let b = rest / length(&rest);
    let (c, s) = (a.dot(&n2), b.dot(&n2));
    let (aa, ab, bb) = (k1 * n1.dot(&n1) + k2 * c * c, k2 * c * s, k2 * s * s);
    let half = Exact::from_f64(0.5);
    let root = ExactMath::sqrt((aa - bb) * (aa - bb) + ab * ab * Exact::from_f64(4.0));
    let stiff = (aa + bb + root) * half;
    let soft = (aa * bb - ab * ab) / stiff;
    let e1 = a * (stiff - bb) + b * ab;
    let e1 = e1 / length(&e1);
    let e2 = b * a.dot(&e1) - a * b.dot(&e1);

    // A_R = Q (Qᵀ Λ Q)⁻¹ Qᵀ. A third direction has no stiffness, so s₂ = 1. A planar device has no level 2.
    let s1 = one - soft / stiff * (soft / stiff);
    let first = e1 / e1.dot(&(lambda * e1));
    let second = |e: &SVector<Exact, N>| {
        if N == 2 {
            return mobility * e;
        }
        let (l11, l12, l22) = (e1.dot(&(lambda * e1)), e1.dot(&(lambda * e2)), e2.dot(&(lambda * e2)));
        let (x, y) = (e1.dot(e), e2.dot(e));
        (e1 * (l22 * x - l12 * y) + e2 * (l11 * y - l12 * x)) / (l11 * l22 - l12 * l12)
    };
    let force = n1 * f1 + n2 * f2;
    let (along, across) = (e1.dot(&force), e2.dot(&force));
    let acceleration = (first * s1 + second(&e1) * (one - s1)) * along + second(&e2) * across;
    mass * (back * acceleration)
}

fn row<A, B, C, const N: usize>(double: A, board: B, reference: C, name: &'static str, device: &Description) -> Vec<Row>
where
    A: Mechanism<f64, N>,
    B: Mechanism<f32, N>,
    C: Mechanism<Exact, N>,
{
    let task = A::SPEC.task;
    ANGLES
        .map(|angle| {
            let mut random = Random(11);
            let mut row = Row { device: name, angle, torque: [0.0; 3], smallest_shaping: f64::INFINITY };
            let mut poses = 0;
            while poses < POSES_PER_ROW {
                let q: SVector<f64, N> = random.pose(&double);
                let pose = double.pose::<Libm>(&q);
                let r = double.regularity(&pose);
                let mut n: SVector<f64, N> = random.normal(task);
                let mut t: SVector<f64, N> = random.normal(task);
                if r.serial.min(r.parallel) < 0.2 || n.norm() < 0.1 {
                    continue;
                }
                poses += 1;
                n /= n.norm();
                t -= n * n.dot(&t);
                t /= t.norm();
                // The surfaces are 1 m away and the stiffness is at most 1 N/m, so that penetrations cause no errors.
                let normals = [n, n * angle.cos() + t * angle.sin()].map(|n| cast::<f64, f32, N>(&n));
                let tip = double.tip(&pose);
                for (index, ratio) in RATIOS.into_iter().enumerate() {
                    let stiffness = [1.0, (1.0 / ratio) as f32];
                    let mut scene: Scene<f32> = scene(task, [0.0; 3], [1.0, 0.0, 0.0], 0.0, 0.0, FeedForward::Full);
                    (scene.rate_hz, scene.cutoff_hz) = (1_000.0, 100.0);
                    (scene.velocity_terms, scene.gravity_compensation) = (VelocityTerms::Off, false);
                    let planes = normals.map(|n| {
                        let n = cast::<f32, f64, N>(&n);
                        let [point, normal] = [tip + n, n].map(|v| pad_to_three(&v, task).map(|x| x as f32));
                        Plane { point, normal }
                    });
                    let first = Wall { damping_compensation: false, bilateral: true, ..scene.walls[0] };
                    let walls =
                        [0, 1].map(|i| Wall { surface: Surface::Plane(planes[i]), stiffness: stiffness[i], ..first });
                    scene.walls = walls.into_iter().collect();
                    let step = controller::<f32, BoardMath, _, N>(board, device, &scene).step(&counts(&q));
                    // The oracle uses the board's rounded angles and planes.
                    let angles: SVector<Exact, N> = cast(&step.q);
                    let tip = reference.tip(&reference.pose::<ExactMath>(&angles));
                    let given = [0, 1].map(|i| {
                        let normal: SVector<Exact, N> = cast(&normals[i]);
                        let mut distance = Exact::from_f64(0.0);
                        for k in 0..task {
                            distance += normal[k] * (tip[k] - Exact::from_f64(f64::from(planes[i].point[k])));
                        }
                        let stiffness = Exact::from_f64(f64::from(stiffness[i]));
                        (normal, stiffness, -(stiffness * distance))
                    });
                    let exact: SVector<f64, N> = cast(&reference_torques(&reference, &angles, &given));
                    let found: SVector<f64, N> = cast(&step.torque);
                    row.torque[index] = row.torque[index].max((found - exact).amax() / exact.amax());
                    let plain: SVector<f64, N> = cast(&step.rendered);
                    row.smallest_shaping = row.smallest_shaping.min((exact - plain).amax() / exact.amax());
                }
            }
            row
        })
        .to_vec()
}

/// Returns the rows of every mechanism with more than one direction.
pub fn all_rows() -> Vec<Row> {
    devices()
        .into_iter()
        .filter(|(_, device)| device.kind.spec().joints > 1)
        .flat_map(|(name, device)| {
            let device = with_encoders(&device);
            in_three_precisions!(&device, (a, b, c) => row(a, b, c, name, &device))
        })
        .collect()
}
