//! Torques never jump. Their slopes over the angle between walls, over the stiffness ratio and over the penetration
//! stay below bounds that do not depend on the sampling.

use super::{Linkage, Precision, device, first_step, normalized, pad_to_three, torque, torque_with_flags, unit_vector};
use crate::common::{bilateral_wall, fine_counts, with_fine_encoders};
use haptic_bridge::control::compiled::BoardMath;
use haptic_bridge::model::device::Device;
use haptic_bridge::model::mechanism::{AnyMechanism, FiveBar};
use haptic_bridge::render::controller::{Controller, TOUCH_DEPTH};
use haptic_bridge::render::scene::{FeedForward, Plane, Scene, Surface, Wall};
use nalgebra::SVector;

fn distance(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum::<f64>().sqrt()
}

/// Returns the largest slope of `f` between `low` and `high`, sampled in `steps` steps.
fn largest_slope(low: f64, high: f64, steps: u32, mut f: impl FnMut(f64) -> Vec<f64>) -> f64 {
    let step = (high - low) / f64::from(steps);
    let mut last = f(low);
    (1..=steps).fold(0.0, |worst: f64, i| {
        let next = f(low + step * f64::from(i));
        let found = distance(&next, &last) / step;
        last = next;
        worst.max(found)
    })
}

fn device_poses() -> Vec<(Linkage, Vec<f64>)> {
    vec![
        (device("coupled-five-bar"), vec![2.6, 1.75]),
        (device("serial-3r"), vec![0.4, 0.9, 0.7]),
        (device("phantom-premium-1.5"), vec![0.3, 0.9, -0.3]),
        (device("woodenhaptics"), vec![0.3, 0.9, -0.3]),
    ]
}

/// Returns a unit vector that turns with `angle` (rad), in the plane or on a cone.
fn turned_normal(task: usize, angle: f64, tilt: f64) -> Vec<f64> {
    match task {
        2 => unit_vector(0.3 + angle),
        _ => normalized(&[angle.cos(), angle.sin() + 0.2, tilt]),
    }
}

/// Sets of walls. The first flag is true if there is a third wall, the others are true for walls with the feed-forward.
const WALL_SETS: [(bool, [bool; 3]); 6] = [
    (false, [true, true, true]),
    (true, [true, true, true]),
    (false, [true, false, true]),
    (false, [false, true, true]),
    (true, [false, true, false]),
    (true, [true, false, true]),
];

/// Returns the largest torque per newton that (4) gives for one wall (m), which scales the bounds of slopes.
fn lever(device: &Linkage, q: &[f64]) -> f64 {
    let task = device.spec().task;
    let mut largest = 0.0_f64;
    for i in 0..64 {
        let n = turned_normal(task, 0.1 * f64::from(i), (f64::from(i) * 0.37).sin() * 2.0);
        largest = largest.max(distance(&torque(device, q, &[(n, 1.0, 1.0)], Precision::F64), &vec![0.0; q.len()]));
    }
    largest
}

#[test]
fn torque_is_continuous_in_the_angle_between_walls() {
    for (device, q) in device_poses() {
        let (task, lever) = (device.spec().task, lever(&device, &q));
        for ratio in [1.0, 1.3, 30.0, 1.0e4] {
            for (third, with) in WALL_SETS {
                let f = |angle: f64| {
                    let mut walls = vec![
                        (turned_normal(task, 0.0, 0.4), 1.0, 5.0),
                        (turned_normal(task, angle, 0.4 + angle), ratio, 5.0),
                    ];
                    if third {
                        walls.push((turned_normal(task, 0.7, -0.3), 0.5 * ratio, 3.0));
                    }
                    torque_with_flags(&device, &q, &walls, &with[..walls.len()], Precision::F64)
                };
                // The fine range passes parallel walls, where the span of the normals jumps. The coarse range ends
                // above 90°.
                let fine = largest_slope(-2.0e-3, 2.0e-3, 400, f);
                let coarse = largest_slope(-0.3, 2.0, 800, f);
                // The turning normals of 13 N cause a slope of 13 levers. The shares limit the slope of e₁ to 8 levers per
                // newton.
                let bound = 8.0 * 13.0 * lever;
                assert!(fine < bound && coarse < bound, "{} {ratio}: slopes {fine}, {coarse} > {bound}", device.name);
            }
        }
    }
}

