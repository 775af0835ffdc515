//! `five-bar`: two motors, two arms, one tip (Pantograph, Haply 2diy).
//!
//! Motors at A = (-base/2, 0) and B = (base/2, 0); elbows C = A + l₁(cos q₁, sin q₁), D = B + l₂(cos q₂, sin q₂). The
//! tip P is an intersection of the circles (C, r₁) and (D, r₂), to the left of C→D for `assembly` 1, else to the right.
//!
//! Closed form: let u₁ = P - C, u₂ = P - D, and let c₁ = l₁(-sin q₁, cos q₁) be the elbow velocity per joint rate, c₂
//! likewise. The rods are rigid, so uᵢ·(ṗ - cᵢ q̇ᵢ) = 0. Hence J⁻¹ = [u₁ᵀ/k₁; u₂ᵀ/k₂] with kᵢ = uᵢ·cᵢ, and J = [u₁ᵀ;
//! u₂ᵀ]⁻¹ diag(k₁, k₂).
//!
//! A rigid rod between elbow and tip has the kinetic energy ½(α|Ċ|² + 2β Ċ·ṗ + γ|ṗ|²) with three *constants* (centre of
//! mass at the fraction s of the rod: α = m(1-s)² + I/r², β = m s(1-s) - I/r², γ = m s² + I/r²). No distal angle is
//! therefore computed, and inertial forces need only the accelerations of elbow and tip.

mod levers;
mod pose;

pub(super) use levers::Levers;
pub use pose::Pose;
pub(super) use pose::UnitMotion;
use pose::rotated_left;

use super::{
    Mechanism, Regularity, SINE_FLOOR, ShapedTorque, Shaping, WallTerms, effective_inertia, reciprocal,
    symmetric_matrix,
};
use crate::math::{Angle, Math, Real, cast};
use crate::model::catalogue::{Kind, Spec};
use crate::model::description::{Description, DescriptionError};
use nalgebra::{Matrix2, Vector2};

/// Minimal coefficients of a planar five-bar.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize, postcard_schema::Schema)]
pub struct FiveBar<T> {
    /// B - A along x, m.
    base: T,
    /// Proximal lengths l₁, l₂, m.
    proximal: [T; 2],
    /// r₁ + r₂ and |r₁ - r₂| squared, m².
    reach: [T; 2],
    /// r₁² - r₂², m².
    distal_difference: T,
    /// 1/(lᵢ rᵢ), 1/m²: converts kᵢ to the sine of the elbow angle.
    elbow_scale: [T; 2],
    /// Assembly mode, ±1.
    assembly: T,
    /// Smallest |kᵢ| used as a divisor, m².
    elbow_floor: T,
    /// 1/(r₁ r₂), 1/m²: converts u₁ x u₂ to the sine of the angle between the rods.
    rods_scale: T,
    /// Smallest |u₁ x u₂| used as a divisor, m².
    rods_floor: T,
    /// Inertia of rotor, proximal link and the rod's α lᵢ² about each motor, kg m².
    pub(super) arm_inertia: [T; 2],
    /// The rods' β, kg.
    pub(super) rod_coupling: [T; 2],
    /// γ₁ + γ₂ + handle, kg.
    pub(super) tip_mass: T,
    /// Effective mass at each elbow for gravity, m_p c_p/l + m_d(1 - s), kg.
    pub(super) elbow_load: [T; 2],
    /// Effective mass at the tip for gravity, m_d1 s_1 + m_d2 s_2 + handle, kg.
    pub(super) tip_load: T,
    /// Gravity in the plane (at q₀ = 0 on a turret), m/s².
    pub(super) gravity: [T; 2],
}

impl<T: Real> FiveBar<T> {
    /// Converts to another precision.
    pub fn cast<U: Real>(&self) -> FiveBar<U> {
        FiveBar {
            base: cast(self.base),
            proximal: self.proximal.map(cast),
            reach: self.reach.map(cast),
            distal_difference: cast(self.distal_difference),
            elbow_scale: self.elbow_scale.map(cast),
            assembly: cast(self.assembly),
            elbow_floor: cast(self.elbow_floor),
            rods_scale: cast(self.rods_scale),
            rods_floor: cast(self.rods_floor),
            arm_inertia: self.arm_inertia.map(cast),
            rod_coupling: self.rod_coupling.map(cast),
            tip_mass: cast(self.tip_mass),
            elbow_load: self.elbow_load.map(cast),
            tip_load: cast(self.tip_load),
            gravity: self.gravity.map(cast),
        }
    }

