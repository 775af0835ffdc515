//! Reduces a compliant device to the motions that affect the wall.
//!
//! The generalised coordinates are the links' joint angles q, the motor angle θ behind each transmission, and the angle
//! of each structural mode. The states are scaled by energy: velocities by a Cholesky factor of the mass matrix, spring
//! deflections by the root of the stiffness. The matrix of a lossless device is then skew-symmetric, however far apart
//! its frequencies lie.
//!
//! The walls measure only the rendered positions, x = Jr (the angles at the encoders). Motions that the walls cannot
//! measure or cause are removed exactly. Arnoldi's method builds a basis of the remaining motions and ends when the
//! next power of the system matrix adds no direction (the staircase form; Paige, "Properties of numerical algorithms
//! related to computing controllability", IEEE TAC 26, 1981). Rounding therefore never decides if an undamped motion
//! along the wall counts as stable.

use super::flexible::Flexible;
use super::plant::{ContinuousPlant, Lags, Linearised};
use haptic_bridge::model::description::{EncoderAt, StructuralMode, Transmission};
use nalgebra::{DMatrix, DVector};

/// Frequency, rad per sample, above which a transmission counts as rigid. The relative error is 1e-10.
const RIGID_ABOVE_RAD_PER_SAMPLE: f64 = 1e5;

/// Length of a new basis vector, relative to the system matrix, below which the vector is only rounding.
const BASIS_ROUNDING: f64 = 1e-13;

/// A compliant device with the directions along which its walls measure it.
pub(crate) struct ObservedDevice<'a> {
    /// M of the rigid device, N x N, kg m².
    pub mass: &'a DMatrix<f64>,
    /// B of each joint, N m s/rad.
    pub viscous: &'a DVector<f64>,
    /// The compliant parts, and the hand.
    pub flexible: &'a Flexible,
    /// Rendered directions as rows, R x N, m/rad. The directions of the tip come first.
    pub rows: &'a DMatrix<f64>,
    pub directions: &'a DMatrix<f64>,
}

/// The reduced device ẋ = a x + b u, and its rendered positions as R rows over the states.
pub(crate) struct ReducedDevice {
    pub a: DMatrix<f64>,
    pub b: DMatrix<f64>,
    pub rendered_rows: DMatrix<f64>,
}

/// Matrices of the device in generalised coordinates, in sample units (see [`super::plant`]): time in samples, forces
/// in m/T². The coordinates are the links, then the motors of joints with a transmission, then the structural modes.
struct Bodies {
    mass: DMatrix<f64>,
    damping: DMatrix<f64>,
    /// Deflection of each spring per unit of motion.
    deflection: DMatrix<f64>,
    stiffness: DVector<f64>,
    /// Coordinate of each joint's motor.
    motor: Vec<usize>,
    encoder: Vec<usize>,
    transmission_spring: Vec<Option<usize>>,
    /// Index of the hand's first spring; `None` without a hand.
    hand_spring: Option<usize>,
}

