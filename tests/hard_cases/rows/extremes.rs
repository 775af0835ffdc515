//! Inertia ratios up to a million, links of 1 mm and 10 m, masses of 1 mg and 100 kg, thin rods without rotors, gears of
//! 1:50, and a tip at 10 m/s.

use super::routes::{Errors, Routes, routes};
use super::singular::{Random, cast};
use super::steps::with_gears;
use super::{Exact, ExactMath, devices};
use haptic_bridge::control::compiled::BoardMath;
use haptic_bridge::math::{Libm, Real};
use haptic_bridge::model::description::{Description, Link};
use haptic_bridge::model::mechanism::Mechanism;
use nalgebra::SVector;

/// Poses per row. Every pose has its own normals.
const POSES_PER_ROW: usize = 40;
/// Speed of a tip in the cases whose name ends with [`FAST`], m/s.
const FAST_TIP_SPEED: f64 = 10.0;
const FAST: &str = "10 m/s";
/// Random normals per pose. Only the normal with the largest Wrr/Weff is measured.
const NORMALS_PER_POSE: usize = 20;

#[derive(Clone, Debug)]
pub struct Row {
    pub device: &'static str,
    pub case: String,
    /// Largest Wrr/Weff of all poses.
    pub ratio: f64,
    pub board: Errors,
    pub double: Errors,
}

/// Computes the largest errors at regular poses of a device, at the normals with the largest Wrr/Weff, while the joints
/// move at up to 1 rad/s or, if `fast`, the tip at [`FAST_TIP_SPEED`].
fn row<A, B, C, const N: usize>(
    (double, board, reference): (&A, &B, &C),
    device: &'static str,
    case: String,
    fast: bool,
) -> Row
where
    A: Mechanism<f64, N>,
    B: Mechanism<f32, N>,
    C: Mechanism<Exact, N>,
{
    let mut random = Random(11);
    let mut row = Row { device, case, ratio: 0.0, board: Errors::default(), double: Errors::default() };
    for _ in 0..POSES_PER_ROW {
        let q: SVector<f32, N> = cast(&random.regular_pose(double));
        let mut qd: SVector<f64, N> = random.vector(1.0);
        if fast {
            let direction: SVector<f64, N> = random.normal(A::SPEC.task);
            qd = double.inverse(&double.pose::<Libm>(&cast(&q)), &(direction * (FAST_TIP_SPEED / direction.norm())));
        }
        let qd: SVector<f32, N> = cast(&qd);
        let mut worst: Option<(f64, SVector<f32, N>, Routes<Exact, N>)> = None;
        for _ in 0..NORMALS_PER_POSE {
            let n: SVector<f32, N> = cast(&random.normal::<N>(A::SPEC.task));
            let exact = routes::<_, ExactMath, _, N>(reference, &cast(&q), &cast(&qd), &cast(&n));
            let ratio = (exact.w_rr_kernel / exact.w_eff_joint).to_f64();
            if worst.as_ref().is_none_or(|(most, ..)| ratio > *most) {
                worst = Some((ratio, n, exact));
            }
        }
        let Some((ratio, n, exact)) = worst else { continue };
        row.ratio = row.ratio.max(ratio);
        row.board.grow(&Errors::new(&routes::<_, BoardMath, _, N>(board, &q, &qd, &n), &exact));
        row.double.grow(&Errors::new(&routes::<_, Libm, _, N>(double, &cast(&q), &cast(&qd), &cast(&n)), &exact));
    }
    row
}

fn measured_row(name: &'static str, device: &Description, case: String) -> Row {
    let fast = case.ends_with(FAST);
    in_three_precisions!(device, (a, b, c) => row((&a, &b, &c), name, case, fast))
}

/// Returns all lengths in a description (m), with signs.
fn lengths(device: &mut Description) -> impl Iterator<Item = &mut f64> {
    let keys = device.kind.spec().geometry.iter();
    let is_length = keys.flat_map(|(key, count)| vec![!["assembly", "azimuth", "task"].contains(key); *count]);
    let geometry =
        device.geometry.iter_mut().zip(is_length).filter_map(|(value, is_length)| is_length.then_some(value));
    geometry.chain(device.joints.iter_mut().flat_map(|joint| joint.frame.origin.iter_mut()))
}

