//! Frozen and tabulated mass matrices are accurate against the closed form, and damaged ones are refused.

use crate::common::device_file::shipped_device;
use haptic_bridge::control::compiled::BoardMath;
use haptic_bridge::math::Libm;
use haptic_bridge::model::mechanism::{AnyMechanism, FiveBar, Mechanism};
use haptic_bridge::model::precomputed::{
    Grid, Interpolation, MassModel, MassModelData, TABLE_VALUES, TableReceiver, checksum, tabulate,
};
use haptic_bridge::with_mechanism;
use nalgebra::SVector;

const DEVICES: [&str; 4] = ["haply-2diy", "fictive-five-bar-turret", "phantom-premium-1.5", "serial-3r"];

fn mechanism(name: &str) -> AnyMechanism<f64> {
    AnyMechanism::new(&shipped_device(name)).expect("a sound device")
}

/// Returns the largest difference of M E between a table and the closed form, as a share of the largest entry, on a
/// grid of 63 x 63 poses around home. The grid includes the centres of all cells of 4 x 4 and of 8 x 8 cells.
fn worst_error<M: Mechanism<f64, N>, const N: usize>(
    mechanism: &M,
    home: &[f64; 3],
    interpolation: Interpolation,
    points: u8,
) -> f64 {
    let q0 = SVector::<f64, N>::from_fn(|i, _| home[i]);
    let shape = mechanism.shape(&q0);
    let (low, high) = (shape.map(|s| s - 0.3), shape.map(|s| s + 0.3));
    let grid = Grid::new(interpolation, [points; 2], low, high, M::MASS_ENTRIES.len()).unwrap();
    let mut values = vec![0.0; grid.values(M::MASS_ENTRIES.len())];
    tabulate::<f64, Libm, M, N>(mechanism, &grid, |index, value| values[index] = value);
    let table = MassModel::table::<M>(&grid, &values).unwrap();
    let n = SVector::<f64, N>::from_fn(|i, _| {
        if i == 0 {
            0.6
        } else if i == 1 {
            0.8
        } else {
            0.0
        }
    });
    let mut worst = 0.0_f64;
    for i in 1..64 {
        for j in 1..64 {
            let mut q = q0;
            let first = if N == 2 { 0 } else { N - 2 };
            q[first] += 0.3 * (f64::from(i) / 32.0 - 1.0);
            q[N - 1] += 0.3 * (f64::from(j) / 32.0 - 1.0);
            let pose = mechanism.pose::<Libm>(&q);
            let exact = mechanism.shaping(&pose, &n).me;
            let looked_up = table.shaping(mechanism, &q, &pose, &n).me;
            worst = worst.max((looked_up - exact).amax() / exact.amax());
        }
    }
    worst
}

fn worst_errors(interpolation: Interpolation, points: u8) -> Vec<f64> {
    DEVICES
        .iter()
        .map(|name| {
            let home = shipped_device(name).home.expect("a shipped device has a home");
            with_mechanism!(&mechanism(name), m => worst_error(m, &home, interpolation, points))
        })
        .collect()
}

#[test]
fn the_error_of_a_bilinear_table_is_of_second_order() {
    for (coarse, fine) in
        worst_errors(Interpolation::Bilinear, 5).into_iter().zip(worst_errors(Interpolation::Bilinear, 9))
    {
        // Half the spacing divides a second-order error by four. Measured are 3.38 to 3.81, because of the fourth
        // derivatives. A first-order error would give 2, a third-order error 8.
        assert!(fine > 0.0 && (3.3..4.0).contains(&(coarse / fine)), "errors {coarse} (coarse) and {fine} (fine)");
    }
}

#[test]
fn a_bicubic_table_is_better_than_a_bilinear_table() {
    for (linear, cubic) in
        worst_errors(Interpolation::Bilinear, 8).into_iter().zip(worst_errors(Interpolation::Bicubic, 10))
    {
        assert!(cubic < 0.2 * linear, "errors {cubic} (bicubic) and {linear} (bilinear)");
    }
}

#[test]
fn a_table_that_fits_the_memory_has_an_error_below_a_thousandth() {
    // A table of 10 x 10 points fits even for a mechanism with six distinct entries.
    for error in worst_errors(Interpolation::Bicubic, 10) {
        assert!(error < 1.0e-3, "an error of {error}");
    }
}

#[test]
fn outside_its_grid_a_table_is_the_closed_form() {
    let AnyMechanism::FiveBar(m) = mechanism("haply-2diy") else { panic!() };
    let grid = Grid::new(Interpolation::Bilinear, [4, 4], [2.0, 0.6], [2.5, 1.0], 3).unwrap();
    let values = vec![f64::NAN; grid.values(3)];
    let table = MassModel::table::<FiveBar<f64>>(&grid, &values).unwrap();
    let n = SVector::from([0.6, 0.8]);
    for q in [[1.99, 0.8], [2.51, 0.8], [2.3, 0.59], [2.3, 1.01]] {
        let q = SVector::from(q);
        let pose = m.pose::<Libm>(&q);
        let (found, exact) = (table.shaping(&m, &q, &pose, &n).me, m.shaping(&pose, &n).me);
        assert!((found - exact).amax() < 1.0e-12 * exact.amax(), "{found}, but the closed form is {exact}");
    }
    // NaN and infinite angles must not cause a panic.
    let pose = m.pose::<Libm>(&SVector::from([2.3, 0.8]));
    for invalid in [f64::NAN, f64::INFINITY, -1.0e300] {
        table.shaping(&m, &SVector::from([invalid, 0.8]), &pose, &n);
    }
    // A table must have exactly as many values as its grid.
    assert!(MassModel::table::<FiveBar<f64>>(&grid, &values[1..]).is_none());
    assert!(MassModel::table::<FiveBar<f64>>(&grid, &vec![1.0; values.len() + 1]).is_none());
}