#[test]
fn torque_is_continuous_in_the_ratio_of_stiffness() {
    for (device, q) in device_poses() {
        let (task, lever) = (device.spec().task, lever(&device, &q));
        for angle in [1.0e-3, 0.05, 0.6, 1.2, std::f64::consts::FRAC_PI_2] {
            for (third, with) in WALL_SETS {
                let mut f = |log: f64| {
                    let mut walls = vec![
                        (turned_normal(task, 0.0, 0.4), 1.0, 5.0),
                        (turned_normal(task, angle, 0.4), log.exp(), 5.0),
                    ];
                    if third {
                        walls.push((turned_normal(task, 0.7, -0.3), 3.0, 3.0));
                    }
                    torque_with_flags(&device, &q, &walls, &with[..walls.len()], Precision::F64)
                };
                let (low, high) = (1.0e-4_f64.ln(), 1.0e4_f64.ln());
                let whole = largest_slope(low, high, 1_500, &mut f);
                // Near equal stiffness the eigenvectors exchange their order.
                let equal = largest_slope(-1.0e-4, 1.0e-4, 200, &mut f);
                let bound = 4.0 * 13.0 * lever;
                assert!(whole < bound && equal < bound, "{} {angle}: slopes {whole}, {equal} > {bound}", device.name);
            }
        }
    }
}

/// Computes the torques of the board's first step at a pose for walls (normal, stiffness, penetration in m). Walls
/// whose flag in `with` is true have the feed-forward.
fn board_torques(file: &Linkage, q: &[f64], walls: &[(Vec<f64>, f64, f64)], with: &[bool]) -> Vec<f64> {
    first_step(file, q, &|tip| {
        let walls = walls.iter().zip(with).map(|((normal, stiffness, depth), with)| {
            let normal = pad_to_three(normal);
            let point = core::array::from_fn(|i| tip[i] + depth * normal[i]);
            let feed_forward = if *with { FeedForward::Full } else { FeedForward::Off };
            let plane = Surface::Plane(Plane { point, normal });
            Wall { feed_forward, bilateral: false, ..bilateral_wall(plane, *stiffness) }
        });
        (Scene { walls: walls.collect(), ..Scene::default() }, None)
    })
}

/// Computes the torque per newton of the wall `pushing` (m) from steps at 1 and 1.1 mm, where all walls count in full.
pub fn lever_of_the_board(
    file: &Linkage,
    q: &[f64],
    walls: &[(Vec<f64>, f64)],
    with: &[bool],
    pushing: usize,
) -> Vec<f64> {
    let at = |pushed: f64| {
        let depth = |i: usize| if i == pushing { pushed } else { 1.0e-3 };
        let walls: Vec<_> = walls.iter().enumerate().map(|(i, (n, k))| (n.clone(), *k, depth(i))).collect();
        board_torques(file, q, &walls, with)
    };
    let newtons = walls[pushing].1 * 1.0e-4;
    at(1.1e-3).iter().zip(at(1.0e-3)).map(|(far, near)| (far - near) / newtons).collect()
}

#[test]
fn torque_is_continuous_in_depth() {
    for (file, q) in device_poses() {
        let (task, lever) = (file.spec().task, lever(&file, &q));
        for (soft, stiff) in [(2_000.0, 2_000.0), (5_000.0, 20_000.0), (20.0, 200_000.0), (20_000.0, 2.0)] {
            for angle in [0.05, 0.8, std::f64::consts::FRAC_PI_2] {
                for (third, with) in WALL_SETS {
                    // The first wall is 2 mm deep, and the penetration of the second wall grows.
                    let f = |depth: f64| {
                        let mut walls = vec![
                            (turned_normal(task, 0.0, 0.4), soft, 2.0e-3),
                            (turned_normal(task, angle, 0.4), stiff, depth),
                        ];
                        if third {
                            walls.push((turned_normal(task, 0.7, -0.3), 0.3 * stiff, depth - 1.0e-4));
                        }
                        board_torques(&file, &q, &walls, &with)
                    };
                    // Each wall's own force contributes its stiffness times a lever. The shaping of the first wall
                    // changes over the depth in which the weight of the second wall grows. That is ∂w/∂x ≤ 2 · 1.5
                    // k₂/k₁ over TOUCH_DEPTH, times the first wall's force.
                    let first = soft * 2.0e-3;
                    let bound = 3.0 * lever * (1.6 * stiff + 3.0 * first / TOUCH_DEPTH * (stiff / soft).max(1.0));
                    let whole = largest_slope(-1.0e-4, 5.0e-4, 300, f);
                    let touch = largest_slope(-1.0e-7, 1.0e-7, 20, f);
                    assert!(
                        whole < bound && touch < bound,
                        "{} {soft} {stiff}: slopes {whole}, {touch} > {bound}",
                        file.name
                    );
                }
            }
        }
    }
}

