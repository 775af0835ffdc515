//! Situations in which errors are computed: pose, wall normal, hand motion, and the largest force that the motors can
//! make along the normal in addition to weight and motion. Motions that need more than the motors' torque are omitted.

use crate::boards::torque_at_rest;
use haptic_bridge::math::Libm;
use haptic_bridge::model::catalogue::MAX_JOINTS;
use haptic_bridge::model::device::Device;
use haptic_bridge::model::mechanism::Mechanism;
use haptic_bridge::render::controller::{FULL_REGULARITY, PARALLEL_REGULARITY};
use haptic_bridge::render::scene::Surface;
use haptic_bridge::safety::limits::Limits;
use haptic_bridge::with_mechanism;
use haptic_host::vectors::padded;
use haptic_stability::analysis::map::Reachable;
use haptic_stability::analysis::pose::PoseError;
use nalgebra::SVector;

const FORCE_WITHOUT_MOTORS: f64 = 5.0;
/// Default speed of the hand, m/s.
pub const HAND_SPEED: f64 = 0.5;
/// Turning rate of the redundant arm's last link per speed of the hand, rad/m.
const LAST_LINK_TURN_PER_METRE: f64 = 4.0;

/// A situation in which errors are computed. Entries beyond the device's joints are zero.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Probe {
    /// Joint angles, rad.
    pub q: [f64; MAX_JOINTS],
    /// Joint velocities, rad/s.
    pub qd: [f64; MAX_JOINTS],
    /// Unit normal of the wall.
    pub normal: [f64; MAX_JOINTS],
    /// Rate of change of the normal, 1/s.
    pub normal_rate: [f64; MAX_JOINTS],
    /// Task velocity, m/s (and rad/s for φ).
    pub velocity: [f64; MAX_JOINTS],
    /// Largest force that the motors can make along the normal in addition to weight and motion, N.
    pub force: f64,
}

