//! Compares straight steps with the general step for random devices, scenes and motions. All numbers are equal bit for
//! bit, except torques and forces. A straight step may sum them in another order, so they may differ by a few roundings
//! of their parts.

use crate::common::{NUMBERS_PER_CASE, TestNumbers, random_device};
use haptic_bridge::control::compiled::BoardMath;
use haptic_bridge::math::{Libm, Math, Real};
use haptic_bridge::model::catalogue::Kind;
use haptic_bridge::model::description::Encoder;
use haptic_bridge::model::device::Device;
use haptic_bridge::model::mechanism::Mechanism;
use haptic_bridge::render::controller::{Controller, Gains, Push, PushedPlane, Step};
use haptic_bridge::render::scene::{FeedForward, Plane, Scene, Sphere, Spring, Surface, VelocityTerms, Wall};
use haptic_bridge::render::velocity::{Estimator, Washout};
use haptic_bridge::with_mechanism;
use nalgebra::SVector;

const CASES_PER_MECHANISM: usize = 200;
const STEPS_PER_CASE: usize = 100;
const COUNTS_PER_TURN: f64 = 20_000.0;
const RATE_HZ: f64 = 20_000.0;

const PUSH_N: f64 = 0.3;

/// Numbers in [0, 1), the same in every run (the upper half of Knuth's 64-bit linear congruential generator).
struct Stream(u64);

impl Stream {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 32) as f64 / f64::from(u32::MAX)
    }

    fn list(&mut self) -> Vec<f64> {
        (0..NUMBERS_PER_CASE).map(|_| self.next().min(0.999_999)).collect()
    }
}

/// Number of steps for each condition that straight steps handle specially.
#[derive(Default, Debug)]
struct Coverage {
    no_walls: usize,
    no_contact: usize,
    one_contact: usize,
    several_contacts: usize,
    only_round_walls: usize,
    springs: usize,
    /// Steps with one round wall whose velocity terms follow the turning normal.
    turning_normal: usize,
    shaped_with_spring: usize,
    shaped_with_plane: usize,
    partly_shaped_steps: usize,
    unshaped_steps: usize,
    passivity_damped_steps: usize,
    energy_debt: usize,
    straight_steps: usize,
    largest_difference: f64,
}

/// Draws a scene with flat or round walls near `place`, with all features of straight steps and some of the general
/// step only.
fn scene<T: Real>(draw: &mut TestNumbers<'_>, place: &[f64], task: usize) -> Scene<T> {
    let choice = |draw: &mut TestNumbers<'_>, count: usize| (draw.uniform(0.0, count as f64) as usize).min(count - 1);
    let mut scene = Scene::<f64> {
        task: task as u8,
        rate_hz: RATE_HZ,
        velocity_terms: [VelocityTerms::Off, VelocityTerms::Paper, VelocityTerms::Rendered][choice(draw, 3)],
        estimator: [Estimator::Butterworth, Estimator::FirstOrder, Estimator::BackwardDifference][choice(draw, 3)],
        gravity_compensation: choice(draw, 2) == 0,
        ..Scene::default()
    };
    let [first, flat, spring] = [choice(draw, 4), choice(draw, 2), choice(draw, 6)];
    // Some scenes have two facets of nearly one wall, some have the same wall twice.
    let nearly = [0.0, 0.01, 1.0, 1.0][choice(draw, 4)];
    let mut before: Option<[f64; 3]> = None;
    for _ in 0..[0, 1, 2, 3][first] {
        let direction: [f64; 3] = draw.list(-1.0, 1.0);
        let direction: [f64; 3] = core::array::from_fn(|i| {
            let base = before.map_or(0.0, |before| before[i] * (1.0 - nearly));
            if i < task { base + direction[i] * before.map_or(1.0, |_| nearly) } else { 0.0 }
        });
        before = Some(direction);
        let length = direction.iter().map(|x| x * x).sum::<f64>().sqrt().max(1.0e-3);
        let normal = direction.map(|x| x / length);
        let depth = draw.uniform(-0.01, 0.02);
        let on_it = |away: f64| core::array::from_fn(|i| if i < task { place[i] + away * normal[i] } else { 0.0 });
        let radius = draw.log_uniform(0.02, 1.0);
        let surface = match (flat, choice(draw, 3)) {
            (0, 0) => Surface::Sphere(Sphere { center: on_it(depth - radius), radius, inside: false }),
            (0, 1) => Surface::Sphere(Sphere { center: on_it(depth + radius), radius, inside: true }),
            _ => Surface::Plane(Plane { point: on_it(depth), normal }),
        };
        let wall = Wall {
            surface,
            stiffness: draw.log_uniform(10.0, 5000.0),
            damping: draw.uniform(0.0, 5.0),
            feed_forward: [FeedForward::Off, FeedForward::Full, FeedForward::Washout][choice(draw, 3)],
            washout_hz: draw.log_uniform(0.2, 50.0),
            damping_compensation: choice(draw, 5) == 0,
            bilateral: choice(draw, 4) == 0,
        };
        scene.walls.push(wall).expect("room for a wall");
    }
    if spring == 0 {
        scene.field_damping = 0.3;
    }
    // Up to two springs lead to points or lines. Some have only damping.
    for _ in 0..[1, 2, 0, 0, 1, 0][spring] {
        let away = draw.uniform(-0.02, 0.02);
        let point = core::array::from_fn(|i| place.get(i).map_or(0.0, |x| if i < task { x + away } else { 0.0 }));
        let (turn, to_line) = (draw.uniform(0.0, core::f64::consts::TAU), choice(draw, 2) == 0 && task > 1);
        let direction = if to_line { [turn.cos(), turn.sin(), 0.0] } else { [0.0; 3] };
        let stiffness = draw.log_uniform(5.0, 2000.0) * [0.0, 1.0, 1.0, 1.0][choice(draw, 4)];
        scene.springs.push(Spring { point, direction, stiffness, damping: 0.5 }).expect("room for a spring");
    }
    scene.cast()
}

