//! The energy that a hand gains as it slides along a wall: derived from Λ, computed from torques, reported as `energy`.
//!
//! At rest a wall with the full feed-forward is the force field f(x) Λn/(nᵀΛn). Its normal part has a potential. Its
//! other part is f γ along the wall, with γ = tᵀΛn/(nᵀΛn). A loop that presses to the depth d, slides, releases and
//! returns therefore gains f(d) ∫ γ ds.

use crate::common::{bilateral_wall, device_file, fine_counts, inverse, with_fine_encoders};
use haptic_bridge::math::Libm;
use haptic_bridge::model::description::Description;
use haptic_bridge::model::device::Device;
use haptic_bridge::model::mechanism::{AnyMechanism, Mechanism};
use haptic_bridge::render::controller::Controller;
use haptic_bridge::render::scene::{FeedForward, Plane, Scene, Surface, VelocityTerms, Wall};
use haptic_bridge::with_mechanism;
use nalgebra::SVector;

const RATE_HZ: f64 = 1_000.0;
const STEPS_PER_LEG: u32 = 1_000;
/// Energy debt above which the passivity controller removes all feed-forward, J (src/render/controller/passivity.rs).
const MAX_DEBT: f64 = 1.0e-3;

/// A loop near the home of a shipped device.
struct Case {
    device: &'static str,
    normal: [f64; 3],
    /// Stiffness of the wall, N/m.
    stiffness: f64,
    /// Penetration while sliding, m.
    depth: f64,
    /// Start of the slide, relative to home, m.
    from: f64,
    /// Length of the slide, m.
    slide: f64,
    /// Energy gain in an independent simulation, whose slide may start elsewhere, J.
    energy_gain: f64,
}

const CASES: [Case; 2] = [
    Case {
        device: "phantom-premium-1.5",
        normal: [-0.7, 0.7, 0.0],
        stiffness: 2_000.0,
        depth: 0.002,
        from: -0.02,
        slide: 0.04,
        energy_gain: 0.066,
    },
    Case {
        device: "coupled-five-bar",
        normal: [0.6, 0.8, 0.0],
        stiffness: 10_000.0,
        depth: 0.0005,
        from: 0.0,
        slide: 0.02,
        energy_gain: 0.014,
    },
];

struct LoopEnergies {
    /// Net work of the torques in each loop, J.
    work: Vec<f64>,
    /// Energy that the controller reports at the end of each contact, negative if it was given out, J.
    reported: Vec<f64>,
    /// f(d) ∫ γ ds of one loop, J.
    derived: f64,
}

