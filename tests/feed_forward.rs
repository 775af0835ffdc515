//! Tests equation (4) in the complete control step. With the feed-forward the tip accelerates in the rendered
//! directions only, on flat and curved walls and in corners. With the washout a resting hand gets no sideways force.

use crate::common::{bilateral_wall, device_file, fine_counts, inverse, with_fine_encoders};
use haptic_bridge::control::compiled::BoardMath;
use haptic_bridge::math::{Libm, Math, Real};
use haptic_bridge::model::description::Description;
use haptic_bridge::model::device::Device;
use haptic_bridge::model::mechanism::{AnyMechanism, Mechanism};
use haptic_bridge::render::controller::Controller;
use haptic_bridge::render::scene::{Cylinder, FeedForward, Plane, Scene, Sphere, Surface, Wall};
use haptic_bridge::with_mechanism;
use nalgebra::SVector;

const RATE_HZ: f64 = 1_000.0;
fn shipped_device(name: &str) -> Description {
    with_fine_encoders(device_file::shipped_device(name))
}

fn wall<T: Real>(surface: Surface<T>, feed_forward: FeedForward) -> Wall<T> {
    Wall { feed_forward, ..bilateral_wall(surface, 100.0) }
}

fn controller<T: Real, K: Math<T>, M: Mechanism<T, N>, const N: usize>(
    mechanism: M,
    device: &Description,
    walls: &[Wall<T>],
) -> Controller<T, M, K, N> {
    let scene = Scene {
        task: M::SPEC.task as u8,
        rate_hz: T::from_f64(RATE_HZ),
        cutoff_hz: T::from_f64(100.0),
        walls: walls.iter().copied().collect(),
        ..Scene::default()
    };
    let device = Device::new("device", device).expect("a sound device");
    Controller::new(mechanism, &device, &scene).expect("a sound scene")
}

/// Motion of the tip under the torques of one control step, and the wall force (N).
struct TipMotion<const N: usize> {
    position: SVector<f64, N>,
    velocity: SVector<f64, N>,
    acceleration: SVector<f64, N>,
    force: f64,
}

/// Returns the tip's motion under the torques of the step that ends a steady motion through `q` at `qd`.
fn tip_motion<M: Mechanism<f64, N>, const N: usize>(
    m: M,
    device: &Description,
    walls: &[Wall<f64>],
    q: &SVector<f64, N>,
    qd: &SVector<f64, N>,
) -> TipMotion<N> {
    let mut controller = controller::<f64, Libm, M, N>(m, device, walls);
    // Sixty steps let the joint filters settle. At constant velocity their lag does not matter.
    let last = (-60..=0).map(|k| controller.step(&fine_counts(&(q + qd * (f64::from(k) / RATE_HZ))))).last();
    let step = last.expect("there are steps");
    let pose = m.pose::<Libm>(q);
    let bias = m.coriolis(&pose, qd) + m.gravity(&pose);
    let qdd = inverse(&m.mass(&pose)) * (step.torque - bias);
    TipMotion {
        position: m.tip(&pose),
        velocity: m.velocity(&pose, qd),
        acceleration: m.jacobian(&pose) * qdd + m.jacobian_rate(&pose, qd) * qd,
        force: step.wall_force,
    }
}

/// Offset of a round wall's centre from the tip, m.
const CENTER_OFFSET: [f64; 3] = [0.03, -0.04, 0.02];

/// Returns a sphere or cylinder whose surface passes near `tip`. The tip is outside or inside, depending on `shape`.
fn round_wall<const N: usize>(tip: &SVector<f64, N>, offset: [f64; 3], shape: u8, task: usize) -> Surface<f64> {
    let point = core::array::from_fn(|i| if i < task.min(N) { tip[i] + offset[i] } else { 0.0 });
    let radius = 0.06;
    match shape {
        0 => Surface::Sphere(Sphere { center: point, radius, inside: false }),
        1 => Surface::Sphere(Sphere { center: point, radius, inside: true }),
        _ => Surface::Cylinder(Cylinder { point, axis: [0.36, 0.48, 0.8], radius, inside: shape == 3 }),
    }
}

fn flat_wall(task: usize) -> Surface<f64> {
    let normal = if task == 2 { [0.8, 0.6, 0.0] } else { [0.36, 0.48, 0.8] };
    Surface::Plane(Plane { point: [0.0; 3], normal })
}