/// Draws a plane of the host near `place`. Some planes have only damping.
fn pushed_plane<T: Real>(draw: &mut TestNumbers<'_>, place: &[f64], task: usize) -> PushedPlane<T> {
    let direction: [f64; 3] = draw.list(-1.0, 1.0);
    let length = direction.iter().take(task).map(|x| x * x).sum::<f64>().sqrt().max(1.0e-3);
    // A plane that moves between two others has a normal shorter than 1.
    let size = draw.uniform(0.5, 1.0) / length;
    let normal: [f64; 3] = core::array::from_fn(|i| if i < task { direction[i] * size } else { 0.0 });
    let at = normal.iter().zip(place).map(|(n, x)| n * x).sum::<f64>() + draw.uniform(-0.01, 0.02);
    let stiffness = if draw.uniform(0.0, 1.0) < 0.2 { 0.0 } else { draw.log_uniform(10.0, 2000.0) };
    let [offset, stiffness, damping] = [at, stiffness, draw.uniform(0.0, 2.0)].map(T::from_f64);
    PushedPlane { normal: normal.map(T::from_f64), offset, stiffness, damping }
}

/// Returns the sum of all absolute forces but wall forces (N), and the tip's acceleration from turning normals (m/s²).
fn other_forces<T: Real, M: Mechanism<T, N>, K: Math<T>, const N: usize>(
    mechanism: &M,
    scene: &Scene<T>,
    push: Option<&Push<T>>,
    step: &Step<T, N>,
) -> (f64, f64) {
    let tip: Vec<f64> = step.tip.iter().take(M::SPEC.task).map(|x| x.to_f64()).collect();
    let speed = mechanism.velocity(&mechanism.pose::<K>(&step.q), &step.qd).map(|v| v.to_f64()).norm();
    let away = |point: &[T; 3]| tip.iter().zip(point).map(|(x, at)| (x - at.to_f64()).powi(2)).sum::<f64>().sqrt();
    let springs = scene
        .springs
        .iter()
        .map(|spring| spring.stiffness.to_f64() * away(&spring.point) + spring.damping.to_f64() * speed);
    let plane = push.map_or(0.0, |Push { plane, .. }| {
        let reached = away(&[T::zero(); 3]) + plane.offset.to_f64().abs();
        plane.stiffness.to_f64() * reached + plane.damping.to_f64() * speed
    });
    let bends = scene.walls.iter().map(|wall| match wall.surface {
        Surface::Sphere(Sphere { center, .. }) => speed * speed / away(&center),
        _ => 0.0,
    });
    (springs.sum::<f64>() + plane + scene.field_damping.to_f64() * speed, bends.sum())
}

/// Allowed error in roundings of a torque's parts. About forty operations lead from the parts to the torque of one
/// wall, and twice as many for several walls. The largest measured error is 6.
const MAX_ROUNDINGS: f64 = 16.0;