    /// Computes the coefficients of a description with the links of a five-bar, whose arms joints 0 and 1 drive.
    pub(super) fn lump(description: &Description) -> Result<Self, DescriptionError> {
        let [base, l1, l2, r1, r2, assembly, ..] = description.geometry;
        for (index, length) in [l1, l2, r1, r2].into_iter().enumerate() {
            if length.is_nan() || length <= 0.0 {
                return Err(DescriptionError::GeometryNotPositive(index + 1));
            }
        }
        if base.is_nan() || base < 0.0 {
            return Err(DescriptionError::GeometryNotPositive(0));
        }
        if assembly != 1.0 && assembly != -1.0 {
            return Err(DescriptionError::Assembly);
        }
        // The linkage closes if the range of the elbows' distance overlaps the range that the rods can bridge.
        let farthest = base + l1 + l2;
        let nearest = (base - l1 - l2).max(0.0).max(l1 - base - l2).max(l2 - base - l1);
        if nearest >= r1 + r2 || farthest <= (r1 - r2).abs() {
            return Err(DescriptionError::CannotClose);
        }
        let [p1, p2, d1, d2] = description.links;
        let arm = |index: usize,
                   proximal: &crate::model::description::Link,
                   distal: &crate::model::description::Link,
                   l: f64,
                   r: f64| {
            let s = distal.com / r;
            let spin = distal.inertia / (r * r);
            let alpha = distal.mass * (1.0 - s) * (1.0 - s) + spin;
            let beta = distal.mass * s * (1.0 - s) - spin;
            let gamma = distal.mass * s * s + spin;
            let about_motor = description.joints[index].inertia
                + proximal.inertia
                + proximal.mass * proximal.com * proximal.com
                + alpha * l * l;
            let elbow_load = proximal.mass * proximal.com / l + distal.mass * (1.0 - s);
            (about_motor, beta, gamma, elbow_load, distal.mass * s)
        };
        let (a1, b1, g1, load1, end1) = arm(0, &p1, &d1, l1, r1);
        let (a2, b2, g2, load2, end2) = arm(1, &p2, &d2, l2, r2);
        let tip_mass = g1 + g2 + description.handle_mass;
        if a1 <= 0.0 || a2 <= 0.0 {
            return Err(DescriptionError::NoInertia);
        }
        let gravity = [description.gravity[0], description.gravity[1]];
        let reals = |values: [f64; 2]| values.map(T::from_f64);
        Ok(Self {
            base: T::from_f64(base),
            proximal: reals([l1, l2]),
            reach: reals([(r1 + r2) * (r1 + r2), (r1 - r2) * (r1 - r2)]),
            distal_difference: T::from_f64((r1 - r2) * (r1 + r2)),
            elbow_scale: reals([1.0 / (l1 * r1), 1.0 / (l2 * r2)]),
            assembly: T::from_f64(assembly),
            elbow_floor: T::from_f64(SINE_FLOOR * (l1 * r1).min(l2 * r2)),
            rods_scale: T::from_f64(1.0 / (r1 * r2)),
            rods_floor: T::from_f64(SINE_FLOOR * r1 * r2),
            arm_inertia: reals([a1, a2]),
            rod_coupling: reals([b1, b2]),
            tip_mass: T::from_f64(tip_mass),
            elbow_load: reals([load1, load2]),
            tip_load: T::from_f64(end1 + end2 + description.handle_mass),
            gravity: reals(gravity),
        })
    }

