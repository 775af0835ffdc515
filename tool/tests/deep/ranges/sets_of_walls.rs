//! Contact with sets of walls: the board's f32 control step, limited motors, and the simulator's nonlinear linkage.

use crate::common::{plane_wall, shipped_device};
use haptic_bridge::control::compiled::BoardMath;
use haptic_bridge::model::description::Encoder;
use haptic_bridge::model::device::Device;
use haptic_bridge::model::mechanism::{AnyMechanism, FiveBar, Mechanism, Parallelogram};
use haptic_bridge::render::controller::Controller;
use haptic_bridge::render::scene::{FeedForward, Scene, Spring, VelocityTerms, Wall};
use haptic_host::device_file::DeviceFile;
use haptic_sim::{Hand, HandSettings, Intent, MotorInput, Options, SimulatedDevice, Waypoint};
use nalgebra::SVector;

const RATE_HZ: f64 = 1_000.0;

/// Returns the unit vector at this angle, rad.
fn unit_vector(angle: f64) -> Vec<f64> {
    vec![angle.cos(), angle.sin()]
}

fn normalise(v: &[f64]) -> Vec<f64> {
    let length = v.iter().map(|x| x * x).sum::<f64>().sqrt();
    v.iter().map(|x| x / length).collect()
}

/// One wall: unit normal, and share of the total stiffness and damping.
type Facet = (Vec<f64>, f64);

fn facets_at_angles(middle: f64, facets: &[(f64, f64)]) -> Vec<Facet> {
    facets.iter().map(|(degrees, share)| (unit_vector(middle + degrees.to_radians()), *share)).collect()
}

/// A run with walls through the tip, pressed by a hand or after an impact of 2 cm/s.
struct WallRun<'a> {
    file: &'a DeviceFile,
    q: [f64; 3],
    stiffness: f64,
    damping: f64,
    feed_forward: FeedForward,
    bilateral: bool,
    /// Target of a hand relative to the tip's start, m; the hand's arm is a spring of 250 N/m. `None` for an impact.
    push: Option<[f64; 3]>,
    hand: HandSettings,
    velocity_terms: VelocityTerms,
    /// True to add the estimated velocity terms b without fading.
    unfaded: bool,
    /// A spring: anchor relative to the tip's start, m, direction of its line (zero for a point), and stiffness, N/m.
    spring: Option<([f64; 3], [f64; 3], f64)>,
}

impl WallRun<'_> {
    /// Returns the peak-to-peak torque in the last tenth of a second, N m.
    fn torque_swing(&self, walls: &[Facet]) -> f64 {
        match AnyMechanism::<f32>::new(&self.file.description).expect("a sound device") {
            AnyMechanism::FiveBar(m) => self.compute_swing::<FiveBar<f32>, 2>(m, walls),
            AnyMechanism::Parallelogram(m) => self.compute_swing::<Parallelogram<f32>, 3>(m, walls),
            other => panic!("no test of this file uses {other:?}"),
        }
    }

    fn compute_swing<M: Mechanism<f32, N>, const N: usize>(&self, m: M, walls: &[Facet]) -> f64 {
        let mut description = self.file.description;
        description.gravity = [0.0; 3];
        for joint in &mut description.joints {
            joint.encoder = Some(Encoder { counts_per_turn: 1_048_576.0, offset: 0.0, inverted: false });
            joint.viscous = 0.0;
        }
        let options =
            Options { start: Some(self.q), absolute_encoders: true, substep: 1.0e-4, ..Options::frictionless() };
        let mut plant = SimulatedDevice::new(&description, &options).expect("a sound device");
        let tip = plant.tip();
        let total: f64 = walls.iter().map(|wall| wall.1).sum();
        let walls = walls.iter().map(|(normal, share)| {
            let n: [f64; 3] = core::array::from_fn(|i| normal.get(i).copied().unwrap_or(0.0));
            let gain = |total_gain: f64| (total_gain * share / total) as f32;
            let [point, n] = [tip, n].map(|v| v.map(|x| x as f32));
            let plane = plane_wall(point, n, gain(self.stiffness), gain(self.damping));
            // There is no joint damping, so the compensation only turns the velocity estimates on.
            let (feed_forward, bilateral) = (self.feed_forward, self.bilateral);
            Wall { feed_forward, bilateral, damping_compensation: self.unfaded, ..plane }
        });
        let springs = self.spring.iter().map(|(aside, line, stiffness)| Spring {
            point: core::array::from_fn(|i| (tip[i] + aside[i]) as f32),
            direction: line.map(|x| x as f32),
            stiffness: *stiffness as f32,
            damping: (0.002 * stiffness) as f32,
        });
        let scene = Scene {
            task: M::SPEC.task as u8,
            rate_hz: RATE_HZ as f32,
            cutoff_hz: 100.0,
            walls: walls.collect(),
            springs: springs.collect(),
            velocity_terms: self.velocity_terms,
            ..Scene::default()
        };
        let device = Device::new("device", &description).expect("a sound device");
        let mut controller = Controller::<f32, M, BoardMath, N>::new(m, &device, &scene).expect("a sound scene");
        match self.push {
            Some(aim) => {
                let value = core::array::from_fn(|i| tip[i] + aim[i]);
                let intent = Intent::Follow(vec![Waypoint { time: 0.0, value }]);
                plant.set_hand(Hand::new(self.hand, intent, tip, 0.0));
            }
            None => plant.push([0.012, -0.016, 0.0]),
        }
        let [mut low, mut high] = [f32::INFINITY, f32::NEG_INFINITY].map(SVector::<f32, N>::repeat);
        let steps = (1.2 * RATE_HZ) as u32;
        for k in 0..steps {
            let counts = plant.counts();
            let mut step = controller.step(&core::array::from_fn(|i| counts[i]));
            if self.unfaded && step.contacts > 0 {
                step.torque += m.velocity_torque(&m.pose::<BoardMath>(&step.q), &step.qd);
            }
            let drive = core::array::from_fn(|i| {
                MotorInput::Torque(if i < N { f64::from(step.torque[i].clamp(-2.0, 2.0)) } else { 0.0 })
            });
            plant.step(&drive, 1.0 / RATE_HZ);
            if k >= steps - (0.1 * RATE_HZ) as u32 {
                low = low.inf(&step.torque);
                high = high.sup(&step.torque);
            }
        }
        f64::from((high - low).amax())
    }
}