impl Bodies {
    fn new(device: &ObservedDevice<'_>, lags: &Lags, t: f64, m: f64) -> Option<Self> {
        let joints = device.mass.nrows();
        let flexible = device.flexible;
        let mut links = device.mass.clone();
        let transmission_of = |joint: usize| flexible.transmissions.get(joint).copied().flatten();
        for joint in 0..joints {
            if let Some(transmission) = transmission_of(joint) {
                links[(joint, joint)] -= transmission.motor_inertia;
            }
        }
        for (joint, mode) in &flexible.modes {
            links[(*joint, *joint)] -= mode.inertia;
        }
        let mobility = links.clone().cholesky()?.inverse();
        let (swinging, stiff): (Vec<(usize, StructuralMode)>, Vec<_>) =
            flexible.modes.iter().partition(|(joint, mode)| {
                let mobility_sum = 1.0 / mode.inertia + mobility[(*joint, *joint)];
                (mode.stiffness() * mobility_sum).sqrt() * t < RIGID_ABOVE_RAD_PER_SAMPLE
            });
        for (joint, mode) in &stiff {
            links[(*joint, *joint)] += mode.inertia;
        }
        let compliant: Vec<(usize, Transmission)> = (0..joints)
            .filter_map(|joint| transmission_of(joint).map(|transmission| (joint, transmission)))
            .filter(|(joint, transmission)| {
                let mobility_sum = 1.0 / transmission.motor_inertia + mobility[(*joint, *joint)];
                (transmission.stiffness * mobility_sum).sqrt() * t < RIGID_ABOVE_RAD_PER_SAMPLE
            })
            .collect();
        for joint in 0..joints {
            if let Some(rigid) = transmission_of(joint).filter(|_| compliant.iter().all(|(other, _)| *other != joint)) {
                links[(joint, joint)] += rigid.motor_inertia;
            }
        }
        let hand = &flexible.hand;
        let held = if hand.stiffness > 0.0 { flexible.tip.nrows() } else { 0 };
        let size = joints + compliant.len() + swinging.len();
        let springs = compliant.len() + swinging.len() + held;
        let mut bodies = Self {
            mass: DMatrix::zeros(size, size),
            damping: DMatrix::zeros(size, size),
            deflection: DMatrix::zeros(springs, size),
            stiffness: DVector::zeros(springs),
            motor: (0..joints).collect(),
            encoder: (0..joints).collect(),
            transmission_spring: vec![None; joints],
            hand_spring: (held > 0).then_some(compliant.len() + swinging.len()),
        };
        bodies.mass.view_mut((0, 0), (joints, joints)).copy_from(&links);
        if hand.is_there() {
            let square = flexible.tip.tr_mul(&flexible.tip);
            let mut carried = bodies.mass.view_mut((0, 0), (joints, joints));
            carried += &square * hand.mass;
            bodies.damping.view_mut((0, 0), (joints, joints)).copy_from(&(square * hand.damping));
        }
        for (spring, (joint, transmission)) in compliant.iter().enumerate() {
            let (q, theta) = (*joint, joints + spring);
            bodies.motor[q] = theta;
            if transmission.encoder_at == EncoderAt::Motor {
                bodies.encoder[q] = theta;
            }
            bodies.transmission_spring[q] = Some(spring);
            bodies.mass[(theta, theta)] = transmission.motor_inertia;
            bodies.deflection[(spring, theta)] = 1.0;
            bodies.deflection[(spring, q)] = -1.0;
            bodies.stiffness[spring] = transmission.stiffness;
            for (a, b, sign) in [(theta, theta, 1.0), (q, q, 1.0), (theta, q, -1.0), (q, theta, -1.0)] {
                bodies.damping[(a, b)] += sign * transmission.damping;
            }
        }
        for (index, (q, mode)) in swinging.iter().enumerate() {
            let spring = compliant.len() + index;
            let (q, swings) = (*q, joints + spring);
            bodies.mass[(swings, swings)] = mode.inertia;
            bodies.deflection[(spring, swings)] = 1.0;
            bodies.deflection[(spring, q)] = -1.0;
            bodies.stiffness[spring] = mode.stiffness();
            for (a, b, sign) in [(swings, swings, 1.0), (q, q, 1.0), (swings, q, -1.0), (q, swings, -1.0)] {
                bodies.damping[(a, b)] += sign * mode.viscous();
            }
        }
        for direction in 0..held {
            let spring = compliant.len() + swinging.len() + direction;
            bodies.deflection.view_mut((spring, 0), (1, joints)).copy_from(&flexible.tip.row(direction));
            bodies.stiffness[spring] = hand.stiffness;
        }
        for joint in 0..joints {
            let turned = bodies.motor[joint];
            let direct = if lags.rate[joint].is_none() { lags.emf[joint] } else { 0.0 };
            bodies.damping[(turned, turned)] += device.viscous[joint] + direct;
        }
        bodies.mass /= m;
        bodies.damping *= t / m;
        bodies.stiffness *= t * t / m;
        Some(bodies)
    }
}

/// Returns the plant of a compliant device for the torque `inputs` (N x p, units of m/T² times metres).
pub(crate) fn reduce(
    device: &Linearised,
    lags: &Lags,
    inputs: &DMatrix<f64>,
    sample_s: f64,
    reference_mass: f64,
) -> Option<ContinuousPlant> {
    let Linearised { mass, viscous, flexible, row, .. } = device;
    let rows = DMatrix::from_rows(&[row.transpose()]);
    let directions = DMatrix::from_columns(std::slice::from_ref(&flexible.normal));
    let observed = ObservedDevice { mass, viscous, flexible, rows: &rows, directions: &directions };
    let ReducedDevice { a, b, rendered_rows } = reduce_observed(&observed, lags, inputs, sample_s, reference_mass)?;
    Some(ContinuousPlant::of_flexible_device(a, b, rendered_rows.row(0).transpose()))
}

