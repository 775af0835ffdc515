//! Springs and host planes together with walls that have the feed-forward. Loops are built from M, J and the board's
//! torques.

use super::linear::{devices, matrices, pose};
use super::{Linkage, Random, device, first_step, largest_norm, normalized, pad_to_three, unit_vector};
use crate::common::bilateral_wall;
use haptic_bridge::render::controller::{Push, PushedPlane};
use haptic_bridge::render::scene::{FeedForward, Plane, Scene, Spring, Surface, Wall};
use nalgebra::{Complex, DMatrix, DVector};

/// Bilateral walls, springs, and a plane of the host, which all act on the tip.
#[derive(Clone, Debug, Default)]
struct ForceSet {
    /// Normal, stiffness (N/m), and true if the wall has the feed-forward.
    walls: Vec<(Vec<f64>, f64, bool)>,
    /// Direction of the line (`None` for a point) and stiffness (N/m).
    springs: Vec<(Option<Vec<f64>>, f64)>,
    /// Normal and stiffness (N/m).
    plane: Option<(Vec<f64>, f64)>,
}

/// Computes the torques of the board's first step. The set is at `shift` (m) from the tip, the plane 1 cm further.
fn torque(file: &Linkage, q: &[f64], set: &ForceSet, shift: &[f64]) -> DVector<f64> {
    let torque = first_step(file, q, &|tip| {
        let point: [f64; 3] = core::array::from_fn(|i| tip[i] + pad_to_three(shift)[i]);
        let walls = set.walls.iter().map(|(normal, stiffness, with)| Wall {
            feed_forward: if *with { FeedForward::Full } else { FeedForward::Off },
            ..bilateral_wall(Surface::Plane(Plane { point, normal: pad_to_three(normal) }), *stiffness)
        });
        let springs = set.springs.iter().map(|(line, stiffness)| Spring {
            point,
            direction: line.as_ref().map_or([0.0; 3], |line| pad_to_three(line)),
            stiffness: *stiffness,
            damping: 0.0,
        });
        let push = set.plane.as_ref().map(|(normal, stiffness)| {
            let normal = pad_to_three(normal);
            let offset = normal.iter().zip(&point).map(|(n, p)| n * p).sum::<f64>() + 0.01;
            Push { force: [0.0; 3], plane: PushedPlane { normal, offset, stiffness: *stiffness, damping: 0.0 } }
        });
        (Scene { walls: walls.collect(), springs: springs.collect(), ..Scene::default() }, push)
    });
    DVector::from_vec(torque)
}

/// Computes the stiffness matrix K of a set, N/m.
fn stiffness(set: &ForceSet, task: usize) -> DMatrix<f64> {
    let along = |n: &Vec<f64>| DVector::from_vec(n.clone()) * DVector::from_vec(n.clone()).transpose();
    let mut sum = DMatrix::zeros(task, task);
    for (normal, k, _) in &set.walls {
        sum += along(normal) * *k;
    }
    for (line, k) in &set.springs {
        let line = line.as_ref().map_or(DMatrix::zeros(task, task), along);
        sum += (DMatrix::identity(task, task) - line) * *k;
    }
    if let Some((normal, k)) = &set.plane {
        sum += along(normal) * *k;
    }
    sum
}

/// Returns the eigenvalues of the tip's acceleration per displacement (1/s²), with the board's torques and with Jᵀ.
fn modes(file: &Linkage, q: &[f64], set: &ForceSet) -> [Vec<Complex<f64>>; 2] {
    let (mass, jacobian) = matrices(file, q).expect("a regular pose");
    let task = jacobian.nrows();
    let step = 1.0e-3;
    let rest = torque(file, q, set, &vec![0.0; task]);
    let columns: Vec<_> = (0..task)
        .map(|j| {
            let shift: Vec<f64> = (0..task).map(|i| if i == j { step } else { 0.0 }).collect();
            (torque(file, q, set, &shift) - &rest) / step
        })
        .collect();
    let inverse = mass.try_inverse().expect("a mass matrix");
    let plain = jacobian.transpose() * stiffness(set, task);
    [DMatrix::from_columns(&columns), plain]
        .map(|torques| (&jacobian * &inverse * torques).complex_eigenvalues().iter().copied().collect())
}

/// Asserts that the modes have real masses that are not lighter than without the feed-forward. Returns the ratio of the
/// lightest masses with and without the feed-forward.
fn mass_ratio(file: &Linkage, q: &[f64], set: &ForceSet) -> f64 {
    let [board, plain] = modes(file, q, set);
    let without = largest_norm(&plain);
    for mode in &board {
        let real = mode.im.abs() <= 1.0e-5 * without && mode.re >= -1.0e-6 * without;
        assert!(real, "{} {q:?} {set:?}: {mode} is not the inverse of a mass, {without}", file.name);
        assert!(mode.re <= without * (1.0 + 1.0e-6), "{} {q:?} {set:?}: mode {mode}, {without} plain", file.name);
    }
    without / largest_norm(&board)
}