    /// Computes the pose at these angles. `inverse` inverts its first argument and may first clamp its magnitude to at
    /// least the second argument. `positive` may clamp the argument of a root to zero.
    #[inline(always)]
    fn close<K: Math<T>>(&self, q: &[Angle<T>; 2], inverse: impl Fn(T, T) -> T, positive: impl Fn(T) -> T) -> Pose<T> {
        let half = T::from_f64(0.5);
        let (s1, c1) = K::sin_cos_of(q[0]);
        let (s2, c2) = K::sin_cos_of(q[1]);
        let arm1 = Vector2::new(self.proximal[0] * c1, self.proximal[0] * s1);
        let arm2 = Vector2::new(self.proximal[1] * c2, self.proximal[1] * s2);
        // C→D and its squared length.
        let span = Vector2::new(self.base + arm2[0] - arm1[0], arm2[1] - arm1[1]);
        let span_squared = span.dot(&span);
        let inverse_span = inverse(span_squared, T::EPSILON * T::EPSILON);
        // u₁ x u₂ = r₁ r₂ sin(angle between the rods), by Heron's formula for the height over C→D, which subtracts
        // lengths instead of nearly equal products.
        let det =
            half * self.assembly * K::sqrt(positive((self.reach[0] - span_squared) * (span_squared - self.reach[1])));
        let along = half + half * self.distal_difference * inverse_span;
        let rod1 = span * along + rotated_left(&span) * (det * inverse_span);
        let rod2 = rod1 - span;
        let k1 = rod1.dot(&rotated_left(&arm1));
        let k2 = rod2.dot(&rotated_left(&arm2));
        Pose {
            tip: Vector2::new(arm1[0] + rod1[0] - half * self.base, arm1[1] + rod1[1]),
            arm: [arm1, arm2],
            rod: [rod1, rod2],
            k: [k1, k2],
            inverse_k: [inverse(k1, self.elbow_floor), inverse(k2, self.elbow_floor)],
            inverse_det: inverse(det, self.rods_floor),
            parallel: (det * self.rods_scale).abs(),
        }
    }

    /// Returns Jᵀ w.
    #[inline(always)]
    pub(super) fn transposed(pose: &Pose<T>, w: &Vector2<T>) -> Vector2<T> {
        let [u1, u2] = &pose.rod;
        Vector2::new(
            pose.k[0] * pose.inverse_det * (u2[1] * w[0] - u2[0] * w[1]),
            pose.k[1] * pose.inverse_det * (u1[0] * w[1] - u1[1] * w[0]),
        )
    }

    /// Returns the joint accelerations for a tip acceleration `a` (m/s², 0 if `None`) at velocities `qd` and `tip`.
    #[inline(always)]
    pub(super) fn joint_acceleration(
        pose: &Pose<T>,
        qd: &Vector2<T>,
        tip: &Vector2<T>,
        a: Option<&Vector2<T>>,
    ) -> Vector2<T> {
        Vector2::new(Self::arm_acceleration(pose, qd, tip, a, 0), Self::arm_acceleration(pose, qd, tip, a, 1))
    }

    /// Returns the joint acceleration of one arm by the rigidity of its rod: uᵢ·(a - p̈_elbow) + |u̇ᵢ|² = 0.
    #[inline(always)]
    fn arm_acceleration(pose: &Pose<T>, qd: &Vector2<T>, tip: &Vector2<T>, a: Option<&Vector2<T>>, i: usize) -> T {
        let rod_rate = tip - rotated_left(&pose.arm[i]) * qd[i];
        let outward = pose.arm[i] * (qd[i] * qd[i]);
        let along = match a {
            Some(a) => a + outward,
            None => outward,
        };
        (pose.rod[i].dot(&along) + rod_rate.dot(&rod_rate)) * pose.inverse_k[i]
    }

    /// Returns the loads of a tip acceleration `a` (if any) and joint accelerations `qdd` at joint velocities `qd`: the
    /// force at the tip (N), to be multiplied by Jᵀ, and the torques at the joints (N m).
    #[inline(always)]
    pub(super) fn inertial_loads(
        &self,
        pose: &Pose<T>,
        qd: &Vector2<T>,
        qdd: &Vector2<T>,
        a: Option<&Vector2<T>>,
    ) -> (Vector2<T>, Vector2<T>) {
        let [c1, c2] = pose.arm.map(|arm| rotated_left(&arm));
        let of_tip = a.map_or(Vector2::zeros(), |a| a * self.tip_mass);
        let at_tip = self.with_rod_forces(pose, of_tip, Some(qd), qdd);
        let at_joints = Vector2::new(self.arm_inertia[0] * qdd[0], self.arm_inertia[1] * qdd[1]);
        let Some(a) = a else { return (at_tip, at_joints) };
        let with_tip = Vector2::new(self.rod_coupling[0] * c1.dot(a), self.rod_coupling[1] * c2.dot(a));
        (at_tip, at_joints + with_tip)
    }