#[test]
fn board_and_model_agree_on_walls_with_and_without_feed_forward() {
    for (device, q) in device_poses() {
        let task = device.spec().task;
        let walls = [
            (turned_normal(task, 0.0, 0.4), 3_000.0),
            (turned_normal(task, 0.9, 0.4), 2_000.0),
            (turned_normal(task, 0.7, -0.3), 1_000.0),
        ];
        for with in [[true, false, true], [false, true, false], [false, false, true], [true, true, true]] {
            for pushing in 0..3 {
                let set: Vec<_> = walls
                    .iter()
                    .enumerate()
                    .map(|(i, (n, k))| (n.clone(), *k, f64::from(u8::from(i == pushing))))
                    .collect();
                let model = torque_with_flags(&device, &q, &set, &with, Precision::F64);
                let board = lever_of_the_board(&device, &q, &walls, &with, pushing);
                // The tolerance allows for the board's angles, which are rounded to counts.
                let error = distance(&model, &board) / distance(&model, &vec![0.0; q.len()]);
                assert!(error < 1.0e-6, "{} {with:?} {pushing}: {board:?} is not {model:?}", device.name);
            }
        }
    }
}

#[test]
fn touching_a_second_wall_causes_no_jump_of_torque() {
    for (file, q) in device_poses() {
        let task = file.spec().task;
        let with = |walls: &[(Vec<f64>, f64, f64)]| board_torques(&file, &q, walls, &[true; 2]);
        let first = (turned_normal(task, 0.0, 0.4), 5_000.0, 2.0e-3);
        let alone = with(std::slice::from_ref(&first));
        for angle in [0.05, 0.8, std::f64::consts::FRAC_PI_2] {
            // A wall of 5 kN/m pushes with 0.05 mN at 10 nm.
            let touched = with(&[first.clone(), (turned_normal(task, angle, 0.4), 5_000.0, 1.0e-8)]);
            let step = distance(&alone, &touched) / distance(&alone, &vec![0.0; q.len()]);
            assert!(step < 1.0e-4, "{}: the torque jumps by {step:e}", file.name);
            let pressed = with(&[first.clone(), (turned_normal(task, angle, 0.4), 5_000.0, 2.0e-3)]);
            assert!(
                distance(&alone, &pressed) > 0.01 * distance(&alone, &vec![0.0; q.len()]),
                "the second wall must act"
            );
        }
    }
}

#[test]
fn single_precision_suffices_up_to_a_stiffness_ratio_of_1e4() {
    for (device, q) in device_poses() {
        let (task, lever) = (device.spec().task, lever(&device, &q));
        for ratio in [1.0, 1.001, 10.0, 1.0e4] {
            for angle in [0.0, 1.0e-3, 0.1, 0.9, std::f64::consts::FRAC_PI_2] {
                let walls = [
                    (turned_normal(task, 0.0, 0.4), 1.0, 5.0),
                    (turned_normal(task, angle, 0.4), ratio, 5.0),
                    (turned_normal(task, 0.7, -0.3), 0.3 * ratio, 3.0),
                ];
                for count in [2, 3] {
                    let [double, single] =
                        [Precision::F64, Precision::F32].map(|p| torque(&device, &q, &walls[..count], p));
                    let error = distance(&double, &single) / (13.0 * lever);
                    // A rounding error of 6e-8 turns the soft directions by up to 6e-8 times the root of the ratio.
                    assert!(error < 5.0e-5, "{} {ratio} {angle}, {count} walls: {error:e}", device.name);
                }
            }
        }
    }
}