/// Returns a run in the demo's pose. At 40 N s/m its walls are stable up to 17.9 kN/m, with the feed-forward to 23.0.
fn demo_run(file: &DeviceFile, feed_forward: FeedForward) -> WallRun<'_> {
    WallRun {
        file,
        q: [2.6, 1.75, 0.0],
        stiffness: 20_000.0,
        damping: 40.0,
        feed_forward,
        bilateral: true,
        push: None,
        hand: HandSettings::default(),
        velocity_terms: VelocityTerms::default(),
        unfaded: false,
        spring: None,
    }
}

/// Largest torque swing of a quiet wall, N m: a few encoder steps times 20 kN/m.
const QUIET_SWING_NM: f64 = 0.05;
/// Smallest torque swing of an unstable wall, N m. An unstable wall uses all 2 N m of the motors.
const UNSTABLE_SWING_NM: f64 = 1.0;

#[test]
fn a_wall_cut_into_facets_is_as_quiet_as_one_wall() {
    let file = shipped_device("coupled-five-bar");
    let middle = 75_f64.to_radians();
    for feed_forward in [FeedForward::Full, FeedForward::Washout] {
        for facets in [
            vec![(0.0, 1.0)],
            vec![(-1.0, 1.0), (1.0, 1.0)],
            vec![(-0.03, 1.0), (0.03, 1.0)],
            vec![(-5.0, 1.0), (5.0, 1.0)],
            vec![(-5.0, 1.0), (0.0, 2.0), (5.0, 1.0)],
            vec![(-1.0, 9.0), (8.0, 1.0)],
        ] {
            let swing = demo_run(&file, feed_forward).torque_swing(&facets_at_angles(middle, &facets));
            assert!(swing < QUIET_SWING_NM, "{facets:?}: {swing} N m");
        }
    }
    let swing = demo_run(&file, FeedForward::Off).torque_swing(&facets_at_angles(middle, &[(0.0, 1.0)]));
    assert!(swing > UNSTABLE_SWING_NM, "without the feed-forward this wall must swing: {swing} N m");
}

/// The hand is so light that the same press swings without the feed-forward.
#[test]
fn pressed_unilateral_facets_are_quiet() {
    let file = shipped_device("coupled-five-bar");
    let middle = 75_f64.to_radians();
    let push = Some([-0.02 * middle.cos(), -0.02 * middle.sin(), 0.0]);
    let hand = HandSettings { mass: 0.01, grip_stiffness: 400.0, grip_damping: 0.5, ..HandSettings::default() };
    for facets in [vec![(0.0, 1.0)], vec![(-1.0, 1.0), (1.0, 1.0)], vec![(-5.0, 1.0), (5.0, 1.0)]] {
        let swing = |feed_forward| {
            let run = WallRun { bilateral: false, push, hand, ..demo_run(&file, feed_forward) };
            run.torque_swing(&facets_at_angles(middle, &facets))
        };
        for feed_forward in [FeedForward::Full, FeedForward::Washout] {
            let swing = swing(feed_forward);
            assert!(swing < QUIET_SWING_NM, "{facets:?} {feed_forward:?}: {swing} N m");
        }
        let without = swing(FeedForward::Off);
        assert!(without > 10.0 * QUIET_SWING_NM, "{facets:?} without the feed-forward: {without} N m");
    }
}

