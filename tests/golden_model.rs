//! The model agrees with independently computed cases: twenty random devices and motions per mechanism (tests/golden).
//! The allowed errors are 1e-9 of the largest entry in f64, and 2e-4 of the largest torque in the board's f32.

use crate::common::device_file::parse;
use crate::golden::{F32_TOLERANCE, F64_TOLERANCE, Quantity, assert_agree, cases, list, number, text};
use haptic_bridge::control::compiled::BoardMath;
use haptic_bridge::math::{FineTable, Math, Real};
use haptic_bridge::model::inertia::Inertia;
use haptic_bridge::model::mechanism::{AnyMechanism, Mechanism};
use haptic_bridge::model::principal::Pull;
use haptic_bridge::with_mechanism;
use nalgebra::{SMatrix, SVector};
use serde_json::Value;

/// Computes all quantities of equation (4). A `side` of -1 reverses the wall's normal and force.
fn quantities<T: Real, K: Math<T>, M: Mechanism<T, N>, const N: usize>(
    m: &M,
    case: &Value,
    side: f64,
) -> Vec<Quantity> {
    let vector = |key: &str, scale: f64| {
        let entries = list(&case[key]);
        SVector::<T, N>::from_fn(|i, _| T::from_f64(scale * entries.get(i).copied().unwrap_or(0.0)))
    };
    let (pose, qd, normal) = (m.pose::<K>(&vector("q", 1.0)), vector("qd", 1.0), vector("normal", side));
    let wall = Pull { normal, across: false, stiffness: T::one(), feed_forward: true };
    let force = normal * T::from_f64(side * number(&case["force"]));
    let inertia = Inertia::new::<K, M>(m, &pose, &qd, &[wall], &force);
    let list = |v: SVector<T, N>, count: usize| v.iter().take(count).map(|x| x.to_f64()).collect();
    let rows = |m: SMatrix<T, N, N>, count: usize, columns: usize| {
        (0..count).flat_map(|i| (0..columns).map(move |j| m[(i, j)].to_f64())).collect()
    };
    vec![
        ("position", list(m.tip(&pose), M::SPEC.task)),
        ("jacobian", rows(m.jacobian(&pose), M::SPEC.task, N)),
        ("mass", rows(m.mass(&pose), N, N)),
        ("bias", list(m.coriolis(&pose, &qd) + m.gravity(&pose), N)),
        ("w_rr", rows(inertia.w, 1, 1)),
        ("w_eff", rows(inertia.w_eff, 1, 1)),
        ("coupling", rows(inertia.w - inertia.w_eff, 1, 1)),
        ("z_r", list(inertia.z, 1)),
        ("f_a", list(inertia.f_a, N - 1)),
        ("torque", list(inertia.torque, N)),
        ("torque_without_feed_forward", list(inertia.torque_without_feed_forward, N)),
    ]
}

fn double_precision(case: &Value, side: f64) -> Vec<Quantity> {
    let mechanism = AnyMechanism::<f64>::new(&parse(text(&case["device"]))).expect("a sound device");
    with_mechanism!(&mechanism, m => quantities::<f64, FineTable, _, _>(m, case, side))
}

#[test]
fn every_quantity_agrees_in_double_precision() {
    for case in cases() {
        assert_agree(&case, &double_precision(&case, 1.0), F64_TOLERANCE);
    }
}

#[test]
fn the_boards_code_computes_the_torques_in_single_precision() {
    for case in cases() {
        let mechanism = AnyMechanism::<f32>::new(&parse(text(&case["device"]))).expect("a sound device");
        let mut found = with_mechanism!(&mechanism, m => quantities::<f32, BoardMath, _, _>(m, &case, 1.0));
        found.retain(|(name, _)| name.starts_with("torque"));
        assert_agree(&case, &found, F32_TOLERANCE);
    }
}

#[test]
fn weff_and_wrr_are_the_same_on_both_sides_of_the_wall() {
    for case in cases() {
        let mut found = double_precision(&case, -1.0);
        found.retain(|(name, _)| ["w_eff", "w_rr", "torque"].contains(name));
        assert_agree(&case, &found, F64_TOLERANCE);
    }
}
