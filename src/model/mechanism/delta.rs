//! `delta`: three arms and three pairs of rods carry a platform that does not turn (Falcon, omega).
//!
//! Leg i lies in the plane of its direction rᵢ = (cos αᵢ, sin αᵢ, 0) and ẑ. An arm of length U ends at its elbow; a pair
//! of rods of length F leads from the elbow to the platform. Because the platform does not turn, the legs move as if
//! each elbow cᵢ = (base - platform + U cos qᵢ) rᵢ + U sin qᵢ ẑ were connected to the tip P by one rod. P is therefore
//! at one of the two points at the distance F from c₀, c₁ and c₂, on the side of (c₁ - c₀) x (c₂ - c₀) for `assembly`
//! 1, else on the other side.
//!
//! Closed form: let uᵢ = P - cᵢ, and let lᵢ = U(-sin qᵢ rᵢ + cos qᵢ ẑ) be the elbow velocity per joint rate. The rods
//! are rigid, so uᵢ·(ṗ - lᵢ q̇ᵢ) = 0. Hence with kᵢ = uᵢ·lᵢ and the rows uᵢᵀ of S, J⁻¹ = diag(1/kᵢ) S, and the columns
//! of J are kᵢ (uⱼ x uₖ)/det S, (i, j, k) cyclic. One more derivative gives uᵢ·(p̈ - lᵢ q̈ᵢ + aᵢ q̇ᵢ²) + |u̇ᵢ|² = 0 with aᵢ
//! = U(cos qᵢ rᵢ + sin qᵢ ẑ).
//!
//! A slender rod of mass m has the kinetic energy m(|Ċ|² + Ċ·ṗ + |ṗ|²)/6. All masses of the rods are therefore
//! constants: α = γ = 2m/3 of a pair at elbow and tip, and β = m/3 between them.

use super::{Mechanism, Regularity, SINE_FLOOR, ShapedTorque, Shaping, reciprocal};
use crate::math::{Angle, Libm, Math, Real, cast};
use crate::model::catalogue::{Kind, Spec};
use crate::model::description::{Description, DescriptionError};
use nalgebra::{Matrix3, Vector2, Vector3};

/// Minimal coefficients of a delta.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize, postcard_schema::Schema)]
pub struct Delta<T> {
    /// base - platform, m.
    offset: T,
    /// U, m.
    upper: T,
    /// F², m².
    fore_squared: T,
    /// cos αᵢ and sin αᵢ.
    azimuths: [[T; 2]; 3],
    /// Assembly mode, ±1.
    assembly: T,
    /// 1/(U F), 1/m²: converts kᵢ to the sine of the elbow's distance from a stretched leg.
    leg_scale: T,
    /// Smallest |kᵢ| used as a divisor, m².
    leg_floor: T,
    /// 1/F³, 1/m³: converts det S to the sine of the solid angle between the rods.
    volume_scale: T,
    /// Smallest |det S| used as a divisor, m³.
    volume_floor: T,
    /// Smallest |(c₁ - c₀) x (c₂ - c₀)|² used as a divisor, m⁴.
    triangle_floor: T,
    /// Inertia of rotor, arm and the rods' α U² about each motor, kg m².
    arm_inertia: [T; 3],
    /// The rods' β, kg.
    rod_coupling: T,
    /// 3γ + platform + handle, kg.
    tip_mass: T,
    /// Weight of each leg at its elbow along rᵢ and ẑ, N.
    elbow_weights: [[T; 2]; 3],
    /// Weight at the tip, N.
    tip_weight: [T; 3],
}

/// Quantities that depend on the three angles alone.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose<T: Real> {
    /// Tip position, m.
    tip: Vector3<T>,
    /// aᵢ along rᵢ and ẑ, m.
    arm: [Vector2<T>; 3],
    /// uᵢ, m.
    rod: [Vector3<T>; 3],
    /// The columns of J, m.
    columns: [Vector3<T>; 3],
    /// kᵢ, m².
    k: [T; 3],
    /// 1/kᵢ, clamped.
    inverse_k: [T; 3],
    /// 1/det S, clamped.
    inverse_det: T,
    /// |det S|/F³; 0 if the rods lie in one plane or cannot reach each other.
    parallel: T,
}

