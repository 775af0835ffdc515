//! Time to compute one shaped torque on this computer: `cargo bench -p haptic --bench step`.
//!
//! `cargo xtask bench` counts the chip's instructions instead.

use criterion::{Criterion, criterion_group, criterion_main};
use haptic_bridge::control::compiled::BoardMath;
use haptic_bridge::model::mechanism::Mechanism;
use haptic_bridge::render::scene::Scene;
use haptic_bridge::with_mechanism;
use haptic_predict::bench::error::{Law, Terms, torque};
use haptic_predict::bench::probe::{HAND_SPEED, workspace};
use haptic_predict::bench::report::devices;
use std::hint::black_box;

fn time_torques<M: Mechanism<f32, N>, const N: usize>(
    criterion: &mut Criterion,
    mechanism: &M,
    law: Law,
    probes: &[haptic_predict::bench::probe::Probe],
) {
    for terms in Terms::ALL {
        let name = format!("{}, {}", M::SPEC.name, terms.name());
        let mut next = probes.iter().cycle();
        criterion.bench_function(&name, |bench| {
            bench.iter(|| {
                let probe = next.next().expect("a cycle does not end");
                torque::<f32, BoardMath, M, N>(mechanism, terms, law, black_box(probe))
            });
        });
    }
}

fn time_every_variant(criterion: &mut Criterion) {
    for device in devices().expect("the shipped devices") {
        let probes = workspace(&device, 9, HAND_SPEED).expect("a device with a workspace");
        let law = Law::of(&Scene::default(), &device).expect("the default cutoff");
        let board = device.mechanism.cast::<f32>();
        with_mechanism!(&board, mechanism => time_torques(criterion, mechanism, law, &probes));
    }
}

criterion_group!(benches, time_every_variant);
criterion_main!(benches);
