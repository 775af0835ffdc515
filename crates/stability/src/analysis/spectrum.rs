//! Small dense linear algebra for delta-form systems: exp(X) - I, growth of modes, and solution of (γ I - F) s = b.
//!
//! All functions use F = A - I, because at 50 kHz modes are 1e-5 from z = 1, which decides stability.

use super::eigenvalues::eigenvalues;
use nalgebra::{Complex, DMatrix, DVector};

/// Computes exp(X) - I without cancellation, by a Taylor series of X/2ˢ and s doublings E ← 2E + E².
pub(crate) fn exp_minus_identity(x: &DMatrix<f64>) -> DMatrix<f64> {
    let norm = x.column_iter().map(|c| c.iter().map(|v| v.abs()).sum::<f64>()).fold(0.0, f64::max);
    let halvings = if norm > 0.25 { (norm / 0.25).log2().ceil() as i32 } else { 0 };
    let scaled = x / 2f64.powi(halvings);
    let n = x.nrows();
    // Horner form of y (I + y/2 (I + y/3 (...))).
    let mut tail = DMatrix::identity(n, n);
    for k in (2..=14).rev() {
        tail = DMatrix::identity(n, n) + &scaled * tail / f64::from(k);
    }
    let mut e = &scaled * tail;
    for _ in 0..halvings {
        e = &e * 2.0 + &e * &e;
    }
    e
}

/// Returns the largest |z|² - 1 of the modes z = 1 + γ of F; infinite without eigenvalues.
pub(crate) fn growth(f: DMatrix<f64>) -> f64 {
    match eigenvalues(f) {
        Some(values) => values.iter().map(|g| 2.0 * g.re + g.norm_sqr()).fold(f64::NEG_INFINITY, f64::max),
        None => f64::INFINITY,
    }
}

/// Solves (γ I - F) s = b by Gaussian elimination with partial pivoting, and reuses its storage.
pub(crate) struct Resolvent {
    f: DMatrix<f64>,
    work: Vec<Complex<f64>>,
    solution: Vec<Complex<f64>>,
}

impl Resolvent {
    /// Prepares repeated solutions for one F.
    pub fn new(f: DMatrix<f64>) -> Self {
        let n = f.nrows();
        let zero = Complex::new(0.0, 0.0);
        Self { f, work: vec![zero; n * n], solution: vec![zero; n] }
    }

    /// Returns the state response to `b` at γ.
    pub fn solve(&mut self, gamma: Complex<f64>, b: &DVector<f64>) -> &[Complex<f64>] {
        let n = self.f.nrows();
        let (a, s) = (&mut self.work, &mut self.solution);
        for row in 0..n {
            for column in 0..n {
                a[row * n + column] = Complex::new(-self.f[(row, column)], 0.0);
            }
            a[row * n + row] += gamma;
            s[row] = Complex::new(b[row], 0.0);
        }
        for k in 0..n {
            let pivot =
                (k..n).max_by(|&i, &j| a[i * n + k].norm_sqr().total_cmp(&a[j * n + k].norm_sqr())).unwrap_or(k);
            if pivot != k {
                for column in k..n {
                    a.swap(k * n + column, pivot * n + column);
                }
                s.swap(k, pivot);
            }
            let inverse = a[k * n + k].inv();
            for row in k + 1..n {
                let factor = a[row * n + k] * inverse;
                if factor.norm_sqr() == 0.0 {
                    continue;
                }
                for column in k + 1..n {
                    let taken = factor * a[k * n + column];
                    a[row * n + column] -= taken;
                }
                let taken = factor * s[k];
                s[row] -= taken;
            }
        }
        for k in (0..n).rev() {
            let mut sum = s[k];
            for column in k + 1..n {
                sum -= a[k * n + column] * s[column];
            }
            s[k] = sum * a[k * n + k].inv();
        }
        s
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_slow_decay_keeps_all_digits() {
        let e = exp_minus_identity(&DMatrix::from_element(1, 1, -1e-12));
        assert!((e[(0, 0)] / (-1e-12f64).exp_m1() - 1.0).abs() < 1e-15);
    }

    #[test]
    fn a_fast_decay_ends_at_minus_one() {
        let e = exp_minus_identity(&DMatrix::from_element(1, 1, -1e5));
        assert!((e[(0, 0)] + 1.0).abs() < 1e-12);
    }

    #[test]
    fn a_rotation_neither_grows_nor_decays() {
        let e = exp_minus_identity(&DMatrix::from_row_slice(2, 2, &[0.0, 3.0, -3.0, 0.0]));
        assert!((e[(0, 0)] - (3f64.cos() - 1.0)).abs() < 1e-13);
        assert!(growth(e).abs() < 1e-13);
    }

    #[test]
    fn the_resolvent_solves_a_companion_form() {
        let f = DMatrix::from_row_slice(2, 2, &[0.0, 1.0, -2.0, -0.5]);
        let gamma = Complex::new(0.1, 0.7);
        let s = Resolvent::new(f).solve(gamma, &DVector::from_vec(vec![0.0, 1.0])).to_vec();
        // s₀ = 1 / (γ² + 0.5 γ + 2) for the companion form.
        let expected = (gamma * gamma + gamma * 0.5 + 2.0).inv();
        assert!((s[0] - expected).norm() < 1e-14);
    }
}
