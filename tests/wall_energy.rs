//! The energy that a wall gives out while a hand slides along it: derived from Λ, done by the torques, and told as
//! `energy`.
//!
//! At rest a wall with the feed-forward in full is the force field f(x) Λn/(nᵀΛn). Its normal part has a potential; the
//! rest of it is f γ along the wall, γ = tᵀΛn/(nᵀΛn), and so a loop that presses to the depth d, slides, lets go and
//! returns gains f(d) ∫ γ ds.

use crate::common::{device_file, inverse};
use haptic_bridge::math::Libm;
use haptic_bridge::model::description::{Description, Encoder};
use haptic_bridge::model::device::Device;
use haptic_bridge::model::mechanism::{AnyMechanism, Mechanism};
use haptic_bridge::render::controller::Controller;
use haptic_bridge::render::scene::{FeedForward, Plane, Scene, Surface, VelocityTerms, Wall};
use haptic_bridge::with_mechanism;
use nalgebra::SVector;

/// So fine that its steps count for nothing.
const COUNTS_PER_TURN: f64 = 1.0e9;
const RATE: f64 = 1_000.0;
/// Steps of each leg of a loop.
const STEPS: u32 = 1_000;
/// Debt from which on the passivity controller leaves no feed-forward, J (src/render/controller/passivity.rs).
const MOST_OWED: f64 = 1.0e-3;

/// A loop at the home of a shipped device.
struct Case {
    device: &'static str,
    normal: [f64; 3],
    /// N/m
    stiffness: f64,
    /// m
    depth: f64,
    /// The beginning of the slide, by its distance from home, and its length, m.
    from: f64,
    slide: f64,
    /// The gain in an independent simulation, whose slide may have begun elsewhere, J.
    gained: f64,
}

const CASES: [Case; 2] = [
    Case {
        device: "phantom-premium-1.5",
        normal: [-0.7, 0.7, 0.0],
        stiffness: 2_000.0,
        depth: 0.002,
        from: -0.02,
        slide: 0.04,
        gained: 0.066,
    },
    Case {
        device: "coupled-five-bar",
        normal: [0.6, 0.8, 0.0],
        stiffness: 10_000.0,
        depth: 0.0005,
        from: 0.0,
        slide: 0.02,
        gained: 0.014,
    },
];

/// Energies (J) of loops, one entry for each.
struct Loops {
    /// The work of the torques, less the work they took.
    done: Vec<f64>,
    /// The controller's sum at the end of contact: taken up, negative where given out.
    told: Vec<f64>,
    /// f(d) ∫ γ ds of one loop.
    derived: f64,
}

impl Case {
    fn description(&self) -> Description {
        let mut description = device_file::shipped(self.device);
        description.gravity = [0.0; 3];
        for joint in &mut description.joints {
            joint.encoder = Some(Encoder { counts_per_turn: COUNTS_PER_TURN, offset: 0.0, inverted: false });
        }
        description
    }

    fn loops(&self, feed_forward: FeedForward, passivity: bool, times: usize) -> Loops {
        let description = self.description();
        let mechanism = AnyMechanism::<f64>::new(&description).expect("a sound device");
        with_mechanism!(&mechanism, m => self.run(*m, &description, feed_forward, passivity, times))
    }