#[test]
fn the_feed_forward_makes_no_walls_with_springs_less_stable() {
    let mut random = Random(17);
    let (mut largest_ratio, mut cases) = (0.0_f64, 0);
    for device in devices() {
        let task = device.spec().task;
        for set in 0..60 {
            let q = pose(&device, &mut random);
            let decades = if set % 4 < 2 { 1.0 } else { 3.0 };
            let gain = |random: &mut Random| 10_f64.powf(random.uniform(0.0, decades));
            let base = random.direction(task);
            let walls = (0..1 + set % 3)
                .map(|i| {
                    let near = set % 2 == 0;
                    let n = if near { random.direction_near(&base, 0.5) } else { random.direction(task) };
                    (n, gain(&mut random), i == 0 || random.uniform(0.0, 1.0) < 0.5)
                })
                .collect();
            let springs = (0..set % 3)
                .map(|_| {
                    let line = (random.uniform(0.0, 1.0) < 0.7).then(|| random.direction(task));
                    (line, gain(&mut random))
                })
                .collect();
            let plane = (set % 3 == 0 || set % 5 == 0).then(|| (random.direction(task), gain(&mut random)));
            largest_ratio = largest_ratio.max(mass_ratio(&device, &q, &ForceSet { walls, springs, plane }));
            cases += 1;
        }
    }
    assert!(cases == 420 && largest_ratio > 1.5, "the feed-forward has too little effect: {largest_ratio}");
}

/// Returns the normal n of the demo's wall, and the direction halfway between n and Λ n.
fn normal_and_oblique(file: &Linkage, q: &[f64]) -> (Vec<f64>, Vec<f64>) {
    let n = unit_vector(75_f64.to_radians());
    let (mass, jacobian) = matrices(file, q).expect("a regular pose");
    let back = jacobian.try_inverse().expect("a square Jacobian");
    let inertial = back.transpose() * mass * &back * DVector::from_vec(n.clone());
    let inertial = normalized(inertial.as_slice());
    let m = normalized(&[n[0] + inertial[0], n[1] + inertial[1]]);
    (n, m)
}

#[test]
fn a_spring_or_plane_with_a_wall_leaves_no_unstable_motion() {
    let (file, q) = (device("coupled-five-bar"), [2.6, 1.75]);
    let (n, m) = normal_and_oblique(&file, &q);
    let walls = vec![(n.clone(), 5_000.0, true)];
    // If the spring or plane acted through Jᵀ and the wall by (4), one eigenvalue would be negative for any gains.
    let (mass, jacobian) = matrices(&file, &q).expect("a regular pose");
    let alone = modes(&file, &q, &ForceSet { walls: walls.clone(), ..ForceSet::default() })[0].clone();
    let (n, m) = (DVector::from_vec(n), DVector::from_vec(m));
    let mobility = &jacobian * mass.try_inverse().expect("a mass matrix") * jacobian.transpose();
    for stiffness in [100.0, 1_000.0, 5_000.0] {
        let straight = &n * n.transpose() * largest_norm(&alone) + &mobility * &m * m.transpose() * stiffness;
        assert!(straight.complex_eigenvalues().iter().any(|mode| mode.re < -1.0), "{stiffness}");
        let across = vec![-m[1], m[0]];
        let spring = ForceSet { walls: walls.clone(), springs: vec![(Some(across), stiffness)], plane: None };
        let plane = ForceSet { walls: walls.clone(), springs: vec![], plane: Some((m.as_slice().to_vec(), stiffness)) };
        for set in [spring, plane] {
            mass_ratio(&file, &q, &set);
        }
    }
}

#[test]
fn torque_is_continuous_in_the_stiffness_of_a_spring() {
    for (name, q) in [("coupled-five-bar", vec![2.6, 1.75]), ("phantom-premium-1.5", vec![0.3, 0.9, -0.3])] {
        let file = device(name);
        let task = file.spec().task;
        let wall = (normalized(&[0.3, 1.0, 0.2][..task]), 2_000.0, true);
        let line = normalized(&[1.0, -0.5, 0.4][..task]);
        let shift = vec![2.0e-3; task];
        for (spring, plane) in [(Some(None), false), (Some(Some(line.clone())), false), (None, true)] {
            // The torque is divided by the stiffness, so that a jump at any stiffness is found.
            let at = |log: f64| {
                let k = log.exp();
                let springs = spring.iter().map(|line| (line.clone(), k)).collect();
                let plane = plane.then(|| (line.clone(), k));
                torque(&file, &q, &ForceSet { walls: vec![wall.clone()], springs, plane }, &shift) / (k + 2_000.0)
            };
            let none =
                torque(&file, &q, &ForceSet { walls: vec![wall.clone()], ..ForceSet::default() }, &shift) / 2_000.0;
            assert!(
                (at(-7.0) - &none).norm() < 1.0e-5 * none.norm(),
                "{name}: a soft spring must not change the torque"
            );
            let (steps, low, high) = (3_000, -7.0, 14.0);
            let step = (high - low) / f64::from(steps);
            let mut last = at(low);
            for i in 1..=steps {
                let next = at(low + step * f64::from(i));
                let slope = (&next - &last).norm() / step;
                // The bound allows for the plane's penetration of 1 cm.
                assert!(slope < 12.0 * none.norm(), "{name} {i}: slope {slope}, torque {}", none.norm());
                last = next;
            }
        }
    }
}

#[test]
fn springs_without_feed_forward_act_through_the_jacobian() {
    let mut random = Random(4);
    for device in devices() {
        let task = device.spec().task;
        let q = pose(&device, &mut random);
        let (_, jacobian) = matrices(&device, &q).expect("a regular pose");
        let springs = vec![(None, 300.0), (Some(random.direction(task)), 800.0)];
        for walls in [vec![], vec![(random.direction(task), 2_000.0, false)]] {
            let set = ForceSet { walls, springs: springs.clone(), plane: None };
            let shift = random.direction(task).iter().map(|x| x * 0.01).collect::<Vec<_>>();
            let straight = jacobian.transpose() * stiffness(&set, task) * DVector::from_vec(shift.clone());
            let found = torque(&device, &q, &set, &shift);
            assert!((&found - &straight).norm() < 1.0e-6 * straight.norm(), "{}: {found} for {straight}", device.name);
        }
    }
}
