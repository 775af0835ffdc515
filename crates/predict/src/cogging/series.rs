//! Least squares of a Fourier series on a slowly varying load.

use nalgebra::{DMatrix, DVector};

/// Degree of the polynomial that takes the load.
const DEGREE: usize = 3;
/// Number of parts into which the arc is divided, and of fits that each leave out every such part.
const SEGMENTS: usize = 25;
const FOLDS: usize = 5;
/// Regularisation as a share of the squares of a basis function.
const RIDGE: f64 = 1e-6;

/// A series fitted to torques.
pub struct Fitted {
    /// Cosine and sine amplitude of each order, N m.
    pub waves: Vec<(f64, f64)>,
    /// Fitted torques, N m.
    pub values: Vec<f64>,
    /// Torques less fitted torques, N m.
    pub residuals: Vec<f64>,
    /// Root mean square of the errors at the torques that a fit did not use, N m.
    pub held_out: f64,
}

/// Fits a load and a series with these orders per turn of the shaft, which makes `ratio` turns per turn of the joint.
pub fn fitted(angles: &[f64], torques: &[f64], orders: &[f64], ratio: f64) -> Fitted {
    let (low, high) = (angles[0], angles[angles.len() - 1]);
    let columns = DEGREE + 1 + 2 * orders.len();
    let basis = DMatrix::from_fn(angles.len(), columns, |row, column| {
        let q = angles[row];
        match column.checked_sub(DEGREE + 1) {
            None => (2.0 * (q - low) / (high - low) - 1.0).powi(column as i32),
            Some(wave) if wave % 2 == 0 => (orders[wave / 2] * ratio * q).cos(),
            Some(wave) => (orders[wave / 2] * ratio * q).sin(),
        }
    });
    let torques = DVector::from_column_slice(torques);
    let values = |weights: &DVector<f64>| &basis * weights;
    let all = solved(&basis, &torques, |_| true);
    let fold = |row: usize| row * SEGMENTS / angles.len() % FOLDS;
    let mut errors = Vec::with_capacity(angles.len());
    for left_out in 0..FOLDS {
        let predicted = values(&solved(&basis, &torques, |row| fold(row) != left_out));
        errors.extend((0..angles.len()).filter(|row| fold(*row) == left_out).map(|row| torques[row] - predicted[row]));
    }
    let fitted = values(&all);
    Fitted {
        waves: (0..orders.len()).map(|i| (all[DEGREE + 1 + 2 * i], all[DEGREE + 2 + 2 * i])).collect(),
        residuals: (&torques - &fitted).iter().copied().collect(),
        values: fitted.iter().copied().collect(),
        held_out: rms(&errors),
    }
}

/// Returns the weights of the basis functions that fit the torques in the rows that `uses` selects.
fn solved(basis: &DMatrix<f64>, torques: &DVector<f64>, uses: impl Fn(usize) -> bool) -> DVector<f64> {
    let columns = basis.ncols();
    let (mut squares, mut products) = (DMatrix::zeros(columns, columns), DVector::zeros(columns));
    for (row, functions) in basis.row_iter().enumerate().filter(|(row, _)| uses(*row)) {
        for i in 0..columns {
            products[i] += functions[i] * torques[row];
            for j in 0..=i {
                squares[(i, j)] += functions[i] * functions[j];
            }
        }
    }
    for i in 0..columns {
        squares[(i, i)] *= 1.0 + RIDGE;
    }
    squares.fill_upper_triangle_with_lower_triangle();
    squares.cholesky().map_or(DVector::zeros(columns), |factor| factor.solve(&products))
}

/// Returns the sum of squares that a wave with this many periods per 2π explains of the residuals.
pub fn score(angles: &[f64], residuals: &[f64], order: f64) -> f64 {
    let [mut cc, mut cs, mut ss, mut c, mut s] = [0.0; 5];
    for (q, residual) in angles.iter().zip(residuals) {
        let (sine, cosine) = (order * q).sin_cos();
        cc += cosine * cosine;
        cs += cosine * sine;
        ss += sine * sine;
        c += cosine * residual;
        s += sine * residual;
    }
    (ss * c * c - 2.0 * cs * c * s + cc * s * s) / (cc * ss - cs * cs)
}

/// Returns the root mean square.
pub fn rms(values: &[f64]) -> f64 {
    (values.iter().map(|value| value * value).sum::<f64>() / values.len().max(1) as f64).sqrt()
}