fn difference_in_roundings<T: Real, M: Mechanism<T, N>, K: Math<T>, const N: usize>(
    mechanism: &M,
    fast: &Step<T, N>,
    slow: &Step<T, N>,
    (other, turning): (f64, f64),
) -> f64 {
    let pose = mechanism.pose::<K>(&slow.q);
    let largest = |v: &SVector<T, N>| v.iter().fold(0.0_f64, |most, x| most.max(x.to_f64().abs()));
    // The parts in each direction, through Jᵀ or of the inertia, may be much larger than their sum.
    let (mut through, mut shaped, mut inertial) = (0.0, 0.0, 0.0);
    for i in 0..M::SPEC.task {
        let mut unit = SVector::<T, N>::zeros();
        unit[i] = T::one();
        through += largest(&mechanism.transpose(&pose, &unit));
        let shaping = mechanism.shaping(&pose, &unit);
        shaped += largest(&shaping.me) / shaping.w_rr.to_f64();
        inertial += largest(&shaping.me);
    }
    let force =
        other + slow.force_squared.to_f64().max(0.0).sqrt() + slow.wall_force.to_f64().abs() + 3.0_f64.sqrt() * PUSH_N;
    let moving = largest(&mechanism.velocity_torque(&pose, &slow.qd));
    let parts = largest(&slow.gravity) + (through + shaped) * force + moving + inertial * turning;
    let apart = largest(&(fast.torque - slow.torque)).max(largest(&(fast.rendered - slow.rendered)));
    let unit = T::EPSILON.to_f64();
    let force_difference = (fast.force_squared - slow.force_squared).abs().to_f64();
    (apart / (unit * parts)).max(force_difference / (unit * force * force))
}

/// Returns a controller's state as text, without the commanded torques, which may differ by some roundings.
fn state_text(controller: &impl std::fmt::Debug) -> String {
    let all = format!("{controller:?}");
    let (before, rest) = all.split_once("wall_torque: ").expect("the walls' torques");
    let (_, after) = rest.split_once(" }").expect("the end of the torques");
    format!("{before}{after}")
}

/// Moves both controllers through a random scene and compares every step.
fn compare_steps<T: Real, M: Mechanism<T, N>, K: Math<T>, const N: usize>(
    mechanism: &M,
    device: &Device<T>,
    stream: &mut Stream,
    coverage: &mut Coverage,
) {
    let numbers = stream.list();
    let mut draw = TestNumbers::new(&numbers);
    let mut counts: [f64; N] = draw.list(-0.5 * COUNTS_PER_TURN, 0.5 * COUNTS_PER_TURN);
    let q = SVector::from_fn(|i, _| T::from_f64(counts[i] / COUNTS_PER_TURN * core::f64::consts::TAU));
    let tip = mechanism.tip(&mechanism.pose::<K>(&q));
    let place: Vec<f64> = tip.iter().map(|x| x.to_f64()).collect();
    let scene = scene::<T>(&mut draw, &place, M::SPEC.task);
    let mut straight = Controller::<T, M, K, N>::new(*mechanism, device, &scene).expect("a scene");
    let passivity = draw.uniform(0.0, 1.0) < 0.5;
    straight.set_passivity(passivity, true);
    let pace = draw.log_uniform(0.1, 60.0);
    let plane = pushed_plane::<T>(&mut draw, &place, M::SPEC.task);
    let plane = if draw.uniform(0.0, 1.0) < 0.5 { plane } else { PushedPlane::default() };
    let (mut push, mut variant) = (None, String::new());
    let mut going: [f64; N] = draw.list(-1.0, 1.0);
    for nth in 0..STEPS_PER_CASE {
        if let (true, Some(wall)) = (nth == STEPS_PER_CASE / 2, scene.walls.first()) {
            let (feed_forward, washout_hz) = (FeedForward::Washout, wall.washout_hz);
            let half = T::from_f64(0.5);
            let gains =
                Gains { wall: 0, stiffness: wall.stiffness * half, damping: wall.damping, feed_forward, washout_hz };
            let washout = Washout::new(washout_hz, scene.rate_hz).expect("a corner");
            straight.set_gains(&gains, &washout);
        }
        if nth % (STEPS_PER_CASE / 4) == 0 {
            // The host pushes in every second quarter of the motion, sometimes with a plane.
            push = (nth / (STEPS_PER_CASE / 4) % 2 == 1).then_some(Push { force: [T::from_f64(PUSH_N); 3], plane });
            straight.set_push(push.as_ref());
        }
        for (count, going) in counts.iter_mut().zip(&mut going) {
            *going = 0.95 * *going + 0.1 * (stream.next() - 0.5);
            *count += pace * *going;
        }
        let at = counts.map(|count| count as i32);
        // Both controllers start from the same state, because the wall energy depends on the previous torques.
        let mut general = straight.clone();
        let (fast, slow): (Step<T, N>, Step<T, N>) = (straight.step(&at), general.step_generally(&at));
        if nth % (STEPS_PER_CASE / 4) == STEPS_PER_CASE / 4 - 1 {
            assert_eq!(state_text(&straight), state_text(&general), "{}: the states differ", M::SPEC.name);
        }
        if nth % (STEPS_PER_CASE / 4) == 0 {
            variant = format!("{straight:?}");
        }
        let other = other_forces::<T, M, K, N>(mechanism, &scene, push.as_ref(), &slow);
        let apart = difference_in_roundings::<T, M, K, N>(mechanism, &fast, &slow, other);
        assert!(apart <= MAX_ROUNDINGS, "{}: {apart} roundings of difference at {at:?} of {scene:?}", M::SPEC.name);
        coverage.largest_difference = coverage.largest_difference.max(apart);
        // The straight step may sum the forces of several walls in another order too.
        let fast = Step { torque: slow.torque, rendered: slow.rendered, force_squared: slow.force_squared, ..fast };
        assert_eq!(fast, slow, "{} at {at:?} of {scene:?}", M::SPEC.name);
        coverage.straight_steps +=
            usize::from(["variant: Wall", "variant: Round", "variant: Several"].iter().any(|it| variant.contains(it)));
        let round = |wall: &Wall<T>| matches!(wall.surface, Surface::Sphere(_));
        coverage.no_walls += usize::from(scene.walls.is_empty());
        coverage.no_contact += usize::from(slow.contacts == 0);
        coverage.one_contact += usize::from(slow.contacts == 1);
        coverage.several_contacts += usize::from(slow.contacts > 1);
        coverage.only_round_walls += usize::from(slow.contacts > 0 && scene.walls.iter().all(round));
        coverage.springs += usize::from(!scene.springs.is_empty());
        let shaped = slow.contacts > 0
            && scene.walls.iter().any(|wall| wall.feed_forward != FeedForward::Off)
            && variant.contains("variant: Several");
        coverage.turning_normal += usize::from(slow.contacts > 0 && variant.contains("variant: Round"));
        coverage.shaped_with_spring +=
            usize::from(shaped && scene.springs.iter().any(|spring| spring.stiffness > T::zero()));
        coverage.shaped_with_plane += usize::from(shaped && push.is_some_and(|push| push.plane.stiffness > T::zero()));
        coverage.partly_shaped_steps += usize::from(slow.shaping > T::zero() && slow.shaping < T::one());
        coverage.unshaped_steps += usize::from(slow.shaping == T::zero());
        coverage.passivity_damped_steps += usize::from(slow.passivity_damping > T::zero());
        coverage.energy_debt += usize::from(slow.energy < T::zero() && scene.walls.iter().all(|wall| !wall.bilateral));
    }
}