/// A unit motion of the tip along a direction.
struct UnitMotion<T: Real> {
    /// E, rad/m.
    e: Vector3<T>,
    /// Part of M E that acts at the joints directly, Aᵢ eᵢ + β lᵢ·n, kg m. The rest of M E acts through the tip.
    momentum: Vector3<T>,
    /// The arms' part of the mass at the tip, kg, computed in task space without J: Λ = Γ 1 + Σ Aᵢ bᵢbᵢᵀ + β(bᵢlᵢᵀ +
    /// lᵢbᵢᵀ) with bᵢ = uᵢ/kᵢ.
    arms: T,
}

/// Returns `v` rotated left by 90°.
#[inline(always)]
fn rotated_left<T: Real>(v: &Vector2<T>) -> Vector2<T> {
    Vector2::new(-v[1], v[0])
}

/// Returns a value of each leg. Inlined, because a call of nalgebra's function would put the whole pose into memory.
#[inline(always)]
fn each_leg<T: Real>(value: impl Fn(usize) -> T) -> Vector3<T> {
    Vector3::new(value(0), value(1), value(2))
}

/// Returns uⱼ x uₖ: the columns of S⁻¹ det S.
#[inline(always)]
fn across<T: Real>(rod: &[Vector3<T>; 3]) -> [Vector3<T>; 3] {
    [rod[1].cross(&rod[2]), rod[2].cross(&rod[0]), rod[0].cross(&rod[1])]
}

impl<T: Real> Delta<T> {
    /// Converts to another precision.
    pub fn cast<U: Real>(&self) -> Delta<U> {
        Delta {
            offset: cast(self.offset),
            upper: cast(self.upper),
            fore_squared: cast(self.fore_squared),
            azimuths: self.azimuths.map(|azimuth| azimuth.map(cast)),
            assembly: cast(self.assembly),
            leg_scale: cast(self.leg_scale),
            leg_floor: cast(self.leg_floor),
            volume_scale: cast(self.volume_scale),
            volume_floor: cast(self.volume_floor),
            triangle_floor: cast(self.triangle_floor),
            arm_inertia: self.arm_inertia.map(cast),
            rod_coupling: cast(self.rod_coupling),
            tip_mass: cast(self.tip_mass),
            elbow_weights: self.elbow_weights.map(|weight| weight.map(cast)),
            tip_weight: self.tip_weight.map(cast),
        }
    }

    /// Returns the components of `v` along rᵢ and ẑ.
    #[inline(always)]
    fn in_leg(&self, i: usize, v: &Vector3<T>) -> Vector2<T> {
        let [x, y] = self.azimuths[i];
        Vector2::new(x * v[0] + y * v[1], v[2])
    }

    /// Returns the vector with these components along rᵢ and ẑ.
    #[inline(always)]
    fn leg_in_base(&self, i: usize, v: &Vector2<T>) -> Vector3<T> {
        let [x, y] = self.azimuths[i];
        Vector3::new(x * v[0], y * v[0], v[1])
    }

    /// Returns lᵢ·v.
    #[inline(always)]
    fn along_lever(&self, pose: &Pose<T>, i: usize, v: &Vector3<T>) -> T {
        rotated_left(&pose.arm[i]).dot(&self.in_leg(i, v))
    }

