//! Least squares of a Fourier series on a slowly varying load.

use nalgebra::{DMatrix, DVector};

/// Degree of the polynomial that takes the load.
const DEGREE: usize = 3;
/// Number of parts into which the arc is divided, and of fits that each leave out every such part.
const SEGMENTS: usize = 25;
const FOLDS: usize = 5;
/// Regularisation as a share of the squares of a basis function.
const RIDGE: f64 = 1e-6;

/// Torques over angles, as a load and a series of the shaft's angle.
pub struct Series<'a> {
    /// Angles in rising order, rad.
    pub angles: &'a [f64],
    /// Torques, N m.
    pub torques: DVector<f64>,
    /// Turns of the shaft per turn of the joint.
    pub ratio: f64,
}

/// A fitted series.
pub struct Fitted {
    /// Cosine and sine amplitude of each order, N m.
    pub waves: Vec<(f64, f64)>,
    /// Torques less fitted torques, N m.
    pub residuals: Vec<f64>,
}

impl Series<'_> {
    /// Fits the load and waves of these orders, periods per turn of the shaft.
    pub fn fit(&self, orders: &[f64]) -> Fitted {
        let basis = self.basis(orders);
        let weights = solved(&basis, &self.torques, |_| true);
        Fitted {
            waves: (0..orders.len()).map(|i| (weights[DEGREE + 1 + 2 * i], weights[DEGREE + 2 + 2 * i])).collect(),
            residuals: (&self.torques - basis * weights).iter().copied().collect(),
        }
    }

    /// Returns the root mean square of the errors at the torques that a fit did not use, N m.
    pub fn held_out(&self, orders: &[f64]) -> f64 {
        let basis = self.basis(orders);
        let fold = |row: usize| row * SEGMENTS / self.angles.len() % FOLDS;
        let error = |left_out: usize| {
            let predicted = &basis * solved(&basis, &self.torques, |row| fold(row) != left_out);
            let rows = (0..self.angles.len()).filter(move |row| fold(*row) == left_out);
            rows.map(|row| self.torques[row] - predicted[row]).collect::<Vec<_>>()
        };
        rms(&(0..FOLDS).flat_map(error).collect::<Vec<_>>())
    }

    fn basis(&self, orders: &[f64]) -> DMatrix<f64> {
        let (low, high) = (self.angles[0], self.angles[self.angles.len() - 1]);
        DMatrix::from_fn(self.angles.len(), DEGREE + 1 + 2 * orders.len(), |row, column| {
            let q = self.angles[row];
            match column.checked_sub(DEGREE + 1) {
                None => (2.0 * (q - low) / (high - low) - 1.0).powi(column as i32),
                Some(wave) if wave % 2 == 0 => (orders[wave / 2] * self.ratio * q).cos(),
                Some(wave) => (orders[wave / 2] * self.ratio * q).sin(),
            }
        })
    }

    /// Returns the sum of squares that a wave of this order explains of the residuals.
    pub fn score(&self, residuals: &[f64], order: f64) -> f64 {
        let [mut cc, mut cs, mut ss, mut c, mut s] = [0.0; 5];
        for (q, residual) in self.angles.iter().zip(residuals) {
            let (sine, cosine) = (order * self.ratio * q).sin_cos();
            cc += cosine * cosine;
            cs += cosine * sine;
            ss += sine * sine;
            c += cosine * residual;
            s += sine * residual;
        }
        (ss * c * c - 2.0 * cs * c * s + cc * s * s) / (cc * ss - cs * cs)
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

/// Returns the root mean square.
pub fn rms(values: &[f64]) -> f64 {
    (values.iter().map(|value| value * value).sum::<f64>() / values.len().max(1) as f64).sqrt()
}
