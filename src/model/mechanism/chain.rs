//! `chain`: one to three revolute or prismatic joints in series, with any axes and any inertia tensors.
//!
//! Every joint moves along or about the z axis of its frame, and the constant transform from one link to the next joint
//! is a translation and one rotation about x: [`lumped`] turns the maker's frames until this is so. The kinematics go
//! through the links once, in the frame of the first link.
//!
//! Each entry of M is a polynomial in (u, v) of the joints behind the first: (cos q, sin q) of a revolute joint, (q, 0)
//! of a prismatic one. It has degree two at most, v² = 1 - u², so its constant coefficients describe all links, all
//! angles and all rotors. Its derivatives give the Coriolis torques. A term of the joint's second-order basis
//! (1, u, v, u², uv) is a column, and the arrays of joint b (the last but one) are the rows.

mod lumped;

use super::{Mechanism, Regularity, reciprocal};
use crate::math::{Angle, BinaryAngle, Math, Real, cast};
use crate::model::catalogue::{MAX_JOINTS, Spec};
use crate::model::description::{Description, DescriptionError};
use nalgebra::{SMatrix, SVector, Vector3};
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

/// Share of the largest determinant of J below which its reciprocal is clamped.
const DETERMINANT_FLOOR: f64 = 1.0e-7;

/// Coefficients of a chain of N joints. Arrays over joints and links begin with the first of the N.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct Chain<T, const N: usize> {
    joints: [ChainJoint<T>; MAX_JOINTS],
    /// Tip in the frame of the last link, m.
    tip: [T; 3],
    /// Distance of the tip from the axis, m, if the task is the length of its arc.
    arc: Option<T>,
    /// Rotation from the first joint's frame to the task: a row for each task coordinate.
    task: [[T; 3]; MAX_JOINTS],
    /// Task coordinates of the first joint's origin, m.
    origin: [T; MAX_JOINTS],
    mass: MassSeries<T>,
    /// Gravity in the first joint's frame, m/s².
    gravity: [T; 3],
    /// 1/(largest |det J| over the joint angles).
    determinant_scale: T,
    /// Smallest |det J| used as a divisor.
    determinant_floor: T,
}

/// A chain of one joint.
pub type Chain1<T> = Chain<T, 1>;
/// A chain of two joints.
pub type Chain2<T> = Chain<T, 2>;
/// A chain of three joints.
pub type Chain3<T> = Chain<T, 3>;

/// A joint, and the link that it moves.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, Schema)]
struct ChainJoint<T> {
    prismatic: bool,
    /// Angle from the joint's zero to the zero of its frame, rad and in binary. Zero in the first joint.
    offset: T,
    binary_offset: u32,
    /// Sine and cosine of `offset`.
    turn: (T, T),
    /// Cosine of the angle about x from the frame of the link before to the joint's frame. Unused in the first joint.
    cosine: T,
    /// Sine of the same angle.
    sine: T,
    /// Origin of the joint's frame in the frame of the link before, m. Unused in the first joint.
    origin: [T; 3],
    /// First moment of the link's own mass in its frame, with the mass of all later links at their origin, kg m.
    moment: [T; 3],
    /// Mass of this link and all later links, kg.
    mass: T,
}

/// Coefficients of the mass matrix. The last joint is c, the joint before it b, and the joint before that a.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, Schema)]
struct MassSeries<T> {
    cc: T,
    bc: [T; 3],
    bb: [T; 5],
    ac: [[T; 3]; 3],
    ab: [[T; 5]; 3],
    aa: [[T; 5]; 5],
}

/// The powers of a joint's (u, v) and their derivatives with respect to the joint's angle or travel.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Basis<T> {
    u: T,
    v: T,
    uu: T,
    uv: T,
    /// Derivatives of u, v, u² and uv.
    slope: [T; 4],
}

/// The mass matrix with its derivatives with respect to the last two joints, lower triangles.
struct MassTerms<T: Real, const N: usize> {
    mass: SMatrix<T, N, N>,
    /// Derivative with respect to joint b. Only its entries aa, ab and ac are not zero.
    by_b: [T; 3],
    /// Derivative with respect to joint c: aa, ab, ac, bb, bc.
    by_c: [T; 5],
}