fn task_part<const N: usize>(v: &SVector<f64, N>, task: usize) -> SVector<f64, N> {
    SVector::from_fn(|i, _| if i < task { v[i] } else { 0.0 })
}

/// Returns orthogonal unit vectors perpendicular to `normal`, including axes beyond the task.
fn perpendicular_units<const N: usize>(normal: &SVector<f64, N>) -> Vec<SVector<f64, N>> {
    let mut found: Vec<SVector<f64, N>> = vec![*normal];
    for i in 0..N {
        let mut v = SVector::<f64, N>::zeros();
        v[i] = 1.0;
        for unit in &found {
            v -= unit * unit.dot(&v);
        }
        if v.norm() > 0.3 {
            found.push(v.normalize());
        }
    }
    found.split_off(1)
}

fn check_one_wall<M: Mechanism<f64, N>, const N: usize>(m: M, device: &Description, q: &[f64], qd: &[f64]) {
    let task = M::SPEC.task;
    let (q, qd) = (SVector::<f64, N>::from_column_slice(q), SVector::<f64, N>::from_column_slice(qd));
    let tip = m.tip(&m.pose::<Libm>(&q));
    let shapes = if task == 3 { 0..5 } else { 0..3 };
    for shape in shapes {
        let surface = if shape == 0 { flat_wall(task) } else { round_wall(&tip, CENTER_OFFSET, shape - 1, task) };
        let o = tip_motion(m, device, &[wall(surface, FeedForward::Full)], &q, &qd);
        let (p, v) = (task_part(&o.position, task), task_part(&o.velocity, task));
        let n = surface.contact::<Libm, N>(&p).normal;
        let n_rate = surface.normal_rate::<Libm, N>(&p, &v);
        assert!(o.force.abs() > 0.1 && v.norm() > 0.1, "no contact in motion: {} N at {} m/s", o.force, v.norm());
        assert!(shape == 0 || n_rate.norm() > 0.5, "the normal turns: {n_rate}");
        for t in perpendicular_units(&n) {
            // π̇a = t·p̈ + ṫ·ṗ, where t turns with n without spinning about n.
            let admissible = t.dot(&o.acceleration) - t.dot(&n_rate) * n.dot(&v);
            assert!(admissible.abs() < 2e-3, "{} shape {shape}: {admissible} m/s² along the wall", M::SPEC.name);
        }
        assert!(n.dot(&o.acceleration).abs() > 0.5, "the wall accelerates the tip");
    }
}

#[test]
fn at_any_wall_the_tip_accelerates_along_the_normal_only() {
    let device = shipped_device("haply-2diy");
    with_five_bar(&device, |m| check_one_wall(m, &device, &[2.4, 0.7], &[1.5, -1.1]));
    for (file, q, qd) in [
        ("fictive-five-bar-turret", [0.3, 2.4, 1.1], [2.0, -1.0, 0.8]),
        ("phantom-premium-1.5", [0.3, 0.9, -0.3], [1.5, -0.7, 1.2]),
        ("serial-3r", [0.4, 0.9, 0.7], [1.0, -0.8, 1.3]),
    ] {
        let device = shipped_device(file);
        match AnyMechanism::<f64>::new(&device).expect("a sound device") {
            AnyMechanism::FiveBarTurret(m) => check_one_wall(m, &device, &q, &qd),
            AnyMechanism::Parallelogram(m) => check_one_wall(m, &device, &q, &qd),
            AnyMechanism::Serial3r(m) => check_one_wall(m, &device, &q, &qd),
            other => panic!("{other:?} does not have three joints"),
        }
    }
}

fn with_five_bar(device: &Description, f: impl Fn(haptic_bridge::model::mechanism::FiveBar<f64>)) {
    let Ok(AnyMechanism::FiveBar(m)) = AnyMechanism::<f64>::new(device) else { panic!("a sound five-bar") };
    f(m);
}