    /// Computes a unit motion of the tip along `n`.
    #[inline(always)]
    pub(super) fn unit_motion(&self, pose: &Pose<T>, n: &Vector2<T>) -> UnitMotion<T> {
        let e = self.inverse(pose, n);
        let with_tip = |i: usize| self.rod_coupling[i] * rotated_left(&pose.arm[i]).dot(n);
        let (with1, with2) = (with_tip(0), with_tip(1));
        let momentum = Vector2::new(self.arm_inertia[0] * e[0] + with1, self.arm_inertia[1] * e[1] + with2);
        UnitMotion { e, momentum, arms: e[0] * (momentum[0] + with1) + e[1] * (momentum[1] + with2) }
    }

    /// Adds to `force` (N) the rods' force on the tip for joint accelerations `qdd`, at velocities `qd` or at rest.
    #[inline(always)]
    pub(super) fn with_rod_forces(
        &self,
        pose: &Pose<T>,
        mut force: Vector2<T>,
        qd: Option<&Vector2<T>>,
        qdd: &Vector2<T>,
    ) -> Vector2<T> {
        for i in 0..2 {
            force += rotated_left(&pose.arm[i]) * (self.rod_coupling[i] * qdd[i]);
            if let Some(qd) = qd {
                force -= pose.arm[i] * (self.rod_coupling[i] * (qd[i] * qd[i]));
            }
        }
        force
    }

    /// Returns the joint torques of accelerations `a` of the tip (if any) and `qdd` of the joints, at velocities `qd`.
    #[inline(always)]
    fn inertial_torque(&self, pose: &Pose<T>, qd: &Vector2<T>, qdd: &Vector2<T>, a: Option<&Vector2<T>>) -> Vector2<T> {
        let (at_tip, at_joints) = self.inertial_loads(pose, qd, qdd, a);
        at_joints + Self::transposed(pose, &at_tip)
    }

    /// Returns the joint torques that hold the linkage against gravity `g` in its plane, m/s².
    #[inline(always)]
    pub(super) fn gravity_torque(&self, pose: &Pose<T>, g: &Vector2<T>) -> Vector2<T> {
        let through_tip = Self::transposed(pose, &(g * self.tip_load));
        let elbow = |i: usize| rotated_left(&pose.arm[i]).dot(g) * self.elbow_load[i];
        -Vector2::new(elbow(0) + through_tip[0], elbow(1) + through_tip[1])
    }
}

impl<T: Real> Mechanism<T, 2> for FiveBar<T> {
    const SPEC: Spec = Spec {
        name: "five-bar",
        label: "five-bar",
        joints: 2,
        task: 2,
        links: &["proximal-1", "proximal-2", "distal-1", "distal-2"],
        geometry: &[("base", 1), ("proximal", 2), ("distal", 2), ("assembly", 1)],
        are_links_optional: false,
        gravity: 2,
    };
    type Pose = Pose<T>;

    fn new(description: &Description) -> Result<Self, DescriptionError> {
        if description.kind != Kind::FiveBar {
            return Err(DescriptionError::WrongKind);
        }
        Self::lump(description)
    }

    #[inline(always)]
    fn pose_at<K: Math<T>>(&self, q: &[Angle<T>; 2]) -> Pose<T> {
        // Rounding or a pose that cannot close may make the square of the height negative. It is clamped to zero, so
        // that `parallel` is 0. A tiny minimum distance of coinciding elbows avoids a division by zero.
        self.close::<K>(q, reciprocal, |squared| squared.greater(T::zero()))
    }

    /// Needs no clamps, because a pose with a zero divisor or without a root is not regular.
    #[inline(always)]
    fn regular_pose<K: Math<T>>(&self, q: &[Angle<T>; 2], least: &Regularity<T>) -> Option<Pose<T>> {
        let pose = self.close::<K>(q, |x, _| T::one() / x, |squared| squared);
        let elbow = |i: usize| (pose.k[i] * self.elbow_scale[i]).abs();
        (elbow(0) >= least.serial && elbow(1) >= least.serial && pose.parallel >= least.parallel).then_some(pose)
    }

