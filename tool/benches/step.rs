//! Time to compute one shaped torque on this computer: `cargo bench -p haptic --bench step`.
//!
//! `cargo xtask bench` counts the chip's instructions instead.

use criterion::{Criterion, criterion_group, criterion_main};
use haptic_bridge::control::compiled::BoardMath;
use haptic_bridge::model::mechanism::Mechanism;
use haptic_bridge::model::precomputed::{Interpolation, MassModel};
use haptic_bridge::render::scene::Scene;
use haptic_bridge::with_mechanism;
use haptic_predict::bench::error::{Law, Terms, torque};
use haptic_predict::bench::precompute::{PrecomputedModel, frozen_model, mass_table, max_grid_points, shape_range};
use haptic_predict::bench::probe::{HAND_SPEED, workspace};
use haptic_predict::bench::report::devices;
use std::hint::black_box;

fn time_torques<M: Mechanism<f32, N>, const N: usize>(
    criterion: &mut Criterion,
    mechanism: &M,
    model: &PrecomputedModel,
    law: Law,
    probes: &[haptic_predict::bench::probe::Probe],
) {
    let mass = MassModel::<f32, N>::new::<M>(&model.data, &model.values).expect("a model of this mechanism");
    for terms in Terms::ALL {
        let name = format!("{}, {}, {}", M::SPEC.name, model.name(), terms.name());
        let mut next = probes.iter().cycle();
        criterion.bench_function(&name, |bench| {
            bench.iter(|| {
                let probe = next.next().expect("a cycle does not end");
                torque::<f32, BoardMath, M, N>(mechanism, &mass, terms, law, black_box(probe))
            });
        });
    }
}

fn time_every_variant(criterion: &mut Criterion) {
    for device in devices().expect("the shipped devices") {
        let probes = workspace(&device, 9, HAND_SPEED).expect("a device with a workspace");
        let (points, range) = (max_grid_points(&device), shape_range(&device, &probes));
        let mut models = vec![PrecomputedModel::default(), frozen_model(&device, &probes)];
        models.extend(mass_table(&device, Interpolation::Bilinear, [points; 2], range));
        models.extend(mass_table(&device, Interpolation::Bicubic, [points; 2], range));
        let law = Law::of(&Scene::default(), &device).expect("the default cutoff");
        let board = device.mechanism.cast::<f32>();
        for model in &models {
            with_mechanism!(&board, mechanism => time_torques(criterion, mechanism, model, law, &probes));
        }
    }
}

criterion_group!(benches, time_every_variant);
criterion_main!(benches);
