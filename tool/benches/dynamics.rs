//! Time of the equations of motion and of equation (4) on this computer, in f64 with the analysis's table of sines:
//! `cargo bench -p haptic --bench dynamics`. The states cover the workspace of each shipped device.
//!
//! `cargo xtask dynamics` compares these times with Pinocchio (pinocchio.cpp). With `--states` this program prints the
//! states and their results, which Pinocchio must reproduce.

use haptic_bridge::math::FineTable;
use haptic_bridge::model::inertia::Inertia;
use haptic_bridge::model::mechanism::Mechanism;
use haptic_bridge::model::principal::Pull;
use haptic_bridge::with_mechanism;
use haptic_predict::bench::probe::{HAND_SPEED, Probe, workspace};
use haptic_predict::bench::report::devices;
use nalgebra::{SMatrix, SVector};
use std::hint::black_box;
use std::time::Instant;

/// Names of the timed computations, each with its parts.
const COMPUTATIONS: [&str; 4] = [
    "pose: sines, cosines, roots and reciprocals, which all other quantities need",
    "M, b, J: the pose, the mass matrix, Coriolis and gravity torques, the Jacobian",
    "(4): the pose, the basis, W, z with J̇q̇, Weff, f_a, the torques with and without the feed-forward",
    "(4) of a given pose: all of (4) except the pose",
];

/// Number of timed passes through all states. The fastest pass counts, because other programs delay the slower passes.
const PASSES: usize = 101;

/// Joint angles, rad, joint velocities, rad/s, unit normal of a wall that pushes with 1 N, and the pose at the angles.
struct State<M: Mechanism<f64, N>, const N: usize> {
    q: SVector<f64, N>,
    qd: SVector<f64, N>,
    normal: SVector<f64, N>,
    pose: M::Pose,
}

impl<M: Mechanism<f64, N>, const N: usize> State<M, N> {
    fn new(m: &M, probe: &Probe) -> Self {
        let part = |values: &[f64]| SVector::from_fn(|i, _| values[i]);
        let q = part(&probe.q);
        Self { q, qd: part(&probe.qd), normal: part(&probe.normal), pose: m.pose::<FineTable>(&q) }
    }
}

/// Mass matrix, Coriolis and gravity torques, and Jacobian.
type Equations<const N: usize> = (SMatrix<f64, N, N>, SVector<f64, N>, SMatrix<f64, N, N>);

#[inline(always)]
fn equations<M: Mechanism<f64, N>, const N: usize>(m: &M, pose: &M::Pose, qd: &SVector<f64, N>) -> Equations<N> {
    (m.mass(pose), m.coriolis(pose, qd) + m.gravity(pose), m.jacobian(pose))
}

#[inline(always)]
fn equation_4<M: Mechanism<f64, N>, const N: usize>(m: &M, pose: &M::Pose, state: &State<M, N>) -> Inertia<f64, N> {
    let wall = Pull { normal: state.normal, across: false, stiffness: 1.0, feed_forward: true };
    Inertia::new::<FineTable, M>(m, pose, &state.qd, &[wall], &state.normal)
}

/// Runs one computation at every state. `row` is its index in [`COMPUTATIONS`].
#[inline(never)]
fn run_pass<M: Mechanism<f64, N>, const N: usize>(m: &M, states: &[State<M, N>], row: usize) {
    for state in states.iter().map(black_box) {
        let pose = || m.pose::<FineTable>(&state.q);
        match row {
            0 => _ = black_box(&pose()),
            1 => _ = black_box(&equations(m, &pose(), &state.qd)),
            2 => _ = black_box(&equation_4(m, &pose(), state)),
            _ => _ = black_box(&equation_4(m, &state.pose, state)),
        }
    }
}

/// Prints one line for each computation: the mechanism, the time for one state, ns, and the computation's name.
fn print_times<M: Mechanism<f64, N>, const N: usize>(m: &M, states: &[State<M, N>]) {
    for (row, name) in COMPUTATIONS.iter().enumerate() {
        let timed = |_| {
            let start = Instant::now();
            run_pass(m, states, row);
            start.elapsed().as_secs_f64()
        };
        let fastest = (0..PASSES).map(timed).fold(f64::INFINITY, f64::min);
        println!("{} {:.1} {name}", M::SPEC.name, fastest * 1e9 / states.len() as f64);
    }
}

/// Prints the mechanism and the number of states, then one line for each state with its results.
fn print_states<M: Mechanism<f64, N>, const N: usize>(m: &M, states: &[State<M, N>]) {
    println!("{} {}", M::SPEC.name, states.len());
    for state in states {
        let (mass, bias, jacobian) = equations(m, &state.pose, &state.qd);
        let Inertia { w, z, w_eff, torque, torque_without_feed_forward, f_a, .. } = equation_4(m, &state.pose, state);
        let vectors = [state.q, state.qd, state.normal, bias, z, torque, torque_without_feed_forward, f_a];
        let vectors = vectors.iter().flat_map(|vector| vector.iter());
        let matrices = [mass, jacobian, w];
        let numbers = vectors.chain(matrices.iter().flat_map(|matrix| matrix.iter())).chain(w_eff.get((0, 0)));
        let words: Vec<String> = numbers.map(|number| format!("{number:e}")).collect();
        println!("{}", words.join(" "));
    }
}

fn main() {
    let only_states = std::env::args().any(|argument| argument == "--states");
    for device in devices().expect("the shipped devices") {
        let probes = workspace(&device, 9, HAND_SPEED).expect("a device with a workspace");
        with_mechanism!(&device.mechanism, m => {
            let states: Vec<_> = probes.iter().map(|probe| State::new(m, probe)).collect();
            if only_states { print_states(m, &states) } else { print_times(m, &states) }
        });
    }
}
