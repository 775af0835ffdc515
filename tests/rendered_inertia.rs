//! The inertia that a wall renders in cases beyond the paper's (4): moving linkages, gains other than 1, and other held
//! coordinates. The oracle solves M q̈ + c + g = τ with the controller's torque, and computes inertias from J and M by
//! elimination, without the library's inertia module.

use crate::common::{bilateral_wall, device_file, fine_counts, inverse, with_fine_encoders};
use haptic_bridge::math::Libm;
use haptic_bridge::model::description::Description;
use haptic_bridge::model::device::Device;
use haptic_bridge::model::mechanism::{AnyMechanism, Mechanism};
use haptic_bridge::render::controller::Controller;
use haptic_bridge::render::scene::{Admissible, Plane, Scene, SceneError, Sphere, Surface, VelocityTerms};
use haptic_bridge::with_mechanism;
use nalgebra::SVector;

const RATE_HZ: f64 = 50_000.0;

/// A shipped device, its pose (rad), joint velocities (rad/s), and the wall's normal.
type Case = (&'static str, [f64; 3], [f64; 3], [f64; 3]);

const CASES: [Case; 4] = [
    ("coupled-five-bar", [2.6, 1.75, 0.0], [1.5, -1.1, 0.0], [0.2588190451025208, 0.9659258262890683, 0.0]),
    ("fictive-five-bar-turret", [0.3, 2.4, 1.1], [2.0, -1.0, 0.8], [0.36, 0.48, 0.8]),
    ("phantom-premium-1.5", [0.3, 0.9, -0.3], [1.5, -0.7, 1.2], [0.36, 0.48, 0.8]),
    ("serial-3r", [0.5, 0.8, 0.7], [1.0, -0.8, 1.3], [0.6, 0.8, 0.0]),
];

struct StepEffect {
    /// Rendered acceleration n·p̈ + ṅ·ṗ, m/s².
    rendered_acceleration: f64,
    /// The wall's force, N.
    force: f64,
    /// Eᵀ b, the paper's zr, N.
    z_r: f64,
    /// Weff, kg.
    w_eff: f64,
    /// Wrr with φ held, kg.
    w_rr: f64,
    /// Accelerations of the coordinates that can be held (joints 0 to 2 and φ), rad/s².
    qdd: [f64; 4],
    /// Torque along the null motion, N m.
    null_torque: f64,
}

fn step_effect(
    name: &str,
    q: [f64; 3],
    qd: [f64; 3],
    surface: impl Fn([f64; 3], usize) -> Surface<f64>,
    with: impl Fn(&mut Scene<f64>),
) -> StepEffect {
    fn run<M: Mechanism<f64, N>, const N: usize>(
        m: M,
        device: &Device<f64>,
        q: [f64; 3],
        qd: [f64; 3],
        surface: &dyn Fn([f64; 3], usize) -> Surface<f64>,
        with: &dyn Fn(&mut Scene<f64>),
    ) -> StepEffect {
        let task = M::SPEC.task;
        let (q, qd) = (SVector::<f64, N>::from_fn(|i, _| q[i]), SVector::<f64, N>::from_fn(|i, _| qd[i]));
        let pose = m.pose::<Libm>(&q);
        let tip = m.tip(&pose);
        let surface = surface(core::array::from_fn(|i| if i < task { tip[i] } else { 0.0 }), task);
        let mut scene = Scene { task: task as u8, rate_hz: RATE_HZ, cutoff_hz: 5_000.0, ..Scene::default() };
        scene.walls.push(bilateral_wall(surface, 300.0)).expect("room");
        with(&mut scene);
        let mut controller = Controller::<f64, M, Libm, N>::new(m, device, &scene).expect("a sound scene");
        // The steady motion through the pose lets the joint filters settle.
        let last = (-60..=0).map(|k| controller.step(&fine_counts(&(q + qd * (f64::from(k) / RATE_HZ))))).last();
        let step = last.expect("steps");

        let (jacobian, rate, mass) = (m.jacobian(&pose), m.jacobian_rate(&pose, &qd), m.mass(&pose));
        let bias = m.coriolis(&pose, &qd);
        let qdd = inverse(&mass) * (step.torque - bias);
        let mut position = tip;
        let mut velocity = jacobian * qd;
        for i in task..N {
            (position[i], velocity[i]) = (0.0, 0.0);
        }
        let n = surface.contact::<Libm, N>(&position).normal;
        let n_rate = surface.normal_rate::<Libm, N>(&position, &velocity);
        // φ is an orientation and its acceleration is not rendered, so n has no component along φ.
        let acceleration = jacobian * qdd + rate * qd;
        let mut without_phi = rate * qd;
        (task..N).for_each(|i| without_phi[i] = 0.0);
        let e = inverse(&jacobian) * n;
        let b = bias - mass * (inverse(&jacobian) * without_phi);
        let row = jacobian.transpose() * n;
        let null = inverse(&jacobian) * SVector::<f64, N>::from_fn(|i, _| if i + 1 == N { 1.0 } else { 0.0 });
        StepEffect {
            rendered_acceleration: n.dot(&acceleration) + n_rate.dot(&velocity),
            force: step.wall_force,
            z_r: e.dot(&b),
            w_eff: 1.0 / row.dot(&(inverse(&mass) * row)),
            w_rr: e.dot(&(mass * e)),
            qdd: core::array::from_fn(|k| if k < 3 { *qdd.get(k).unwrap_or(&0.0) } else { qdd.sum() }),
            null_torque: null.dot(&step.torque),
        }
    }
    // Gravity is off, so that only the walls' forces act.
    let description = Description { gravity: [0.0; 3], ..with_fine_encoders(device_file::shipped_device(name)) };
    let device = Device::<f64>::new("test", &description).expect("a sound device");
    let mechanism = AnyMechanism::<f64>::new(&description).expect("a sound device");
    with_mechanism!(&mechanism, m => run(*m, &device, q, qd, &surface, &with))
}

/// Returns a plane 2 cm from the tip.
fn plane_near_tip(normal: [f64; 3]) -> impl Fn([f64; 3], usize) -> Surface<f64> {
    move |tip, task| {
        let normal = core::array::from_fn(|i| if i < task { normal[i] } else { 0.0 });
        Surface::Plane(Plane { point: core::array::from_fn(|i| tip[i] + 0.02 * normal[i]), normal })
    }
}

/// Returns a sphere of 6 cm radius whose surface passes near the tip.
fn sphere_near_tip(tip: [f64; 3], task: usize) -> Surface<f64> {
    let offset = [0.03, -0.04, 0.02];
    let center = core::array::from_fn(|i| if i < task { tip[i] + offset[i] } else { 0.0 });
    Surface::Sphere(Sphere { center, radius: 0.06, inside: false })
}

#[test]
fn only_the_rendered_force_accelerates_a_moving_tip() {
    let mut largest_z_r = 0.0_f64;
    for (name, q, qd, normal) in CASES {
        for round in [false, true] {
            let surface =
                |tip, task| if round { sphere_near_tip(tip, task) } else { plane_near_tip(normal)(tip, task) };
            let force_error = |terms| {
                let o = step_effect(name, q, qd, surface, |scene| scene.velocity_terms = terms);
                (o.w_rr * o.rendered_acceleration - o.force, o.z_r)
            };
            // The bound of 2e-3 N allows for the joint filters, which the tip's acceleration disturbs.
            let (error, _) = force_error(VelocityTerms::Rendered);
            assert!(error.abs() < 2e-3, "{name}, round {round}: a force error of {error} N");
            if !round {
                let (error, z_r) = force_error(VelocityTerms::Paper);
                assert!((error + z_r).abs() < 2e-3, "{name}: (4) leaves {error} N, zr is {z_r} N");
                largest_z_r = largest_z_r.max(z_r.abs());
            }
        }
    }
    // The effect must be ten times larger than the tolerance.
    assert!(largest_z_r > 0.02, "zr is too small to test: {largest_z_r} N");
}

#[test]
fn a_gain_changes_the_inertia_and_is_limited_below_its_pole() {
    let mut limited = 0;
    for (name, q, _, normal) in CASES {
        for gain in [0.0, 0.5, 1.0, 1.1, 2.0, 3.0] {
            let o = step_effect(name, q, [0.0; 3], plane_near_tip(normal), |scene| scene.feed_forward_gain = gain);
            let coupling = 1.0 - o.w_eff / o.w_rr;
            let pole = 1.0 / coupling;
            let effective = gain.min(0.5 * (1.0 + pole));
            limited += usize::from(effective < gain);
            let rendered = o.force / o.rendered_acceleration;
            let expected = o.w_eff / (1.0 - effective * coupling);
            assert!((rendered / expected - 1.0).abs() < 1e-6, "{name}, gain {gain}: {rendered} kg, not {expected}");
            assert!(rendered > 0.0 && rendered < 2.0 * o.w_rr * (1.0 + 1e-6), "{name}, gain {gain}: {rendered} kg");
        }
    }
    assert!(limited >= 2, "the redundant arm's gain must be limited");
}

#[test]
fn the_demos_wall_has_the_documented_inertias() {
    // Independent computation gives 0.2116 kg without the feed-forward, 0.2659 kg with it, and 0.357 kg with α = 2.
    let (name, q, _, normal) = CASES[0];
    let inertia = |gain| {
        let o = step_effect(name, q, [0.0; 3], plane_near_tip(normal), |scene| scene.feed_forward_gain = gain);
        o.force / o.rendered_acceleration
    };
    for (gain, kilograms) in [(0.0, 0.211), (1.0, 0.265), (2.0, 0.357)] {
        assert!((inertia(gain) - kilograms).abs() < 1e-3, "gain {gain}: an inertia of {} kg", inertia(gain));
    }
}

#[test]
fn a_gain_beyond_its_limits_is_refused() {
    let scene = |gain, walls: usize| {
        let mut scene = Scene::<f64> { task: 2, feed_forward_gain: gain, ..Scene::default() };
        for _ in 0..walls {
            scene.walls.push(bilateral_wall(plane_near_tip([0.6, 0.8, 0.0])([0.0; 3], 2), 300.0)).expect("room");
        }
        scene.check(2)
    };
    assert_eq!(scene(3.0, 1), Ok(()));
    assert_eq!(scene(1.0, 2), Ok(()));
    for (gain, walls) in [(3.01, 1), (-0.1, 1), (f64::NAN, 1), (1.5, 2)] {
        assert_eq!(scene(gain, walls), Err(SceneError::FeedForwardGain), "gain {gain} with {walls} walls");
    }
}

#[test]
fn a_redundant_arm_holds_the_coordinate_of_the_scene() {
    let (name, q, qd, normal) = CASES[3];
    // The ratios Wrr/Weff come from an independent computation.
    for (admissible, held, ratio) in [
        (Admissible::Orientation, Some(3), 3.99),
        (Admissible::Joint0, Some(0), 1.29),
        (Admissible::Joint1, Some(1), 1.26),
        (Admissible::Joint2, Some(2), 2.38),
        (Admissible::Consistent, None, 1.22),
    ] {
        let at_rest = step_effect(name, q, [0.0; 3], plane_near_tip(normal), |scene| scene.admissible = admissible);
        let found = at_rest.force / at_rest.rendered / at_rest.w_eff;
        assert!((found - ratio).abs() < 0.006, "{admissible:?}: Wrr/Weff is {found}");
        for speeds in [[0.0; 3], qd] {
            let o = step_effect(name, q, speeds, plane_near_tip(normal), |scene| scene.admissible = admissible);
            match held {
                Some(coordinate) => {
                    assert!(o.qdd[coordinate].abs() < 0.02, "{admissible:?}: {:?}", o.qdd)
                }
                None => assert!(o.null_torque.abs() < 1e-6, "{admissible:?}: {} N m", o.null_torque),
            }
            let expected = o.force / (ratio * o.w_eff);
            let error = (o.rendered_acceleration - expected).abs();
            assert!(error < 0.01 * expected.abs(), "{admissible:?}: {} m/s², not {expected}", o.rendered_acceleration);
        }
    }
}

#[test]
fn a_joint_without_null_motion_is_released_smoothly() {
    // A joint's share of the null motion passes zero if the third link is in line with the second, or if the arm bends
    // the other way. The torque must stay bounded there.
    let (name, _, _, normal) = CASES[3];
    for admissible in [Admissible::Joint0, Admissible::Joint1, Admissible::Joint2] {
        let share = |third: f64| {
            let q = [0.5, 0.8, third];
            let o = step_effect(name, q, [0.0; 3], plane_near_tip(normal), |scene| scene.admissible = admissible);
            let share = o.rendered_acceleration / o.force * o.w_eff;
            assert!(share > 0.0 && share <= 1.0 + 1e-9, "{admissible:?} at {q:?}: Weff/Wrr is {share}");
            share
        };
        // The largest change on a grid is compared with the largest change on a grid fifty times as fine at that place.
        let steepest = |low: f64, step: f64, count: i32| {
            let values: Vec<f64> = (0..=count).map(|k| share(low + step * f64::from(k))).collect();
            let changes = values.windows(2).enumerate().map(|(k, pair)| ((pair[1] - pair[0]).abs(), k));
            let (change, k) = changes.max_by(|a, b| a.0.total_cmp(&b.0)).expect("some");
            (change, low + step * k as f64)
        };
        let (coarse, at) = steepest(-2.5, 0.01, 500);
        let (fine, _) = steepest(at, 0.0002, 50);
        assert!(fine < 0.1 * coarse.max(0.5), "{admissible:?} near {at}: the share jumps by {fine} of {coarse}");
    }
}