#[test]
fn coplanar_walls_are_one_wall_and_the_order_does_not_matter() {
    for (device, q) in device_poses() {
        let task = device.spec().task;
        let n = turned_normal(task, 0.4, 0.3);
        let one = torque(&device, &q, &[(n.clone(), 1.0, 8.0)], Precision::F64);
        let cut = torque(&device, &q, &[(n.clone(), 3.0, 5.0), (n.clone(), 0.1, 3.0)], Precision::F64);
        assert!(distance(&one, &cut) < 1.0e-12, "{}: the torques differ: {one:?} {cut:?}", device.name);
        let mut walls =
            vec![(n, 1.0, 5.0), (turned_normal(task, 1.5, 0.3), 4.0, 2.0), (turned_normal(task, -0.7, 0.9), 0.2, 3.0)];
        let forth = torque(&device, &q, &walls, Precision::F64);
        walls.reverse();
        let back = torque(&device, &q, &walls, Precision::F64);
        assert!(distance(&forth, &back) < 1.0e-10, "{}: torques {forth:?}, in reversed order {back:?}", device.name);
        // Torques are linear in the forces.
        let doubled: Vec<_> = walls.iter().map(|(n, k, f)| (n.clone(), *k, 2.0 * f)).collect();
        let twice: Vec<f64> = back.iter().map(|t| 2.0 * t).collect();
        assert!(distance(&twice, &torque(&device, &q, &doubled, Precision::F64)) < 1.0e-10, "{}", device.name);
    }
}

#[test]
fn the_feed_forward_of_several_walls_fades_near_a_singularity() {
    // Near a stretched elbow the feed-forward is reduced, so the torque is between Jᵀ F and the shaped torque.
    let file = device("coupled-five-bar");
    let Ok(AnyMechanism::FiveBar(m)) = AnyMechanism::<f32>::new(&file.description) else { panic!("a five-bar") };
    let device = Device::<f32>::new("device", &with_fine_encoders(file.description)).expect("a sound device");
    let walls = |feed_forward| {
        [([0.6, 0.8, 0.0], 50.0), ([-0.8, 0.6, 0.0], 20.0)].map(|(normal, stiffness)| {
            let plane = Surface::Plane(Plane { point: [0.0, 0.4, 0.0], normal });
            Wall { feed_forward, ..bilateral_wall(plane, stiffness) }
        })
    };
    let step = |q: [f64; 2], feed_forward| {
        let scene = Scene { task: 2, walls: walls(feed_forward).into_iter().collect(), ..Scene::default() };
        let mut controller =
            Controller::<f32, FiveBar<f32>, BoardMath, 2>::new(m, &device, &scene).expect("a sound scene");
        controller.step(&fine_counts(&q.into()))
    };
    let (mut last, mut shares, mut changed) = (None::<SVector<f32, 2>>, Vec::new(), 0.0_f32);
    // The right arm turns until its elbow stretches.
    for k in 0..600 {
        let q = [2.6, 1.75 + 1.0e-3 * f64::from(k)];
        let (full, off) = (step(q, FeedForward::Full), step(q, FeedForward::Off));
        if full.parallel <= 0.2 {
            break;
        }
        assert!(full.torque.iter().all(|t| t.is_finite()));
        changed = changed.max((full.torque - off.torque).amax());
        shares.push(full.shaping);
        if full.shaping == 0.0 {
            assert!((full.torque - off.torque).amax() <= 1.0e-5, "the torques differ: {} {}", full.torque, off.torque);
        }
        if let Some(last) = last {
            assert!((full.torque - last).amax() < 0.25, "pose {k}: torque {} after {last}", full.torque);
        }
        last = Some(full.torque);
    }
    let partly = shares.iter().filter(|share| **share > 0.0 && **share < 1.0).count();
    assert!(
        changed > 0.01 && shares.first() == Some(&1.0),
        "the feed-forward must act: {changed} {:?}",
        shares.first()
    );
    assert!(partly > 3, "{partly} poses in the fade of {}", shares.len());
}
