//! `parallelogram`: two arms on a turret, driven from the base through a parallelogram (Phantom, WoodenHaptics).
//!
//! Turret q₀ about the vertical Y: world (X, Y, Z) = (x cos q₀, y, -x sin q₀). In the plane the angles are absolute:
//! the upper arm O→E is at q₁, length U; the tip is P = E + F(cos q₂, sin q₂). The drive crank points from O along
//! -(cos q₂, sin q₂), length K, and the coupler runs from the crank's end parallel to the upper arm. Every link is
//! parallel to one of the two directions e₁, e₂, so with δ = q₂ - q₁ M_plane = [a, b cos δ; b cos δ, c],
//! J_plane = [U e₁⊥, F e₂⊥], J_plane⁻¹ = [e₂ᵀ/(U sin δ); -e₁ᵀ/(F sin δ)], and the turret's inertia is a quadratic form
//! in the cosines, J₀ = I₀ + α cos² q₁ + 2β cos q₁ cos q₂ + γ cos² q₂.
//!
//! The sines and cosines of q₁ and δ are computed; those of q₂ follow by the addition theorem. The divisor sin δ of J⁻¹
//! therefore keeps full precision when the arm is nearly stretched.

use super::{Mechanism, Regularity, SINE_FLOOR, Shaping, WallTerms, inertia_with_turret, reciprocal, symmetric_matrix};
use crate::math::{Angle, Math, Real, cast};
use crate::model::catalogue::{Kind, Spec};
use crate::model::description::{Description, DescriptionError};
use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};

/// Minimal coefficients of a parallelogram on a turret.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize, postcard_schema::Schema)]
pub struct Parallelogram<T> {
    /// U and F, m.
    lengths: [T; 2],
    inverse_lengths: [T; 2],
    /// a and c: diagonal of the mass matrix, kg m².
    arm_inertia: [T; 2],
    /// b: coefficient of cos δ off the diagonal, kg m².
    coupling: T,
    /// I₀: inertia of turret, rotor and links about their own axes, kg m².
    turret_inertia: T,
    /// α, β, γ, kg m².
    spin: [T; 3],
    /// First moments of mass along e₁ and e₂, kg m.
    loads: [T; 2],
    /// Gravity in the world, m/s².
    gravity: [T; 3],
    /// 1/(U + F), 1/m: converts |x| to a number in [0, 1].
    reach_scale: T,
    /// Smallest |x| used as a divisor, m.
    axis_floor: T,
}

/// Quantities that depend on the three angles alone.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose<T: Real> {
    /// Tip in the plane, m.
    tip: Vector2<T>,
    /// sin q₀.
    sine: T,
    /// cos q₀.
    cosine: T,
    /// e₁, the direction of the upper arm.
    upper: Vector2<T>,
    /// e₂, the direction of the forearm.
    fore: Vector2<T>,
    /// sin δ.
    elbow_sine: T,
    /// cos δ.
    elbow_cosine: T,
    /// 1/sin δ, clamped.
    inverse_sine: T,
    /// 1/x, clamped.
    inverse_x: T,
}

impl<T: Real> Pose<T> {
    /// Returns the components of a world vector in the plane and normal to it.
    #[inline(always)]
    fn to_plane(self, v: &Vector3<T>) -> (Vector2<T>, T) {
        let Self { sine: s, cosine: c, .. } = self;
        (Vector2::new(c * v[0] - s * v[2], v[1]), -s * v[0] - c * v[2])
    }

    /// Returns the world vector with these components in the plane and normal to it.
    #[inline(always)]
    fn to_world(self, plane: &Vector2<T>, normal: T) -> Vector3<T> {
        let Self { sine: s, cosine: c, .. } = self;
        Vector3::new(c * plane[0] - s * normal, plane[1], -s * plane[0] - c * normal)
    }

    /// Returns J_planeᵀ f for these lengths (m).
    #[inline(always)]
    fn transposed(&self, lengths: [T; 2], f: &Vector2<T>) -> Vector2<T> {
        let (e1, e2) = (&self.upper, &self.fore);
        Vector2::new(lengths[0] * (e1[0] * f[1] - e1[1] * f[0]), lengths[1] * (e2[0] * f[1] - e2[1] * f[0]))
    }
}

impl<T: Real> Parallelogram<T> {
    /// Converts to another precision.
    pub fn cast<U: Real>(&self) -> Parallelogram<U> {
        Parallelogram {
            lengths: self.lengths.map(cast),
            inverse_lengths: self.inverse_lengths.map(cast),
            arm_inertia: self.arm_inertia.map(cast),
            coupling: cast(self.coupling),
            turret_inertia: cast(self.turret_inertia),
            spin: self.spin.map(cast),
            loads: self.loads.map(cast),
            gravity: self.gravity.map(cast),
            reach_scale: cast(self.reach_scale),
            axis_floor: cast(self.axis_floor),
        }
    }

