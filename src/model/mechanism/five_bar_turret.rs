//! `five-bar-turret`: a five-bar whose plane is rotated about its x axis by a third motor. The tip moves in space.
//!
//! World (X, Y, Z) = (x, y cos q₀, y sin q₀). In the rotating frame (x, radial, normal) the motion separates. In the
//! plane it is the motion of `five_bar.rs`; across the plane the tip moves at y q̇₀. So J = R [J_plane; y], M =
//! diag(J₀, M_plane), and the code of the plane is reused.
//!
//! The turret's inertia needs no distal angle either. A link's inertia about the axis is m y_com² + I_axial +
//! (I_transverse - I_axial) sin²(angle to the axis), and y_com and the sine are linear in the y of the link's two ends.
//! The sum over the links is a quadratic form in the y of the two elbows and the tip: J₀ = I₀ + a₁ y_C² + a₂ y_D² + 2
//! y_P(b₁ y_C + b₂ y_D) + c y_P². Half its gradient times q̇₀² gives the centrifugal forces on elbows and tip.

use super::five_bar::{self, FiveBar, Levers, UnitMotion};
use super::{
    Mechanism, Regularity, SINE_FLOOR, ShapedTorque, Shaping, WallTerms, inertia_with_turret, reciprocal,
    symmetric_matrix,
};
use crate::math::{Angle, Math, Real, cast};
use crate::model::catalogue::{Kind, Spec};
use crate::model::description::{Description, DescriptionError};
use nalgebra::{Matrix3, Vector2, Vector3};

/// Minimal coefficients of a five-bar on a turret.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize, postcard_schema::Schema)]
pub struct FiveBarTurret<T> {
    /// The linkage; its gravity is the world's (X, Y).
    plane: FiveBar<T>,
    /// Gravity along the world's Z, m/s².
    gravity_z: T,
    /// I₀: inertia of the turret, its rotor and the links about their own axes, kg m².
    turret_inertia: T,
    /// aᵢ: coefficient of the squared y of each elbow, kg.
    elbow_spin: [T; 2],
    /// bᵢ: coefficient of the product of each elbow's y and the tip's y, kg.
    coupled_spin: [T; 2],
    /// c: coefficient of the squared y of the tip, kg.
    tip_spin: T,
    /// 1/(largest distance of the tip from the axis), 1/m: converts |y| to a number in [0, 1].
    reach_scale: T,
    /// Smallest |y| used as a divisor, m.
    axis_floor: T,
}

/// Quantities that depend on the three angles alone.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose<T: Real> {
    /// The linkage in its plane.
    plane: five_bar::Pose<T>,
    /// sin q₀.
    sine: T,
    /// cos q₀.
    cosine: T,
    /// 1/y, clamped.
    inverse_y: T,
}

/// The turret's inertia, and half its gradient with respect to the y of the elbows and the tip, kg m².
struct Spin<T> {
    inertia: T,
    elbow: [T; 2],
    tip: T,
}

impl<T: Real> Pose<T> {
    /// Returns the components of a world vector in the plane and normal to it.
    #[inline(always)]
    fn to_plane(self, v: &Vector3<T>) -> (Vector2<T>, T) {
        let Self { sine: s, cosine: c, .. } = self;
        (Vector2::new(v[0], c * v[1] + s * v[2]), c * v[2] - s * v[1])
    }

    /// Returns the world vector with these components in the plane and normal to it.
    #[inline(always)]
    fn to_world(self, plane: &Vector2<T>, normal: T) -> Vector3<T> {
        let Self { sine: s, cosine: c, .. } = self;
        Vector3::new(plane[0], c * plane[1] - s * normal, s * plane[1] + c * normal)
    }
}

/// Returns the entries of the linkage's joints.
#[inline(always)]
fn linkage<T: Real>(joints: &Vector3<T>) -> Vector2<T> {
    Vector2::new(joints[1], joints[2])
}

impl<T: Real> FiveBarTurret<T> {
    /// Converts to another precision.
    pub fn cast<U: Real>(&self) -> FiveBarTurret<U> {
        FiveBarTurret {
            plane: self.plane.cast(),
            gravity_z: cast(self.gravity_z),
            turret_inertia: cast(self.turret_inertia),
            elbow_spin: self.elbow_spin.map(cast),
            coupled_spin: self.coupled_spin.map(cast),
            tip_spin: cast(self.tip_spin),
            reach_scale: cast(self.reach_scale),
            axis_floor: cast(self.axis_floor),
        }
    }

