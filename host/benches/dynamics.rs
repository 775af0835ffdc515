//! Time of the equations of motion and of the whole of equation (4) on this computer, in f64 as every sweep of the
//! analysis uses them: `cargo bench -p haptic --bench dynamics`.
//!
//! "M, b, J" is the pose (its sines, cosines and square root) with the mass matrix, the Coriolis and gravity torques and
//! the Jacobian. "equation (4)" is the pose with everything that an [`Inertia`] holds for one wall: E and M E of every
//! direction, W, z with the velocity terms, Weff, f_a and both torques.

use criterion::{Criterion, criterion_group, criterion_main};
use haptic::bench::probe::{HAND_SPEED, workspace};
use haptic::bench::report::devices;
use haptic_bridge::math::Libm;
use haptic_bridge::model::inertia::Inertia;
use haptic_bridge::model::mechanism::Mechanism;
use haptic_bridge::model::principal::Pull;
use haptic_bridge::with_mechanism;
use nalgebra::SVector;
use std::hint::black_box;

type State<const N: usize> = (SVector<f64, N>, SVector<f64, N>, SVector<f64, N>);

fn both<M: Mechanism<f64, N>, const N: usize>(criterion: &mut Criterion, mechanism: &M, states: &[State<N>]) {
    let mut group = criterion.benchmark_group(M::SPEC.name);
    let mut next = states.iter().cycle();
    group.bench_function("M, b, J", |bench| {
        bench.iter(|| {
            let (q, qd, _) = black_box(next.next().expect("a cycle does not end"));
            let pose = mechanism.pose::<Libm>(q);
            let torque = mechanism.coriolis(&pose, qd) + mechanism.gravity(&pose);
            (mechanism.mass(&pose), torque, mechanism.jacobian(&pose))
        });
    });
    group.bench_function("equation (4)", |bench| {
        bench.iter(|| {
            let (q, qd, normal) = black_box(next.next().expect("a cycle does not end"));
            let pose = mechanism.pose::<Libm>(q);
            let wall = Pull { normal: *normal, across: false, stiffness: 1.0, feed_forward: true };
            Inertia::new::<Libm, M>(mechanism, &pose, qd, &[wall], normal)
        });
    });
}

fn every_mechanism(criterion: &mut Criterion) {
    for device in devices().expect("the shipped devices") {
        let probes = workspace(&device, 9, HAND_SPEED).expect("a device with a workspace");
        with_mechanism!(&device.mechanism, mechanism => {
            let states: Vec<_> = probes
                .iter()
                .map(|probe| {
                    let part = |values: &[f64]| SVector::from_fn(|i, _| values.get(i).copied().unwrap_or(0.0));
                    (part(&probe.q), part(&probe.qd), part(&probe.normal))
                })
                .collect();
            both(criterion, mechanism, &states);
        });
    }
}

criterion_group!(benches, every_mechanism);
criterion_main!(benches);