    /// Returns J₀ and half its gradient with respect to (cos q₁, cos q₂), kg m².
    #[inline(always)]
    fn spin(&self, pose: &Pose<T>) -> (T, [T; 2]) {
        let (c1, c2) = (pose.upper[0], pose.fore[0]);
        let [alpha, beta, gamma] = self.spin;
        let half_gradient = [alpha * c1 + beta * c2, beta * c1 + gamma * c2];
        (self.turret_inertia + c1 * half_gradient[0] + c2 * half_gradient[1], half_gradient)
    }

    /// Returns J_plane⁻¹ v.
    #[inline(always)]
    fn inverse_in_plane(&self, pose: &Pose<T>, v: &Vector2<T>) -> Vector2<T> {
        let [iu, inverse_fore] = self.inverse_lengths;
        Vector2::new(pose.fore.dot(v) * pose.inverse_sine * iu, -pose.upper.dot(v) * pose.inverse_sine * inverse_fore)
    }

    /// Returns M q̇.
    #[inline(always)]
    fn momentum(&self, pose: &Pose<T>, qd: &Vector3<T>) -> Vector3<T> {
        let off = self.coupling * pose.elbow_cosine;
        let [a, c] = self.arm_inertia;
        Vector3::new(self.spin(pose).0 * qd[0], a * qd[1] + off * qd[2], off * qd[1] + c * qd[2])
    }

    /// Returns the torques of joint accelerations `qdd` at joint velocities `qd`.
    #[inline(always)]
    fn inertial_torque(&self, pose: &Pose<T>, qd: &Vector3<T>, qdd: &Vector3<T>) -> Vector3<T> {
        let (inertia, [h1, h2]) = self.spin(pose);
        // Half the rates of J₀ per joint rate, which are also the centrifugal torques per q̇₀².
        let (f1, f2) = (h1 * pose.upper[1], h2 * pose.fore[1]);
        let turning = qd[0] * qd[0];
        let [a, c] = self.arm_inertia;
        let (b_cos, b_sin) = (self.coupling * pose.elbow_cosine, self.coupling * pose.elbow_sine);
        Vector3::new(
            inertia * qdd[0] - T::from_f64(2.0) * qd[0] * (f1 * qd[1] + f2 * qd[2]),
            a * qdd[1] + b_cos * qdd[2] - b_sin * qd[2] * qd[2] + f1 * turning,
            c * qdd[2] + b_cos * qdd[1] + b_sin * qd[1] * qd[1] + f2 * turning,
        )
    }
}

impl<T: Real> Mechanism<T, 3> for Parallelogram<T> {
    const SPEC: Spec = Spec {
        name: "parallelogram",
        label: "parallelogram",
        joints: 3,
        task: 3,
        links: &["upper", "fore", "crank", "coupler"],
        geometry: &[("upper", 1), ("fore", 1), ("crank", 1)],
        are_links_optional: false,
        gravity: 3,
    };
    type Pose = Pose<T>;

    fn new(description: &Description) -> Result<Self, DescriptionError> {
        if description.kind != Kind::Parallelogram {
            return Err(DescriptionError::WrongKind);
        }
        let [u, f, k, ..] = description.geometry;
        for (index, length) in [u, f, k].into_iter().enumerate() {
            if length.is_nan() || length <= 0.0 {
                return Err(DescriptionError::GeometryNotPositive(index));
            }
        }
        let [upper, fore, crank, coupler] = description.links;
        let handle = description.handle_mass;
        let about_proximal = |link: &crate::model::description::Link| link.mass * link.com * link.com;
        // Second moments of mass along e₁e₁, e₁e₂, e₂e₂. The turret's inertia uses the same moments.
        let along_upper = about_proximal(&upper) + about_proximal(&coupler) + (fore.mass + handle) * u * u;
        let along_fore = about_proximal(&fore) + about_proximal(&crank) + coupler.mass * k * k + handle * f * f;
        let mixed = fore.mass * u * fore.com - coupler.mass * k * coupler.com + handle * u * f;
        let tilt = |link: &crate::model::description::Link| link.inertia_transverse - link.inertia_axial;
        let [turret, joint1, joint2] = description.joints;
        let a = joint1.inertia + upper.inertia + coupler.inertia + along_upper;
        let c = joint2.inertia + fore.inertia + crank.inertia + along_fore;
        let turret_inertia = turret.inertia + description.links.iter().map(|link| link.inertia_axial).sum::<f64>();
        // a c > b² up to rounding, unless a and c come only from coincident point masses.
        if [a, c, turret_inertia, a * c - mixed * mixed].into_iter().any(|value| value.is_nan() || value <= 0.0) {
            return Err(DescriptionError::NoInertia);
        }
        let real = T::from_f64;
        Ok(Self {
            lengths: [real(u), real(f)],
            inverse_lengths: [real(1.0 / u), real(1.0 / f)],
            arm_inertia: [real(a), real(c)],
            coupling: real(mixed),
            turret_inertia: real(turret_inertia),
            spin: [
                real(along_upper + tilt(&upper) + tilt(&coupler)),
                real(mixed),
                real(along_fore + tilt(&fore) + tilt(&crank)),
            ],
            loads: [
                real(upper.mass * upper.com + coupler.mass * coupler.com + (fore.mass + handle) * u),
                real(fore.mass * fore.com - crank.mass * crank.com - coupler.mass * k + handle * f),
            ],
            gravity: description.gravity.map(real),
            reach_scale: real(1.0 / (u + f)),
            axis_floor: real(SINE_FLOOR * (u + f)),
        })
    }

