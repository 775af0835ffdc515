//! Eigenvalues of a small real matrix by double-shift QR iteration with exceptional shifts.
//!
//! nalgebra's Schur decomposition has no exceptional shifts after 10 and 20 iterations, so it fails to converge on one
//! in a few hundred of the graded, nearly defective matrices of a sampled loop. Algorithm: Wilkinson and Reinsch,
//! *Handbook for Automatic Computation II: Linear Algebra* (1971), contributions II/11, II/13 and II/14 (`balance`,
//! `elmhes`, `hqr`).

use nalgebra::{Complex, DMatrix, linalg::balancing};

const MAX_ITERATIONS: usize = 100;

/// Returns all eigenvalues of a square matrix; `None` if the iteration does not converge or the matrix is not finite.
pub(crate) fn eigenvalues(mut a: DMatrix<f64>) -> Option<Vec<Complex<f64>>> {
    if a.iter().any(|v| !v.is_finite()) {
        return None;
    }
    let _scaling = balancing::balance_parlett_reinsch(&mut a);
    hessenberg(&mut a);
    quotient_iteration(&mut a)
}

/// Reduces a matrix to upper Hessenberg form by elimination with pivoting (`elmhes`).
fn hessenberg(a: &mut DMatrix<f64>) {
    let n = a.nrows();
    for m in 1..n.saturating_sub(1) {
        let pivot = (m..n).max_by(|&i, &j| a[(i, m - 1)].abs().total_cmp(&a[(j, m - 1)].abs())).unwrap_or(m);
        let x = a[(pivot, m - 1)];
        if pivot != m {
            a.swap_rows(pivot, m);
            a.swap_columns(pivot, m);
        }
        if x == 0.0 {
            continue;
        }
        for i in m + 1..n {
            let factor = a[(i, m - 1)] / x;
            if factor == 0.0 {
                continue;
            }
            a[(i, m - 1)] = 0.0;
            for j in m..n {
                let taken = factor * a[(m, j)];
                a[(i, j)] -= taken;
            }
            for j in 0..n {
                let given = factor * a[(j, i)];
                a[(j, m)] += given;
            }
        }
    }
}

/// Runs the QR iteration on a Hessenberg matrix (`hqr`).
fn quotient_iteration(a: &mut DMatrix<f64>) -> Option<Vec<Complex<f64>>> {
    let n = a.nrows();
    let mut result = Vec::with_capacity(n);
    let norm: f64 = a.iter().map(|v| v.abs()).sum();
    let mut shifted = 0.0;
    let mut left = n;
    while left > 0 {
        let hi = left - 1;
        let mut iterations = 0;
        loop {
            // A subdiagonal entry that is negligible compared with its neighbours splits the matrix.
            let mut l = hi;
            while l > 0 {
                let neighbours = a[(l - 1, l - 1)].abs() + a[(l, l)].abs();
                let neighbours = if neighbours == 0.0 { norm } else { neighbours };
                if a[(l, l - 1)].abs() <= f64::EPSILON * neighbours {
                    a[(l, l - 1)] = 0.0;
                    break;
                }
                l -= 1;
            }
            let x = a[(hi, hi)];
            if l == hi {
                result.push(Complex::new(x + shifted, 0.0));
                left -= 1;
                break;
            }
            let y = a[(hi - 1, hi - 1)];
            let w = a[(hi, hi - 1)] * a[(hi - 1, hi)];
            if l + 1 == hi {
                result.extend(block_eigenvalues(x, y, w, shifted));
                left -= 2;
                break;
            }
            if iterations == MAX_ITERATIONS {
                return None;
            }
            let (mut x, mut y, mut w) = (x, y, w);
            if iterations > 0 && iterations % 10 == 0 {
                // Applies the exceptional shift.
                shifted += x;
                for i in 0..=hi {
                    a[(i, i)] -= x;
                }
                let s = a[(hi, hi - 1)].abs() + a[(hi - 1, hi - 2)].abs();
                (x, y, w) = (0.75 * s, 0.75 * s, -0.4375 * s * s);
            }
            iterations += 1;
            sweep(a, l, hi, x, y, w);
        }
    }
    Some(result)
}

/// Returns the eigenvalues of the trailing 2 x 2 block.
fn block_eigenvalues(x: f64, y: f64, w: f64, shifted: f64) -> [Complex<f64>; 2] {
    let p = 0.5 * (y - x);
    let q = p * p + w;
    let root = q.abs().sqrt();
    let x = x + shifted;
    if q >= 0.0 {
        let z = p + if p >= 0.0 { root } else { -root };
        let other = if z == 0.0 { x + z } else { x - w / z };
        [Complex::new(x + z, 0.0), Complex::new(other, 0.0)]
    } else {
        [Complex::new(x + p, root), Complex::new(x + p, -root)]
    }
}