/// Like [`reduce`], for walls along several directions.
pub(crate) fn reduce_observed(
    device: &ObservedDevice<'_>,
    lags: &Lags,
    inputs: &DMatrix<f64>,
    sample_s: f64,
    reference_mass: f64,
) -> Option<ReducedDevice> {
    let (rendered, joints) = device.rows.shape();
    let bodies = Bodies::new(device, lags, sample_s, reference_mass)?;
    let (moving, springs) = (bodies.mass.nrows(), bodies.stiffness.len());
    let lagging: Vec<usize> = (0..joints).filter(|&joint| lags.rate[joint].is_some()).collect();
    // States: scaled velocities L' v, scaled deflections, lagging torques, positions without a hand's spring.
    let (torques, position) = (moving + springs, moving + springs + lagging.len());
    // A hand's springs hold the tip's position but not its orientation.
    let held = |k: usize| bodies.hand_spring.filter(|_| k < device.directions.ncols());
    let integrated: Vec<usize> = (0..rendered).filter(|&k| held(k).is_none()).collect();
    let size = position + integrated.len();
    let (mut a, mut b) = (DMatrix::zeros(size, size), DMatrix::zeros(size, inputs.ncols()));
    let lower = bodies.mass.cholesky()?.l();
    // L⁻¹ maps forces to changes of the scaled velocities; its transpose maps scaled velocities to velocities.
    let inverse = lower.solve_lower_triangular(&DMatrix::identity(moving, moving))?;
    let velocities = inverse.transpose();
    let roots = bodies.stiffness.map(f64::sqrt);
    let stretch = DMatrix::from_diagonal(&roots) * &bodies.deflection * &velocities;
    a.view_mut((0, 0), (moving, moving)).copy_from(&-(&inverse * &bodies.damping * &velocities));
    a.view_mut((0, moving), (moving, springs)).copy_from(&-stretch.transpose());
    a.view_mut((moving, 0), (springs, moving)).copy_from(&stretch);
    for joint in 0..joints {
        let turned = bodies.motor[joint];
        match lagging.iter().position(|&other| other == joint) {
            None => {
                let mut driven = b.view_mut((0, 0), (moving, inputs.ncols()));
                driven += inverse.column(turned) * inputs.row(joint);
            }
            Some(slot) => {
                let (state, rate) = (torques + slot, lags.rate[joint].unwrap_or_default());
                a.view_mut((0, state), (moving, 1)).copy_from(&inverse.column(turned));
                a[(state, state)] = -rate;
                let emf = rate * lags.emf[joint] * sample_s / reference_mass;
                a.view_mut((state, 0), (1, moving)).copy_from(&(velocities.row(turned) * -emf));
                b.view_mut((state, 0), (1, inputs.ncols())).copy_from(&(inputs.row(joint) * rate));
            }
        }
    }
    // The rendered positions, one per column.
    let mut rendered_rows = DMatrix::zeros(size, rendered);
    for k in 0..rendered {
        let Some(held) = held(k) else {
            let state = position + integrated.iter().position(|&other| other == k)?;
            for joint in 0..joints {
                let mut row = a.view_mut((state, 0), (1, moving));
                row += velocities.row(bodies.encoder[joint]) * device.rows[(k, joint)];
            }
            rendered_rows[(state, k)] = 1.0;
            continue;
        };
        // Jr q is the deflection of the hand's springs; an encoder on a motor also measures the twist.
        for (direction, along) in device.directions.column(k).iter().enumerate() {
            rendered_rows[(moving + held + direction, k)] += along / roots[held + direction];
        }
        for joint in (0..joints).filter(|&joint| bodies.encoder[joint] != joint) {
            if let Some(spring) = bodies.transmission_spring[joint] {
                rendered_rows[(moving + spring, k)] += device.rows[(k, joint)] / roots[spring];
            }
        }
    }

    let basis = krylov_basis(&a.transpose(), &rendered_rows);
    let (a, b, rendered_rows) = (basis.tr_mul(&(&a * &basis)), basis.tr_mul(&b), basis.tr_mul(&rendered_rows));
    let basis = krylov_basis(&a, &b);
    let (a, b, rendered_rows) = if basis.ncols() < a.nrows() {
        (basis.tr_mul(&(&a * &basis)), basis.tr_mul(&b), basis.tr_mul(&rendered_rows))
    } else {
        (a, b, rendered_rows)
    };
    Some(ReducedDevice { a, b, rendered_rows: rendered_rows.transpose() })
}

/// Returns an orthonormal basis of the Krylov space span(from, a from, a² from, …).
fn krylov_basis(a: &DMatrix<f64>, from: &DMatrix<f64>) -> DMatrix<f64> {
    let size = a.nrows();
    let mut basis: Vec<DVector<f64>> = Vec::new();
    let add = |basis: &mut Vec<DVector<f64>>, mut candidate: DVector<f64>, scale: f64| {
        // Orthogonalising twice is enough (Kahan and Parlett).
        for _ in 0..2 {
            for known in basis.iter() {
                candidate -= known * known.dot(&candidate);
            }
        }
        let length = candidate.norm();
        if basis.len() < size && length > BASIS_ROUNDING * scale {
            basis.push(candidate / length);
        }
    };
    for column in from.column_iter() {
        add(&mut basis, column.into_owned(), column.norm());
    }
    let norm = a.norm();
    let mut next = 0;
    while next < basis.len() && basis.len() < size {
        let powered = a * &basis[next];
        add(&mut basis, powered, norm);
        next += 1;
    }
    DMatrix::from_columns(&basis)
}
