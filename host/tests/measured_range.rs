//! The stable range measured on the simulated board, through the protocol, agrees with the one predicted.
//!
//! Friction and hand are off, the drive is ideal and the encoders are fine: what is left is what the linear theory is
//! about.

use haptic::analysis::plant::{Drive, Linearised};
use haptic::analysis::range::domain;
use haptic::analysis::sampled::{self, Estimator, Loop};
use haptic::device_file::DeviceFile;
use haptic::link::Board;
use haptic::measure::{Bench, MeasureError, Setup};
use haptic::sim::{BoardOptions, DriveModel, Options, SHIPPED_DEVICE, SharedBoard, ready_board};
use haptic_bridge::render::scene::FeedForward;
use haptic_bridge::safety::fault::State;
use std::cell::Cell;

const POSE: [f64; 3] = [2.6, 1.75, 0.0];
const NORMAL: [f64; 2] = [0.6, 0.8];

fn file() -> DeviceFile {
    let mut file = DeviceFile::parse(SHIPPED_DEVICE, "coupled-five-bar.toml").unwrap();
    for joint in &mut file.description.joints[..2] {
        joint.encoder.as_mut().unwrap().counts_per_turn = f64::from(1 << 23);
    }
    file
}

fn board(file: &DeviceFile) -> SharedBoard {
    let device = Options { friction: false, start: Some(POSE), ..Options::default() };
    let options = BoardOptions { device, drive: DriveModel::Ideal, ..BoardOptions::default() };
    SharedBoard::new(ready_board(file, options).unwrap())
}

fn setup(rate_hz: f64, cutoff_hz: f64) -> Setup {
    Setup { normal: NORMAL.to_vec(), rate_hz, cutoff_hz, washout_hz: 2.0, torque_limit: 2.0, largest_pull: 3e-4 }
}

#[test]
fn the_measured_boundary_is_the_predicted_one() {
    let (rate_hz, cutoff) = (20_000.0, 500.0);
    let file = file();
    let device = Linearised::at(&file.description, &POSE[..2], &NORMAL).unwrap().undamped();
    let around = Loop {
        rate_hz,
        delay_samples: 0.5,
        estimator: Estimator::Butterworth(cutoff),
        drive: Drive::Ideal,
        damping_compensation: false,
    };
    let shared = board(&file);
    let mut board = Board::over(shared.wire(), "sim").unwrap();
    let mut bench = Bench::new(&mut board, &file, setup(rate_hz, cutoff), &|| false).unwrap();
    for (mode, theory) in
        [(FeedForward::Off, sampled::FeedForward::Off), (FeedForward::Full, sampled::FeedForward::Full)]
    {
        let kd_max = domain(&device, &around, theory, Some(&[])).unwrap().kd_max;
        for share in [0.3, 0.8] {
            let kd = share * kd_max;
            let predicted = domain(&device, &around, theory, Some(&[kd])).unwrap().boundary[0].kp;
            let measured = bench.boundary(mode, kd, 0, None).unwrap();
            assert!((measured / predicted - 1.0).abs() < 0.03, "{mode:?} at {kd}: {measured} is not {predicted}");
        }
    }
    bench.finish().unwrap();
    assert_eq!(board.status().unwrap().state, State::Disarmed);
}

#[test]
fn an_interrupted_measurement_leaves_the_motors_off() {
    let file = file();
    let shared = board(&file);
    let mut board = Board::over(shared.wire(), "sim").unwrap();
    let looks = Cell::new(0);
    let interrupted = || {
        looks.set(looks.get() + 1);
        looks.get() > 60
    };
    let stopped = Bench::new(&mut board, &file, setup(20_000.0, 500.0), &interrupted)
        .and_then(|mut bench| bench.boundary(FeedForward::Off, 100.0, 0, None));
    assert!(matches!(stopped, Err(MeasureError::Interrupted)));
    assert_eq!(board.status().unwrap().state, State::Disarmed);
    shared.lock().run(0.01);
    assert_eq!(shared.lock().device().torque(), [0.0; 3]);
}
