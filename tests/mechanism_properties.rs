//! Properties of every mechanism at regular poses of random devices. Mass matrix, gravity and tip are compared with
//! separate rigid bodies (common/bodies.rs). Velocity terms are compared with derivatives of the mass matrix, and each
//! hand-written kernel of the control step with the matrices that it replaces.

use crate::common::bodies::{derivative, dynamics, place_bodies};
use crate::common::{NUMBERS_PER_CASE, TestNumbers, determinant, inverse, property_config, random_device};
use haptic_bridge::control::compiled::BoardMath;
use haptic_bridge::math::Libm;
use haptic_bridge::model::catalogue::Kind;
use haptic_bridge::model::description::Description;
use haptic_bridge::model::inertia::Inertia;
use haptic_bridge::model::mechanism::{AnyMechanism, Mechanism, Regularity};
use haptic_bridge::model::principal::Pull;
use haptic_bridge::with_mechanism;
use nalgebra::{SMatrix, SVector};
use proptest::prelude::*;
use proptest::test_runner::TestCaseError;

type TestResult = Result<(), TestCaseError>;

/// Smallest sine of a regular pose. tests/hard_cases covers poses nearer to a singularity.
const MIN_SINE: f64 = 0.15;

/// A moving mechanism, with a unit vector `n` and a vector `v` of its task space.
struct Case<M, const N: usize> {
    m: M,
    device: Description,
    q: SVector<f64, N>,
    qd: SVector<f64, N>,
    /// Unit vector, with zeros beyond the task dimension.
    n: SVector<f64, N>,
    v: SVector<f64, N>,
}

impl<M: Mechanism<f64, N>, const N: usize> Case<M, N> {
    fn new(m: M, device: Description, draw: &mut TestNumbers<'_>) -> Option<Self> {
        let mut vector = |bound: f64| SVector::<f64, N>::from(draw.list::<N>(-bound, bound));
        let (q, qd, v) = (vector(3.2), vector(6.0), vector(3.0));
        let mut n = vector(1.0);
        for i in M::SPEC.task..N {
            n[i] = 0.0;
        }
        let Regularity { serial, parallel } = m.regularity(&m.pose::<Libm>(&q));
        (serial.min(parallel) > MIN_SINE && n.norm() > 0.1).then(|| Self { m, device, q, qd, n: n.normalize(), v })
    }

    fn pose(&self) -> M::Pose {
        self.m.pose::<Libm>(&self.q)
    }

    /// Returns the pose after motion at `qd` for the time `t`.
    fn pose_after(&self, t: f64) -> M::Pose {
        self.m.pose::<Libm>(&(self.q + self.qd * t))
    }
}

/// Checks that `a` equals `b` within `tolerance` times the largest entry of `b` (or `floor` if that is larger).
fn check_equal<const R: usize, const C: usize>(
    name: &str,
    a: &SMatrix<f64, R, C>,
    b: &SMatrix<f64, R, C>,
    tolerance: f64,
    floor: f64,
) -> TestResult {
    let error = (a - b).amax() / b.amax().max(floor);
    prop_assert!(error <= tolerance, "{name}: {a} differs from {b} by {error:e}");
    Ok(())
}

fn tip_and_jacobian_are_those_of_the_links<M: Mechanism<f64, N>, const N: usize>(case: &Case<M, N>) -> TestResult {
    let task = |q: &SVector<f64, N>| {
        let (_, tip) = place_bodies(&case.device, q.as_slice());
        SVector::<f64, N>::from_fn(|i, _| tip[i])
    };
    check_equal("tip", &case.m.tip(&case.pose()), &task(&case.q), 1e-11, 1e-3)?;
    let mut differences = SMatrix::<f64, N, N>::zeros();
    for i in 0..N {
        let column = derivative(1e-4, |h| {
            let mut q = case.q;
            q[i] += h;
            task(&q)
        });
        differences.set_column(i, &column);
    }
    check_equal("J", &case.m.jacobian(&case.pose()), &differences, 1e-6, 1e-3)
}

fn jacobian_rate_is_the_rate_of_the_jacobian<M: Mechanism<f64, N>, const N: usize>(case: &Case<M, N>) -> TestResult {
    let differences = derivative(2e-5, |t| case.m.jacobian(&case.pose_after(t)));
    check_equal("J̇", &case.m.jacobian_rate(&case.pose(), &case.qd), &differences, 1e-6, 1e-2)
}