/// Checks two walls that act together, where the admissible direction is the line along both. Curved walls, at right
/// angles and of equal stiffness, show that the line turns. Flat walls are tested at several angles and ratios of
/// stiffness.
fn check_edge<M: Mechanism<f64, 3>>(m: M, device: &Description, q: [f64; 3], qd: [f64; 3]) {
    let (q, qd) = (SVector::from(q), SVector::from(qd));
    let tip = m.tip(&m.pose::<Libm>(&q));
    let normals = [SVector::from([0.36, 0.48, 0.8]), SVector::from([0.8, -0.6, 0.0])];
    let plane = |n: &SVector<f64, 3>| Surface::Plane(Plane { point: [0.0; 3], normal: (*n).into() });
    let behind = |n: &SVector<f64, 3>, distance: f64| (tip - n * distance).into();
    let ball = |n| Surface::Sphere(Sphere { center: behind(n, 0.05), radius: 0.06, inside: false });
    let bowl = |n| Surface::Sphere(Sphere { center: behind(n, -0.05), radius: 0.06, inside: true });
    let rod = |n, axis: &SVector<f64, 3>| {
        Surface::Cylinder(Cylinder { point: behind(n, 0.05), axis: (*axis).into(), radius: 0.06, inside: false })
    };
    let [n1, n2] = &normals;
    let oblique = (n1 + n2 * 0.7).normalize();
    for (pair, stiffness) in [
        ([plane(n1), plane(n2)], 100.0),
        ([plane(n1), plane(&oblique)], 100.0),
        ([plane(n1), plane(&oblique)], 3.0),
        ([plane(n1), ball(n2)], 100.0),
        ([bowl(n1), rod(n2, n1)], 100.0),
    ] {
        let mut walls = pair.map(|surface| wall(surface, FeedForward::Full));
        walls[1].stiffness = stiffness;
        let o = tip_motion(m, device, &walls, &q, &qd);
        let n = pair.map(|surface| surface.contact::<Libm, 3>(&o.position).normal);
        let rate = pair.map(|surface| surface.normal_rate::<Libm, 3>(&o.position, &o.velocity));
        // The line is t = n₁ x n₂ / |n₁ x n₂|. Its rate follows from the product rule.
        let line = n[0].cross(&n[1]);
        let length = line.norm();
        assert!(length > 0.2, "the walls cross");
        let t = line / length;
        let line_rate = rate[0].cross(&n[1]) + n[0].cross(&rate[1]);
        let t_rate = (line_rate - t * t.dot(&line_rate)) / length;
        let admissible = t.dot(&o.acceleration) + t_rate.dot(&o.velocity);
        assert!(admissible.abs() < 2e-3, "{} {pair:?}: {admissible} m/s²", M::SPEC.name);
        assert!(o.acceleration.norm() > 0.5, "the walls accelerate the tip");
    }
}

#[test]
fn the_tip_does_not_accelerate_along_an_edge_of_two_walls() {
    let device = shipped_device("fictive-five-bar-turret");
    let Ok(AnyMechanism::FiveBarTurret(m)) = AnyMechanism::new(&device) else { panic!("a turreted five-bar") };
    check_edge(m, &device, [0.3, 2.4, 1.1], [2.0, -1.0, 0.8]);
    let device = shipped_device("phantom-premium-1.5");
    let Ok(AnyMechanism::Parallelogram(m)) = AnyMechanism::new(&device) else { panic!("a parallelogram") };
    check_edge(m, &device, [0.3, 0.9, -0.3], [1.5, -0.7, 1.2]);
}

/// Computes the sideways force per wall force (N/N) of the board's torques at rest, `seconds` after contact.
fn sideways_force<A, B, const N: usize>(
    double: A,
    board: B,
    device: &Description,
    q: &SVector<f64, N>,
    n: &SVector<f64, N>,
    feed_forward: FeedForward,
    seconds: f64,
) -> f64
where
    A: Mechanism<f64, N>,
    B: Mechanism<f32, N>,
{
    let pose = double.pose::<Libm>(q);
    let tip = task_part(&double.tip(&pose), A::SPEC.task) + n * 0.01;
    let three = |v: &SVector<f64, N>| core::array::from_fn(|i| if i < A::SPEC.task { v[i] as f32 } else { 0.0 });
    let mut plane = wall(Surface::Plane(Plane { point: three(&tip), normal: three(n) }), feed_forward);
    plane.bilateral = false;
    let mut controller = controller::<f32, BoardMath, B, N>(board, device, &[plane]);
    let mut step = controller.step(&fine_counts(q));
    for _ in 0..(seconds * RATE_HZ) as u32 {
        step = controller.step(&fine_counts(q));
    }
    let torque = step.torque.map(f64::from) - double.gravity(&pose);
    let force = double.jacobian_inverse(&pose).tr_mul(&torque);
    (force - n * n.dot(&force)).norm() / f64::from(step.wall_force)
}

