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
//!
//! A planar chain is an arm in a plane that the first joint moves, as most haptic arms are. It needs fewer operations,
//! because the angle of its last link against the first one is a sum, and many terms vanish.

mod lumped;

use super::{Mechanism, Regularity, ShapedTorque, Shaping, reciprocal};
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
    /// True if joints b and c turn about parallel axes, and neither is coupled with joint a by inertia.
    is_planar: bool,
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
    /// 1 for a revolute joint, 0 for a prismatic one. Products with it cost less than branches.
    turns: T,
    /// 1 for a prismatic joint, 0 for a revolute one.
    slides: T,
    /// Mask of the binary angle: all bits of a revolute joint, none of a prismatic one.
    angle_mask: u32,
    /// Angle from the joint's zero to the zero of its frame, rad and in binary. Zero in the first joint.
    offset: T,
    binary_offset: u32,
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
    /// Of a planar chain, the columns belong to the angle of link c against link a, and 13 entries are not zero.
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
    is_planar: bool,
}

/// Quantities that depend on the joint coordinates alone. Vectors are in the frame of the first link.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose<T: Real, const N: usize> {
    motions: [Motion<T>; N],
    tip: SVector<T, N>,
    /// Velocity of the tip per unit velocity of each joint.
    levers: [Vector3<T>; N],
    /// det J, which a left-handed order of the task's coordinates makes negative.
    determinant: T,
    /// 1/det of `levers` in space and of J otherwise, clamped.
    inverse_determinant: T,
    /// Cross products of the levers in space: the rows of their adjugate.
    adjugate: [Vector3<T>; N],
}

/// Coordinate of a joint, and the rotation about its axis from its frame to the frame of its link.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Motion<T> {
    /// Angle in rad or travel in m.
    q: T,
    /// Travel of a prismatic joint, m; zero for a revolute joint.
    lift: T,
    cosine: T,
    sine: T,
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

/// Returns the cosine and sine of the sum of the last two joints' angles.
#[inline(always)]
fn sum_of_angles<T: Real, const N: usize>(motions: &[Motion<T>; N]) -> (T, T) {
    let (b, c) = (&motions[N - 2], &motions[N - 1]);
    (b.cosine * c.cosine - b.sine * c.sine, b.sine * c.cosine + b.cosine * c.sine)
}

impl<T: Real> Motion<T> {
    /// Returns a vector of the joint's link in the frame of the joint.
    #[inline(always)]
    fn turned(&self, v: &Vector3<T>) -> Vector3<T> {
        about_z(v, self.cosine, self.sine)
    }

    /// Returns a vector in the frame of the joint in the frame of its link.
    #[inline(always)]
    fn turned_back(&self, v: &Vector3<T>) -> Vector3<T> {
        about_z(v, self.cosine, -self.sine)
    }

    /// Returns a point of the joint's link in the frame of the joint.
    #[inline(always)]
    fn moved(&self, point: &Vector3<T>) -> Vector3<T> {
        let turned = self.turned(point);
        Vector3::new(turned[0], turned[1], turned[2] + self.lift)
    }
}

impl<T: Real> ChainJoint<T> {
    #[inline(always)]
    fn motion<K: Math<T>>(&self, angle: Angle<T>) -> Motion<T> {
        let q = angle.radians;
        let turned = |binary: BinaryAngle| BinaryAngle((binary.0 & self.angle_mask).wrapping_add(self.binary_offset));
        let radians = q * self.turns + self.offset;
        let (sine, cosine) = K::sin_cos_of(Angle { radians, binary: angle.binary.map(turned) });
        Motion { q, lift: q * self.slides, cosine, sine }
    }

    /// Returns a vector in the joint's frame in the frame of the link before.
    #[inline(always)]
    fn before(&self, v: &Vector3<T>) -> Vector3<T> {
        about_x(v, self.cosine, self.sine)
    }