fn mass_and_gravity_are_those_of_the_bodies<M: Mechanism<f64, N>, const N: usize>(case: &Case<M, N>) -> TestResult {
    let (mass, gravity) = dynamics(&case.device, case.q.as_slice());
    let pose = case.pose();
    check_equal("M", &case.m.mass(&pose), &SMatrix::from_fn(|i, j| mass[i][j]), 1e-6, 0.0)?;
    check_equal("g", &case.m.gravity(&pose), &SVector::from_fn(|i, _| gravity[i]), 1e-6, 1e-3)
}

fn mass_is_symmetric_and_positive_definite<M: Mechanism<f64, N>, const N: usize>(case: &Case<M, N>) -> TestResult {
    let mass = case.m.mass(&case.pose());
    prop_assert_eq!(mass, mass.transpose());
    // Every leading minor must be positive (Sylvester's criterion).
    for size in 1..=N {
        let minor = SMatrix::<f64, N, N>::from_fn(|i, j| {
            if i < size && j < size { mass[(i, j)] } else { f64::from(u8::from(i == j)) }
        });
        prop_assert!(determinant(&minor) > 0.0, "{mass}");
    }
    Ok(())
}

fn coriolis_forces_agree_with_the_rate_of_m<M: Mechanism<f64, N>, const N: usize>(case: &Case<M, N>) -> TestResult {
    let pose = case.pose();
    let (m, qd) = (&case.m, &case.qd);
    let mass_rate = derivative(2e-5, |t| m.mass(&case.pose_after(t)));
    let scale = mass_rate.amax().max(m.mass(&pose).amax());
    // c is quadratic in q̇. The columns are C from Christoffel's symbols, computed with the polar form of c.
    let mut c = SMatrix::<f64, N, N>::zeros();
    for i in 0..N {
        let mut unit = SVector::<f64, N>::zeros();
        unit[i] = 1.0;
        let both = m.coriolis(&pose, &(qd + unit)) - m.coriolis(&pose, qd) - m.coriolis(&pose, &unit);
        c.set_column(i, &(both * 0.5));
    }
    let skew = mass_rate - c * 2.0;
    check_equal("Ṁ - 2C", &(skew + skew.transpose()), &SMatrix::zeros(), 1e-6, scale)?;
    // Lagrange's equation: c = Ṁ q̇ - ½ ∂(q̇ᵀ M q̇)/∂q.
    let gradient = SVector::<f64, N>::from_fn(|i, _| {
        derivative(1e-4, |h| {
            let mut q = case.q;
            q[i] += h;
            qd.dot(&(m.mass(&m.pose::<Libm>(&q)) * qd))
        })
    });
    check_equal("c", &m.coriolis(&pose, qd), &(mass_rate * qd - gradient * 0.5), 1e-6, scale)
}

fn free_motion_keeps_its_energy<M: Mechanism<f64, N>, const N: usize>(case: &Case<M, N>) -> TestResult {
    let m = &case.m;
    let rate = |q: &SVector<f64, N>, qd: &SVector<f64, N>| {
        let pose = m.pose::<Libm>(q);
        -(inverse(&m.mass(&pose)) * m.coriolis(&pose, qd))
    };
    let energy = |q: &SVector<f64, N>, qd: &SVector<f64, N>| 0.5 * qd.dot(&(m.mass(&m.pose::<Libm>(q)) * qd));
    let (mut q, mut qd) = (case.q, case.qd);
    let before = energy(&q, &qd);
    // Integrates by fourth-order Runge-Kutta until the motion comes near a singularity.
    let h = 2e-5;
    for _ in 0..500 {
        let Regularity { serial, parallel } = m.regularity(&m.pose::<Libm>(&q));
        if serial.min(parallel) < 0.5 * MIN_SINE {
            break;
        }
        let k1 = rate(&q, &qd);
        let (q2, qd2) = (q + qd * (h / 2.0), qd + k1 * (h / 2.0));
        let k2 = rate(&q2, &qd2);
        let (q3, qd3) = (q + qd2 * (h / 2.0), qd + k2 * (h / 2.0));
        let k3 = rate(&q3, &qd3);
        let (q4, qd4) = (q + qd3 * h, qd + k3 * h);
        let k4 = rate(&q4, &qd4);
        q += (qd + qd2 * 2.0 + qd3 * 2.0 + qd4) * (h / 6.0);
        qd += (k1 + k2 * 2.0 + k3 * 2.0 + k4) * (h / 6.0);
    }
    let drift = (energy(&q, &qd) / before - 1.0).abs();
    prop_assert!(drift < 1e-7, "the energy changes by {drift:e}");
    Ok(())
}