#[test]
fn with_the_washout_a_resting_hand_gets_no_sideways_force() {
    let device = shipped_device("phantom-premium-1.5");
    let Ok(AnyMechanism::Parallelogram(double)) = AnyMechanism::<f64>::new(&device) else { panic!("a parallelogram") };
    let Ok(AnyMechanism::Parallelogram(board)) = AnyMechanism::<f32>::new(&device) else { panic!("a parallelogram") };
    let q = SVector::from([0.3, 0.9, -0.3]);
    let mut worst_full = 0.0_f64;
    for k in 0..24 {
        let angle = f64::from(k) / 24.0 * std::f64::consts::TAU;
        let n = SVector::from([0.8 * angle.cos(), angle.sin(), 0.6 * angle.cos()]);
        let force = |feed_forward, seconds| sideways_force(double, board, &device, &q, &n, feed_forward, seconds);
        let (full, fresh) = (force(FeedForward::Full, 3.0), force(FeedForward::Washout, 0.0));
        let (early, rested) = (force(FeedForward::Washout, 0.01), force(FeedForward::Washout, 3.0));
        worst_full = worst_full.max(full);
        // The washout acts like the full feed-forward at contact, almost the same after 10 ms, and finally not at all.
        assert!((fresh - full).abs() <= 0.02 * full + 1e-4, "sideways force {fresh} at contact, {full} in full");
        assert!(early <= full + 1e-4 && early >= 0.8 * full - 1e-4, "sideways {early} after 10 ms, {full} in full");
        assert!(rested < 1e-4, "a sideways force of {rested} N per N at rest");
        assert!(force(FeedForward::Off, 0.0) < 1e-4);
    }
    assert!(worst_full > 0.2, "the full feed-forward must push sideways at rest: {worst_full}");
}

#[test]
fn a_wall_never_pulls() {
    for file in ["hapkit-paddle", "haply-2diy", "fictive-five-bar-turret", "phantom-premium-1.5", "serial-3r"] {
        let device = shipped_device(file);
        let mechanism = AnyMechanism::<f32>::new(&device).expect("a sound device");
        with_mechanism!(mechanism, m => check_shaken_wall(m, &device));
    }
}

/// Shakes the tip in and out of a damped wall and checks that the wall never pulls.
fn check_shaken_wall<M: Mechanism<f32, N>, const N: usize>(m: M, device: &Description) {
    let home = device.home.expect("shipped devices have a home");
    let home = SVector::<f64, N>::from_fn(|i, _| home[i]);
    let task = M::SPEC.task;
    let tip = m.tip(&m.pose::<BoardMath>(&home.map(|x| x as f32)));
    let normal = match task {
        1 => [1.0, 0.0, 0.0],
        2 => [0.8, 0.6, 0.0],
        _ => [0.36, 0.48, 0.8],
    };
    let at = core::array::from_fn(|i| if i < task { tip[i] } else { 0.0 });
    for feed_forward in [FeedForward::Off, FeedForward::Full, FeedForward::Washout] {
        let mut wall = wall(Surface::Plane(Plane { point: at, normal }), feed_forward);
        wall.damping = 50.0;
        wall.bilateral = false;
        let mut controller = controller::<f32, BoardMath, M, N>(m, device, &[wall]);
        let (mut touched, mut leaving) = (false, false);
        for k in 0..4_000 {
            let t = f64::from(k) / RATE_HZ;
            let q = home.map(|x| x + 0.05 * (31.0 * t).sin() + 0.03 * (83.0 * t).cos());
            let step = controller.step(&fine_counts(&q));
            assert!(step.wall_force >= 0.0, "{step:?}");
            touched |= step.wall_force > 0.0;
            // The tip is inside and leaves so fast that the damping force alone would pull.
            let unclamped = -100.0 * step.distance - 50.0 * step.normal_velocity;
            if step.distance < 0.0 && unclamped < 0.0 {
                leaving = true;
                assert_eq!(step.wall_force, 0.0);
            }
        }
        assert!(touched && leaving, "{}: the tip must hit and leave the wall", M::SPEC.name);
    }
}