/// Performs a double-shift sweep over rows and columns `l` to `hi`.
fn sweep(a: &mut DMatrix<f64>, l: usize, hi: usize, x: f64, y: f64, w: f64) {
    let start = |m: usize, a: &DMatrix<f64>| -> (f64, f64, f64) {
        let z = a[(m, m)];
        let (r, s) = (x - z, y - z);
        let p = (r * s - w) / a[(m + 1, m)] + a[(m, m + 1)];
        let q = a[(m + 1, m + 1)] - z - r - s;
        let r = a[(m + 2, m + 1)];
        let scale = p.abs() + q.abs() + r.abs();
        (p / scale, q / scale, r / scale)
    };
    // Two consecutive small subdiagonal entries allow the sweep to start further down.
    let mut m = hi - 2;
    let (mut p, mut q, mut r) = start(m, a);
    while m > l {
        let u = a[(m, m - 1)].abs() * (q.abs() + r.abs());
        let v = p.abs() * (a[(m - 1, m - 1)].abs() + a[(m, m)].abs() + a[(m + 1, m + 1)].abs());
        if u <= f64::EPSILON * v {
            break;
        }
        m -= 1;
        (p, q, r) = start(m, a);
    }
    for i in m + 2..=hi {
        a[(i, i - 2)] = 0.0;
        if i != m + 2 {
            a[(i, i - 3)] = 0.0;
        }
    }
    for k in m..hi {
        let mut scale = 1.0;
        if k != m {
            p = a[(k, k - 1)];
            q = a[(k + 1, k - 1)];
            r = if k + 1 != hi { a[(k + 2, k - 1)] } else { 0.0 };
            scale = p.abs() + q.abs() + r.abs();
            if scale == 0.0 {
                continue;
            }
            (p, q, r) = (p / scale, q / scale, r / scale);
        }
        let root = (p * p + q * q + r * r).sqrt();
        let s = if p >= 0.0 { root } else { -root };
        if s == 0.0 {
            continue;
        }
        if k == m {
            if l != m {
                a[(k, k - 1)] = -a[(k, k - 1)];
            }
        } else {
            a[(k, k - 1)] = -s * scale;
        }
        p += s;
        let (x, y, z) = (p / s, q / s, r / s);
        q /= p;
        r /= p;
        let third = k + 1 != hi;
        for j in k..=hi {
            let mut sum = a[(k, j)] + q * a[(k + 1, j)];
            if third {
                sum += r * a[(k + 2, j)];
                a[(k + 2, j)] -= sum * z;
            }
            a[(k + 1, j)] -= sum * y;
            a[(k, j)] -= sum * x;
        }
        for i in l..=hi.min(k + 3) {
            let mut sum = x * a[(i, k)] + y * a[(i, k + 1)];
            if third {
                sum += z * a[(i, k + 2)];
                a[(i, k + 2)] -= sum * r;
            }
            a[(i, k + 1)] -= sum * q;
            a[(i, k)] -= sum;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use haptic_sim::Random;

    fn sorted(mut values: Vec<Complex<f64>>) -> Vec<Complex<f64>> {
        values.sort_by(|a, b| (a.re, a.im).partial_cmp(&(b.re, b.im)).unwrap());
        values
    }

    #[test]
    fn eigenvalues_of_a_companion_matrix_are_its_roots() {
        // (x - 1)(x - 2)(x - 3)(x² - 2x + 5)
        let expanded = [-8.0, 28.0, -58.0, 67.0, -30.0];
        let mut companion = DMatrix::zeros(5, 5);
        for (j, c) in expanded.iter().enumerate() {
            companion[(0, j)] = -c;
        }
        for i in 1..5 {
            companion[(i, i - 1)] = 1.0;
        }
        let result = eigenvalues(companion).unwrap();
        assert_eq!(result.len(), 5);
        for (re, im) in [(1.0, -2.0), (1.0, 0.0), (1.0, 2.0), (2.0, 0.0), (3.0, 0.0)] {
            assert!(result.iter().any(|got| (got - Complex::new(re, im)).norm() < 1e-9), "{result:?}");
        }
    }

    #[test]
    fn exceptional_shifts_solve_a_permutation() {
        let cycle = DMatrix::from_row_slice(4, 4, &[0., 0., 0., 1., 1., 0., 0., 0., 0., 1., 0., 0., 0., 0., 1., 0.]);
        let result = eigenvalues(cycle).unwrap();
        assert!(result.iter().all(|v| (v.norm() - 1.0).abs() < 1e-12));
        assert!(result.iter().all(|v| (v.powi(4) - 1.0).norm() < 1e-11));
    }

    #[test]
    fn similar_matrices_keep_their_eigenvalues() {
        let mut random = Random::new(3);
        for _ in 0..500 {
            let n = 2 + random.between(0.0, 12.0) as usize;
            let size = |r: &mut Random| 10f64.powf(r.between(-6.0, 1.0));
            let known: Vec<f64> = (0..n).map(|_| -size(&mut random)).collect();
            let basis = DMatrix::from_fn(n, n, |_, _| random.between(-1.0, 1.0)).qr().q();
            let matrix = &basis * DMatrix::from_diagonal(&known.clone().into()) * basis.transpose();
            let result = sorted(eigenvalues(matrix).unwrap());
            let known = sorted(known.into_iter().map(|v| Complex::new(v, 0.0)).collect());
            for (got, known) in result.iter().zip(&known) {
                assert!((got - known).norm() < 1e-13 * 10.0 * n as f64, "{got} {known}");
            }
        }
    }
}
