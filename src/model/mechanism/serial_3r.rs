//! `serial-3r`: a planar arm of three links with relative joint angles; redundant for the tip position.
//!
//! The third task coordinate is the orientation φ = q₁ + q₂ + q₃, whose row of J is (1, 1, 1). In the links' absolute
//! angular rates θ̇ = (q̇₁, q̇₁ + q̇₂, φ̇), with link directions eᵢ, the tip velocity is ṗ = Σ lᵢ eᵢ⊥ θ̇ᵢ. For a given
//! φ̇ the other two rates are those of a two-link arm: θ̇₁ = v·e₂/(l₁ sin q₂), θ̇₂ = -v·e₁/(l₂ sin q₂), v = ṗ - l₃ e₃⊥
//! φ̇. The mass matrix in absolute rates has a constant diagonal. Its other entries are constants times the cosine of
//! the angle between the two links (less the reflected rotor between neighbours). Joint torques are sums of the moments
//! on the absolute angles, τᵢ = Σ_{j≥i}.

use super::{Mechanism, Regularity, SINE_FLOOR, Shaping, WallTerms, effective_inertia, reciprocal};
use crate::math::{Angle, Math, Real, cast};
use crate::model::catalogue::{Kind, Spec};
use crate::model::description::{Description, DescriptionError};
use nalgebra::{Matrix3, Vector2, Vector3};

/// Minimal coefficients of a planar 3R arm.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize, postcard_schema::Schema)]
pub struct Serial3r<T> {
    /// l₁, l₂, l₃, m.
    lengths: [T; 3],
    inverse_lengths: [T; 2],
    /// Diagonal of the mass matrix in absolute rates, kg m².
    inertia: [T; 3],
    /// Coefficients of the cosines between links 1 and 2, 2 and 3, 1 and 3, kg m².
    coupling: [T; 3],
    /// Rotor inertias of joints 2 and 3, kg m².
    rotor: [T; 2],
    /// First moments of mass along each link times gravity, N m.
    weight: [[T; 2]; 3],
}

/// Quantities that depend on the three angles alone.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose<T: Real> {
    /// Tip (m) and φ (rad).
    tip: Vector3<T>,
    /// e₁, e₂, e₃.
    link: [Vector2<T>; 3],
    /// Sines of q₂, q₃ and q₂ + q₃, the angles between links 1 and 2, 2 and 3, 1 and 3.
    sine: [T; 3],
    /// Cosines of q₂, q₃ and q₂ + q₃.
    cosine: [T; 3],
    /// 1/sin q₂, clamped.
    inverse_sine: T,
}

/// Returns `v` rotated left by 90°.
#[inline(always)]
fn rotated_left<T: Real>(v: &Vector2<T>) -> Vector2<T> {
    Vector2::new(-v[1], v[0])
}

/// Returns the absolute rates of the links for joint rates.
#[inline(always)]
fn absolute_rates<T: Real>(qd: &Vector3<T>) -> Vector3<T> {
    let second = qd[0] + qd[1];
    Vector3::new(qd[0], second, second + qd[2])
}

/// Returns the joint rates for absolute rates of the links.
#[inline(always)]
fn joint_rates<T: Real>(rates: &Vector3<T>) -> Vector3<T> {
    Vector3::new(rates[0], rates[1] - rates[0], rates[2] - rates[1])
}

/// Returns the joint torques for moments on the absolute angles.
#[inline(always)]
fn joint_torques<T: Real>(moments: &Vector3<T>) -> Vector3<T> {
    let second = moments[1] + moments[2];
    Vector3::new(moments[0] + second, second, moments[2])
}

impl<T: Real> Serial3r<T> {
    /// Converts to another precision.
    pub fn cast<U: Real>(&self) -> Serial3r<U> {
        Serial3r {
            lengths: self.lengths.map(cast),
            inverse_lengths: self.inverse_lengths.map(cast),
            inertia: self.inertia.map(cast),
            coupling: self.coupling.map(cast),
            rotor: self.rotor.map(cast),
            weight: self.weight.map(|row| row.map(cast)),
        }
    }

    /// Returns the absolute rates of the links for a task velocity.
    #[inline(always)]
    fn rates(&self, pose: &Pose<T>, point: &Vector2<T>, turning: T) -> Vector3<T> {
        let [first, second] =
            self.arm_rates(pose, &(point - rotated_left(&pose.link[2]) * (self.lengths[2] * turning)));
        Vector3::new(first, second, turning)
    }