    /// Computes the pose at these angles. `inverse` inverts its first argument and may first clamp its magnitude to at
    /// least the second argument. `reach` may change the circumcentre of the elbows relative to c₀, and returns the
    /// square of its height below the tip.
    #[inline(always)]
    fn close<K: Math<T>>(
        &self,
        q: &[Angle<T>; 3],
        inverse: impl Fn(T, T) -> T,
        reach: impl Fn(&mut Vector3<T>) -> T,
    ) -> Pose<T> {
        let arm = q.map(|angle| {
            let (s, c) = K::sin_cos_of(angle);
            Vector2::new(self.upper * c, self.upper * s)
        });
        let elbow = |i: usize| self.leg_in_base(i, &Vector2::new(self.offset + arm[i][0], arm[i][1]));
        let c0 = elbow(0);
        let (side1, side2) = (elbow(1) - c0, elbow(2) - c0);
        let normal = side1.cross(&side2);
        let area_squared = normal.dot(&normal);
        let inverse_area = inverse(area_squared, self.triangle_floor);
        // The circumcentre of c₀, c₁ and c₂ relative to c₀. The tip is on the normal through it.
        let mut center =
            (side2 * side1.dot(&side1) - side1 * side2.dot(&side2)).cross(&normal) * (T::from_f64(0.5) * inverse_area);
        let height_squared = reach(&mut center);
        let height = self.assembly * K::sqrt(height_squared * inverse_area);
        let u0 = center + normal * height;
        let rod = [u0, u0 - side1, u0 - side2];
        let det = height * area_squared;
        let inverse_det = inverse(det, self.volume_floor);
        let across = across(&rod);
        let k: [T; 3] = core::array::from_fn(|i| rotated_left(&arm[i]).dot(&self.in_leg(i, &rod[i])));
        Pose {
            tip: c0 + u0,
            arm,
            rod,
            columns: core::array::from_fn(|i| across[i] * (k[i] * inverse_det)),
            k,
            inverse_k: k.map(|k| inverse(k, self.leg_floor)),
            inverse_det,
            parallel: (det * self.volume_scale).abs(),
        }
    }

    /// Returns the sine of each leg's distance from a singularity.
    #[inline(always)]
    fn leg_sines(&self, pose: &Pose<T>) -> [T; 3] {
        pose.k.map(|k| (k * self.leg_scale).abs())
    }

    /// Returns the joint accelerations, by the rigidity of the rods, for a tip acceleration `a` (m/s², 0 if `None`) at
    /// velocities `qd` and `tip`.
    #[inline(always)]
    fn joint_acceleration(
        &self,
        pose: &Pose<T>,
        qd: &Vector3<T>,
        tip: &Vector3<T>,
        a: Option<&Vector3<T>>,
    ) -> Vector3<T> {
        // Written out, because the compiler does not inline such a long closure.
        let along = [
            self.constrained(pose, 0, qd[0], tip),
            self.constrained(pose, 1, qd[1], tip),
            self.constrained(pose, 2, qd[2], tip),
        ];
        each_leg(|i| pose.inverse_k[i] * a.map_or(along[i], |a| along[i] + pose.rod[i].dot(a)))
    }

    /// Returns uᵢ·aᵢ q̇ᵢ² + |u̇ᵢ|², m²/s², with |u̇ᵢ|² = |ṗ|² - 2 lᵢ·ṗ q̇ᵢ + U² q̇ᵢ².
    #[inline(always)]
    fn constrained(&self, pose: &Pose<T>, i: usize, qd: T, tip: &Vector3<T>) -> T {
        let along_arm = pose.arm[i].dot(&self.in_leg(i, &pose.rod[i])) + self.upper * self.upper;
        let along_lever = self.along_lever(pose, i, tip);
        tip.dot(tip) + (along_arm * qd - along_lever - along_lever) * qd
    }

    /// Returns the rods' force on the tip (N) for joint accelerations `qdd`, at velocities `qd` or at rest.
    #[inline(always)]
    fn rod_force(&self, pose: &Pose<T>, qd: Option<&Vector3<T>>, qdd: &Vector3<T>) -> Vector3<T> {
        let mut sum = Vector3::zeros();
        for i in 0..3 {
            let along = rotated_left(&pose.arm[i]) * qdd[i];
            sum += self.leg_in_base(i, &qd.map_or(along, |qd| along - pose.arm[i] * (qd[i] * qd[i])));
        }
        sum * self.rod_coupling
    }