/// Quantities that depend on the joint coordinates alone.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose<T: Real, const N: usize> {
    /// Coordinates of the joints, rad or m.
    q: [T; N],
    cosine: [T; N],
    sine: [T; N],
    tip: SVector<T, N>,
    /// Axis of each joint in the frame of the first link.
    axis: [Vector3<T>; N],
    /// Velocity of the tip per unit velocity of each joint in the frame of the first link.
    lever: [Vector3<T>; N],
    /// Rows of the rotation from the first link to the task.
    task: [Vector3<T>; N],
    jacobian: SMatrix<T, N, N>,
    /// J⁻¹ det J.
    adjugate: SMatrix<T, N, N>,
    determinant: T,
    /// 1/det J, clamped.
    inverse_determinant: T,
}

/// Returns v after a rotation about z.
#[inline(always)]
fn about_z<T: Real>(v: &Vector3<T>, c: T, s: T) -> Vector3<T> {
    Vector3::new(c * v[0] - s * v[1], s * v[0] + c * v[1], v[2])
}

/// Returns v after a rotation about x.
#[inline(always)]
fn about_x<T: Real>(v: &Vector3<T>, c: T, s: T) -> Vector3<T> {
    Vector3::new(v[0], c * v[1] - s * v[2], s * v[1] + c * v[2])
}

impl<T: Real> ChainJoint<T> {
    /// Returns the angle from the zero of the joint's frame.
    #[inline(always)]
    fn turned(&self, angle: Angle<T>) -> Angle<T> {
        let binary = angle.binary.map(|binary| BinaryAngle(binary.0.wrapping_add(self.binary_offset)));
        Angle { radians: angle.radians + self.offset, binary }
    }
}

impl<T: Real> Basis<T> {
    #[inline(always)]
    fn new(prismatic: bool, q: T, c: T, s: T) -> Self {
        let (u, v, du, dv) = if prismatic { (q, T::zero(), T::one(), T::zero()) } else { (c, s, -s, c) };
        Self { u, v, uu: u * u, uv: u * v, slope: [du, dv, (u + u) * du, du * v + u * dv] }
    }

    #[inline(always)]
    fn first(&self, k: &[T; 3]) -> T {
        k[0] + k[1] * self.u + k[2] * self.v
    }

    #[inline(always)]
    fn first_slope(&self, k: &[T; 3]) -> T {
        k[1] * self.slope[0] + k[2] * self.slope[1]
    }

    #[inline(always)]
    fn second(&self, k: &[T; 5]) -> T {
        k[0] + k[1] * self.u + k[2] * self.v + k[3] * self.uu + k[4] * self.uv
    }

    #[inline(always)]
    fn second_slope(&self, k: &[T; 5]) -> T {
        k[1] * self.slope[0] + k[2] * self.slope[1] + k[3] * self.slope[2] + k[4] * self.slope[3]
    }
}

impl<T: Real, const N: usize> Chain<T, N> {
    /// Converts to another precision.
    pub fn cast<U: Real>(&self) -> Chain<U, N> {
        Chain {
            joints: self.joints.map(|joint| ChainJoint {
                prismatic: joint.prismatic,
                offset: cast(joint.offset),
                binary_offset: joint.binary_offset,
                turn: (cast(joint.turn.0), cast(joint.turn.1)),
                cosine: cast(joint.cosine),
                sine: cast(joint.sine),
                origin: joint.origin.map(cast),
                moment: joint.moment.map(cast),
                mass: cast(joint.mass),
            }),
            tip: self.tip.map(cast),
            arc: self.arc.map(cast),
            task: self.task.map(|row| row.map(cast)),
            origin: self.origin.map(cast),
            mass: MassSeries {
                cc: cast(self.mass.cc),
                bc: self.mass.bc.map(cast),
                bb: self.mass.bb.map(cast),
                ac: self.mass.ac.map(|row| row.map(cast)),
                ab: self.mass.ab.map(|row| row.map(cast)),
                aa: self.mass.aa.map(|row| row.map(cast)),
            },
            gravity: self.gravity.map(cast),
            determinant_scale: cast(self.determinant_scale),
            determinant_floor: cast(self.determinant_floor),
        }
    }

    /// Returns the basis of the joint `back` joints before the last one.
    #[inline(always)]
    fn basis(&self, pose: &Pose<T, N>, back: usize) -> Basis<T> {
        let i = N - 1 - back;
        Basis::new(self.joints[i].prismatic, pose.q[i], pose.cosine[i], pose.sine[i])
    }

