//! Predicts the largest stable stiffness of a wall without and with the feed-forward:
//! `cargo run -p haptic --example predict_range`.

use haptic_host::device_file::DeviceFile;
use haptic_stability::analysis::plant::{Drive, Linearised};
use haptic_stability::analysis::range::predict;
use haptic_stability::analysis::sampled::{LinearEstimator, Loop};

/// Computes and prints the prediction.
pub fn main() -> Result<(), Box<dyn std::error::Error>> {
    let device = DeviceFile::load(concat!(env!("CARGO_MANIFEST_DIR"), "/../devices/coupled-five-bar.toml"))?;
    // Joint angles (rad), and the wall's unit normal, which points out of the wall.
    let plant = Linearised::at(&device.description, &[2.6, 1.75], &[0.6, 0.8])?;
    let control_loop = Loop {
        rate_hz: 20_000.0,
        delay_samples: 0.5,
        estimator: LinearEstimator::Butterworth(500.0),
        drive: Drive::Ideal,
        damping_compensation: false,
    };
    let range = predict(&plant, &control_loop, Some(&[5.0, 20.0, 80.0]), None)?;
    println!(
        "inertia at the wall: {:.1} g without the feed-forward, {:.1} g with it",
        1e3 * range.w_eff,
        1e3 * range.w_rr
    );
    for (off, full) in range.off.boundary.iter().zip(&range.full.boundary) {
        println!(
            "damping {:3} N s/m: up to {:6.0} N/m without, {:6.0} N/m with the feed-forward",
            off.kd, off.kp, full.kp
        );
    }
    Ok(())
}