    #[inline(always)]
    fn spin(&self, pose: &Pose<T>) -> Spin<T> {
        let [y1, y2] = pose.plane.arm.map(|arm| arm[1]);
        let y = pose.plane.tip[1];
        let [a1, a2] = self.elbow_spin;
        let [b1, b2] = self.coupled_spin;
        let elbow = [a1 * y1 + b1 * y, a2 * y2 + b2 * y];
        let tip = self.tip_spin * y + b1 * y1 + b2 * y2;
        Spin { inertia: self.turret_inertia + y1 * elbow[0] + y2 * elbow[1] + y * tip, elbow, tip }
    }

    /// Returns the torques that move the tip straight at joint velocities `qd` and hold the device's weight.
    #[inline(always)]
    fn bias(&self, pose: &Pose<T>, levers: &Levers<'_, T>, spin: &Spin<T>, qd: &Vector3<T>) -> Vector3<T> {
        let (plane, joints, two) = (&pose.plane, linkage(qd), T::from_f64(2.0));
        let tip = levers.velocity(&joints);
        // The linkage's joints compensate the turret's centripetal and Coriolis accelerations.
        let turning = qd[0] * qd[0];
        let inward = plane.tip[1] * turning;
        let qdd_bias = FiveBar::joint_acceleration(plane, &joints, &tip, Some(&Vector2::new(T::zero(), inward)));
        let q0dd = -two * tip[1] * qd[0] * pose.inverse_y;
        let [x, y] = self.plane.gravity;
        let (g, across) = pose.to_plane(&Vector3::new(x, y, self.gravity_z));
        let at_tip = Vector2::new(T::zero(), self.plane.tip_mass * inward - spin.tip * turning);
        let arms = levers.bias(&joints, &qdd_bias, at_tip, &g);
        // The elbows' x coordinates are their velocities in y per joint rate.
        let [[x1, y1], [x2, y2]] = plane.arm.map(|arm| [arm[0], arm[1]]);
        let (f1, f2) = (spin.elbow[0] * x1, spin.elbow[1] * x2);
        let [b1, b2] = self.plane.rod_coupling;
        let [w1, w2] = self.plane.elbow_load;
        let half_rate = f1 * joints[0] + f2 * joints[1] + spin.tip * tip[1];
        let weight = across * (w1 * y1 + w2 * y2 + self.plane.tip_load * plane.tip[1]);
        Vector3::new(
            spin.inertia * q0dd + two * qd[0] * half_rate - weight,
            arms[0] + b1 * x1 * inward - f1 * turning,
            arms[1] + b2 * x2 * inward - f2 * turning,
        )
    }

    /// Returns the torques of accelerations: `q0dd` of the turret, `qdd` and `a` of the linkage in its plane. `tip` is
    /// a velocity in the plane.
    #[inline(always)]
    fn inertial_torque(
        &self,
        pose: &Pose<T>,
        qd: &Vector3<T>,
        tip: &Vector2<T>,
        q0dd: T,
        qdd: &Vector2<T>,
        a: &Vector2<T>,
    ) -> Vector3<T> {
        let plane = &pose.plane;
        let spin = self.spin(pose);
        let (mut at_tip, at_joints) = self.plane.inertial_loads(plane, &linkage(qd), qdd, Some(a));
        let turning = qd[0] * qd[0];
        at_tip[1] -= turning * spin.tip;
        let through_tip = FiveBar::transposed(plane, &at_tip);
        // The elbows' x coordinates are their velocities in y per joint rate.
        let [f1, f2] = [spin.elbow[0] * plane.arm[0][0], spin.elbow[1] * plane.arm[1][0]];
        let half_rate = f1 * qd[1] + f2 * qd[2] + spin.tip * tip[1];
        Vector3::new(
            spin.inertia * q0dd + T::from_f64(2.0) * qd[0] * half_rate,
            at_joints[0] + through_tip[0] - turning * f1,
            at_joints[1] + through_tip[1] - turning * f2,
        )
    }
}

impl<T: Real> Mechanism<T, 3> for FiveBarTurret<T> {
    const SPEC: Spec = Spec {
        name: "five-bar-turret",
        label: "five-bar-turret",
        joints: 3,
        task: 3,
        links: &["proximal-1", "proximal-2", "distal-1", "distal-2"],
        geometry: &[("base", 1), ("proximal", 2), ("distal", 2), ("assembly", 1)],
        are_links_optional: false,
        gravity: 3,
    };
    type Pose = Pose<T>;