/// Near a stretched arm the velocity terms b grow as 1/sin³, and their estimate is late. Without fading, b pushes a
/// pressed tip further into the singularity, and the tip never settles.
#[test]
fn fading_velocity_terms_keep_a_press_at_a_stretched_arm_quiet() {
    let file = shipped_device("coupled-five-bar");
    let middle = 77_f64.to_radians();
    // At smaller depths the result depends on the last digit.
    for aim in [0.023, 0.024, 0.025] {
        let push = Some([-aim * middle.cos(), -aim * middle.sin(), 0.0]);
        let swing = |velocity_terms, unfaded| {
            let run = WallRun { bilateral: false, push, velocity_terms, unfaded, ..demo_run(&file, FeedForward::Full) };
            run.torque_swing(&facets_at_angles(middle, &[(0.0, 1.0)]))
        };
        let in_full = swing(VelocityTerms::Off, true);
        assert!(in_full > UNSTABLE_SWING_NM, "{aim} m, without fading: {in_full} N m");
        for terms in [VelocityTerms::Off, VelocityTerms::Rendered, VelocityTerms::Paper] {
            let faded = swing(terms, false);
            assert!(faded < QUIET_SWING_NM, "{aim} m, {terms:?}: {faded} N m");
        }
    }
}

/// A press along the normal also slides the tip along the wall. At 75° it slides 18 mm, until an elbow is 6° from
/// stretched, where the velocity terms grow as 1/sin³ and their estimate is too late.
#[test]
fn velocity_terms_keep_quiet_presses_quiet() {
    let file = shipped_device("coupled-five-bar");
    let (mut pressed, mut quiet) = (0, 0);
    for stiffness in [2_000.0, 10_000.0, 15_000.0, 20_000.0] {
        for degrees in (0..12).map(|k| 15.0 + 30.0 * f64::from(k)) {
            let normal = unit_vector(f64::to_radians(degrees));
            for aim in [0.005, 0.01, 0.015, 0.02] {
                let swing = |velocity_terms| {
                    let push = Some([-aim * normal[0], -aim * normal[1], 0.0]);
                    let damping = if stiffness > 5_000.0 { 40.0 } else { 10.0 };
                    let run = demo_run(&file, FeedForward::Full);
                    let run = WallRun { stiffness, damping, bilateral: false, push, velocity_terms, ..run };
                    run.torque_swing(&[(normal.clone(), 1.0)])
                };
                pressed += 1;
                if swing(VelocityTerms::Off) < QUIET_SWING_NM {
                    quiet += 1;
                    for terms in [VelocityTerms::default(), VelocityTerms::Paper] {
                        let swing = swing(terms);
                        let press = format!("{stiffness} N/m, normal at {degrees}°, aim {aim} m, {terms:?}");
                        assert!(swing < QUIET_SWING_NM, "{press}: {swing} N m");
                    }
                }
            }
        }
    }
    assert!(quiet > pressed / 2, "{quiet} of {pressed} presses are quiet");
}

#[test]
fn the_feed_forward_keeps_stable_corners_quiet() {
    let file = shipped_device("coupled-five-bar");
    // A right-angled corner of 2 x 8 kN/m, an acute corner, and a stiff wall with a second wall 100 times softer.
    for (angles, stiffness) in [
        (vec![(75.0, 1.0), (-15.0, 1.0)], 12_000.0),
        (vec![(75.0, 1.0), (15.0, 1.0)], 12_000.0),
        (vec![(75.0, 1.0), (165.0, 0.01)], 15_000.0),
        (vec![(75.0, 1.0), (-15.0, 1.0), (30.0, 0.5)], 12_000.0),
    ] {
        let walls = facets_at_angles(0.0, &angles);
        for feed_forward in [FeedForward::Off, FeedForward::Full, FeedForward::Washout] {
            let run = WallRun { stiffness, damping: 0.002 * stiffness, ..demo_run(&file, feed_forward) };
            let swing = run.torque_swing(&walls);
            assert!(swing < QUIET_SWING_NM, "{angles:?} {feed_forward:?}: {swing} N m");
        }
    }
}

