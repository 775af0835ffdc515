//! The coefficients of a chain from the maker's description.

use super::{Chain, ChainJoint, DETERMINANT_FLOOR, MassSeries, about_x, about_z};
use crate::math::{Angle, BinaryAngle, Libm, Real};
use crate::model::catalogue::MAX_JOINTS;
use crate::model::description::{ARC, Description, DescriptionError};
use crate::model::mechanism::Mechanism;
use crate::model::solve::is_positive_definite;
use core::f64::consts::TAU;
use nalgebra::{Matrix3, SMatrix, Vector3};

/// Sine of the angle between two axes below which they count as parallel.
const PARALLEL_SINE: f64 = 1.0e-9;
/// Share of the inertia below which a coupling of the first joint counts as zero.
const COUPLING: f64 = 1.0e-12;
/// Travel at which the coefficients of a prismatic joint are sampled, m.
const SAMPLE_TRAVEL: f64 = 0.1;
/// Number of positions of each joint at which |det J| is sampled: every 30 degrees of a turn.
const DETERMINANT_SAMPLES: usize = 12;
/// Share of the levers' largest product below which |det J| counts as zero.
const LEAST_DETERMINANT: f64 = 1.0e-6;

/// Coefficients of each entry of M, by the powers of the last joint but one and of the last.
type Coefficients = [[[[f64; 5]; 5]; MAX_JOINTS]; MAX_JOINTS];

/// A link in a frame whose z axis is the axis of its joint. All vectors are in the base frame with every joint at zero.
struct Body {
    prismatic: bool,
    /// Axes of the link's frame as columns. The x axis is perpendicular to the axis of the next joint too.
    frame: Matrix3<f64>,
    origin: Vector3<f64>,
    mass: f64,
    /// Centre of mass from the origin, m.
    com: Vector3<f64>,
    /// Inertia about the centre of mass, kg m².
    inertia: Matrix3<f64>,
    rotor_inertia: f64,
}

/// Returns the coefficients of a chain of N joints.
pub(super) fn chain<T: Real, const N: usize>(description: &Description) -> Result<Chain<T, N>, DescriptionError> {
    if description.kind.spec() != <Chain<T, N> as Mechanism<T, N>>::SPEC {
        return Err(DescriptionError::WrongKind);
    }
    let [x, y, z, task @ ..] = description.geometry;
    let (bodies, tip) = bodies::<N>(description, &Vector3::new(x, y, z))?;
    let (first, last) = (&bodies[0], &bodies[N - 1]);
    let tip_in_link = last.frame.tr_mul(&tip);
    let is_arc = task[0] == ARC;
    let mut chain = Chain::<f64, N> {
        joints: joints(&bodies),
        tip: tip_in_link.into(),
        arc: is_arc.then(|| libm::hypot(tip_in_link[0], tip_in_link[1])),
        task: [[0.0; 3]; MAX_JOINTS],
        origin: [0.0; MAX_JOINTS],
        is_planar: false,
        mass: MassSeries::default(),
        gravity: first.frame.tr_mul(&Vector3::from(description.gravity)).into(),
        determinant_scale: 1.0,
        determinant_floor: 0.0,
    };
    if is_arc && (N > 1 || first.prismatic) {
        return Err(DescriptionError::Task);
    }
    for (row, coordinate) in task.into_iter().enumerate().take(if is_arc { 0 } else { N }) {
        let axis = [0.0, 1.0, 2.0].iter().position(|axis| *axis == coordinate).ok_or(DescriptionError::Task)?;
        if task.iter().take(row).any(|before| *before == coordinate) {
            return Err(DescriptionError::Task);
        }
        chain.task[row] = core::array::from_fn(|column| first.frame[(axis, column)]);
        chain.origin[row] = first.origin[axis];
    }
    (chain.is_planar, chain.mass) = mass_series(&chain, &bodies)?;
    let largest = largest_determinant(&chain, description)?;
    chain.determinant_scale = 1.0 / largest;
    chain.determinant_floor = DETERMINANT_FLOOR * largest;
    Ok(chain.cast())
}