    #[inline(always)]
    fn tip(&self, pose: &Pose<T>) -> Vector2<T> {
        pose.tip
    }

    #[inline(always)]
    fn regularity(&self, pose: &Pose<T>) -> Regularity<T> {
        let elbow1 = (pose.k[0] * self.elbow_scale[0]).abs();
        let elbow2 = (pose.k[1] * self.elbow_scale[1]).abs();
        Regularity { serial: elbow1.lesser(elbow2), parallel: pose.parallel }
    }

    fn jacobian(&self, pose: &Pose<T>) -> Matrix2<T> {
        let [u1, u2] = &pose.rod;
        let (a, b) = (pose.k[0] * pose.inverse_det, pose.k[1] * pose.inverse_det);
        Matrix2::new(a * u2[1], -b * u1[1], -a * u2[0], b * u1[0])
    }

    fn jacobian_rate(&self, pose: &Pose<T>, qd: &Vector2<T>) -> Matrix2<T> {
        // Derivative of [u₁ᵀ; u₂ᵀ] J = diag(k): J̇ = [u₁ᵀ; u₂ᵀ]⁻¹ (diag(k̇) - [u̇₁ᵀ; u̇₂ᵀ] J).
        let jacobian = self.jacobian(pose);
        let tip = jacobian * qd;
        let [u1, u2] = &pose.rod;
        let [c1, c2] = pose.arm.map(|arm| rotated_left(&arm));
        let du1 = tip - c1 * qd[0];
        let du2 = tip - c2 * qd[1];
        let dk1 = du1.dot(&c1) - u1.dot(&pose.arm[0]) * qd[0];
        let dk2 = du2.dot(&c2) - u2.dot(&pose.arm[1]) * qd[1];
        let rods_inverse = Matrix2::new(u2[1], -u1[1], -u2[0], u1[0]) * pose.inverse_det;
        let right = Matrix2::new(dk1, T::zero(), T::zero(), dk2)
            - Matrix2::from_rows(&[du1.transpose(), du2.transpose()]) * jacobian;
        rods_inverse * right
    }

    fn mass(&self, pose: &Pose<T>) -> Matrix2<T> {
        let j = self.jacobian(pose);
        let [b1, b2] = self.rod_coupling;
        let [c1, c2] = pose.arm.map(|arm| rotated_left(&arm));
        let (j1, j2) = (j.column(0), j.column(1));
        let off = self.tip_mass * j1.dot(&j2) + b1 * c1.dot(&j2) + b2 * c2.dot(&j1);
        let two = T::from_f64(2.0);
        Matrix2::new(
            self.arm_inertia[0] + self.tip_mass * j1.dot(&j1) + two * b1 * c1.dot(&j1),
            off,
            off,
            self.arm_inertia[1] + self.tip_mass * j2.dot(&j2) + two * b2 * c2.dot(&j2),
        )
    }

    fn coriolis(&self, pose: &Pose<T>, qd: &Vector2<T>) -> Vector2<T> {
        let a = self.jacobian_rate(pose, qd) * qd;
        self.inertial_torque(pose, qd, &Vector2::zeros(), Some(&a))
    }

    #[inline(always)]
    fn gravity(&self, pose: &Pose<T>) -> Vector2<T> {
        self.gravity_torque(pose, &Vector2::from(self.gravity))
    }

    #[inline(always)]
    fn transpose(&self, pose: &Pose<T>, force: &Vector2<T>) -> Vector2<T> {
        Self::transposed(pose, force)
    }

    #[inline(always)]
    fn velocity(&self, pose: &Pose<T>, qd: &Vector2<T>) -> Vector2<T> {
        let [u1, u2] = &pose.rod;
        let (a, b) = (pose.k[0] * pose.inverse_det * qd[0], pose.k[1] * pose.inverse_det * qd[1]);
        Vector2::new(a * u2[1] - b * u1[1], b * u1[0] - a * u2[0])
    }

    #[inline(always)]
    fn inverse(&self, pose: &Pose<T>, velocity: &Vector2<T>) -> Vector2<T> {
        Vector2::new(pose.rod[0].dot(velocity) * pose.inverse_k[0], pose.rod[1].dot(velocity) * pose.inverse_k[1])
    }