    /// Returns the joint torques of accelerations `a` of the tip and `qdd` of the joints, at velocities `qd`.
    #[inline(always)]
    fn inertial_torque(&self, pose: &Pose<T>, qd: &Vector3<T>, qdd: &Vector3<T>, a: Option<&Vector3<T>>) -> Vector3<T> {
        let rods = self.rod_force(pose, Some(qd), qdd);
        let at_joints = each_leg(|i| self.arm_inertia[i] * qdd[i]);
        let Some(a) = a else { return at_joints + self.transpose(pose, &rods) };
        let with_tip = each_leg(|i| self.rod_coupling * self.along_lever(pose, i, a));
        at_joints + with_tip + self.transpose(pose, &(a * self.tip_mass + rods))
    }

    /// Computes a unit motion of the tip along `n`.
    #[inline(always)]
    fn unit_motion(&self, pose: &Pose<T>, n: &Vector3<T>) -> UnitMotion<T> {
        let e = self.inverse(pose, n);
        let with_tip = each_leg(|i| self.rod_coupling * self.along_lever(pose, i, n));
        let momentum = each_leg(|i| self.arm_inertia[i] * e[i]) + with_tip;
        UnitMotion { e, momentum, arms: e.dot(&(momentum + with_tip)) }
    }
}

impl<T: Real> Mechanism<T, 3> for Delta<T> {
    const SPEC: Spec = Spec {
        name: "delta",
        label: "delta",
        joints: 3,
        task: 3,
        links: &["arm", "rod", "platform"],
        geometry: &[("base", 1), ("platform", 1), ("upper", 1), ("fore", 1), ("azimuth", 3), ("assembly", 1)],
        are_links_optional: false,
        gravity: 3,
    };
    type Pose = Pose<T>;

    fn new(description: &Description) -> Result<Self, DescriptionError> {
        if description.kind != Kind::Delta {
            return Err(DescriptionError::WrongKind);
        }
        let [base, platform, upper, fore, azimuths @ .., assembly] = description.geometry;
        for (index, (length, may_be_zero)) in
            [(base, true), (platform, true), (upper, false), (fore, false)].into_iter().enumerate()
        {
            if length.is_nan() || length < 0.0 || (length == 0.0 && !may_be_zero) {
                return Err(DescriptionError::GeometryNotPositive(index));
            }
        }
        if assembly != 1.0 && assembly != -1.0 {
            return Err(DescriptionError::Assembly);
        }
        // At equal angles the elbows are on a circle about the z axis, whose radius must be less than a rod. Legs that
        // are turned outwards or inwards as far as they go make this radius as small as possible.
        if (base - platform).abs() - upper >= fore {
            return Err(DescriptionError::CannotClose);
        }
        let [arm, rod, end, ..] = description.links;
        let about_motor = arm.inertia + arm.mass * arm.com * arm.com + rod.mass * upper * upper * (2.0 / 3.0);
        let arm_inertia: [f64; 3] = core::array::from_fn(|i| description.joints[i].inertia + about_motor);
        if arm_inertia.iter().any(|inertia| inertia.is_nan() || *inertia <= 0.0) {
            return Err(DescriptionError::NoInertia);
        }
        let point = end.mass + description.handle_mass;
        let elbow_load = arm.mass * arm.com / upper + rod.mass;
        let [x, y, z] = description.gravity;
        let directions = azimuths.map(<Libm as Math<f64>>::sin_cos);
        let reals = |values: [f64; 3]| values.map(T::from_f64);
        let pairs = |pair: &dyn Fn(f64, f64) -> [f64; 2]| directions.map(|(s, c)| pair(s, c).map(T::from_f64));
        Ok(Self {
            offset: T::from_f64(base - platform),
            upper: T::from_f64(upper),
            fore_squared: T::from_f64(fore * fore),
            azimuths: pairs(&|s, c| [c, s]),
            assembly: T::from_f64(assembly),
            leg_scale: T::from_f64(1.0 / (upper * fore)),
            leg_floor: T::from_f64(SINE_FLOOR * upper * fore),
            volume_scale: T::from_f64(1.0 / (fore * fore * fore)),
            volume_floor: T::from_f64(SINE_FLOOR * fore * fore * fore),
            triangle_floor: T::from_f64(SINE_FLOOR * SINE_FLOOR * fore * fore * fore * fore),
            arm_inertia: reals(arm_inertia),
            rod_coupling: T::from_f64(rod.mass / 3.0),
            tip_mass: T::from_f64(2.0 * rod.mass + point),
            elbow_weights: pairs(&|s, c| [elbow_load * (c * x + s * y), elbow_load * z]),
            tip_weight: reals([x, y, z].map(|g| g * (3.0 * rod.mass + point))),
        })
    }