    fn new(description: &Description) -> Result<Self, DescriptionError> {
        if description.kind != Kind::FiveBarTurret {
            return Err(DescriptionError::WrongKind);
        }
        let [turret, arm1, arm2] = description.joints;
        let plane = FiveBar::lump(&Description { joints: [arm1, arm2, turret], ..*description })?;
        let [_, l1, l2, r1, r2, ..] = description.geometry;
        let [p1, p2, d1, d2] = description.links;
        let side =
            |proximal: &crate::model::description::Link, distal: &crate::model::description::Link, l: f64, r: f64| {
                let s = distal.com / r;
                let tilt = (distal.inertia_transverse - distal.inertia_axial) / (r * r);
                let elbow = (proximal.mass * proximal.com * proximal.com + proximal.inertia_transverse
                    - proximal.inertia_axial)
                    / (l * l)
                    + distal.mass * (1.0 - s) * (1.0 - s)
                    + tilt;
                (elbow, distal.mass * s * (1.0 - s) - tilt, distal.mass * s * s + tilt)
            };
        let (a1, b1, c1) = side(&p1, &d1, l1, r1);
        let (a2, b2, c2) = side(&p2, &d2, l2, r2);
        let turret_inertia = turret.inertia + description.links.iter().map(|link| link.inertia_axial).sum::<f64>();
        if turret_inertia.is_nan() || turret_inertia <= 0.0 {
            return Err(DescriptionError::NoInertia);
        }
        let reach = (l1 + r1).min(l2 + r2);
        let real = T::from_f64;
        Ok(Self {
            plane,
            gravity_z: real(description.gravity[2]),
            turret_inertia: real(turret_inertia),
            elbow_spin: [real(a1), real(a2)],
            coupled_spin: [real(b1), real(b2)],
            tip_spin: real(c1 + c2 + description.handle_mass),
            reach_scale: real(1.0 / reach),
            axis_floor: real(SINE_FLOOR * reach),
        })
    }

    #[inline(always)]
    fn pose_at<K: Math<T>>(&self, [turret, first, second]: &[Angle<T>; 3]) -> Pose<T> {
        let (sine, cosine) = K::sin_cos_of(*turret);
        let plane = self.plane.pose_at::<K>(&[*first, *second]);
        Pose { plane, sine, cosine, inverse_y: reciprocal(plane.tip[1], self.axis_floor) }
    }

    #[inline(always)]
    fn regular_pose<K: Math<T>>(
        &self,
        [turret, first, second]: &[Angle<T>; 3],
        least: &Regularity<T>,
    ) -> Option<Pose<T>> {
        let plane = self.plane.regular_pose::<K>(&[*first, *second], least)?;
        let y = plane.tip[1];
        if (y * self.reach_scale).abs() >= least.serial {
            let (sine, cosine) = K::sin_cos_of(*turret);
            Some(Pose { plane, sine, cosine, inverse_y: T::one() / y })
        } else {
            None
        }
    }

    #[inline(always)]
    fn tip(&self, pose: &Pose<T>) -> Vector3<T> {
        pose.to_world(&pose.plane.tip, T::zero())
    }

    #[inline(always)]
    fn regularity(&self, pose: &Pose<T>) -> Regularity<T> {
        let Regularity { serial, parallel } = self.plane.regularity(&pose.plane);
        Regularity { serial: serial.lesser((pose.plane.tip[1] * self.reach_scale).abs()), parallel }
    }

    fn jacobian(&self, pose: &Pose<T>) -> Matrix3<T> {
        let plane = self.plane.jacobian(&pose.plane);
        Matrix3::from_columns(&[
            pose.to_world(&Vector2::zeros(), pose.plane.tip[1]),
            pose.to_world(&plane.column(0).into_owned(), T::zero()),
            pose.to_world(&plane.column(1).into_owned(), T::zero()),
        ])
    }

    fn jacobian_rate(&self, pose: &Pose<T>, qd: &Vector3<T>) -> Matrix3<T> {
        let plane = self.plane.jacobian(&pose.plane);
        let rate = self.plane.jacobian_rate(&pose.plane, &linkage(qd));
        let radial_rate = (plane * linkage(qd))[1];
        Matrix3::from_columns(&[
            pose.to_world(&Vector2::new(T::zero(), -pose.plane.tip[1] * qd[0]), radial_rate),
            pose.to_world(&rate.column(0).into_owned(), plane[(1, 0)] * qd[0]),
            pose.to_world(&rate.column(1).into_owned(), plane[(1, 1)] * qd[0]),
        ])
    }