/// Returns unit normals that cover the directions of a task space.
fn unit_normals(task: usize) -> Vec<[f64; MAX_JOINTS]> {
    match task {
        1 => vec![[1.0, 0.0, 0.0]],
        2 => (0..4).map(|i| (f64::from(i) * std::f64::consts::FRAC_PI_4).sin_cos()).map(|(s, c)| [c, s, 0.0]).collect(),
        _ => {
            let d = 1.0 / 3.0_f64.sqrt();
            vec![[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [d, d, d], [-d, d, d], [d, -d, d], [d, d, -d]]
        }
    }
}

/// Returns situations throughout the workspace, with `per_joint` angles per joint and hands at `speed` (m/s).
pub fn workspace(device: &Device<f64>, per_joint: usize, speed: f64) -> Result<Vec<Probe>, PoseError> {
    let reachable = Reachable::of(device, per_joint, None)?;
    let mut probes = Vec::new();
    for index in reachable.indices() {
        let q = padded(&reachable.angles(index));
        for normal in unit_normals(device.mechanism.kind().spec().task) {
            with_mechanism!(&device.mechanism, m => push_situations(m, device, &q, &normal, None, speed, &mut probes));
        }
    }
    Ok(probes)
}

/// Returns situations at which the tip touches a surface. Grid poses near the surface are moved onto it.
pub fn on_surface(
    device: &Device<f64>,
    surface: &Surface<f64>,
    per_joint: usize,
    speed: f64,
) -> Result<Vec<Probe>, PoseError> {
    let reachable = Reachable::of(device, per_joint, None)?;
    let spacing: Vec<f64> = reachable.axes.iter().map(|axis| axis.get(1).map_or(1.0, |next| next - axis[0])).collect();
    let mut probes = Vec::new();
    for index in reachable.indices() {
        let q = padded(&reachable.angles(index));
        with_mechanism!(&device.mechanism, m => {
            if let Some((q, normal)) = move_onto(m, device, surface, &q, &spacing) {
                push_situations(m, device, &q, &normal, Some(surface), speed, &mut probes);
            }
        });
    }
    Ok(probes)
}

fn task_part<M: Mechanism<f64, N>, const N: usize>(task: &SVector<f64, N>) -> SVector<f64, N> {
    SVector::from_fn(|i, _| if i < M::SPEC.task { task[i] } else { 0.0 })
}

/// Moves a pose onto the surface by Newton's method; returns `None` if the surface is more than a grid cell away.
fn move_onto<M: Mechanism<f64, N>, const N: usize>(
    m: &M,
    device: &Device<f64>,
    surface: &Surface<f64>,
    from: &[f64; MAX_JOINTS],
    spacing: &[f64],
) -> Option<([f64; MAX_JOINTS], [f64; MAX_JOINTS])> {
    let start = SVector::<f64, N>::from_fn(|i, _| from[i]);
    let mut q = start;
    for _ in 0..6 {
        let pose = m.pose::<Libm>(&q);
        let contact = surface.contact::<Libm, N>(&task_part::<M, N>(&m.tip(&pose)));
        if contact.distance.abs() < 1.0e-7 {
            let allowed = |i: usize| device.joints[i].limits.is_none_or(|(low, high)| (low..=high).contains(&q[i]));
            let near = (0..N).all(|i| (q[i] - start[i]).abs() <= 1.5 * spacing[i]);
            return ((0..N).all(allowed) && near).then(|| (padded(q.as_slice()), padded(contact.normal.as_slice())));
        }
        q -= m.inverse(&pose, &(contact.normal * contact.distance));
    }
    None
}

fn push_situations<M: Mechanism<f64, N>, const N: usize>(
    m: &M,
    device: &Device<f64>,
    q: &[f64; MAX_JOINTS],
    normal: &[f64; MAX_JOINTS],
    surface: Option<&Surface<f64>>,
    speed: f64,
    probes: &mut Vec<Probe>,
) {
    let joints = SVector::<f64, N>::from_fn(|i, _| q[i]);
    let n = SVector::<f64, N>::from_fn(|i, _| normal[i]);
    let pose = m.pose::<Libm>(&joints);
    let regularity = m.regularity(&pose);
    // Nearer to a singularity every variant fades the feed-forward out.
    if regularity.serial < FULL_REGULARITY || regularity.parallel < FULL_REGULARITY * PARALLEL_REGULARITY {
        return;
    }
    let weight = m.gravity(&pose);
    let (plain, shaping) = (m.transpose(&pose, &n), m.shaping(&pose, &n));
    let per_newton = SVector::<f64, N>::from_fn(|i, _| plain[i].abs().max((shaping.me[i] / shaping.w_rr).abs()));
    // Force that the motors can make in addition to weight and motion; at most zero if they cannot.
    let remaining_force = |b: &SVector<f64, N>| {
        let joints = (0..N).filter_map(|i| device.joints[i].motor.map(|motor| (i, torque_at_rest(&motor, N))));
        let share = joints.map(|(i, most)| (most - weight[i].abs() - b[i].abs()) / per_newton[i].max(1.0e-9));
        share.fold(f64::INFINITY, f64::min)
    };
    let here = task_part::<M, N>(&m.tip(&pose));
    // The guard trips at higher joint speeds, and the board then renders no torque.
    let fastest = Limits::default().in_units(&device.mechanism.units()).speed;
    for velocity in hand_motions::<M, N>(normal) {
        let velocity = SVector::<f64, N>::from_fn(|i, _| speed * velocity[i]);
        let qd = m.inverse(&pose, &velocity);
        if qd.iter().zip(fastest).any(|(rate, fastest)| rate.abs() > f64::from(fastest)) {
            continue;
        }
        let force = remaining_force(&m.velocity_torque(&pose, &qd));
        if force <= 0.0 {
            continue;
        }
        let force = if force.is_finite() { force } else { FORCE_WITHOUT_MOTORS };
        let rate = surface.map_or(SVector::zeros(), |s| s.normal_rate::<Libm, N>(&here, &task_part::<M, N>(&velocity)));
        probes.push(Probe {
            q: *q,
            qd: padded(qd.as_slice()),
            normal: *normal,
            normal_rate: padded(rate.as_slice()),
            velocity: padded(velocity.as_slice()),
            force,
        });
    }
}

/// Returns hand motions per m/s: into the wall, along it, and obliquely.
fn hand_motions<M: Mechanism<f64, N>, const N: usize>(n: &[f64; MAX_JOINTS]) -> Vec<[f64; MAX_JOINTS]> {
    let d = std::f64::consts::FRAC_1_SQRT_2;
    match (M::SPEC.task, N) {
        (1, _) => vec![*n],
        (2, 2) => {
            let t = [-n[1], n[0], 0.0];
            vec![*n, t, [d * (n[0] + t[0]), d * (n[1] + t[1]), 0.0]]
        }
        (2, _) => {
            let t = [-n[1], n[0], 0.0];
            vec![
                *n,
                t,
                [n[0], n[1], LAST_LINK_TURN_PER_METRE],
                [t[0], t[1], LAST_LINK_TURN_PER_METRE],
                [t[0], t[1], -LAST_LINK_TURN_PER_METRE],
            ]
        }
        _ => {
            let n = nalgebra::Vector3::from(*n);
            let t1 = n.cross(&nalgebra::Vector3::ith_axis(n.iamin())).normalize();
            let t2 = n.cross(&t1);
            [n, t1, t2, (t1 + t2) * d, (n + t2) * d].into_iter().map(Into::into).collect()
        }
    }
}