    #[inline(always)]
    fn pose_at<K: Math<T>>(&self, q: &[Angle<T>; 3]) -> Pose<T> {
        // Elbows too far from each other or nearly in one line have a circumcentre beyond the rods' reach. It is moved
        // to the distance F, where the rods lie in one plane and `parallel` is 0.
        self.close::<K>(q, reciprocal, |center| {
            let distance_squared = center.dot(center);
            let height_squared = self.fore_squared - distance_squared;
            if height_squared < T::zero() {
                *center *= K::sqrt(self.fore_squared / distance_squared);
            }
            height_squared.greater(T::zero())
        })
    }

    /// Needs no clamps, because a pose with a zero divisor or without a root is not regular.
    #[inline(always)]
    fn regular_pose<K: Math<T>>(&self, q: &[Angle<T>; 3], least: &Regularity<T>) -> Option<Pose<T>> {
        let pose = self.close::<K>(q, |x, _| T::one() / x, |center| self.fore_squared - center.dot(center));
        let is_regular = self.leg_sines(&pose).into_iter().all(|sine| sine >= least.serial);
        (is_regular && pose.parallel >= least.parallel).then_some(pose)
    }

    #[inline(always)]
    fn tip(&self, pose: &Pose<T>) -> Vector3<T> {
        pose.tip
    }

    #[inline(always)]
    fn regularity(&self, pose: &Pose<T>) -> Regularity<T> {
        let [a, b, c] = self.leg_sines(pose);
        Regularity { serial: a.lesser(b).lesser(c), parallel: pose.parallel }
    }

    fn jacobian(&self, pose: &Pose<T>) -> Matrix3<T> {
        Matrix3::from_columns(&pose.columns)
    }

    fn jacobian_rate(&self, pose: &Pose<T>, qd: &Vector3<T>) -> Matrix3<T> {
        // Derivative of S J = diag(k): J̇ = S⁻¹ (diag(k̇) - Ṡ J).
        let jacobian = self.jacobian(pose);
        let tip = jacobian * qd;
        let mut right = Matrix3::zeros();
        for i in 0..3 {
            let lever = self.leg_in_base(i, &rotated_left(&pose.arm[i]));
            let rate = tip - lever * qd[i];
            right.set_row(i, &-jacobian.tr_mul(&rate).transpose());
            right[(i, i)] += rate.dot(&lever) - pose.arm[i].dot(&self.in_leg(i, &pose.rod[i])) * qd[i];
        }
        Matrix3::from_columns(&across(&pose.rod)) * right * pose.inverse_det
    }

    fn mass(&self, pose: &Pose<T>) -> Matrix3<T> {
        // M = diag(A) + Jᵀ(Γ J + L) + Lᵀ J with the columns β lᵢ of L.
        let j = self.jacobian(pose);
        let lever = |i: usize| self.leg_in_base(i, &(rotated_left(&pose.arm[i]) * self.rod_coupling));
        let levers = Matrix3::from_columns(&[lever(0), lever(1), lever(2)]);
        let half = j * (self.tip_mass * T::from_f64(0.5)) + levers;
        let mixed = j.tr_mul(&half);
        super::symmetric_matrix(|i, k| {
            let both = mixed[(i, k)] + mixed[(k, i)];
            if i == k { self.arm_inertia[i] + both } else { both }
        })
    }

    fn coriolis(&self, pose: &Pose<T>, qd: &Vector3<T>) -> Vector3<T> {
        // The tip's acceleration while no joint accelerates, by the rigidity of the rods.
        let tip = self.velocity(pose, qd);
        let constrained = each_leg(|i| self.constrained(pose, i, qd[i], &tip));
        let a = Matrix3::from_columns(&across(&pose.rod)) * constrained * -pose.inverse_det;
        self.inertial_torque(pose, qd, &Vector3::zeros(), Some(&a))
    }