    #[inline(always)]
    fn shaping(&self, pose: &Pose<T>, n: &Vector2<T>) -> Shaping<T, 2> {
        let UnitMotion { e, momentum, arms } = self.unit_motion(pose, n);
        let me = momentum + Self::transposed(pose, &self.with_rod_forces(pose, n * self.tip_mass, None, &e));
        Shaping { e, me, w_rr: self.tip_mass * n.dot(n) + arms }
    }

    #[inline(always)]
    fn shaped_torque(&self, pose: &Pose<T>, n: &Vector2<T>, force: T, qd: Option<&Vector2<T>>) -> ShapedTorque<T, 2> {
        let UnitMotion { e, momentum, arms } = self.unit_motion(pose, n);
        // Acceleration of the tip along n.
        let s = force / (self.tip_mass + arms);
        let (mut qdd, mut at_joints) = (e * s, momentum * s);
        if let Some(qd) = qd {
            // At these velocities, the joints must accelerate to keep the tip without acceleration.
            let qdd_bias = Self::joint_acceleration(pose, qd, &self.velocity(pose, qd), None);
            qdd += qdd_bias;
            at_joints += Vector2::new(self.arm_inertia[0] * qdd_bias[0], self.arm_inertia[1] * qdd_bias[1]);
        }
        let at_tip = self.with_rod_forces(pose, n * (self.tip_mass * s), qd, &qdd);
        ShapedTorque { e, torque: at_joints + Self::transposed(pose, &at_tip) }
    }

    #[inline(always)]
    fn shaped_torque_of_turning_wall(
        &self,
        pose: &Pose<T>,
        n: &Vector2<T>,
        force: T,
        qd: &Vector2<T>,
        turning: &Vector2<T>,
    ) -> ShapedTorque<T, 2> {
        let UnitMotion { e, arms, .. } = self.unit_motion(pose, n);
        // Total acceleration of the tip.
        let a = n * (force / (self.tip_mass + arms)) + turning;
        let qdd = Self::joint_acceleration(pose, qd, &self.velocity(pose, qd), Some(&a));
        ShapedTorque { e, torque: self.inertial_torque(pose, qd, &qdd, Some(&a)) }
    }

    #[inline(always)]
    fn velocity_torque(&self, pose: &Pose<T>, qd: &Vector2<T>) -> Vector2<T> {
        let tip = self.velocity(pose, qd);
        let qdd = Self::joint_acceleration(pose, qd, &tip, None);
        self.inertial_torque(pose, qd, &qdd, None)
    }

    fn operational_inertia(&self, pose: &Pose<T>) -> Matrix2<T> {
        let mut inertia = Matrix2::from_diagonal_element(self.tip_mass);
        for i in 0..2 {
            let a = pose.rod[i] * pose.inverse_k[i];
            let c = rotated_left(&pose.arm[i]) * self.rod_coupling[i];
            inertia += a * a.transpose() * self.arm_inertia[i] + a * c.transpose() + c * a.transpose();
        }
        inertia
    }

    #[inline(always)]
    fn wall_terms(&self, pose: &Pose<T>, basis: &Matrix2<T>, qd: &Vector2<T>) -> WallTerms<T, 2> {
        let levers = Levers::new(self, pose);
        let motion = |i: usize| levers.unit_motion(&basis.column(i).into_owned());
        let motion = [motion(0), motion(1)];
        let qdd_bias = Self::joint_acceleration(pose, qd, &levers.velocity(qd), None);
        let row = levers.transposed(&motion[0].n);
        WallTerms {
            e: Matrix2::from_columns(&[motion[0].e, motion[1].e]),
            me: levers.momentum(&motion[0]),
            // Λ contains the tip's mass in every direction.
            w: symmetric_matrix(|i, j| {
                let arms = motion[i].arms(&motion[j]);
                if i == j { self.tip_mass + arms } else { arms }
            }),
            b: levers.bias(qd, &qdd_bias, Vector2::zeros(), &Vector2::from(self.gravity)),
            row,
            w_eff: effective_inertia(&levers.mass(), &row),
        }
    }
}