    /// Returns the mass matrix and its derivatives. A caller that needs only one of them pays only for that one.
    #[inline(always)]
    fn mass_terms(&self, pose: &Pose<T, N>) -> MassTerms<T, N> {
        let (series, zero) = (&self.mass, T::zero());
        let mut terms = MassTerms { mass: SMatrix::zeros(), by_b: [zero; 3], by_c: [zero; 5] };
        let mut put = |i: usize, j: usize, entry: T| {
            terms.mass[(N - i, N - j)] = entry;
            terms.mass[(N - j, N - i)] = entry;
        };
        put(1, 1, series.cc);
        if N >= 2 {
            let c = self.basis(pose, 0);
            put(2, 1, c.first(&series.bc));
            put(2, 2, c.second(&series.bb));
            terms.by_c[3] = c.second_slope(&series.bb);
            terms.by_c[4] = c.first_slope(&series.bc);
            if N >= 3 {
                let b = self.basis(pose, 1);
                let (aa, ab, ac) = (
                    series.aa.each_ref().map(|row| c.second(row)),
                    series.ab.each_ref().map(|row| c.second(row)),
                    series.ac.each_ref().map(|row| c.first(row)),
                );
                put(3, 3, b.second(&aa));
                put(3, 2, b.first(&ab));
                put(3, 1, b.first(&ac));
                terms.by_b = [b.second_slope(&aa), b.first_slope(&ab), b.first_slope(&ac)];
                terms.by_c[0] = b.second(&series.aa.each_ref().map(|row| c.second_slope(row)));
                terms.by_c[1] = b.first(&series.ab.each_ref().map(|row| c.second_slope(row)));
                terms.by_c[2] = b.first(&series.ac.each_ref().map(|row| c.first_slope(row)));
            }
        }
        terms
    }

    /// Returns the Coriolis and centrifugal torques: Ṁ q̇ less half the gradient of q̇ᵀ M q̇.
    #[inline(always)]
    fn coriolis_of(terms: &MassTerms<T, N>, qd: &SVector<T, N>) -> SVector<T, N> {
        let half = T::from_f64(0.5);
        let mut torque = SVector::zeros();
        if N == 2 {
            let [.., bb, bc] = terms.by_c;
            let (b, c) = (qd[0], qd[N - 1]);
            let moved = bb * b + bc * c;
            torque[0] = moved * c;
            torque[N - 1] = bc * b * c - half * b * (moved + bc * c);
        } else if N == 3 {
            let ([baa, bab, bac], [caa, cab, cac, cbb, cbc]) = (terms.by_b, terms.by_c);
            let (a, b, c) = (qd[0], qd[N - 2], qd[N - 1]);
            let by_b = [baa * a + bab * b + bac * c, bab * a, bac * a];
            let by_c = [caa * a + cab * b + cac * c, cab * a + cbb * b + cbc * c, cac * a + cbc * b];
            torque[0] = by_b[0] * b + by_c[0] * c;
            torque[N - 2] = by_b[1] * b + by_c[1] * c - half * (a * by_b[0] + b * by_b[1] + c * by_b[2]);
            torque[N - 1] = by_b[2] * b + by_c[2] * c - half * (a * by_c[0] + b * by_c[1] + c * by_c[2]);
        }
        torque
    }

    /// Returns J̇ q̇, the tip's acceleration while no joint accelerates.
    #[inline(always)]
    fn tip_acceleration(&self, pose: &Pose<T, N>, qd: &SVector<T, N>) -> SVector<T, N> {
        // Σᵢ q̇ᵢ zᵢ × (q̇ᵢ Jᵢ + 2 Σ_{j>i} q̇ⱼ Jⱼ) over the revolute joints i.
        let (mut acceleration, mut later) = (Vector3::zeros(), Vector3::zeros());
        for i in (0..N).rev() {
            let own = pose.lever[i] * qd[i];
            let moved = own + later;
            if !self.joints[i].prismatic {
                acceleration += if i == 0 {
                    Vector3::new(-moved[1] * qd[i], moved[0] * qd[i], T::zero())
                } else {
                    pose.axis[i].cross(&moved) * qd[i]
                };
            }
            later = moved + own;
        }
        if self.arc.is_some() {
            return SVector::zeros();
        }
        SVector::from_fn(|row, _| pose.task[row].dot(&acceleration))
    }
}