/// Returns the bodies of a description, and the tip (m, in the base frame, from the origin of the last body).
fn bodies<const N: usize>(
    description: &Description,
    tip: &Vector3<f64>,
) -> Result<([Body; N], Vector3<f64>), DescriptionError> {
    // The maker's frame of the link before.
    let (mut frame, mut origin) = (Matrix3::identity(), Vector3::zeros());
    let mut error = None;
    let mut bodies: [Body; N] = core::array::from_fn(|i| {
        let (joint, mut link) = (&description.joints[i], description.links[i]);
        if i + 1 == N {
            link.add_point(description.handle_mass, (*tip).into());
        }
        origin += frame * Vector3::from(joint.frame.origin);
        frame *= from_roll_pitch_yaw(joint.frame.rpy);
        let axis = unit_vector(&(frame * Vector3::from(joint.frame.axis)));
        if axis.is_none() {
            error = Some(DescriptionError::Axis(i));
        }
        Body {
            prismatic: joint.prismatic,
            frame: Matrix3::from_columns(&[Vector3::zeros(), Vector3::zeros(), axis.unwrap_or_default()]),
            origin,
            mass: link.mass,
            com: frame * Vector3::from(link.com_vector()),
            inertia: frame * link.tensor() * frame.transpose(),
            rotor_inertia: joint.inertia,
        }
    });
    if let Some(error) = error {
        return Err(error);
    }
    let mut x: Option<Vector3<f64>> = None;
    for i in 0..N {
        let axis = bodies[i].frame.column(2).into_owned();
        let next = bodies.get(i + 1).map(|next| axis.cross(&next.frame.column(2)));
        // Any normal serves parallel axes; the one of the link before needs no further turn.
        let normal = next.filter(|normal| normal.dot(normal) > PARALLEL_SINE * PARALLEL_SINE);
        let chosen = normal.or(x.filter(|x| x.dot(&axis).abs() < PARALLEL_SINE)).unwrap_or_else(|| {
            let [x, y, z] = [axis[0].abs(), axis[1].abs(), axis[2].abs()];
            let far = if x <= y && x <= z {
                Vector3::x()
            } else if y <= z {
                Vector3::y()
            } else {
                Vector3::z()
            };
            axis.cross(&far)
        });
        let chosen = unit_vector(&chosen).unwrap_or_default();
        bodies[i].frame = Matrix3::from_columns(&[chosen, axis.cross(&chosen), axis]);
        x = Some(chosen);
    }
    Ok((bodies, frame * tip))
}

fn joints<const N: usize>(bodies: &[Body; N]) -> [ChainJoint<f64>; MAX_JOINTS] {
    let mut joints = [ChainJoint::default(); MAX_JOINTS];
    for i in (0..N).rev() {
        let body = &bodies[i];
        let (mut later_mass, mut moment) = (0.0, body.com * body.mass);
        if let Some(next) = bodies.get(i + 1) {
            later_mass = joints[i + 1].mass;
            moment += (next.origin - body.origin) * later_mass;
        }
        joints[i] = ChainJoint {
            prismatic: body.prismatic,
            moment: body.frame.tr_mul(&moment).into(),
            mass: body.mass + later_mass,
            turns: if body.prismatic { 0.0 } else { 1.0 },
            slides: if body.prismatic { 1.0 } else { 0.0 },
            angle_mask: if body.prismatic { 0 } else { u32::MAX },
            ..ChainJoint::default()
        };
        if i > 0 {
            let before = &bodies[i - 1];
            let relative = before.frame.tr_mul(&body.frame);
            // x of the joint's frame is x of the link before, so the rest of the rotation is the joint's offset.
            let offset = libm::atan2(-relative[(0, 1)], relative[(0, 0)]);
            (joints[i].offset, joints[i].binary_offset) = (offset, BinaryAngle::from_radians(offset).0);
            let (y, z) = (before.frame.column(1).into_owned(), body.frame.column(2).into_owned());
            (joints[i].cosine, joints[i].sine) = (relative[(2, 2)], -y.dot(&z));
            joints[i].origin = before.frame.tr_mul(&(body.origin - before.origin)).into();
        }
    }
    joints
}