    /// Returns the absolute rates of the first two links for a velocity `v` of the second link's end.
    #[inline(always)]
    fn arm_rates(&self, pose: &Pose<T>, v: &Vector2<T>) -> [T; 2] {
        [
            pose.link[1].dot(v) * pose.inverse_sine * self.inverse_lengths[0],
            -pose.link[0].dot(v) * pose.inverse_sine * self.inverse_lengths[1],
        ]
    }

    /// Returns the off-diagonal entries (12, 23, 13) of the mass matrix in absolute rates.
    #[inline(always)]
    fn off_diagonal_entries(&self, pose: &Pose<T>) -> [T; 3] {
        let [c12, c23, c13] = pose.cosine;
        [self.coupling[0] * c12 - self.rotor[0], self.coupling[1] * c23 - self.rotor[1], self.coupling[2] * c13]
    }

    /// Multiplies the mass matrix in absolute rates by the rates of the first two links and of the third link, if any.
    #[inline(always)]
    fn momentum(&self, pose: &Pose<T>, [first, second]: [T; 2], third: Option<T>) -> Vector3<T> {
        let [m12, m23, m13] = self.off_diagonal_entries(pose);
        let [m11, m22, m33] = self.inertia;
        let momentum = Vector3::new(m11 * first + m12 * second, m12 * first + m22 * second, m13 * first + m23 * second);
        third.map_or(momentum, |third| momentum + Vector3::new(m13, m23, m33) * third)
    }

    /// Returns the centrifugal moments on the absolute angles, from the squares of their rates.
    #[inline(always)]
    fn centrifugal_moments(&self, pose: &Pose<T>, squares: &Vector3<T>) -> Vector3<T> {
        let [k12, k23, k13] = self.coupling;
        let [s12, s23, s13] = pose.sine;
        let (a, b, c) = (k12 * s12, k23 * s23, k13 * s13);
        Vector3::new(-a * squares[1] - c * squares[2], a * squares[0] - b * squares[2], c * squares[0] + b * squares[1])
    }
}

impl<T: Real> Mechanism<T, 3> for Serial3r<T> {
    const SPEC: Spec = Spec {
        name: "serial-3r",
        label: "serial-3r",
        joints: 3,
        task: 2,
        links: &["link-1", "link-2", "link-3"],
        geometry: &[("lengths", 3)],
        are_links_optional: false,
        gravity: 2,
    };
    type Pose = Pose<T>;

    fn new(description: &Description) -> Result<Self, DescriptionError> {
        if description.kind != Kind::Serial3r {
            return Err(DescriptionError::WrongKind);
        }
        let [l1, l2, l3, ..] = description.geometry;
        for length in [l1, l2, l3] {
            if length.is_nan() || length <= 0.0 {
                return Err(DescriptionError::GeometryNotPositive(0));
            }
        }
        let [link1, link2, link3, _] = description.links;
        let [j1, j2, j3] = description.joints.map(|joint| joint.inertia);
        let handle = description.handle_mass;
        let own = |link: &crate::model::description::Link| link.inertia + link.mass * link.com * link.com;
        // First moments of each link and all later links about its proximal joint.
        let moment3 = link3.mass * link3.com + handle * l3;
        let moment2 = link2.mass * link2.com + (link3.mass + handle) * l2;
        let moment1 = link1.mass * link1.com + (link2.mass + link3.mass + handle) * l1;
        let links = [
            own(&link1) + (link2.mass + link3.mass + handle) * l1 * l1,
            own(&link2) + (link3.mass + handle) * l2 * l2,
            own(&link3) + handle * l3 * l3,
        ];
        let inertias = [links[0] + j1, links[1] + j2, links[2] + j3];
        if inertias.into_iter().any(|value| value.is_nan() || value <= 0.0) {
            return Err(DescriptionError::NoInertia);
        }
        let real = T::from_f64;
        let weight = |moment: f64| [real(moment * description.gravity[0]), real(moment * description.gravity[1])];
        Ok(Self {
            lengths: [real(l1), real(l2), real(l3)],
            inverse_lengths: [real(1.0 / l1), real(1.0 / l2)],
            inertia: [real(links[0] + j1 + j2), real(links[1] + j2 + j3), real(links[2] + j3)],
            coupling: [real(l1 * moment2), real(l2 * moment3), real(l1 * moment3)],
            rotor: [real(j2), real(j3)],
            weight: [weight(moment1), weight(moment2), weight(moment3)],
        })
    }