    #[inline(always)]
    fn pose_at<K: Math<T>>(&self, q: &[Angle<T>; 3]) -> Pose<T> {
        let (sine, cosine) = K::sin_cos_of(q[0]);
        let (s1, c1) = K::sin_cos_of(q[1]);
        let (elbow_sine, elbow_cosine) = K::sin_cos_of(q[2] - q[1]);
        let upper = Vector2::new(c1, s1);
        let fore = Vector2::new(c1 * elbow_cosine - s1 * elbow_sine, s1 * elbow_cosine + c1 * elbow_sine);
        let tip = upper * self.lengths[0] + fore * self.lengths[1];
        Pose {
            tip,
            sine,
            cosine,
            upper,
            fore,
            elbow_sine,
            elbow_cosine,
            inverse_sine: reciprocal(elbow_sine, T::from_f64(SINE_FLOOR)),
            inverse_x: reciprocal(tip[0], self.axis_floor),
        }
    }

    #[inline(always)]
    fn tip(&self, pose: &Pose<T>) -> Vector3<T> {
        pose.to_world(&pose.tip, T::zero())
    }

    #[inline(always)]
    fn regularity(&self, pose: &Pose<T>) -> Regularity<T> {
        let off_axis = (pose.tip[0] * self.reach_scale).abs();
        Regularity { serial: pose.elbow_sine.abs().lesser(off_axis), parallel: T::one() }
    }

    fn jacobian(&self, pose: &Pose<T>) -> Matrix3<T> {
        let [u, f] = self.lengths;
        Matrix3::from_columns(&[
            pose.to_world(&Vector2::zeros(), pose.tip[0]),
            pose.to_world(&Vector2::new(-u * pose.upper[1], u * pose.upper[0]), T::zero()),
            pose.to_world(&Vector2::new(-f * pose.fore[1], f * pose.fore[0]), T::zero()),
        ])
    }

    fn jacobian_rate(&self, pose: &Pose<T>, qd: &Vector3<T>) -> Matrix3<T> {
        let [u, f] = self.lengths;
        // Radial velocities of the tip per rate of q₁ and q₂.
        let (x1, x2) = (-u * pose.upper[1], -f * pose.fore[1]);
        let radial_rate = x1 * qd[1] + x2 * qd[2];
        Matrix3::from_columns(&[
            pose.to_world(&Vector2::new(-pose.tip[0] * qd[0], T::zero()), radial_rate),
            pose.to_world(&(pose.upper * (-u * qd[1])), x1 * qd[0]),
            pose.to_world(&(pose.fore * (-f * qd[2])), x2 * qd[0]),
        ])
    }

    fn mass(&self, pose: &Pose<T>) -> Matrix3<T> {
        let zero = T::zero();
        let off = self.coupling * pose.elbow_cosine;
        let [a, c] = self.arm_inertia;
        Matrix3::new(self.spin(pose).0, zero, zero, zero, a, off, zero, off, c)
    }

    fn coriolis(&self, pose: &Pose<T>, qd: &Vector3<T>) -> Vector3<T> {
        self.inertial_torque(pose, qd, &Vector3::zeros())
    }

    #[inline(always)]
    fn gravity(&self, pose: &Pose<T>) -> Vector3<T> {
        let (in_plane, normal) = pose.to_plane(&Vector3::from(self.gravity));
        let [w1, w2] = self.loads;
        let arms = pose.transposed(self.loads, &in_plane);
        Vector3::new(-normal * (w1 * pose.upper[0] + w2 * pose.fore[0]), -arms[0], -arms[1])
    }

    #[inline(always)]
    fn transpose(&self, pose: &Pose<T>, force: &Vector3<T>) -> Vector3<T> {
        let (in_plane, normal) = pose.to_plane(force);
        let arms = pose.transposed(self.lengths, &in_plane);
        Vector3::new(pose.tip[0] * normal, arms[0], arms[1])
    }