/// The feed-forward of a firm press on one wall pushes the tip onto a second wall. The push falls with the depth in the
/// second wall. If the push fell within 0.1 mm, these light touches would swing with 0.2 N m or more.
#[test]
fn a_light_touch_during_a_firm_press_is_quiet() {
    let file = shipped_device("coupled-five-bar");
    for (first, between, k1, k2) in [
        (165.0, 90.0, 8_000.0, 8_000.0),
        (75.0, -90.0, 8_000.0, 8_000.0),
        (135.0, 90.0, 8_000.0, 8_000.0),
        (165.0, 90.0, 2_000.0, 6_000.0),
        (75.0, -90.0, 2_000.0, 6_000.0),
    ] {
        let [one, other] = [first, first + between].map(|degrees: f64| unit_vector(degrees.to_radians()));
        for light in [0.02, 0.1] {
            let push = Some([0, 1, 2].map(|i| if i < 2 { -0.02 * (one[i] + light * other[i]) } else { 0.0 }));
            for feed_forward in [FeedForward::Off, FeedForward::Full, FeedForward::Washout] {
                let stiffness = k1 + k2;
                let run = WallRun {
                    stiffness,
                    damping: 0.002 * stiffness,
                    bilateral: false,
                    push,
                    ..demo_run(&file, feed_forward)
                };
                let swing = run.torque_swing(&[(one.clone(), k1), (other.clone(), k2)]);
                assert!(swing < QUIET_SWING_NM, "{first}° {between}° {k1} {k2} {light} {feed_forward:?}: {swing} N m");
            }
        }
    }
}

/// The spring acts between the wall's normal and the direction of the shaped force. If only the wall were shaped,
/// spring and wall would be unstable at any gain.
#[test]
fn the_feed_forward_keeps_a_spring_with_a_wall_quiet() {
    let file = shipped_device("coupled-five-bar");
    let normal = unit_vector(75_f64.to_radians());
    for degrees in (0..12).map(|k| 15.0 * f64::from(k)) {
        let line = unit_vector(f64::to_radians(degrees + 90.0));
        for stiffness in [1_000.0, 4_000.0] {
            for feed_forward in [FeedForward::Off, FeedForward::Full, FeedForward::Washout] {
                let spring = Some(([0.0; 3], [line[0], line[1], 0.0], stiffness));
                let run = WallRun { stiffness: 8_000.0, damping: 16.0, spring, ..demo_run(&file, feed_forward) };
                let swing = run.torque_swing(&[(normal.clone(), 1.0)]);
                assert!(swing < QUIET_SWING_NM, "{degrees}° {stiffness} {feed_forward:?}: {swing} N m");
            }
        }
    }
}

/// With the depth of contact, the shaped part of a spring's force rises so slowly that a light touch does not swing.
#[test]
fn a_light_touch_with_a_stretched_spring_is_quiet() {
    let file = shipped_device("coupled-five-bar");
    for degrees in (0..12).map(|k| 15.0 + 30.0 * f64::from(k)) {
        let n = unit_vector(f64::to_radians(degrees));
        let along = |far: f64| [far * n[0], far * n[1], 0.0];
        for far in [-0.02, 0.02] {
            for aim in [-0.021, -0.019, -0.01, 0.0, 0.015] {
                let swing = |feed_forward| {
                    let (push, spring) = (Some(along(aim)), Some((along(far), [0.0; 3], 200.0)));
                    let run = demo_run(&file, feed_forward);
                    WallRun { stiffness: 6_000.0, damping: 12.0, bilateral: false, push, spring, ..run }
                        .torque_swing(&[(n.clone(), 1.0)])
                };
                for feed_forward in [FeedForward::Off, FeedForward::Full, FeedForward::Washout] {
                    let swing = swing(feed_forward);
                    assert!(swing < QUIET_SWING_NM, "{degrees}° {far} {aim} {feed_forward:?}: {swing} N m");
                }
            }
        }
    }
}

#[test]
fn the_feed_forward_keeps_edges_and_vertices_quiet() {
    let file = shipped_device("phantom-premium-1.5");
    let q = [0.3, 0.9, -0.3];
    for (walls, stiffness) in [
        (vec![(vec![0.6, 0.8, 0.0], 1.0), (vec![0.0, 0.6, 0.8], 1.0)], 2_000.0),
        (vec![(vec![1.0, 0.0, 0.0], 1.0), (vec![0.0, 1.0, 0.0], 0.3), (vec![0.0, 0.0, 1.0], 0.05)], 2_000.0),
        (
            vec![
                (normalise(&[0.1, 1.0, 0.0]), 1.0),
                (normalise(&[-0.1, 1.0, 0.1]), 1.0),
                (normalise(&[0.0, 1.0, -0.1]), 1.0),
            ],
            2_000.0,
        ),
    ] {
        for feed_forward in [FeedForward::Off, FeedForward::Full, FeedForward::Washout] {
            let run = WallRun { q, stiffness, damping: 0.002 * stiffness, ..demo_run(&file, feed_forward) };
            let swing = run.torque_swing(&walls);
            assert!(swing < QUIET_SWING_NM, "{walls:?} {feed_forward:?}: {swing} N m");
        }
    }
}
