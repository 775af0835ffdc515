//! The highest stable stiffness, found by raising it on the simulated board until the loop oscillates.
//!
//! Friction, hand and encoder steps are left out and the drive is ideal, as in the linear theory, because they raise or
//! lower the limit and would make the comparison with the theory meaningless.

use super::{Demo, DemoError};
use haptic_bridge::render::scene::FeedForward;
use haptic_host::link::Board;
use haptic_predict::measure::{Law, MeasurementSetup, PreparedBoard};
use haptic_sim::{BoardOptions, DriveModel, Options, SharedBoard, ready_board};
use haptic_stability::analysis::control_loop::TorquePath;
use haptic_stability::analysis::plant::Drive;
use haptic_stability::analysis::pose::PoseError;
use haptic_stability::analysis::prediction::{Prediction, Subject};
use haptic_stability::analysis::range::domain;
use haptic_stability::analysis::sampled::{LinearEstimator, Loop, Mode};
use haptic_stability::analysis::several::Member;

/// Measured and predicted limit, N/m.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StiffnessLimit {
    /// Stiffness at which the simulated board began to oscillate.
    pub measured: f64,
    /// Stiffness at which the theory predicts oscillation.
    pub predicted: f64,
    /// Delay that the board reports and the theory uses, control samples.
    pub delay_samples: f64,
}

/// Measures and predicts the largest stable stiffness at the demo's damping.
pub fn stiffness_limit(demo: &Demo, feed_forward: FeedForward) -> Result<StiffnessLimit, DemoError> {
    let mut demo = demo.clone();
    for joint in &mut demo.file.description.joints {
        if let Some(encoder) = &mut joint.encoder {
            encoder.counts_per_turn = f64::from(1 << 23);
        }
    }
    let device =
        Options { friction: false, start: Some(demo.pose), substep: 0.02 / demo.rate_hz, ..Options::default() };
    let options = BoardOptions { device, drive: DriveModel::Ideal, ..BoardOptions::default() };
    let shared = SharedBoard::new(ready_board(&demo.file, options)?);
    let mut board = Board::over(shared.wire(), "sim")?;
    let setup = MeasurementSetup {
        walls: vec![Member::new(demo.normal.to_vec(), 1.0)],
        rate_hz: demo.rate_hz,
        cutoff_hz: demo.cutoff_hz,
        washout_hz: demo.washout_hz,
        law: Law::default(),
        torque_limit: 2.0,
        largest_pull: 1e-3,
    };
    let mut prepared = PreparedBoard::new(&mut board, &demo.file, setup, &|| false)?;
    let measured = prepared.boundary(feed_forward, demo.damping, 1.0, None)?.gain;
    // The prediction uses the delay that the board reports while it runs at the demo's rate.
    let delay_samples = f64::from(prepared.board().details()?.delay_samples);
    prepared.finish()?;
    Ok(StiffnessLimit { measured, predicted: predict_limit(&demo, feed_forward, delay_samples)?, delay_samples })
}

fn predict_limit(demo: &Demo, feed_forward: FeedForward, delay_samples: f64) -> Result<f64, DemoError> {
    let path = TorquePath { delay_samples, drive: Drive::Ideal };
    let control_loop = Loop::with_torque_path(&path, demo.rate_hz, LinearEstimator::Butterworth(demo.cutoff_hz));
    let subject = Subject::new(&demo.file.description).map_err(PoseError::from)?.undamped();
    let device = Prediction::new(subject, control_loop.clone()).linearise(demo.q(), &demo.normal)?;
    let mode = Mode::of(feed_forward, demo.washout_hz);
    let boundary = domain(&device, &control_loop, mode, Some(&[demo.damping]))?.boundary;
    Ok(boundary.first().map_or(0.0, |point| point.kp))
}