    #[inline(always)]
    fn pose_at<K: Math<T>>(&self, q: &[Angle<T>; 3]) -> Pose<T> {
        let (s1, c1) = K::sin_cos_of(q[0]);
        let (s12, c12) = K::sin_cos_of(q[1]);
        let (s23, c23) = K::sin_cos_of(q[2]);
        let turned = |v: &Vector2<T>, s: T, c: T| Vector2::new(v[0] * c - v[1] * s, v[1] * c + v[0] * s);
        let first = Vector2::new(c1, s1);
        let second = turned(&first, s12, c12);
        let third = turned(&second, s23, c23);
        let across = turned(&Vector2::new(c12, s12), s23, c23);
        let [l1, l2, l3] = self.lengths;
        let point = first * l1 + second * l2 + third * l3;
        Pose {
            tip: Vector3::new(point[0], point[1], q[0].radians + q[1].radians + q[2].radians),
            link: [first, second, third],
            sine: [s12, s23, across[1]],
            cosine: [c12, c23, across[0]],
            inverse_sine: reciprocal(s12, T::from_f64(SINE_FLOOR)),
        }
    }

    #[inline(always)]
    fn tip(&self, pose: &Pose<T>) -> Vector3<T> {
        pose.tip
    }

    #[inline(always)]
    fn regularity(&self, pose: &Pose<T>) -> Regularity<T> {
        Regularity { serial: pose.sine[0].abs(), parallel: T::one() }
    }

    fn jacobian(&self, pose: &Pose<T>) -> Matrix3<T> {
        let [l1, l2, l3] = self.lengths;
        let third = rotated_left(&pose.link[2]) * l3;
        let second = third + rotated_left(&pose.link[1]) * l2;
        let first = second + rotated_left(&pose.link[0]) * l1;
        let one = T::one();
        Matrix3::new(first[0], second[0], third[0], first[1], second[1], third[1], one, one, one)
    }

    fn jacobian_rate(&self, pose: &Pose<T>, qd: &Vector3<T>) -> Matrix3<T> {
        let rates = absolute_rates(qd);
        let column = |i: usize| pose.link[i] * (-self.lengths[i] * rates[i]);
        let third = column(2);
        let second = third + column(1);
        let first = second + column(0);
        let zero = T::zero();
        Matrix3::new(first[0], second[0], third[0], first[1], second[1], third[1], zero, zero, zero)
    }

    fn mass(&self, pose: &Pose<T>) -> Matrix3<T> {
        let [m12, m23, m13] = self.off_diagonal_entries(pose);
        let [m11, m22, m33] = self.inertia;
        let two = T::from_f64(2.0);
        let last = [m13 + m23 + m33, m23 + m33, m33];
        let middle = [m12 + m22 + m13 + m23 + last[1], m22 + m23 + last[1]];
        let first = m11 + m22 + m33 + two * (m12 + m13 + m23);
        Matrix3::new(first, middle[0], last[0], middle[0], middle[1], last[1], last[0], last[1], last[2])
    }

    fn coriolis(&self, pose: &Pose<T>, qd: &Vector3<T>) -> Vector3<T> {
        let rates = absolute_rates(qd);
        joint_torques(&self.centrifugal_moments(pose, &rates.component_mul(&rates)))
    }

    #[inline(always)]
    fn gravity(&self, pose: &Pose<T>) -> Vector3<T> {
        let moment = |i: usize| pose.link[i][1] * self.weight[i][0] - pose.link[i][0] * self.weight[i][1];
        joint_torques(&Vector3::new(moment(0), moment(1), moment(2)))
    }

    #[inline(always)]
    fn transpose(&self, pose: &Pose<T>, force: &Vector3<T>) -> Vector3<T> {
        let moment = |i: usize| self.lengths[i] * (pose.link[i][0] * force[1] - pose.link[i][1] * force[0]);
        joint_torques(&Vector3::new(moment(0), moment(1), moment(2) + force[2]))
    }