    fn mass(&self, pose: &Pose<T>) -> Matrix3<T> {
        let mut mass = Matrix3::zeros();
        mass[(0, 0)] = self.spin(pose).inertia;
        mass.fixed_view_mut::<2, 2>(1, 1).copy_from(&self.plane.mass(&pose.plane));
        mass
    }

    fn coriolis(&self, pose: &Pose<T>, qd: &Vector3<T>) -> Vector3<T> {
        let joints = linkage(qd);
        let tip = self.plane.velocity(&pose.plane, &joints);
        let a = self.plane.jacobian_rate(&pose.plane, &joints) * joints;
        self.inertial_torque(pose, qd, &tip, T::zero(), &Vector2::zeros(), &a)
    }

    #[inline(always)]
    fn gravity(&self, pose: &Pose<T>) -> Vector3<T> {
        let [x, y] = self.plane.gravity;
        let (in_plane, normal) = pose.to_plane(&Vector3::new(x, y, self.gravity_z));
        let linkage = self.plane.gravity_torque(&pose.plane, &in_plane);
        let [y1, y2] = pose.plane.arm.map(|arm| arm[1]);
        let [w1, w2] = self.plane.elbow_load;
        Vector3::new(-normal * (w1 * y1 + w2 * y2 + self.plane.tip_load * pose.plane.tip[1]), linkage[0], linkage[1])
    }

    #[inline(always)]
    fn transpose(&self, pose: &Pose<T>, force: &Vector3<T>) -> Vector3<T> {
        let (in_plane, normal) = pose.to_plane(force);
        let linkage = FiveBar::transposed(&pose.plane, &in_plane);
        Vector3::new(pose.plane.tip[1] * normal, linkage[0], linkage[1])
    }

    #[inline(always)]
    fn velocity(&self, pose: &Pose<T>, qd: &Vector3<T>) -> Vector3<T> {
        pose.to_world(&self.plane.velocity(&pose.plane, &linkage(qd)), pose.plane.tip[1] * qd[0])
    }

    #[inline(always)]
    fn inverse(&self, pose: &Pose<T>, velocity: &Vector3<T>) -> Vector3<T> {
        let (in_plane, normal) = pose.to_plane(velocity);
        let linkage = self.plane.inverse(&pose.plane, &in_plane);
        Vector3::new(normal * pose.inverse_y, linkage[0], linkage[1])
    }

    #[inline(always)]
    fn shaping(&self, pose: &Pose<T>, n: &Vector3<T>) -> Shaping<T, 3> {
        let (in_plane, normal) = pose.to_plane(n);
        let linkage = self.plane.shaping(&pose.plane, &in_plane);
        let e0 = normal * pose.inverse_y;
        let me0 = self.spin(pose).inertia * e0;
        Shaping {
            e: Vector3::new(e0, linkage.e[0], linkage.e[1]),
            me: Vector3::new(me0, linkage.me[0], linkage.me[1]),
            w_rr: linkage.w_rr + e0 * me0,
        }
    }

    #[inline(always)]
    fn shaped_torque(&self, pose: &Pose<T>, n: &Vector3<T>, force: T, qd: Option<&Vector3<T>>) -> ShapedTorque<T, 3> {
        let (plane, two) = (&pose.plane, T::from_f64(2.0));
        let (in_plane, normal) = pose.to_plane(n);
        let UnitMotion { e, momentum, arms } = self.plane.unit_motion(plane, &in_plane);
        let e0 = normal * pose.inverse_y;
        let spin = self.spin(pose);
        let w_rr = self.plane.tip_mass * in_plane.dot(&in_plane) + arms + spin.inertia * (e0 * e0);
        // Acceleration of the tip along n.
        let s = force / w_rr;
        let (mut q0dd, mut qdd, mut at_joints) = (e0 * s, e * s, momentum * s);
        let mut at_tip = in_plane * (self.plane.tip_mass * s);
        let (mut turret, mut joints) = (T::zero(), None);
        if let Some(qd) = qd {
            let of_arms = linkage(qd);
            let tip = self.plane.velocity(plane, &of_arms);
            let turning = qd[0] * qd[0];
            // At these velocities, the joints must accelerate to keep the tip without acceleration: the linkage
            // compensates the turret's centripetal and Coriolis accelerations.
            let inward = plane.tip[1] * turning;
            let qdd_bias = FiveBar::joint_acceleration(plane, &of_arms, &tip, Some(&Vector2::new(T::zero(), inward)));
            let twice = two * qd[0];
            q0dd -= tip[1] * twice * pose.inverse_y;
            qdd += qdd_bias;
            at_tip[1] += turning * (self.plane.tip_mass * plane.tip[1] - spin.tip);
            // The elbows' x coordinates are their velocities in y per joint rate.
            let [x1, x2] = plane.arm.map(|arm| arm[0]);
            let [a1, a2] = self.plane.arm_inertia;
            let [b1, b2] = self.plane.rod_coupling;
            at_joints[0] += a1 * qdd_bias[0] + turning * (x1 * (b1 * plane.tip[1] - spin.elbow[0]));
            at_joints[1] += a2 * qdd_bias[1] + turning * (x2 * (b2 * plane.tip[1] - spin.elbow[1]));
            turret =
                twice * (spin.elbow[0] * (x1 * of_arms[0]) + spin.elbow[1] * (x2 * of_arms[1]) + spin.tip * tip[1]);
            joints = Some(of_arms);
        }
        let at_tip = self.plane.with_rod_forces(plane, at_tip, joints.as_ref(), &qdd);
        let linkage = at_joints + FiveBar::transposed(plane, &at_tip);
        ShapedTorque {
            e: Vector3::new(e0, e[0], e[1]),
            torque: Vector3::new(spin.inertia * q0dd + turret, linkage[0], linkage[1]),
        }
    }

