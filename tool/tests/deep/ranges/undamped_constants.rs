//! The simulated board agrees with independent numbers. The boundary of an undamped loop depends only on kp T²/m and
//! kd T/m, and docs/model.md section 3 lists its largest values at delay 0.
//!
//! Gains are raised through the protocol until the board oscillates; friction, hand and encoder steps are off.

use crate::common::measurement;
use crate::common::prelude::*;
use haptic_predict::measure::{MeasurementSetup, PreparedBoard};

/// A paddle of 0.16 kg at 0.1 m without friction, with an encoder so fine that its steps have no effect.
const PADDLE_TOML: &str = r#"
name = "mass"
mechanism = "paddle"
gravity = [0.0]
[geometry]
length = 0.1
[[joint]]
inertia = 0.0016
[joint.encoder]
counts_per_turn = 8388608
offset = 0.0
inverted = false
[joint.motor]
torque_constant = 0.5
resistance = 2.0
max_current = 10.0
[home]
q = [0.0]
"#;
const MASS_KG: f64 = 0.16;

/// Measures the largest kp T²/m, at `share` of the largest damping, and the largest kd T/m.
fn measure(rate_hz: f64, cutoff_hz: f64, share: f64) -> (f64, f64) {
    let file = DeviceFile::parse(PADDLE_TOML, "mass.toml").unwrap();
    // One integration step per sample is exact for a constant inertia under a constant torque.
    let device = Options { friction: false, substep: 1.0 / rate_hz, ..Options::default() };
    let options = BoardOptions { device, drive: DriveModel::Ideal, delay: 0.0, ..BoardOptions::default() };
    let (_, mut board) = crate::common::board(&file, options);
    let setup = MeasurementSetup { torque_limit: 5.0, largest_pull: 1e-3, ..measurement(&[1.0], rate_hz, cutoff_hz) };
    let mut prepared = PreparedBoard::new(&mut board, &file, setup, &|| false).unwrap();
    let end = prepared.damping_end(FeedForward::Off).unwrap().gain;
    let summit = prepared.boundary(FeedForward::Off, share * end, 1.0, None).unwrap().gain;
    prepared.finish().unwrap();
    (summit / MASS_KG / rate_hz.powi(2), end / MASS_KG / rate_hz)
}

/// Largest relative difference: the search ends at a bracket of half a percent, and slow growth may be missed within a
/// trial. The constants have four digits.
const TOLERANCE: f64 = 0.004;

#[test]
fn measured_boundaries_have_the_known_constants() {
    for (rate, cutoff, share, known) in [
        (200.0, 20.0, 0.29, (0.08921, 0.5190)),
        (1_000.0, 20.0, 0.18, (0.008215, 0.1520)),
        (20_000.0, 500.0, 0.2, (0.01184, 0.1838)),
    ] {
        let (kp, kd) = measure(rate, cutoff, share);
        assert!((kp / known.0 - 1.0).abs() < TOLERANCE, "{rate} Hz: largest kp T²/m is {kp}, not {}", known.0);
        assert!((kd / known.1 - 1.0).abs() < TOLERANCE, "{rate} Hz: kd_max T/m is {kd}, not {}", known.1);
    }
}