    /// Returns the joint's axis in the frame of the link before.
    #[inline(always)]
    fn axis_before(&self) -> Vector3<T> {
        Vector3::new(T::zero(), -self.sine, self.cosine)
    }

    /// Returns the velocity per unit velocity of the joint of a point in the joint's frame.
    #[inline(always)]
    fn lever(&self, point: &Vector3<T>) -> Vector3<T> {
        Vector3::new(-self.turns * point[1], self.turns * point[0], self.slides)
    }

    /// Returns [`ChainJoint::lever`] in the frame of the link before.
    #[inline(always)]
    fn lever_before(&self, point: &Vector3<T>) -> Vector3<T> {
        self.before(&self.lever(point))
    }

    /// Returns [`ChainJoint::lever_before`] of a revolute joint.
    #[inline(always)]
    fn turning_lever_before(&self, point: &Vector3<T>) -> Vector3<T> {
        Vector3::new(-point[1], self.cosine * point[0], self.sine * point[0])
    }

    /// Returns a vector in the frame of the link before in the frame of the joint's link.
    #[inline(always)]
    fn turned_back(&self, v: &Vector3<T>, motion: &Motion<T>) -> Vector3<T> {
        motion.turned_back(&about_x(v, self.cosine, -self.sine))
    }

    /// Returns the torque or force that holds this link and all later links, whose first moment of mass is `moment`
    /// (kg m), against gravity (m/s²). Both are in the link's frame.
    #[inline(always)]
    fn weight(&self, moment: &Vector3<T>, gravity: &Vector3<T>) -> T {
        self.turns * (moment[1] * gravity[0] - moment[0] * gravity[1]) - self.slides * self.mass * gravity[2]
    }

    /// Returns the first moment of mass of this link and all later links (kg m), of which `next` has the moment `later`.
    #[inline(always)]
    fn moment_with(&self, next: &Self, motion: &Motion<T>, later: &Vector3<T>) -> Vector3<T> {
        let mut moment = motion.turned(later);
        moment[2] += next.mass * motion.lift;
        next.before(&moment) + Vector3::from(self.moment)
    }

    /// Returns the acceleration of a point by the joint's rotation at the rate `qd` (rad/s) while the point moves with
    /// the velocity `v`: `axis` × v qd.
    #[inline(always)]
    fn turning(&self, axis: &Vector3<T>, v: &Vector3<T>, qd: T) -> Vector3<T> {
        axis.cross(&(v * (qd * self.turns)))
    }
}

impl<T: Real> Basis<T> {
    #[inline(always)]
    fn new(joint: &ChainJoint<T>, motion: &Motion<T>) -> Self {
        let (dv, v) = (joint.turns * motion.cosine, joint.turns * motion.sine);
        let (u, du) = (dv + motion.lift, joint.slides - v);
        Self { u, v, uu: u * u, uv: u * v, slope: [du, dv, (u + u) * du, du * v + u * dv] }
    }