    #[inline(always)]
    fn velocity(&self, pose: &Pose<T>, qd: &Vector3<T>) -> Vector3<T> {
        let rates = absolute_rates(qd);
        let [l1, l2, l3] = self.lengths;
        let [v1, v2, v3] = [l1 * rates[0], l2 * rates[1], l3 * rates[2]];
        let [e1, e2, e3] = &pose.link;
        Vector3::new(-v1 * e1[1] - v2 * e2[1] - v3 * e3[1], v1 * e1[0] + v2 * e2[0] + v3 * e3[0], rates[2])
    }

    #[inline(always)]
    fn inverse(&self, pose: &Pose<T>, velocity: &Vector3<T>) -> Vector3<T> {
        joint_rates(&self.rates(pose, &Vector2::new(velocity[0], velocity[1]), velocity[2]))
    }

    #[inline(always)]
    fn shaping(&self, pose: &Pose<T>, n: &Vector3<T>) -> Shaping<T, 3> {
        let rates = self.rates(pose, &Vector2::new(n[0], n[1]), n[2]);
        let momentum = self.momentum(pose, [rates[0], rates[1]], Some(rates[2]));
        Shaping { e: joint_rates(&rates), me: joint_torques(&momentum), w_rr: rates.dot(&momentum) }
    }

    #[inline(always)]
    fn velocity_torque(&self, pose: &Pose<T>, qd: &Vector3<T>) -> Vector3<T> {
        let rates = absolute_rates(qd);
        let squares = rates.component_mul(&rates);
        let [l1, l2, l3] = self.lengths;
        let [e1, e2, e3] = &pose.link;
        let point = e1 * (l1 * squares[0]) + e2 * (l2 * squares[1]) + e3 * (l3 * squares[2]);
        let momentum = self.momentum(pose, self.arm_rates(pose, &point), None);
        joint_torques(&(momentum + self.centrifugal_moments(pose, &squares)))
    }

    #[inline(always)]
    fn wall_terms(&self, pose: &Pose<T>, basis: &Matrix3<T>, qd: &Vector3<T>) -> WallTerms<T, 3> {
        // Computes `arm_rates` for several velocities.
        let first = pose.link[1] * (pose.inverse_sine * self.inverse_lengths[0]);
        let second = pose.link[0] * (-pose.inverse_sine * self.inverse_lengths[1]);
        let arms = |v: Vector2<T>| [first.dot(&v), second.dot(&v)];
        // The third link does not rotate along the wall's normal or across it. For φ it rotates about the tip.
        let (n, one, zero) = (Vector2::new(basis[(0, 0)], basis[(1, 0)]), T::one(), T::zero());
        let (along, across, about) =
            (arms(n), arms(rotated_left(&n)), arms(rotated_left(&pose.link[2]) * -self.lengths[2]));
        let momentum = |rates: [T; 2], third| self.momentum(pose, rates, third);
        let (pn, pt, pf) = (momentum(along, None), momentum(across, None), momentum(about, Some(one)));
        let product = |p: &Vector3<T>, rates: [T; 2]| p[0] * rates[0] + p[1] * rates[1];
        let (nn, nt, tt) = (product(&pn, along), product(&pn, across), product(&pt, across));
        let (nf, tf, ff) = (product(&pn, about) + pn[2], product(&pt, about) + pt[2], product(&pf, about) + pf[2]);
        let e = |rates: [T; 2], third| joint_rates(&Vector3::new(rates[0], rates[1], third));
        // Weff in absolute rates, because the mass matrix then has the fewest terms.
        let moment = |i: usize| self.lengths[i] * (pose.link[i][0] * n[1] - pose.link[i][1] * n[0]);
        let moments = Vector3::new(moment(0), moment(1), moment(2));
        let ([m11, m22, m33], [m12, m23, m13]) = (self.inertia, self.off_diagonal_entries(pose));
        let mass = Matrix3::new(m11, m12, m13, m12, m22, m23, m13, m23, m33);
        WallTerms {
            e: Matrix3::from_columns(&[e(along, zero), e(across, zero), e(about, one)]),
            me: joint_torques(&pn),
            w: Matrix3::new(nn, nt, nf, nt, tt, tf, nf, tf, ff),
            b: self.velocity_torque(pose, qd) + self.gravity(pose),
            row: joint_torques(&moments),
            w_eff: effective_inertia(&mass, &moments),
        }
    }
}