/// Returns the largest |det J| over the joints' positions.
fn largest_determinant<const N: usize>(
    chain: &Chain<f64, N>,
    description: &Description,
) -> Result<f64, DescriptionError> {
    let origins = chain.joints.iter().take(N).map(|joint| norm(&joint.origin.into()));
    let reach = norm(&chain.tip.into()) + origins.sum::<f64>();
    let (mut largest, mut levers) = (0.0_f64, 0.0_f64);
    for sample in 0..DETERMINANT_SAMPLES.pow(N as u32) {
        let mut left = sample;
        let angles = core::array::from_fn(|i| {
            let share = (left % DETERMINANT_SAMPLES) as f64 / DETERMINANT_SAMPLES as f64;
            left /= DETERMINANT_SAMPLES;
            let (low, high) = if chain.joints[i].prismatic {
                description.joints[i].limits.unwrap_or((-reach, reach))
            } else {
                (0.0, TAU)
            };
            Angle::from_radians(low + (high - low) * share)
        });
        let pose = chain.pose_at::<Libm>(&angles);
        largest = largest.max(pose.determinant.abs());
        levers = levers.max(pose.levers.iter().map(norm).product());
    }
    // Written so that NaN is an error.
    if largest > LEAST_DETERMINANT * levers { Ok(largest) } else { Err(DescriptionError::Task) }
}

/// Returns the coefficients of M, and true for a planar chain.
fn mass_series<const N: usize>(
    chain: &Chain<f64, N>,
    bodies: &[Body; N],
) -> Result<(bool, MassSeries<f64>), DescriptionError> {
    let first_order = |row: &[f64; 5]| [row[0], row[1], row[2]];
    let (mean, [[cc, ..], [bc, bb, _], [ac, ab, aa]]) = coefficients(chain, bodies, false);
    // A direction without inertia at all samples has none anywhere.
    if !is_positive_definite(&mean) {
        return Err(DescriptionError::NoInertia);
    }
    let mut series = MassSeries {
        cc: cc[0][0],
        bc: first_order(&bc[0]),
        bb: bb[0],
        ac: [0, 1, 2].map(|row| first_order(&ac[row])),
        ab: [ab[0], ab[1], ab[2]],
        aa,
    };
    let [_, b, c] = &chain.joints;
    let are_parallel = N == 3 && !b.prismatic && !c.prismatic && c.cosine > 0.0 && c.sine.abs() < PARALLEL_SINE;
    let coupling = ac.iter().chain(&ab).flatten().fold(0.0_f64, |largest, entry| largest.max(entry.abs()));
    let is_planar = are_parallel && coupling < COUPLING * mean.trace();
    if is_planar {
        let (_, [.., [.., aa]]) = coefficients(chain, bodies, true);
        series.aa = aa;
    }
    Ok((is_planar, series))
}

/// Returns the sum of samples of M and the coefficients of the entries of M, with the last joint first. The samples
/// determine a polynomial of the second degree exactly. The last angle is the sum of two joints if `is_sum`.
fn coefficients<const N: usize>(
    chain: &Chain<f64, N>,
    bodies: &[Body; N],
    is_sum: bool,
) -> (SMatrix<f64, N, N>, Coefficients) {
    // Joint N - back, whose polynomial is a constant if the chain has no joint before it.
    let samples_of = |back: usize| match N.checked_sub(back).filter(|i| *i > 0) {
        Some(i) => samples(&chain.joints[i]),
        None => [(0.0, [1.0, 0.0, 0.0, 0.0, 0.0]), (0.0, [0.0; 5]), (0.0, [0.0; 5]), (0.0, [0.0; 5]), (0.0, [0.0; 5])],
    };
    let mut mean = SMatrix::<f64, N, N>::zeros();
    let mut coefficients = [[[[0.0; 5]; 5]; MAX_JOINTS]; MAX_JOINTS];
    for (b, weights_b) in samples_of(2) {
        for (sample, weights_c) in samples_of(1) {
            let c = if is_sum { sample - b - chain.joints[1].offset } else { sample };
            let q = core::array::from_fn(|i| if i + 1 == N { c } else { b });
            let mass = mass_at(chain, bodies, &q);
            mean += mass;
            for (i, j) in (0..N).flat_map(|i| (0..=i).map(move |j| (i, j))) {
                for (row, weight_b) in weights_b.iter().enumerate() {
                    for (column, weight_c) in weights_c.iter().enumerate() {
                        coefficients[N - 1 - j][N - 1 - i][row][column] += weight_b * weight_c * mass[(i, j)];
                    }
                }
            }
        }
    }
    (mean, coefficients)
}