    fn run<M: Mechanism<f64, N>, const N: usize>(
        &self,
        m: M,
        description: &Description,
        feed_forward: FeedForward,
        passivity: bool,
        times: usize,
    ) -> Loops {
        let home = description.home.expect("a home");
        let mut q = SVector::<f64, N>::from_fn(|i, _| home[i]);
        let start = m.tip(&m.pose::<Libm>(&q));
        let n = SVector::<f64, N>::from_fn(|i, _| self.normal[i]).normalize();
        // Λn/(nᵀΛn), where the field points.
        let points = |q: &SVector<f64, N>| {
            let pose = m.pose::<Libm>(q);
            let back = inverse(&m.jacobian(&pose));
            let push = back.transpose() * m.mass(&pose) * back * n;
            push / n.dot(&push)
        };
        let aside = points(&q) - n;
        let t = aside.normalize();

        let mut scene = Scene::<f64> {
            task: N as u8,
            rate_hz: RATE,
            cutoff_hz: 100.0,
            velocity_terms: VelocityTerms::Off,
            ..Scene::default()
        };
        let padded = |v: &SVector<f64, N>| core::array::from_fn(|i| v.get(i).copied().unwrap_or(0.0));
        let wall = Wall {
            surface: Surface::Plane(Plane { point: padded(&start), normal: padded(&n) }),
            stiffness: self.stiffness,
            damping: 0.0,
            feed_forward,
            washout_hz: 2.0,
            damping_compensation: false,
            bilateral: false,
        };
        scene.walls.push(wall).expect("room");
        let device = Device::<f64>::new("loop", description).expect("a sound device");
        let mut controller = Controller::<f64, M, Libm, N>::new(m, &device, &scene).expect("a sound scene");
        controller.set_passivity(passivity, true);

        let (from, to) = (self.from, self.from + self.slide);
        let corners = [(1e-6, to), (1e-6, from), (-self.depth, from), (-self.depth, to), (1e-6, to)];
        let mut loops = Loops { done: Vec::new(), told: Vec::new(), derived: 0.0 };
        let mut torque = SVector::<f64, N>::zeros();
        for nth in 0..times {
            let (mut done, mut told) = (0.0, 0.0);
            for leg in corners.windows(2) {
                for k in 1..=STEPS {
                    let share = f64::from(k) / f64::from(STEPS);
                    let between = |a: f64, b: f64| a + (b - a) * share;
                    let (x, s) = (between(leg[0].0, leg[1].0), between(leg[0].1, leg[1].1));
                    let (place, before) = (start + n * x + t * s, q);
                    for _ in 0..3 {
                        let pose = m.pose::<Libm>(&q);
                        q += m.inverse(&pose, &(place - m.tip(&pose)));
                    }
                    done += torque.dot(&(q - before));
                    let count = |i: usize| (q[i] / core::f64::consts::TAU * COUNTS_PER_TURN).round() as i32;
                    let step = controller.step(&core::array::from_fn(count));
                    torque = step.torque;
                    if step.contacts > 0 {
                        told = step.energy;
                    }
                    if nth == 0 && leg[0].1 != leg[1].1 && x < 0.0 {
                        loops.derived +=
                            self.stiffness * self.depth * t.dot(&points(&q)) * self.slide / f64::from(STEPS);
                    }
                }
            }
            loops.done.push(done);
            loops.told.push(told);
        }
        loops
    }
}

#[test]
fn a_hand_gains_what_the_sideways_push_does_along_its_slide_and_telemetry_tells_it() {
    for case in &CASES {
        let Loops { done, told, derived } = case.loops(FeedForward::Full, false, 2);
        assert!((derived / case.gained - 1.0).abs() < 0.1, "{}: {derived} J derived", case.device);
        // Torques that are held through each step are behind by half a step.
        assert!(done.iter().all(|done| (done / derived - 1.0).abs() < 0.005), "{}: {done:?} J done", case.device);
        // The debt of one loop is not forgotten in the next.
        assert!((told[0] + done[0]).abs() < 1e-2 * done[0], "{}: {told:?} told of {done:?}", case.device);
        assert!((told[1] + done[0] + done[1]).abs() < 1e-2 * done[0], "{}: {told:?} told of {done:?}", case.device);
    }
}

#[test]
fn without_the_feed_forward_or_at_rest_behind_a_washout_a_slide_gains_nothing() {
    for case in &CASES {
        for (feed_forward, share) in [(FeedForward::Off, 0.005), (FeedForward::Washout, 0.02)] {
            let Loops { done, derived, .. } = case.loops(feed_forward, false, 1);
            assert!(done[0].abs() < share * derived, "{} {feed_forward:?}: {done:?} J of {derived}", case.device);
        }
    }
}

#[test]
fn with_the_passivity_controller_all_loops_gain_no_more_than_a_wall_stores_and_may_owe() {
    for case in &CASES {
        let Loops { done, told, derived } = case.loops(FeedForward::Full, true, 5);
        let most = 0.5 * case.stiffness * case.depth * case.depth + MOST_OWED;
        assert!(derived > 3.0 * most, "{}", case.device);
        assert!(done.iter().sum::<f64>() < 1.02 * most, "{}: {done:?} J", case.device);
        assert!(told.iter().all(|told| *told > -1.02 * most), "{}: {told:?} J", case.device);
        assert!(done[0] > 0.5 * most, "{}: it acts until then: {done:?} J", case.device);
    }
}
