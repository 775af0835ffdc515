//! All terms of equation (4) for a five-bar, for the analysis. The terms' common quantities of the pose are computed
//! once. The control step needs fewer terms and has its own kernels.

use super::FiveBar;
use super::pose::{Pose, rotated_left};
use crate::math::Real;
use nalgebra::{Matrix2, Vector2};

/// A five-bar in a pose. Its mass matrix is diag Aᵢ + Jᵀ(Γ J + C) + Cᵀ J.
#[derive(Clone, Copy, Debug)]
pub struct Levers<'a, T: Real> {
    linkage: &'a FiveBar<T>,
    pose: &'a Pose<T>,
    /// The columns of J, m.
    jacobian: [Vector2<T>; 2],
    /// The rows of J⁻¹, 1/m.
    inverse: [Vector2<T>; 2],
    /// The columns of C, βᵢ cᵢ, kg m.
    rods: [Vector2<T>; 2],
}

/// A unit motion of the tip.
#[derive(Clone, Copy, Debug)]
pub struct TipMotion<T: Real> {
    /// Direction of the motion.
    pub n: Vector2<T>,
    /// E, rad/m.
    pub e: Vector2<T>,
    /// Cᵀ n, kg m.
    rods: Vector2<T>,
    /// Part of M E that acts at the joints directly, Aᵢ eᵢ + Cᵀ n, kg m. The rest of M E acts through the tip.
    momentum: Vector2<T>,
}

impl<T: Real> TipMotion<T> {
    /// Returns the arms' part of the inertia between this motion and `other`, kg.
    #[inline(always)]
    pub fn arms(&self, other: &Self) -> T {
        self.e.dot(&other.momentum) + self.rods.dot(&other.e)
    }
}

impl<'a, T: Real> Levers<'a, T> {
    #[inline(always)]
    pub fn new(linkage: &'a FiveBar<T>, pose: &'a Pose<T>) -> Self {
        let ([u1, u2], [k1, k2]) = (&pose.rod, pose.k.map(|k| k * pose.inverse_det));
        Self {
            linkage,
            pose,
            jacobian: [Vector2::new(k1 * u2[1], -k1 * u2[0]), Vector2::new(-k2 * u1[1], k2 * u1[0])],
            inverse: [u1 * pose.inverse_k[0], u2 * pose.inverse_k[1]],
            rods: [
                rotated_left(&pose.arm[0]) * linkage.rod_coupling[0],
                rotated_left(&pose.arm[1]) * linkage.rod_coupling[1],
            ],
        }
    }

    /// Returns J q̇.
    #[inline(always)]
    pub fn velocity(&self, qd: &Vector2<T>) -> Vector2<T> {
        self.jacobian[0] * qd[0] + self.jacobian[1] * qd[1]
    }

    /// Returns Jᵀ f.
    #[inline(always)]
    pub fn transposed(&self, f: &Vector2<T>) -> Vector2<T> {
        Vector2::new(self.jacobian[0].dot(f), self.jacobian[1].dot(f))
    }

    /// Returns M.
    #[inline(always)]
    pub fn mass(&self) -> Matrix2<T> {
        let ([j1, j2], [c1, c2], [a1, a2]) = (&self.jacobian, &self.rods, self.linkage.arm_inertia);
        let (g1, g2) = (j1 * self.linkage.tip_mass + c1, j2 * self.linkage.tip_mass + c2);
        let off = j1.dot(&g2) + c1.dot(j2);
        Matrix2::new(a1 + j1.dot(&(g1 + c1)), off, off, a2 + j2.dot(&(g2 + c2)))
    }

    /// Computes a unit motion of the tip along `n`.
    #[inline(always)]
    pub fn unit_motion(&self, n: &Vector2<T>) -> TipMotion<T> {
        let along = |rows: &[Vector2<T>; 2]| Vector2::new(rows[0].dot(n), rows[1].dot(n));
        let (e, rods, [a1, a2]) = (along(&self.inverse), along(&self.rods), self.linkage.arm_inertia);
        TipMotion { n: *n, e, rods, momentum: Vector2::new(a1 * e[0] + rods[0], a2 * e[1] + rods[1]) }
    }

    /// Returns M E of a motion, kg m.
    #[inline(always)]
    pub fn momentum(&self, motion: &TipMotion<T>) -> Vector2<T> {
        let through_tip = motion.n * self.linkage.tip_mass + self.rods[0] * motion.e[0] + self.rods[1] * motion.e[1];
        motion.momentum + self.transposed(&through_tip)
    }

    /// Returns the torques of joint accelerations `qdd` at joint velocities `qd`, with the additional force `at_tip`
    /// (N) at the tip, and of the gravity `g` (m/s²) in the linkage's plane.
    #[inline(always)]
    pub fn bias(&self, qd: &Vector2<T>, qdd: &Vector2<T>, at_tip: Vector2<T>, g: &Vector2<T>) -> Vector2<T> {
        let FiveBar { arm_inertia, elbow_load, tip_load, .. } = self.linkage;
        // An elbow accelerates along its circle with the joint, and inwards with the square of the joint's velocity.
        let rod = |i: usize| self.rods[i] * qdd[i] + rotated_left(&self.rods[i]) * (qd[i] * qd[i]);
        let at_joint = |i: usize| arm_inertia[i] * qdd[i] - rotated_left(&self.pose.arm[i]).dot(g) * elbow_load[i];
        let through_tip = at_tip - g * *tip_load + rod(0) + rod(1);
        Vector2::new(at_joint(0), at_joint(1)) + self.transposed(&through_tip)
    }
}
