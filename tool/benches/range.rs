//! Times of a map and of one prediction, which has two boundaries of 200 points and their areas.

use criterion::{Criterion, criterion_group, criterion_main};
use haptic_host::device_file::DeviceFile;
use haptic_stability::analysis::map::map;
use haptic_stability::analysis::plant::{Drive, Linearised};
use haptic_stability::analysis::range::predict;
use haptic_stability::analysis::sampled::{LinearEstimator, Loop};
use std::hint::black_box;

fn time_prediction(criterion: &mut Criterion) {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../devices/phantom-premium-1.5.toml");
    let file = DeviceFile::load(path).expect("a shipped device file");
    let device = Linearised::at(&file.description, &[0.3, 0.9, -0.3], &[0.5, 0.5, 0.7]).expect("a regular pose");
    for (rate_hz, cutoff) in [(200.0, 20.0), (1000.0, 20.0), (20_000.0, 500.0), (50_000.0, 20.0)] {
        let around = Loop {
            rate_hz,
            delay_samples: 0.5,
            estimator: LinearEstimator::Butterworth(cutoff),
            drive: Drive::Ideal,
            damping_compensation: false,
        };
        criterion.bench_function(&format!("range, {rate_hz} Hz, cutoff {cutoff} Hz"), |bench| {
            bench.iter(|| predict(black_box(&device), &around, None, None));
        });
    }
}

fn time_map(criterion: &mut Criterion) {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../devices/coupled-five-bar.toml");
    let file = DeviceFile::load(path).expect("a shipped device file");
    criterion.bench_function("map, 2000 poses", |bench| {
        bench.iter(|| map(black_box(&file.description), &[1.0, 0.0], 2000));
    });
}

criterion_group!(benches, time_prediction, time_map);
criterion_main!(benches);
