//! The inertia that a hand feels at the tip: in the air, and along a wall that holds it (docs/model.md section 2).
//!
//! A hand that pushes the tip along a wall with F_t while the wall keeps it from moving along n has Λ p̈ = F_t + f n
//! without the feed-forward, so it feels the block of Λ along the wall: the paper's Waa. With (4) the wall's force
//! moves nothing along the wall, and it feels what it feels in the air, the inverse of the block of Λ⁻¹: Waa - War
//! Wrr⁻¹ Wra.

use nalgebra::{DMatrix, DVector};
use serde::Serialize;

/// See the module.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Perception {
    /// Eigenvalues of Λ = (J M⁻¹ Jᵀ)⁻¹, the smallest first, kg (d). On a redundant arm what does not move the tip is
    /// free.
    pub tip: Vec<f64>,
    /// The largest over the smallest.
    pub ratio: f64,
    /// Along one wall, where that leaves a direction.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub along_wall: Option<AlongWall>,
}

/// Principal inertias along a wall, the smallest first, kg (d - 1).
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct AlongWall {
    /// Without the feed-forward.
    pub off: Vec<f64>,
    /// With the full feed-forward.
    pub full: Vec<f64>,
}

impl Perception {
    /// From the tip's Jacobian (d x N), M (N x N) and the unit normal of a wall; not finite where these are not
    /// regular.
    pub fn new(jacobian: &[Vec<f64>], mass: &[Vec<f64>], normal: Option<&[f64]>) -> Self {
        let matrix = |rows: &[Vec<f64>]| DMatrix::from_fn(rows.len(), rows[0].len(), |i, j| rows[i][j]);
        let (jacobian, mass) = (matrix(jacobian), matrix(mass));
        let none = || DMatrix::from_element(jacobian.nrows(), jacobian.nrows(), f64::NAN);
        let mobility = mass.cholesky().map_or_else(none, |mass| &jacobian * mass.solve(&jacobian.transpose()));
        let inertia = mobility.clone().try_inverse().unwrap_or_else(none);
        let tip = eigenvalues(&inertia);
        let along_wall = normal.filter(|normal| normal.len() > 1).map(|normal| {
            // Across n both have an eigenvalue of zero, the smallest.
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

/// Of a symmetric matrix, the smallest first; no numbers where it has none.
fn eigenvalues(matrix: &DMatrix<f64>) -> Vec<f64> {
    if matrix.iter().any(|entry| !entry.is_finite()) {
        return vec![f64::NAN; matrix.nrows()];
    }
    let mut found: Vec<f64> = matrix.symmetric_eigenvalues().iter().copied().collect();
    found.sort_by(f64::total_cmp);
    found
}