#[test]
fn the_edges_of_a_grid_belong_to_the_table() {
    let AnyMechanism::FiveBar(m) = mechanism("haply-2diy") else { panic!() };
    for interpolation in [Interpolation::Bilinear, Interpolation::Bicubic] {
        // The spacing and the corners are exact in binary.
        let grid = Grid::new(interpolation, [6, 6], [2.0, 0.5], [2.5, 1.0], 3).unwrap();
        let grid = Grid { spacing: [0.125; 2], low: grid.low.map(|x: f64| (x * 8.0).round() / 8.0), ..grid };
        let mut values = vec![0.0; grid.values(3)];
        tabulate::<f64, Libm, _, 2>(&m, &grid, |index, value| values[index] = value);
        // All values are 10 % too large, to show that the result comes from the table.
        let increased: Vec<f64> = values.iter().map(|value| value * 1.1).collect();
        let table = MassModel::table::<FiveBar<f64>>(&grid, &increased).unwrap();
        let margin = if interpolation == Interpolation::Bicubic { 1 } else { 0 };
        for corner in [[margin, margin], [5 - margin, 5 - margin], [margin, 5 - margin]] {
            let at = grid.at(corner[0], corner[1]);
            let pose = m.pose::<Libm>(&SVector::from(at));
            let n = SVector::from([0.6, 0.8]);
            let exact = m.shaping(&pose, &n).me;
            let found = table.shaping(&m, &SVector::from(at), &pose, &n).me;
            assert!((found - exact * 1.1).amax() < 1.0e-12 * exact.amax(), "{interpolation:?} {corner:?}");
        }
    }
}

#[test]
fn a_table_too_large_or_without_cells_is_refused() {
    let make = |points, entries| Grid::<f32>::new(Interpolation::Bilinear, points, [0.0; 2], [1.0; 2], entries);
    assert!(make([15, 15], 3).is_some());
    assert!(make([16, 15], 3).is_none(), "720 values are more than {TABLE_VALUES}");
    assert!(make([1, 15], 3).is_none());
    assert!(Grid::<f32>::new(Interpolation::Bicubic, [3, 15], [0.0; 2], [1.0; 2], 3).is_none());
    assert!(Grid::<f32>::new(Interpolation::Bilinear, [4, 4], [0.0; 2], [0.0, 1.0], 3).is_none());
    assert!(Grid::<f32>::new(Interpolation::Bilinear, [4, 4], [f32::NAN; 2], [1.0; 2], 3).is_none());
}

#[test]
fn a_frozen_matrix_must_be_a_mass_matrix() {
    let model = |triangle| MassModel::<f32, 2>::new::<FiveBar<f32>>(&MassModelData::Frozen(triangle), &[]);
    assert!(model([1.0, 0.1, 1.0, 0.0, 0.0, 0.0]).is_some());
    assert!(model([0.0, 0.1, 1.0, 0.0, 0.0, 0.0]).is_none());
    assert!(model([1.0, f32::NAN, 1.0, 0.0, 0.0, 0.0]).is_none());
}

#[test]
fn a_table_needs_all_chunks_in_order_and_unchanged() {
    let values: Vec<f32> = (0..150).map(|n| n as f32 * 0.1).collect();
    let crc = checksum(&values);
    let mut receiving = TableReceiver::default();
    for (index, chunk) in values.chunks(64).enumerate() {
        assert!(!receiving.is_complete(150, crc));
        assert!(receiving.take(64 * index, chunk));
    }
    assert!(receiving.is_complete(150, crc));
    assert_eq!(receiving.values(), values);
    assert!(!receiving.is_complete(149, crc));

    let mut gap = TableReceiver::default();
    assert!(gap.take(0, &values[..64]));
    assert!(!gap.take(128, &values[128..]));
    let mut changed = TableReceiver::default();
    assert!(changed.take(0, &values[..149]));
    assert!(changed.take(149, &[15.0]));
    assert!(!changed.is_complete(150, crc));
    assert!(!TableReceiver::default().take(0, &[f32::NAN]));
    assert!(!TableReceiver::default().take(0, &vec![0.0; TABLE_VALUES + 1]));
    // A new transfer discards the old values.
    assert!(receiving.take(0, &values[..64]));
    assert!(!receiving.is_complete(150, crc));
}

#[test]
fn a_table_is_accurate_in_the_boards_precision() {
    let Ok(AnyMechanism::FiveBar(m)) = AnyMechanism::<f32>::new(&shipped_device("haply-2diy")) else { panic!() };
    let AnyMechanism::FiveBar(exact) = mechanism("haply-2diy") else { panic!() };
    let grid = Grid::<f32>::new(Interpolation::Bicubic, [15, 15], [2.0, 0.5], [2.6, 1.1], 3).unwrap();
    let mut values = vec![0.0; grid.values(3)];
    tabulate::<f32, BoardMath, _, 2>(&m, &grid, |index, value| values[index] = value);
    let table = MassModel::table::<FiveBar<f32>>(&grid, &values).unwrap();
    for (a, b) in [(2.1, 0.6), (2.33, 0.87), (2.59, 1.09)] {
        let q = SVector::from([a as f32, b as f32]);
        let found = table.shaping(&m, &q, &m.pose::<BoardMath>(&q), &SVector::from([0.6, 0.8])).me;
        let q = SVector::from([a, b]);
        let right = exact.shaping(&exact.pose::<Libm>(&q), &SVector::from([0.6, 0.8])).me;
        let error = (found.map(f64::from) - right).amax() / right.amax();
        assert!(error < 1.0e-4, "an error of {error}");
    }
}