    #[inline(always)]
    fn velocity_torque(&self, pose: &Pose<T>, qd: &Vector3<T>) -> Vector3<T> {
        let joints = linkage(qd);
        let tip = self.plane.velocity(&pose.plane, &joints);
        // The linkage's joints compensate the turret's centripetal and Coriolis accelerations.
        let in_plane = Vector2::new(T::zero(), pose.plane.tip[1] * qd[0] * qd[0]);
        let q0dd = T::from_f64(-2.0) * tip[1] * qd[0] * pose.inverse_y;
        let qdd = FiveBar::joint_acceleration(&pose.plane, &joints, &tip, Some(&in_plane));
        self.inertial_torque(pose, qd, &tip, q0dd, &qdd, &in_plane)
    }

    fn operational_inertia(&self, pose: &Pose<T>) -> Matrix3<T> {
        let plane = self.plane.operational_inertia(&pose.plane);
        let normal = self.spin(pose).inertia * pose.inverse_y * pose.inverse_y;
        // Rotates about x: the plane's y axis is (0, cos, sin), its normal (0, -sin, cos).
        let (s, c) = (pose.sine, pose.cosine);
        let (xy, yy) = (plane[(0, 1)], plane[(1, 1)]);
        let across = (yy - normal) * (s * c);
        Matrix3::new(
            plane[(0, 0)],
            xy * c,
            xy * s,
            xy * c,
            yy * c * c + normal * s * s,
            across,
            xy * s,
            across,
            yy * s * s + normal * c * c,
        )
    }

    #[inline(always)]
    fn wall_terms(&self, pose: &Pose<T>, basis: &Matrix3<T>, qd: &Vector3<T>) -> WallTerms<T, 3> {
        let (levers, spin) = (Levers::new(&self.plane, &pose.plane), self.spin(pose));
        let b = self.bias(pose, &levers, &spin, qd);
        let motion = |i: usize| {
            let (in_plane, normal) = pose.to_plane(&basis.column(i).into_owned());
            (levers.unit_motion(&in_plane), normal)
        };
        let motion = [motion(0), motion(1), motion(2)];
        // Λ contains the tip's mass in the plane and J₀/y² along the normal. The product of two directions in the plane
        // is their total product (1 or 0) less the product of their parts along the normal.
        let mass = self.plane.tip_mass;
        let more = spin.inertia * pose.inverse_y * pose.inverse_y - mass;
        let w = |i: usize, j: usize| {
            let ((a, normal_a), (b, normal_b)) = (&motion[i], &motion[j]);
            let arms = more * *normal_a * *normal_b + a.arms(b);
            if i == j { mass + arms } else { arms }
        };
        let e = |i: usize| Vector3::new(motion[i].1 * pose.inverse_y, motion[i].0.e[0], motion[i].0.e[1]);
        let (first, normal) = &motion[0];
        let (me, row) = (levers.momentum(first), levers.transposed(&first.n));
        let lever = pose.plane.tip[1] * *normal;
        WallTerms {
            e: Matrix3::from_columns(&[e(0), e(1), e(2)]),
            me: Vector3::new(spin.inertia * (*normal * pose.inverse_y), me[0], me[1]),
            w: symmetric_matrix(w),
            b,
            row: Vector3::new(lever, row[0], row[1]),
            w_eff: inertia_with_turret(spin.inertia, lever, &levers.mass(), &row),
        }
    }
}
