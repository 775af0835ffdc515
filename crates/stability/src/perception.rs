//! Inertia that a hand feels at the tip, in free motion and along a wall (docs/model.md section 2).
//!
//! A hand pushes the tip along a wall with F_t, and the wall prevents motion along n. Without the feed-forward Λ p̈ =
//! F_t + f n, so the hand feels the block of Λ along the wall: the paper's Waa. With the feed-forward of (4) the wall's
//! force does not accelerate the tip along the wall. The hand then feels the inertia of free motion, the inverse of the
//! block of Λ⁻¹: Waa - War Wrr⁻¹ Wra.

use nalgebra::{DMatrix, DVector};
use serde::Serialize;

/// Inertia that a hand feels at one pose.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Perception {
    /// Eigenvalues of Λ = (J M⁻¹ Jᵀ)⁻¹ in ascending order, kg (d). The null motion of a redundant arm is free.
    pub tip: Vec<f64>,
    /// Ratio of the largest to the smallest eigenvalue.
    pub ratio: f64,
    /// Inertia along one wall; `None` without a wall, or if the task has only one direction.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub along_wall: Option<AlongWall>,
}

/// Principal inertias along a wall in ascending order, kg (d - 1).
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct AlongWall {
    /// Inertia without the feed-forward.
    pub off: Vec<f64>,
    /// Inertia with the full feed-forward.
    pub full: Vec<f64>,
}

impl Perception {
    /// Computes the inertia from J (d x N), M (N x N) and a wall's normal; not finite at a singularity.
    pub fn new(jacobian: &[Vec<f64>], mass: &[Vec<f64>], normal: Option<&[f64]>) -> Self {
        let matrix = |rows: &[Vec<f64>]| DMatrix::from_fn(rows.len(), rows[0].len(), |i, j| rows[i][j]);
        let (jacobian, mass) = (matrix(jacobian), matrix(mass));
        let none = || DMatrix::from_element(jacobian.nrows(), jacobian.nrows(), f64::NAN);
        let mobility = mass.cholesky().map_or_else(none, |mass| &jacobian * mass.solve(&jacobian.transpose()));
        let inertia = mobility.clone().try_inverse().unwrap_or_else(none);
        let tip = eigenvalues(&inertia);
        let along_wall = normal.filter(|normal| normal.len() > 1).map(|normal| {
            // The smallest eigenvalue of both matrices is 0, along n.
            let along = |of: &DMatrix<f64>| {
                let n = DVector::from_column_slice(normal);
                let along = DMatrix::identity(n.len(), n.len()) - &n * n.transpose();
                eigenvalues(&(&along * of * &along)).split_off(1)
            };
            let full = along(&mobility).into_iter().rev().map(|mobility| 1.0 / mobility).collect();
            AlongWall { off: along(&inertia), full }
        });
        Self { ratio: tip[tip.len() - 1] / tip[0], tip, along_wall }
    }

    /// Returns true if all values are finite.
    pub fn is_finite(&self) -> bool {
        self.ratio.is_finite() && self.tip.iter().all(|inertia| inertia.is_finite())
    }
}

/// Returns the eigenvalues of a symmetric matrix in ascending order; NaN if an entry is not finite.
fn eigenvalues(matrix: &DMatrix<f64>) -> Vec<f64> {
    if matrix.iter().any(|entry| !entry.is_finite()) {
        return vec![f64::NAN; matrix.nrows()];
    }
    let mut values: Vec<f64> = matrix.symmetric_eigenvalues().iter().copied().collect();
    values.sort_by(f64::total_cmp);
    values
}