/// Returns five coordinates of a joint, and for each the weights of a sample in the coefficients of 1, u, v, u² and uv.
fn samples(joint: &ChainJoint<f64>) -> [(f64, [f64; 5]); 5] {
    core::array::from_fn(|k| {
        if joint.prismatic {
            // Three samples determine a parabola.
            let (slope, square) = (0.5 / SAMPLE_TRAVEL, 0.5 / (SAMPLE_TRAVEL * SAMPLE_TRAVEL));
            return match k {
                0 => (0.0, [1.0, 0.0, 0.0, -2.0 * square, 0.0]),
                1 => (SAMPLE_TRAVEL, [0.0, slope, 0.0, square, 0.0]),
                2 => (-SAMPLE_TRAVEL, [0.0, -slope, 0.0, square, 0.0]),
                _ => (0.0, [0.0; 5]),
            };
        }
        let angle = TAU * k as f64 / 5.0;
        let (sine, cosine) = libm::sincos(angle);
        let (sine_of_twice, cosine_of_twice) = libm::sincos(2.0 * angle);
        // cos 2q = 2 u² - 1 and sin 2q = 2 u v.
        let weights =
            [0.2 - 0.4 * cosine_of_twice, 0.4 * cosine, 0.4 * sine, 0.8 * cosine_of_twice, 0.8 * sine_of_twice];
        (angle - joint.offset, weights)
    })
}

/// Returns M (kg m²) at joint coordinates `q` from the motion of every body.
fn mass_at<const N: usize>(chain: &Chain<f64, N>, bodies: &[Body; N], q: &[f64; N]) -> SMatrix<f64, N, N> {
    let mut mass = SMatrix::<f64, N, N>::zeros();
    for (last, body) in bodies.iter().enumerate() {
        let inertia = body.frame.tr_mul(&(body.inertia * body.frame));
        // Velocity of the centre of mass and angular velocity per unit velocity of each joint, in the body's frame.
        let (mut linear, mut angular) = ([Vector3::zeros(); N], [Vector3::zeros(); N]);
        // The centre of mass in the frame of link i, and the rotation from there to the body's frame.
        let (mut place, mut back) = (body.frame.tr_mul(&body.com), Matrix3::identity());
        for i in (0..=last).rev() {
            let axis = back.column(2).into_owned();
            if chain.joints[i].prismatic {
                linear[i] = axis;
            } else {
                linear[i] = back * Vector3::new(-place[1], place[0], 0.0);
                angular[i] = axis;
            }
            if i > 0 {
                let joint = &chain.joints[i];
                let (sine, cosine) = libm::sincos(q[i] * joint.turns + joint.offset);
                let lift = q[i] * joint.slides;
                let moved = about_z(&place, cosine, sine) + Vector3::new(0.0, 0.0, lift);
                place = about_x(&moved, joint.cosine, joint.sine) + Vector3::from(joint.origin);
                let columns = [Vector3::x(), Vector3::y(), Vector3::z()];
                let turned = columns.map(|v| about_x(&about_z(&v, cosine, sine), joint.cosine, joint.sine));
                back *= Matrix3::from_columns(&turned).transpose();
            }
        }
        for (i, j) in (0..N).flat_map(|i| (0..N).map(move |j| (i, j))) {
            mass[(i, j)] += body.mass * linear[i].dot(&linear[j]) + angular[i].dot(&(inertia * angular[j]));
        }
        mass[(last, last)] += body.rotor_inertia;
    }
    mass
}

/// Returns the rotation Rz(yaw) Ry(pitch) Rx(roll) of URDF; angles in rad.
fn from_roll_pitch_yaw([roll, pitch, yaw]: [f64; 3]) -> Matrix3<f64> {
    let ((sr, cr), (sp, cp), (sy, cy)) = (libm::sincos(roll), libm::sincos(pitch), libm::sincos(yaw));
    Matrix3::new(
        cy * cp,
        cy * sp * sr - sy * cr,
        cy * sp * cr + sy * sr,
        sy * cp,
        sy * sp * sr + cy * cr,
        sy * sp * cr - cy * sr,
        -sp,
        cp * sr,
        cp * cr,
    )
}

/// Returns a vector of length 1 with the direction of `v`, or `None` for a vector without a direction.
fn unit_vector(v: &Vector3<f64>) -> Option<Vector3<f64>> {
    let length = libm::sqrt(v.dot(v));
    (length > 0.0 && length.is_finite()).then(|| v / length)
}

/// Returns the norm of `v`.
fn norm(v: &Vector3<f64>) -> f64 {
    libm::sqrt(v.dot(v))
}