    #[inline(always)]
    fn of_angle(u: T, v: T) -> Self {
        let (uu, uv) = (u * u, u * v);
        Self { u, v, uu, uv, slope: [-v, u, -uv - uv, uu - v * v] }
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
                turns: cast(joint.turns),
                slides: cast(joint.slides),
                angle_mask: joint.angle_mask,
                offset: cast(joint.offset),
                binary_offset: joint.binary_offset,
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
            is_planar: self.is_planar,
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

    /// Returns a vector in the frame of the first link along the task's coordinates.
    #[inline(always)]
    fn in_task(&self, first: &Motion<T>, v: &Vector3<T>) -> SVector<T, N> {
        let turned = first.turned(v);
        SVector::from_fn(|row, _| Vector3::from(self.task[row]).dot(&turned))
    }

    /// Returns a vector of the task in the frame of the first link.
    #[inline(always)]
    fn in_first_link(&self, first: &Motion<T>, v: &SVector<T, N>) -> Vector3<T> {
        let mut sum = Vector3::from(self.task[0]) * v[0];
        if N >= 2 {
            sum += Vector3::from(self.task[1]) * v[1];
        }
        if N >= 3 {
            sum += Vector3::from(self.task[2]) * v[N - 1];
        }
        first.turned_back(&sum)
    }

    /// Returns J from the levers.
    #[inline(always)]
    fn jacobian_of(&self, first: &Motion<T>, levers: &[Vector3<T>; N]) -> SMatrix<T, N, N> {
        let mut jacobian = SMatrix::<T, N, N>::zeros();
        for (column, lever) in levers.iter().enumerate() {
            jacobian.set_column(column, &self.in_task(first, lever));
        }
        if let (1, Some(radius)) = (N, self.arc) {
            jacobian[(0, 0)] = radius;
        }
        jacobian
    }

    /// Returns the basis of the joint `back` joints before the last one.
    #[inline(always)]
    fn basis(&self, motions: &[Motion<T>; N], back: usize) -> Basis<T> {
        let i = N - 1 - back;
        Basis::new(&self.joints[i], &motions[i])
    }

    /// Returns M and the Coriolis and centrifugal torques.
    #[inline(always)]
    fn mass_and_coriolis(&self, pose: &Pose<T, N>, qd: &SVector<T, N>) -> (SMatrix<T, N, N>, SVector<T, N>) {
        if N == 3 && !self.is_planar {
            // Passes copies, so that the planar case can keep the values in registers.
            return self.spatial_mass_and_coriolis(&{ pose.motions }, &{ *qd });
        }
        let terms = self.mass_terms(&pose.motions);
        (terms.mass, Self::coriolis_of(&terms, qd))
    }

    /// Computes [`Chain::mass_and_coriolis`] in a function of its own, because the long series would otherwise push the
    /// rest of the step out of the registers.
    #[inline(never)]
    fn spatial_mass_and_coriolis(
        &self,
        motions: &[Motion<T>; N],
        qd: &SVector<T, N>,
    ) -> (SMatrix<T, N, N>, SVector<T, N>) {
        let terms = self.general_mass_terms(motions);
        (terms.mass, Self::coriolis_of(&terms, qd))
    }

    /// Returns the mass matrix and its derivatives. A caller that needs only one of them pays only for that one.
    #[inline(always)]
    fn mass_terms(&self, motions: &[Motion<T>; N]) -> MassTerms<T, N> {
        if N == 3 && self.is_planar { self.planar_mass_terms(motions) } else { self.general_mass_terms(motions) }
    }

    #[inline(always)]
    fn general_mass_terms(&self, motions: &[Motion<T>; N]) -> MassTerms<T, N> {
        let (series, zero) = (&self.mass, T::zero());
        let mut terms = MassTerms { mass: SMatrix::zeros(), by_b: [zero; 3], by_c: [zero; 5], is_planar: false };
        let mut put = |i: usize, j: usize, entry: T| {
            terms.mass[(N - i, N - j)] = entry;
            terms.mass[(N - j, N - i)] = entry;
        };
        put(1, 1, series.cc);
        if N >= 2 {
            let c = self.basis(motions, 0);
            put(2, 1, c.first(&series.bc));
            put(2, 2, c.second(&series.bb));
            terms.by_c[3] = c.second_slope(&series.bb);
            terms.by_c[4] = c.first_slope(&series.bc);
            if N >= 3 {
                let b = self.basis(motions, 1);
                // Written out, because the compiler does not unroll these loops.
                let [a0, a1, a2, a3, a4] = &series.aa;
                let aa = [c.second(a0), c.second(a1), c.second(a2), c.second(a3), c.second(a4)];
                let by_c = [
                    c.second_slope(a0),
                    c.second_slope(a1),
                    c.second_slope(a2),
                    c.second_slope(a3),
                    c.second_slope(a4),
                ];
                let [b0, b1, b2] = &series.ab;
                let ab = [c.second(b0), c.second(b1), c.second(b2)];
                let [c0, c1, c2] = &series.ac;
                let ac = [c.first(c0), c.first(c1), c.first(c2)];
                put(3, 3, b.second(&aa));
                put(3, 2, b.first(&ab));
                put(3, 1, b.first(&ac));
                terms.by_b = [b.second_slope(&aa), b.first_slope(&ab), b.first_slope(&ac)];
                terms.by_c[0] = b.second(&by_c);
                terms.by_c[1] = b.first(&[c.second_slope(b0), c.second_slope(b1), c.second_slope(b2)]);
                terms.by_c[2] = b.first(&[c.first_slope(c0), c.first_slope(c1), c.first_slope(c2)]);
            }
        }
        terms
    }

    /// Returns [`Chain::mass_terms`] of a planar chain.
    #[inline(always)]
    fn planar_mass_terms(&self, motions: &[Motion<T>; N]) -> MassTerms<T, N> {
        let (series, zero) = (&self.mass, T::zero());
        let (b, c, (cosine, sine)) = (&motions[N - 2], &motions[N - 1], sum_of_angles(motions));
        // The angles of links b and c against link a.
        let (angle_b, angle_c) = (Basis::of_angle(b.cosine, b.sine), Basis::of_angle(cosine, sine));
        let [a0, [u0, u1, u2, ..], [v0, v1, v2, ..], [a3, ..], [a4, ..]] = &series.aa;
        let (u, v) = ([*u0, *u1, *u2], [*v0, *v1, *v2]);
        let aa = [angle_c.second(a0), angle_c.first(&u), angle_c.first(&v), *a3, *a4];
        let by_angle_c =
            angle_c.second_slope(a0) + b.cosine * angle_c.first_slope(&u) + b.sine * angle_c.first_slope(&v);
        let [bc0, bc1, bc2] = series.bc;
        let (coupling, slope) = (bc1 * c.cosine + bc2 * c.sine, bc2 * c.cosine - bc1 * c.sine);
        let mut mass = SMatrix::zeros();
        mass[(0, 0)] = angle_b.second(&aa);
        mass[(N - 2, N - 2)] = series.bb[0] + coupling + coupling;
        mass[(N - 2, N - 1)] = bc0 + coupling;
        mass[(N - 1, N - 2)] = bc0 + coupling;
        mass[(N - 1, N - 1)] = series.cc;
        MassTerms {
            mass,
            by_b: [angle_b.second_slope(&aa) + by_angle_c, zero, zero],
            by_c: [by_angle_c, zero, zero, slope + slope, slope],
            is_planar: true,
        }
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
        } else if N == 3 && terms.is_planar {
            let ([baa, ..], [caa, .., bc]) = (terms.by_b, terms.by_c);
            let (a, b, c) = (qd[0], qd[N - 2], qd[N - 1]);
            let half_square = half * a * a;
            torque[0] = (baa * b + caa * c) * a;
            torque[N - 2] = bc * c * (b + b + c) - half_square * baa;
            torque[N - 1] = -bc * b * b - half_square * caa;
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

    /// Returns the axis of a joint in the frame of the first link.
    #[inline(always)]
    fn axis(&self, pose: &Pose<T, N>, joint: usize) -> Vector3<T> {
        match joint {
            0 => Vector3::z(),
            2 => self.joints[1].before(&pose.motions[1].turned(&self.joints[2].axis_before())),
            _ => self.joints[1].axis_before(),
        }
    }

    /// Returns the tip's acceleration while no joint accelerates, in the frame of the first link.
    #[inline(always)]
    fn tip_acceleration(&self, pose: &Pose<T, N>, qd: &SVector<T, N>) -> Vector3<T> {
        // Σᵢ zᵢ × (q̇ᵢ Jᵢ + 2 Σ_{j>i} q̇ⱼ Jⱼ) q̇ᵢ over the revolute joints i.
        let joints = &self.joints;
        let first = pose.levers[0] * qd[0];
        if N == 1 {
            return joints[0].turning(&self.axis(pose, 0), &first, qd[0]);
        }
        let last = pose.levers[N - 1] * qd[N - 1];
        let mut later = last + last;
        let acceleration = if N == 3 {
            let middle = pose.levers[1] * qd[1];
            let (axis, seen) = (self.axis(pose, 1), middle + later);
            later += middle + middle;
            if self.is_planar {
                axis.cross(&(last * qd[N - 1] + seen * qd[1]))
            } else {
                joints[1].turning(&axis, &seen, qd[1]) + joints[2].turning(&self.axis(pose, 2), &last, qd[N - 1])
            }
        } else {
            joints[N - 1].turning(&self.axis(pose, N - 1), &last, qd[N - 1])
        };
        acceleration + joints[0].turning(&self.axis(pose, 0), &(first + later), qd[0])
    }

    /// Returns the joint velocities for a velocity of the tip, which in space is given in the frame of the first link.
    #[inline(always)]
    fn joint_velocities(&self, pose: &Pose<T, N>, spatial: &Vector3<T>) -> SVector<T, N> {
        // Written out, because a call would put the whole pose into memory.
        let mut rates = SVector::zeros();
        rates[0] = pose.adjugate[0].dot(spatial) * pose.inverse_determinant;
        rates[N - 2] = pose.adjugate[N - 2].dot(spatial) * pose.inverse_determinant;
        rates[N - 1] = pose.adjugate[N - 1].dot(spatial) * pose.inverse_determinant;
        rates
    }

    /// Returns the joint accelerations that cancel the tip's acceleration: J⁻¹ J̇ q̇.
    #[inline(always)]
    fn joint_acceleration(&self, pose: &Pose<T, N>, qd: &SVector<T, N>) -> SVector<T, N> {
        if N == 1 && self.arc.is_some() {
            return SVector::zeros();
        }
        let acceleration = self.tip_acceleration(pose, qd);
        if N == 3 {
            return self.joint_velocities(pose, &acceleration);
        }
        self.inverse(pose, &self.in_task(&pose.motions[0], &acceleration))
    }
}

impl<T: Real, const N: usize> Mechanism<T, N> for Chain<T, N> {
    const SPEC: Spec = Spec {
        name: "chain",
        label: match N {
            1 => "chain-1",
            2 => "chain-2",
            _ => "chain-3",
        },
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
    type Pose = Pose<T, N>;

    fn new(description: &Description) -> Result<Self, DescriptionError> {
        lumped::chain(description)
    }

    #[inline(always)]
    fn pose_at<K: Math<T>>(&self, angles: &[Angle<T>; N]) -> Pose<T, N> {
        let joints = &self.joints;
        // The loops over joints are written out, because the compiler does not unroll them.
        let mut motions = [joints[0].motion::<K>(angles[0]); N];
        let mut levers = [Vector3::z(); N];
        // The tip in the frame of each link, from the last to the first.
        let mut tip = Vector3::from(self.tip);
        if N >= 2 {
            motions[N - 1] = joints[N - 1].motion::<K>(angles[N - 1]);
        }
        if N >= 3 {
            motions[1] = joints[1].motion::<K>(angles[1]);
        }
        if N >= 3 && self.is_planar {
            let (joint, (cosine, sine)) = (&joints[1], sum_of_angles(&motions));
            let last = about_z(&tip, cosine, sine);
            let point = motions[1].turned(&Vector3::from(joints[N - 1].origin)) + last;
            levers[1] = joint.turning_lever_before(&point);
            levers[N - 1] = joint.turning_lever_before(&last);
            tip = joint.before(&point) + Vector3::from(joint.origin);
        } else if N >= 2 {
            let joint = &joints[N - 1];
            let point = motions[N - 1].moved(&tip);
            levers[N - 1] = joint.lever_before(&point);
            tip = joint.before(&point) + Vector3::from(joint.origin);
            if N >= 3 {
                let joint = &joints[1];
                let point = motions[1].moved(&tip);
                levers[1] = joint.lever_before(&point);
                levers[N - 1] = joint.before(&motions[1].turned(&levers[N - 1]));
                tip = joint.before(&point) + Vector3::from(joint.origin);
            }
        }
        levers[0] = joints[0].lever(&tip);
        tip[2] += motions[0].lift;
        let mut place = self.in_task(&motions[0], &tip);
        for (row, entry) in place.iter_mut().enumerate() {
            *entry += self.origin[row];
        }
        if let (1, Some(radius)) = (N, self.arc) {
            place[0] = radius * motions[0].q;
        }
        let jacobian = self.jacobian_of(&motions[0], &levers);
        let mut adjugate = [Vector3::zeros(); N];
        let determinant = match N {
            1 => jacobian[(0, 0)],
            2 => jacobian[(0, 0)] * jacobian[(N - 1, N - 1)] - jacobian[(0, N - 1)] * jacobian[(N - 1, 0)],
            _ => {
                adjugate[0] = levers[N - 2].cross(&levers[N - 1]);
                adjugate[N - 2] = levers[N - 1].cross(&levers[0]);
                adjugate[N - 1] = levers[0].cross(&levers[N - 2]);
                levers[0].dot(&adjugate[0])
            }
        };
        Pose {
            motions,
            tip: place,
            levers,
            determinant,
            inverse_determinant: reciprocal(determinant, self.determinant_floor),
            adjugate,
        }
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
        self.jacobian_of(&pose.motions[0], &pose.levers)
    }

    fn jacobian_rate(&self, pose: &Pose<T, N>, qd: &SVector<T, N>) -> SMatrix<T, N, N> {
        // Column j of J̇ is the velocity of lever j: Σᵢ q̇ᵢ (zᵢ × Jⱼ for i <= j, zⱼ × Jᵢ for i > j).
        let mut rate = SMatrix::<T, N, N>::zeros();
        for j in 0..if self.arc.is_some() { 0 } else { N } {
            let mut column = Vector3::zeros();
            for i in 0..N {
                let first = i.min(j);
                if !self.joints[first].prismatic {
                    column += self.axis(pose, first).cross(&pose.levers[i.max(j)]) * qd[i];
                }
            }
            rate.set_column(j, &self.in_task(&pose.motions[0], &column));
        }
        rate
    }

    #[inline(always)]
    fn mass(&self, pose: &Pose<T, N>) -> SMatrix<T, N, N> {
        self.mass_terms(&pose.motions).mass
    }

    #[inline(always)]
    fn coriolis(&self, pose: &Pose<T, N>, qd: &SVector<T, N>) -> SVector<T, N> {
        Self::coriolis_of(&self.mass_terms(&pose.motions), qd)
    }

    #[inline(always)]
    fn gravity(&self, pose: &Pose<T, N>) -> SVector<T, N> {
        // Gravity in the frame of each link, from the first to the last, and there the torque of the weight; the moment of
        // the later links goes from the last to the first.
        let joints = &self.joints;
        let first = pose.motions[0].turned_back(&Vector3::from(self.gravity));
        let mut torque = SVector::zeros();
        let last_moment = Vector3::from(joints[N - 1].moment);
        if N == 1 {
            torque[0] = joints[0].weight(&last_moment, &first);
            return torque;
        }
        if N == 3 && self.is_planar {
            // Both moments in the frame of joint b.
            let (joint, (cosine, sine)) = (&joints[1], sum_of_angles(&pose.motions));
            let last = about_z(&last_moment, cosine, sine);
            let moment = pose.motions[1].turned(&Vector3::from(joint.moment)) + last;
            let second = about_x(&first, joint.cosine, -joint.sine);
            torque[N - 1] = last[1] * second[0] - last[0] * second[1];
            torque[N - 2] = moment[1] * second[0] - moment[0] * second[1];
            torque[0] = joints[0].weight(&(joint.before(&moment) + Vector3::from(joints[0].moment)), &first);
            return torque;
        }
        let second = joints[1].turned_back(&first, &pose.motions[1]);
        if N == 2 {
            torque[N - 1] = joints[1].weight(&last_moment, &second);
            torque[0] =
                joints[0].weight(&joints[0].moment_with(&joints[1], &pose.motions[N - 1], &last_moment), &first);
            return torque;
        }
        let third = joints[2].turned_back(&second, &pose.motions[N - 1]);
        let middle_moment = joints[1].moment_with(&joints[2], &pose.motions[N - 1], &last_moment);
        let first_moment = joints[0].moment_with(&joints[1], &pose.motions[1], &middle_moment);
        torque[0] = joints[0].weight(&first_moment, &first);
        torque[N - 2] = joints[1].weight(&middle_moment, &second);
        torque[N - 1] = joints[2].weight(&last_moment, &third);
        torque
    }

    #[inline(always)]
    fn transpose(&self, pose: &Pose<T, N>, force: &SVector<T, N>) -> SVector<T, N> {
        if N < 3 {
            return self.jacobian(pose).tr_mul(force);
        }
        let spatial = self.in_first_link(&pose.motions[0], force);
        SVector::from_fn(|i, _| pose.levers[i].dot(&spatial))
    }

    #[inline(always)]
    fn velocity(&self, pose: &Pose<T, N>, qd: &SVector<T, N>) -> SVector<T, N> {
        if N < 3 {
            return self.jacobian(pose) * qd;
        }
        let spatial = pose.levers[0] * qd[0] + pose.levers[N - 2] * qd[N - 2] + pose.levers[N - 1] * qd[N - 1];
        self.in_task(&pose.motions[0], &spatial)
    }

    #[inline(always)]
    fn inverse(&self, pose: &Pose<T, N>, velocity: &SVector<T, N>) -> SVector<T, N> {
        if N == 3 {
            return self.joint_velocities(pose, &self.in_first_link(&pose.motions[0], velocity));
        }
        if N == 1 {
            return velocity * pose.inverse_determinant;
        }
        let (first, last, j) = (velocity[0], velocity[N - 1], self.jacobian(pose));
        let mut rates = SVector::zeros();
        rates[0] = (j[(N - 1, N - 1)] * first - j[(0, N - 1)] * last) * pose.inverse_determinant;
        rates[N - 1] = (j[(0, 0)] * last - j[(N - 1, 0)] * first) * pose.inverse_determinant;
        rates
    }

    #[inline(always)]
    fn velocity_torque(&self, pose: &Pose<T, N>, qd: &SVector<T, N>) -> SVector<T, N> {
        let (mass, coriolis) = self.mass_and_coriolis(pose, qd);
        coriolis - mass * self.joint_acceleration(pose, qd)
    }

    #[inline(always)]
    fn shaped_torque(
        &self,
        pose: &Pose<T, N>,
        n: &SVector<T, N>,
        force: T,
        qd: Option<&SVector<T, N>>,
    ) -> ShapedTorque<T, N> {
        let e = self.inverse(pose, n);
        let Some(qd) = qd else {
            let shaping = Shaping::of(&self.mass(pose), e);
            return ShapedTorque { e, torque: shaping.me * (force / shaping.w_rr) };
        };
        let (mass, coriolis) = self.mass_and_coriolis(pose, qd);
        let w_rr = e.dot(&(mass * e));
        ShapedTorque { e, torque: mass * (e * (force / w_rr) - self.joint_acceleration(pose, qd)) + coriolis }
    }

    fn repeats(&self, joint: usize) -> bool {
        self.arc.is_none() && !self.is_prismatic(joint)
    }

    fn is_prismatic(&self, joint: usize) -> bool {
        self.joints.get(joint).is_some_and(|joint| joint.prismatic)
    }
}