/// Returns the adjugate of a matrix with one to three rows, and its determinant.
#[inline(always)]
fn adjugate<T: Real, const N: usize>(m: &SMatrix<T, N, N>) -> (SMatrix<T, N, N>, T) {
    let mut adjugate = SMatrix::<T, N, N>::identity();
    if N == 1 {
        return (adjugate, m[(0, 0)]);
    }
    if N == 2 {
        let l = N - 1;
        (adjugate[(0, 0)], adjugate[(l, l)]) = (m[(l, l)], m[(0, 0)]);
        (adjugate[(0, l)], adjugate[(l, 0)]) = (-m[(0, l)], -m[(l, 0)]);
        return (adjugate, m[(0, 0)] * m[(l, l)] - m[(0, l)] * m[(l, 0)]);
    }
    for i in 0..N {
        for j in 0..N {
            let (r, s, c, d) = ((j + 1) % N, (j + 2) % N, (i + 1) % N, (i + 2) % N);
            adjugate[(i, j)] = m[(r, c)] * m[(s, d)] - m[(r, d)] * m[(s, c)];
        }
    }
    let determinant = (0..N).fold(T::zero(), |sum, i| sum + m[(0, i)] * adjugate[(i, 0)]);
    (adjugate, determinant)
}

impl<T: Real, const N: usize> Mechanism<T, N> for Chain<T, N> {
    const SPEC: Spec = Spec {
        name: "chain",
        joints: N,
        task: N,
        links: match N {
            1 => &["link-1"],
            2 => &["link-1", "link-2"],
            _ => &["link-1", "link-2", "link-3"],
        },
        are_links_optional: false,
        geometry: &[("tip", 3), ("task", N)],
        gravity: 3,
    };
    const MASS_ENTRIES: &'static [(usize, usize)] = match N {
        1 => &[(0, 0)],
        2 => &[(0, 0), (1, 0), (1, 1)],
        _ => &[(0, 0), (1, 0), (1, 1), (2, 0), (2, 1), (2, 2)],
    };
    type Pose = Pose<T, N>;

    fn new(description: &Description) -> Result<Self, DescriptionError> {
        lumped::chain(description)
    }

    #[inline(always)]
    fn pose_at<K: Math<T>>(&self, angles: &[Angle<T>; N]) -> Pose<T, N> {
        let zero = T::zero();
        let mut pose = Pose {
            q: angles.each_ref().map(|angle| angle.radians),
            cosine: [zero; N],
            sine: [zero; N],
            tip: SVector::zeros(),
            axis: [Vector3::z(); N],
            lever: [Vector3::z(); N],
            task: [Vector3::zeros(); N],
            jacobian: SMatrix::zeros(),
            adjugate: SMatrix::zeros(),
            determinant: zero,
            inverse_determinant: zero,
        };
        // The tip in the frame of each link, from the last to the first; the levers and axes go along.
        let mut tip = Vector3::from(self.tip);
        for i in (0..N).rev() {
            let joint = &self.joints[i];
            if joint.prismatic {
                (pose.sine[i], pose.cosine[i]) = joint.turn;
                tip[2] += pose.q[i];
            } else {
                (pose.sine[i], pose.cosine[i]) = K::sin_cos_of(joint.turned(angles[i]));
                pose.lever[i] = Vector3::new(-tip[1], tip[0], zero);
            }
            if i == 0 {
                break;
            }
            let (c, s) = (pose.cosine[i], pose.sine[i]);
            tip = about_x(&about_z(&tip, c, s), joint.cosine, joint.sine) + Vector3::from(joint.origin);
            for later in i..N {
                pose.lever[later] = about_x(&about_z(&pose.lever[later], c, s), joint.cosine, joint.sine);
                if later > i {
                    pose.axis[later] = about_z(&pose.axis[later], c, s);
                }
                pose.axis[later] = about_x(&pose.axis[later], joint.cosine, joint.sine);
            }
        }
        let (c, s) = (pose.cosine[0], pose.sine[0]);
        for row in 0..N {
            let [x, y, z] = self.task[row];
            let turned = Vector3::new(x * c + y * s, y * c - x * s, z);
            pose.task[row] = turned;
            pose.tip[row] = self.origin[row] + turned.dot(&tip);
            for column in 0..N {
                pose.jacobian[(row, column)] = turned.dot(&pose.lever[column]);
            }
        }
        if let Some(radius) = self.arc {
            pose.tip[0] = radius * pose.q[0];
            pose.jacobian[(0, 0)] = radius;
        }
        (pose.adjugate, pose.determinant) = adjugate(&pose.jacobian);
        pose.inverse_determinant = reciprocal(pose.determinant, self.determinant_floor);
        pose
    }

    #[inline(always)]
    fn tip(&self, pose: &Pose<T, N>) -> SVector<T, N> {
        pose.tip
    }

    #[inline(always)]
    fn regularity(&self, pose: &Pose<T, N>) -> Regularity<T> {
        Regularity { serial: (pose.determinant * self.determinant_scale).abs(), parallel: T::one() }
    }

    #[inline(always)]
    fn jacobian(&self, pose: &Pose<T, N>) -> SMatrix<T, N, N> {
        pose.jacobian
    }

    fn jacobian_rate(&self, pose: &Pose<T, N>, qd: &SVector<T, N>) -> SMatrix<T, N, N> {
        // Column j of J̇ is the velocity of lever j: Σᵢ q̇ᵢ (zᵢ × Jⱼ for i <= j, zⱼ × Jᵢ for i > j).
        let mut rate = SMatrix::zeros();
        if self.arc.is_some() {
            return rate;
        }
        for j in 0..N {
            let mut column = Vector3::zeros();
            for i in 0..N {
                let first = i.min(j);
                if !self.joints[first].prismatic {
                    column += pose.axis[first].cross(&pose.lever[i.max(j)]) * qd[i];
                }
            }
            for row in 0..N {
                rate[(row, j)] = pose.task[row].dot(&column);
            }
        }
        rate
    }

    #[inline(always)]
    fn mass(&self, pose: &Pose<T, N>) -> SMatrix<T, N, N> {
        self.mass_terms(pose).mass
    }

    #[inline(always)]
    fn coriolis(&self, pose: &Pose<T, N>, qd: &SVector<T, N>) -> SVector<T, N> {
        Self::coriolis_of(&self.mass_terms(pose), qd)
    }

    #[inline(always)]
    fn gravity(&self, pose: &Pose<T, N>) -> SVector<T, N> {
        // Gravity in the frame of each link, then the moment of all later links about each joint.
        let mut gravity = [Vector3::from(self.gravity); N];
        for i in 0..N {
            let before = if i == 0 { gravity[0] } else { gravity[i - 1] };
            let joint = &self.joints[i];
            let fixed = if i == 0 { before } else { about_x(&before, joint.cosine, -joint.sine) };
            gravity[i] = about_z(&fixed, pose.cosine[i], -pose.sine[i]);
        }
        let (mut torque, mut carried) = (SVector::zeros(), Vector3::zeros());
        for i in (0..N).rev() {
            let joint = &self.joints[i];
            let moment = carried + Vector3::from(joint.moment);
            if joint.prismatic {
                torque[i] = -joint.mass * gravity[i][2];
            } else {
                torque[i] = moment[1] * gravity[i][0] - moment[0] * gravity[i][1];
            }
            if i > 0 {
                let mut lifted = about_z(&moment, pose.cosine[i], pose.sine[i]);
                if joint.prismatic {
                    lifted[2] += joint.mass * pose.q[i];
                }
                carried = about_x(&lifted, joint.cosine, joint.sine);
            }
        }
        torque
    }

    #[inline(always)]
    fn inverse(&self, pose: &Pose<T, N>, velocity: &SVector<T, N>) -> SVector<T, N> {
        pose.adjugate * velocity * pose.inverse_determinant
    }

    #[inline(always)]
    fn velocity_torque(&self, pose: &Pose<T, N>, qd: &SVector<T, N>) -> SVector<T, N> {
        let terms = self.mass_terms(pose);
        let qdd_bias = self.inverse(pose, &self.tip_acceleration(pose, qd));
        Self::coriolis_of(&terms, qd) - terms.mass * qdd_bias
    }

    fn shape(&self, q: &SVector<T, N>) -> [T; 2] {
        [if N > 2 { q[1] } else { T::zero() }, if N > 1 { q[N - 1] } else { T::zero() }]
    }
}