fn kernels_agree_with_the_matrices<M: Mechanism<f64, N>, const N: usize>(case: &Case<M, N>) -> TestResult {
    let (m, pose, qd, n, v) = (&case.m, case.pose(), &case.qd, &case.n, &case.v);
    let (jacobian, mass) = (m.jacobian(&pose), m.mass(&pose));
    let jacobian_inverse = inverse(&jacobian);
    let rate = m.jacobian_rate(&pose, qd);
    let c = m.coriolis(&pose, qd);
    check_equal("Jᵀ f", &m.transpose(&pose, v), &jacobian.tr_mul(v), 1e-10, 0.0)?;
    check_equal("J q̇", &m.velocity(&pose, qd), &(jacobian * qd), 1e-10, 0.0)?;
    check_equal("J⁻¹ v", &m.inverse(&pose, v), &(jacobian_inverse * v), 1e-9, 0.0)?;
    check_equal("J⁻¹", &m.jacobian_inverse(&pose), &jacobian_inverse, 1e-9, 0.0)?;
    let shaping = m.shaping(&pose, n);
    let e = jacobian_inverse * n;
    check_equal("E", &shaping.e, &e, 1e-9, 0.0)?;
    check_equal("M E", &shaping.me, &(mass * e), 1e-9, 0.0)?;
    check_equal("Wrr", &[[shaping.w_rr]].into(), &[[e.dot(&(mass * e))]].into(), 1e-9, 0.0)?;
    check_equal("Λ", &m.operational_inertia(&pose), &(jacobian_inverse.tr_mul(&mass) * jacobian_inverse), 1e-9, 0.0)?;
    let expected = c - mass * (jacobian_inverse * (rate * qd));
    check_equal("velocity torque", &m.velocity_torque(&pose, qd), &expected, 1e-8, 1e-4)?;
    Ok(())
}

/// Compares every field of [`Inertia`] with the paper's equations (1) to (4) in matrix form, for one wall.
fn inertia_agrees_with_the_paper<M: Mechanism<f64, N>, const N: usize>(case: &Case<M, N>) -> TestResult {
    let (m, pose, qd) = (&case.m, case.pose(), &case.qd);
    let (jacobian, mass) = (m.jacobian(&pose), m.mass(&pose));
    let force = 2.5;
    let wall = Pull { normal: case.n, across: false, stiffness: 1.0, feed_forward: true };
    let found = Inertia::new::<Libm, M>(m, &pose, qd, &[wall], &(case.n * force));
    let basis = found.split.basis;
    check_equal("n", &basis.column(0).into_owned(), &case.n, 1e-15, 0.0)?;
    check_equal("Bᵀ B", &basis.tr_mul(&basis), &SMatrix::identity(), 1e-15, 0.0)?;
    prop_assert!(N == 1 || determinant(&basis) > 0.0, "{basis}");
    let (t, t_rate) = (basis.tr_mul(&jacobian), basis.tr_mul(&m.jacobian_rate(&pose, qd)));
    let t_inverse = inverse(&t);
    let w = t_inverse.tr_mul(&(mass * t_inverse));
    check_equal("W", &found.w, &w, 1e-9, 0.0)?;
    let z = t_inverse.tr_mul(&(m.coriolis(&pose, qd) + m.gravity(&pose))) - w * (t_rate * qd);
    check_equal("z", &found.z, &z, 1e-8, 1e-3)?;
    let row = jacobian.tr_mul(&case.n);
    let w_eff = 1.0 / row.dot(&(inverse(&mass) * row));
    check_equal("Weff", &[[found.w_eff[(0, 0)]]].into(), &[[w_eff]].into(), 1e-9, 0.0)?;
    prop_assert_eq!(found.w_eff.sum(), found.w_eff[(0, 0)]);
    let mut forces = SVector::<f64, N>::zeros();
    forces[0] = force;
    for i in 1..N {
        forces[i] = w[(i, 0)] / w[(0, 0)] * (force - z[0]) + z[i];
    }
    let f_a = SVector::<f64, N>::from_fn(|i, _| if i + 1 < N { forces[i + 1] } else { 0.0 });
    check_equal("f_a", &found.f_a, &f_a, 1e-8, forces.amax())?;
    check_equal("τ", &found.torque, &t.tr_mul(&forces), 1e-8, 0.0)?;
    check_equal("τ without", &found.torque_without_feed_forward, &(row * force), 1e-10, 0.0)
}