#[test]
fn a_straight_step_equals_the_general_step_up_to_roundings() {
    let mut stream = Stream(7);
    for (kind, fade_reached) in [
        (Kind::Paddle, false),
        (Kind::FiveBar, true),
        (Kind::FiveBarTurret, true),
        (Kind::Parallelogram, true),
        (Kind::Serial3r, true),
        (Kind::Delta, true),
    ] {
        let mut coverage = Coverage::default();
        // Devices with two joints have their own straight steps, so more cases are drawn.
        for _ in 0..if kind == Kind::FiveBar { 4 * CASES_PER_MECHANISM } else { CASES_PER_MECHANISM } {
            let numbers = stream.list();
            let mut description = random_device(kind, &mut TestNumbers::new(&numbers));
            for joint in &mut description.joints {
                joint.encoder = Some(Encoder { counts_per_turn: COUNTS_PER_TURN, offset: 0.0, inverted: false });
            }
            let Ok(single) = Device::<f32>::new("drawn", &description) else { continue };
            let Ok(double) = Device::<f64>::new("drawn", &description) else { continue };
            with_mechanism!(&single.mechanism, m => compare_steps::<f32, _, BoardMath, _>(m, &single, &mut stream, &mut coverage));
            with_mechanism!(&double.mechanism, m => compare_steps::<f64, _, Libm, _>(m, &double, &mut stream, &mut coverage));
        }
        println!("{kind:?}: {coverage:?}");
        let ways = [
            coverage.no_walls,
            coverage.no_contact,
            coverage.one_contact,
            coverage.several_contacts,
            coverage.only_round_walls,
            coverage.springs,
            coverage.passivity_damped_steps,
            coverage.energy_debt,
        ];
        assert!(ways.iter().all(|times| *times > 100), "{kind:?}: {coverage:?}");
        let planar = [coverage.turning_normal, coverage.shaped_with_spring, coverage.shaped_with_plane];
        assert!(kind != Kind::FiveBar || planar.iter().all(|times| *times > 100), "{kind:?}: {coverage:?}");
        assert!(coverage.straight_steps > 2000, "{kind:?}: {coverage:?}");
        assert!(
            !fade_reached || (coverage.partly_shaped_steps > 10 && coverage.unshaped_steps > 10),
            "{kind:?}: {coverage:?}"
        );
    }
}