    #[inline(always)]
    fn gravity(&self, pose: &Pose<T>) -> Vector3<T> {
        let through_tip = self.transpose(pose, &Vector3::from(self.tip_weight));
        let elbow = |i: usize| rotated_left(&pose.arm[i]).dot(&Vector2::from(self.elbow_weights[i]));
        each_leg(|i| -elbow(i) - through_tip[i])
    }

    #[inline(always)]
    fn transpose(&self, pose: &Pose<T>, force: &Vector3<T>) -> Vector3<T> {
        each_leg(|i| pose.columns[i].dot(force))
    }

    #[inline(always)]
    fn velocity(&self, pose: &Pose<T>, qd: &Vector3<T>) -> Vector3<T> {
        pose.columns[0] * qd[0] + pose.columns[1] * qd[1] + pose.columns[2] * qd[2]
    }

    #[inline(always)]
    fn inverse(&self, pose: &Pose<T>, velocity: &Vector3<T>) -> Vector3<T> {
        each_leg(|i| pose.rod[i].dot(velocity) * pose.inverse_k[i])
    }

    #[inline(always)]
    fn shaping(&self, pose: &Pose<T>, n: &Vector3<T>) -> Shaping<T, 3> {
        let UnitMotion { e, momentum, arms } = self.unit_motion(pose, n);
        let at_tip = n * self.tip_mass + self.rod_force(pose, None, &e);
        Shaping { e, me: momentum + self.transpose(pose, &at_tip), w_rr: self.tip_mass * n.dot(n) + arms }
    }

    #[inline(always)]
    fn shaped_torque(&self, pose: &Pose<T>, n: &Vector3<T>, force: T, qd: Option<&Vector3<T>>) -> ShapedTorque<T, 3> {
        let UnitMotion { e, momentum, arms } = self.unit_motion(pose, n);
        // Acceleration of the tip along n.
        let s = force / (self.tip_mass + arms);
        let (mut qdd, mut at_joints) = (e * s, momentum * s);
        if let Some(qd) = qd {
            // At these velocities, the joints must accelerate to keep the tip without acceleration.
            let qdd_bias = self.joint_acceleration(pose, qd, &self.velocity(pose, qd), None);
            qdd += qdd_bias;
            at_joints += each_leg(|i| self.arm_inertia[i] * qdd_bias[i]);
        }
        let at_tip = n * (self.tip_mass * s) + self.rod_force(pose, qd, &qdd);
        ShapedTorque { e, torque: at_joints + self.transpose(pose, &at_tip) }
    }

    #[inline(always)]
    fn shaped_torque_of_turning_wall(
        &self,
        pose: &Pose<T>,
        n: &Vector3<T>,
        force: T,
        qd: &Vector3<T>,
        turning: &Vector3<T>,
    ) -> ShapedTorque<T, 3> {
        let UnitMotion { e, arms, .. } = self.unit_motion(pose, n);
        // Total acceleration of the tip.
        let a = n * (force / (self.tip_mass + arms)) + turning;
        let qdd = self.joint_acceleration(pose, qd, &self.velocity(pose, qd), Some(&a));
        ShapedTorque { e, torque: self.inertial_torque(pose, qd, &qdd, Some(&a)) }
    }

    #[inline(always)]
    fn velocity_torque(&self, pose: &Pose<T>, qd: &Vector3<T>) -> Vector3<T> {
        let qdd = self.joint_acceleration(pose, qd, &self.velocity(pose, qd), None);
        self.inertial_torque(pose, qd, &qdd, None)
    }

    fn operational_inertia(&self, pose: &Pose<T>) -> Matrix3<T> {
        let mut inertia = Matrix3::from_diagonal_element(self.tip_mass);
        for i in 0..3 {
            let b = pose.rod[i] * pose.inverse_k[i];
            let l = self.leg_in_base(i, &(rotated_left(&pose.arm[i]) * self.rod_coupling));
            inertia += b * b.transpose() * self.arm_inertia[i] + b * l.transpose() + l * b.transpose();
        }
        inertia
    }
}