/// Compares [`Inertia`] with the paper for walls along the axes and the first joint at 0. One of these walls is
/// perpendicular to the plane of a turret's arms, which then do not move.
fn inertia_agrees_with_the_paper_along_the_axes<M: Mechanism<f64, N>, const N: usize>(case: &Case<M, N>) -> TestResult {
    let mut q = case.q;
    q[0] = 0.0;
    let Regularity { serial, parallel } = case.m.regularity(&case.m.pose::<Libm>(&q));
    for axis in (0..M::SPEC.task).filter(|_| serial.min(parallel) > MIN_SINE) {
        let n = SVector::from_fn(|i, _| if i == axis { 1.0 } else { 0.0 });
        inertia_agrees_with_the_paper(&Case { q, n, ..*case })?;
    }
    Ok(())
}

fn effective_inertia_is_at_most_the_rendered_inertia<M: Mechanism<f64, N>, const N: usize>(
    case: &Case<M, N>,
) -> TestResult {
    let (m, pose) = (&case.m, case.pose());
    let row = m.transpose(&pose, &case.n);
    let mobility = row.dot(&(inverse(&m.mass(&pose)) * row));
    let w_rr = m.shaping(&pose, &case.n).w_rr;
    prop_assert!(1.0 / mobility <= w_rr * (1.0 + 1e-9), "Weff {} against Wrr {w_rr}", 1.0 / mobility);
    Ok(())
}

fn with_feed_forward_the_tip_accelerates_along_the_normal<M: Mechanism<f64, N>, const N: usize>(
    case: &Case<M, N>,
) -> TestResult {
    let (m, pose, qd, n) = (&case.m, case.pose(), &case.qd, &case.n);
    let b = m.velocity_torque(&pose, qd) + m.gravity(&pose);
    let shaping = m.shaping(&pose, n);
    let force = case.v[0];
    let torque = shaping.torque(force, &b, &b);
    let bias = m.coriolis(&pose, qd) + m.gravity(&pose);
    let qdd = inverse(&m.mass(&pose)) * (torque - bias);
    let acceleration = m.jacobian(&pose) * qdd + m.jacobian_rate(&pose, qd) * qd;
    let expected = n * ((force - shaping.e.dot(&b)) / shaping.w_rr);
    check_equal("acceleration", &acceleration, &expected, 1e-7, 1e-1)
}

fn torque_does_not_depend_on_the_admissible_directions<M: Mechanism<f64, N>, const N: usize>(
    case: &Case<M, N>,
) -> TestResult {
    let (m, pose, qd, n) = (&case.m, case.pose(), &case.qd, &case.n);
    let b = m.velocity_torque(&pose, qd) + m.gravity(&pose);
    let torque = m.shaping(&pose, n).torque(case.v[0], &b, &b);
    // Equation (4) as written, with admissible directions that are neither orthogonal nor unit vectors.
    let mut directions = SMatrix::<f64, N, N>::identity();
    directions.set_column(0, n);
    for i in 1..N {
        let skewed = SVector::<f64, N>::from_fn(|k, _| case.v[(i + k) % N] + if i == k { 2.0 } else { 0.0 });
        directions.set_column(i, &(skewed - n * n.dot(&skewed)));
    }
    prop_assume!(determinant(&directions).abs() > 0.3);
    let t = directions.tr_mul(&m.jacobian(&pose));
    let t_rate = directions.tr_mul(&m.jacobian_rate(&pose, qd));
    let inverse = inverse(&t);
    let w = inverse.tr_mul(&(m.mass(&pose) * inverse));
    let z = inverse.tr_mul(&(m.coriolis(&pose, qd) + m.gravity(&pose))) - w * (t_rate * qd);
    let mut f = z;
    f[0] = case.v[0];
    for i in 1..N {
        f[i] += w[(i, 0)] / w[(0, 0)] * (case.v[0] - z[0]);
    }
    check_equal("τ", &torque, &t.tr_mul(&f), 1e-7, 1e-3)
}

fn check_every_property<M: Mechanism<f64, N>, const N: usize>(
    m: M,
    device: Description,
    draw: &mut TestNumbers<'_>,
) -> TestResult {
    let Some(case) = Case::new(m, device, draw) else {
        return Err(TestCaseError::reject("too near a singularity"));
    };
    tip_and_jacobian_are_those_of_the_links(&case)?;
    jacobian_rate_is_the_rate_of_the_jacobian(&case)?;
    mass_and_gravity_are_those_of_the_bodies(&case)?;
    mass_is_symmetric_and_positive_definite(&case)?;
    coriolis_forces_agree_with_the_rate_of_m(&case)?;
    free_motion_keeps_its_energy(&case)?;
    kernels_agree_with_the_matrices(&case)?;
    inertia_agrees_with_the_paper(&case)?;
    inertia_agrees_with_the_paper_along_the_axes(&case)?;
    effective_inertia_is_at_most_the_rendered_inertia(&case)?;
    with_feed_forward_the_tip_accelerates_along_the_normal(&case)?;
    torque_does_not_depend_on_the_admissible_directions(&case)
}