impl Case {
    fn run_loops(&self, feed_forward: FeedForward, passivity: bool, times: usize) -> LoopEnergies {
        let shipped = device_file::shipped_device(self.device);
        let description = Description { gravity: [0.0; 3], ..with_fine_encoders(shipped) };
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
    ) -> LoopEnergies {
        let home = description.home.expect("a home");
        let mut q = SVector::<f64, N>::from_fn(|i, _| home[i]);
        let start = m.tip(&m.pose::<Libm>(&q));
        let n = SVector::<f64, N>::from_fn(|i, _| self.normal[i]).normalize();
        // Direction of the force field, Λn/(nᵀΛn).
        let field = |q: &SVector<f64, N>| {
            let pose = m.pose::<Libm>(q);
            let back = inverse(&m.jacobian(&pose));
            let push = back.transpose() * m.mass(&pose) * back * n;
            push / n.dot(&push)
        };
        let aside = field(&q) - n;
        let t = aside.normalize();

        let mut scene = Scene::<f64> {
            task: N as u8,
            rate_hz: RATE_HZ,
            cutoff_hz: 100.0,
            velocity_terms: VelocityTerms::Off,
            ..Scene::default()
        };
        let padded = |v: &SVector<f64, N>| core::array::from_fn(|i| v.get(i).copied().unwrap_or(0.0));
        let surface = Surface::Plane(Plane { point: padded(&start), normal: padded(&n) });
        let wall = Wall { feed_forward, bilateral: false, ..bilateral_wall(surface, self.stiffness) };
        scene.walls.push(wall).expect("room");
        let device = Device::<f64>::new("loop", description).expect("a sound device");
        let mut controller = Controller::<f64, M, Libm, N>::new(m, &device, &scene).expect("a sound scene");
        controller.set_passivity(passivity, true);

        let (from, to) = (self.from, self.from + self.slide);
        let corners = [(1e-6, to), (1e-6, from), (-self.depth, from), (-self.depth, to), (1e-6, to)];
        let mut loops = LoopEnergies { work: Vec::new(), reported: Vec::new(), derived: 0.0 };
        let mut torque = SVector::<f64, N>::zeros();
        for nth in 0..times {
            let (mut work, mut reported) = (0.0, 0.0);
            for leg in corners.windows(2) {
                for k in 1..=STEPS_PER_LEG {
                    let share = f64::from(k) / f64::from(STEPS_PER_LEG);
                    let between = |a: f64, b: f64| a + (b - a) * share;
                    let (x, s) = (between(leg[0].0, leg[1].0), between(leg[0].1, leg[1].1));
                    let (target, before) = (start + n * x + t * s, q);
                    for _ in 0..3 {
                        let pose = m.pose::<Libm>(&q);
                        q += m.inverse(&pose, &(target - m.tip(&pose)));
                    }
                    work += torque.dot(&(q - before));
                    let step = controller.step(&fine_counts(&q));
                    torque = step.torque;
                    if step.contacts > 0 {
                        reported = step.energy;
                    }
                    if nth == 0 && leg[0].1 != leg[1].1 && x < 0.0 {
                        loops.derived +=
                            self.stiffness * self.depth * t.dot(&field(&q)) * self.slide / f64::from(STEPS_PER_LEG);
                    }
                }
            }
            loops.work.push(work);
            loops.reported.push(reported);
        }
        loops
    }
}

#[test]
fn the_energy_gain_of_a_slide_is_as_derived_and_reported() {
    for case in &CASES {
        let LoopEnergies { work, reported, derived } = case.run_loops(FeedForward::Full, false, 2);
        assert!((derived / case.energy_gain - 1.0).abs() < 0.1, "{}: {derived} J derived", case.device);
        // Torques are constant during a step, so they lag by half a step.
        assert!(work.iter().all(|work| (work / derived - 1.0).abs() < 0.005), "{}: work {work:?} J", case.device);
        // The debt of the first loop remains in the second loop.
        assert!((reported[0] + work[0]).abs() < 1e-2 * work[0], "{}: {reported:?} reported for {work:?}", case.device);
        assert!(
            (reported[1] + work[0] + work[1]).abs() < 1e-2 * work[0],
            "{}: {reported:?} reported for {work:?}",
            case.device
        );
    }
}

#[test]
fn a_slide_gains_nothing_without_feed_forward_or_with_a_washout() {
    for case in &CASES {
        for (feed_forward, share) in [(FeedForward::Off, 0.005), (FeedForward::Washout, 0.02)] {
            let LoopEnergies { work, derived, .. } = case.run_loops(feed_forward, false, 1);
            assert!(work[0].abs() < share * derived, "{} {feed_forward:?}: work {work:?} of {derived}", case.device);
        }
    }
}

#[test]
fn the_passivity_controller_bounds_the_energy_of_all_loops() {
    for case in &CASES {
        let LoopEnergies { work, reported, derived } = case.run_loops(FeedForward::Full, true, 5);
        let bound = 0.5 * case.stiffness * case.depth * case.depth + MAX_DEBT;
        assert!(derived > 3.0 * bound, "{}", case.device);
        assert!(work.iter().sum::<f64>() < 1.02 * bound, "{}: too much work: {work:?} J", case.device);
        assert!(reported.iter().all(|reported| *reported > -1.02 * bound), "{}: {reported:?} J of debt", case.device);
        assert!(work[0] > 0.5 * bound, "{}: the feed-forward must act up to the bound: {work:?} J", case.device);
    }
}