    #[inline(always)]
    fn velocity(&self, pose: &Pose<T>, qd: &Vector3<T>) -> Vector3<T> {
        let (v1, v2) = (self.lengths[0] * qd[1], self.lengths[1] * qd[2]);
        let in_plane = Vector2::new(-v1 * pose.upper[1] - v2 * pose.fore[1], v1 * pose.upper[0] + v2 * pose.fore[0]);
        pose.to_world(&in_plane, pose.tip[0] * qd[0])
    }

    #[inline(always)]
    fn inverse(&self, pose: &Pose<T>, velocity: &Vector3<T>) -> Vector3<T> {
        let (in_plane, normal) = pose.to_plane(velocity);
        let arms = self.inverse_in_plane(pose, &in_plane);
        Vector3::new(normal * pose.inverse_x, arms[0], arms[1])
    }

    #[inline(always)]
    fn shaping(&self, pose: &Pose<T>, n: &Vector3<T>) -> Shaping<T, 3> {
        let e = self.inverse(pose, n);
        let me = self.momentum(pose, &e);
        Shaping { e, me, w_rr: e.dot(&me) }
    }

    #[inline(always)]
    fn velocity_torque(&self, pose: &Pose<T>, qd: &Vector3<T>) -> Vector3<T> {
        let [u, f] = self.lengths;
        // The negative sum of the plane's J̇ q̇ and the turret's centripetal and Coriolis accelerations.
        let mut in_plane = pose.upper * (u * qd[1] * qd[1]) + pose.fore * (f * qd[2] * qd[2]);
        in_plane[0] += pose.tip[0] * qd[0] * qd[0];
        let radial_rate = -u * pose.upper[1] * qd[1] - f * pose.fore[1] * qd[2];
        let q0dd = T::from_f64(-2.0) * radial_rate * qd[0] * pose.inverse_x;
        let arms = self.inverse_in_plane(pose, &in_plane);
        self.inertial_torque(pose, qd, &Vector3::new(q0dd, arms[0], arms[1]))
    }

    fn operational_inertia(&self, pose: &Pose<T>) -> Matrix3<T> {
        let [iu, inverse_fore] = self.inverse_lengths;
        let [a, c] = self.arm_inertia;
        let (e1, e2) = (pose.upper * inverse_fore, pose.fore * iu);
        let mixed = e2 * e1.transpose();
        let plane: Matrix2<T> = (e2 * e2.transpose() * a + e1 * e1.transpose() * c
            - (mixed + mixed.transpose()) * (self.coupling * pose.elbow_cosine))
            * (pose.inverse_sine * pose.inverse_sine);
        let normal = self.spin(pose).0 * pose.inverse_x * pose.inverse_x;
        // Rotates about the turret's axis: the plane's x axis is (cos, 0, -sin), its normal (-sin, 0, -cos).
        let (s, c) = (pose.sine, pose.cosine);
        let (xx, xy) = (plane[(0, 0)], plane[(0, 1)]);
        let across = (normal - xx) * (s * c);
        Matrix3::new(
            xx * c * c + normal * s * s,
            xy * c,
            across,
            xy * c,
            plane[(1, 1)],
            -xy * s,
            across,
            -xy * s,
            xx * s * s + normal * c * c,
        )
    }

    #[inline(always)]
    fn wall_terms(&self, pose: &Pose<T>, basis: &Matrix3<T>, qd: &Vector3<T>) -> WallTerms<T, 3> {
        // The rows of J_plane⁻¹.
        let upper = pose.fore * (pose.inverse_sine * self.inverse_lengths[0]);
        let fore = pose.upper * (-pose.inverse_sine * self.inverse_lengths[1]);
        let e = |i: usize| {
            let (in_plane, normal) = pose.to_plane(&basis.column(i).into_owned());
            Vector3::new(normal * pose.inverse_x, upper.dot(&in_plane), fore.dot(&in_plane))
        };
        let e = [e(0), e(1), e(2)];
        let momenta = [self.momentum(pose, &e[0]), self.momentum(pose, &e[1]), self.momentum(pose, &e[2])];
        let row = self.transpose(pose, &basis.column(0).into_owned());
        let ([a, c], off) = (self.arm_inertia, self.coupling * pose.elbow_cosine);
        let (turret, arms) = (self.spin(pose).0, Matrix2::new(a, off, off, c));
        WallTerms {
            e: Matrix3::from_columns(&e),
            me: momenta[0],
            w: symmetric_matrix(|i, j| e[i].dot(&momenta[j])),
            b: self.velocity_torque(pose, qd) + self.gravity(pose),
            row,
            w_eff: inertia_with_turret(turret, row[0], &arms, &Vector2::new(row[1], row[2])),
        }
    }
}