/// Computes the board's error of the torque of (4) (f32, minimax sines, rounded angles), as a share of its largest
/// entry.
fn board_error<A, B, const N: usize>(exact: &A, board: &B, case: &Case<A, N>) -> f64
where
    A: Mechanism<f64, N>,
    B: Mechanism<f32, N>,
{
    let f32s = |v: &SVector<f64, N>| v.map(|x| x as f32);
    let f64s = |v: &SVector<f32, N>| v.map(f64::from);
    let (q, qd, n) = (f32s(&case.q), f32s(&case.qd), f32s(&case.n));
    let pose = board.pose::<BoardMath>(&q);
    let b = board.velocity_torque(&pose, &qd) + board.gravity(&pose);
    let torque = board.shaping(&pose, &n).torque(3.0, &b, &b);
    let (q, qd, n) = (f64s(&q), f64s(&qd), f64s(&n));
    let pose = exact.pose::<Libm>(&q);
    let b = exact.velocity_torque(&pose, &qd) + exact.gravity(&pose);
    let expected = exact.shaping(&pose, &n).torque(3.0, &b, &b);
    (f64s(&torque) - expected).amax() / expected.amax()
}

fn check_board_error<A, B, const N: usize>(
    exact: A,
    board: AnyMechanism<f32>,
    device: Description,
    draw: &mut TestNumbers<'_>,
    as_board: impl Fn(AnyMechanism<f32>) -> Option<B>,
) -> TestResult
where
    A: Mechanism<f64, N>,
    B: Mechanism<f32, N>,
{
    let Some(case) = Case::new(exact, device, draw) else {
        return Err(TestCaseError::reject("too near a singularity"));
    };
    let board = as_board(board).expect("both precisions have the same mechanism");
    let error = board_error(&exact, &board, &case);
    prop_assert!(error < 2e-4, "the board's error is {error:e}");
    Ok(())
}

fn check_properties(kind: Kind, numbers: &[f64]) -> TestResult {
    let draw = &mut TestNumbers::new(numbers);
    let device = random_device(kind, draw);
    let Ok(mechanism) = AnyMechanism::<f64>::new(&device) else {
        return Err(TestCaseError::reject("the mechanism cannot close"));
    };
    with_mechanism!(mechanism, m => check_every_property(m, device, draw))
}

fn check_board(kind: Kind, numbers: &[f64]) -> TestResult {
    let draw = &mut TestNumbers::new(numbers);
    let device = random_device(kind, draw);
    let (Ok(exact), Ok(board)) = (AnyMechanism::<f64>::new(&device), AnyMechanism::<f32>::new(&device)) else {
        return Err(TestCaseError::reject("the mechanism cannot close"));
    };
    macro_rules! pair {
        ($($Variant:ident)*) => {
            match exact {
                $(AnyMechanism::$Variant(m) => check_board_error(m, board, device, draw, |any| match any {
                    AnyMechanism::$Variant(m) => Some(m),
                    _ => None,
                }),)*
            }
        };
    }
    pair!(Paddle FiveBar FiveBarTurret Parallelogram Serial3r)
}

macro_rules! properties {
    ($($kind:ident: $exact:ident $board:ident;)*) => {
        proptest! {
            #![proptest_config(ProptestConfig { max_global_rejects: 8192, ..property_config(96) })]
            $(
                #[test]
                fn $exact(numbers in prop::collection::vec(0.0..1.0, NUMBERS_PER_CASE)) {
                    check_properties(Kind::$kind, &numbers)?;
                }
                #[test]
                fn $board(numbers in prop::collection::vec(0.0..1.0, NUMBERS_PER_CASE)) {
                    check_board(Kind::$kind, &numbers)?;
                }
            )*
        }
    };
}

properties! {
    Paddle: a_paddle_obeys_mechanics a_paddle_keeps_four_digits_on_the_board;
    FiveBar: a_five_bar_obeys_mechanics a_five_bar_keeps_four_digits_on_the_board;
    FiveBarTurret: a_turreted_five_bar_obeys_mechanics a_turreted_five_bar_keeps_four_digits_on_the_board;
    Parallelogram: a_parallelogram_obeys_mechanics a_parallelogram_keeps_four_digits_on_the_board;
    Serial3r: a_redundant_arm_obeys_mechanics a_redundant_arm_keeps_four_digits_on_the_board;
}

#[test]
fn every_mechanism_is_listed_in_properties() {
    assert_eq!(Kind::ALL.len(), 5, "a new mechanism needs its line in `properties!`");
}