fn scale_device(device: &Description, length: f64, mass: f64) -> Description {
    let mut scaled = *device;
    lengths(&mut scaled).for_each(|value| *value *= length);
    let inertia = mass * length * length;
    for link in &mut scaled.links {
        link.mass *= mass;
        link.com *= length;
        link.com_across = link.com_across.map(|value| value * length);
        link.inertia *= inertia;
        link.inertia_axial *= inertia;
        link.inertia_transverse *= inertia;
        link.inertia_products = link.inertia_products.map(|value| value * inertia);
    }
    for joint in &mut scaled.joints {
        joint.inertia *= if joint.prismatic { mass } else { inertia };
        if joint.prismatic {
            joint.limits = joint.limits.map(|(low, high)| (low * length, high * length));
        }
    }
    scaled.handle_mass *= mass;
    scaled
}

/// Scales a device so that its longest link has `length` (m) and its heaviest link or handle has `mass` (kg).
fn resize_device(device: &Description, length: f64, mass: f64) -> Description {
    let longest = lengths(&mut device.clone()).fold(0.0_f64, |most, l| most.max(l.abs()));
    let heaviest = device.links.iter().fold(device.handle_mass, |most, link| most.max(link.mass));
    // The mass of a paddle is lumped into its joint, so the equivalent mass is the inertia over the square of the
    // length.
    let heaviest = if heaviest > 0.0 { heaviest } else { device.joints[0].inertia / (longest * longest) };
    scale_device(device, length / longest, mass / heaviest)
}

/// Returns a device of 10 m and 100 kg whose links are rods without thickness and whose rotors are light.
fn thin_rods(device: &Description) -> Description {
    let mut thin = resize_device(device, 1e1, 1e2);
    for link in &mut thin.links {
        let com = link.com_vector();
        let mut rod = Link { mass: 0.0, ..*link };
        (rod.inertia, rod.inertia_axial, rod.inertia_transverse, rod.inertia_products) = (0.0, 0.0, 0.0, [0.0; 3]);
        // Simpson's rule is exact for a slender rod from its joint to twice its centre.
        for (share, place) in [(1.0 / 6.0, 0.0), (2.0 / 3.0, 1.0), (1.0 / 6.0, 2.0)] {
            rod.add_point(share * link.mass, com.map(|value| place * value));
        }
        *link = rod;
    }
    thin.joints.iter_mut().for_each(|joint| joint.inertia *= 1e-3);
    thin
}

/// Target ratios Wrr/Weff, reached with a heavier joint 0.
const RATIOS: [f64; 3] = [1e2, 1e4, 1e6];

pub fn all_rows() -> Vec<Row> {
    let mut rows = Vec::new();
    for (name, device) in devices() {
        for (length, mass) in [(1e-3, 1e-6), (1e-3, 1e2), (1e1, 1e-6), (1e1, 1e2)] {
            let unit = if length < 1.0 { "1 mm" } else { "10 m" };
            let weight = if mass < 1.0 { "1 mg" } else { "100 kg" };
            rows.push(measured_row(name, &resize_device(&device, length, mass), format!("{unit}, {weight}")));
        }
        rows.push(measured_row(name, &thin_rods(&device), format!("thin rods, {FAST}")));
        rows.push(measured_row(name, &with_gears(&device), format!("gears of 1:50, {FAST}")));
        if device.kind.spec().joints == 1 {
            continue; // A paddle has no admissible direction, so Wrr = Weff.
        }
        for ratio in RATIOS {
            // If the heavy joint dominates, Wrr/Weff is proportional to its inertia, so few corrections suffice.
            let heavier = |factor: f64| {
                let mut heavy = device;
                heavy.joints[0].inertia *= factor;
                heavy
            };
            let mut factor = 10.0 * ratio;
            for _ in 0..3 {
                factor *= ratio / measured_row(name, &heavier(factor), String::new()).ratio;
            }
            rows.push(measured_row(name, &heavier(factor), format!("Wrr/Weff {ratio:.0e}")));
        }
    }
    rows
}
