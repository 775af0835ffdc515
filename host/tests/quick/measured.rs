//! What a device file says is measured before a board arms: files, wires and sensors that lie.

use crate::common::{all_shipped, shipped};
use haptic::device_file::DeviceFile;
use haptic::link::Board;
use haptic::sim::{BoardOptions, SharedBoard, SimulatedBoard, Support};
use haptic_bridge::model::description::Description;
use haptic_bridge::safety::fault::{Fault, FaultRecord, State};
use haptic_bridge::servo::{HostAction, Rules};

/// How the polarity check of a board ends that was told `file`, whose device and wires are as `lie` makes them.
fn checked(file: &DeviceFile, lie: impl FnOnce(&mut Description, &mut BoardOptions)) -> Result<(), FaultRecord> {
    let mut told = file.description;
    let home = told.home.unwrap();
    for (joint, home) in told.joints.iter_mut().zip(home) {
        joint.motor.iter_mut().for_each(|motor| motor.verified = true);
        joint.limits = Some((home - 1.5, home + 1.5));
    }
    let mut wired = told;
    let mut options = BoardOptions { strict: true, support: Support::Held, ..BoardOptions::default() };
    lie(&mut wired, &mut options);
    let mut simulated = SimulatedBoard::new(&wired, options).unwrap();
    simulated.load(&file.name, &told, None).unwrap();
    let shared = SharedBoard::new(simulated);
    let mut board = Board::over(shared.wire(), "sim").unwrap();
    let rules = board.rules().unwrap();
    board.set_rules(&Rules { host_action: HostAction::Ignore, ..rules }).unwrap();
    board.home_at_rest().unwrap();
    board.check_polarity().unwrap();
    for _ in 0..600 {
        shared.lock().run(0.1);
        let status = shared.lock().status();
        match (status.state, status.polarity, status.fault) {
            (State::CheckingPolarity, ..) => {}
            (_, true, None) => return Ok(()),
            (_, _, Some(record)) => return Err(record),
            other => panic!("{}: {other:?}", file.name),
        }
    }
    panic!("{}: the check does not end", file.name);
}

/// The faults that say that something is not as the file has it.
fn is_seen(ended: Result<(), FaultRecord>) -> bool {
    let seen = [
        Fault::TorqueMismatch,
        Fault::ResistanceMismatch,
        Fault::PolarityWrong,
        Fault::PolarityNoMotion,
        Fault::MotorModel,
        Fault::EncoderLoss,
        Fault::SpeedLimit,
    ];
    ended.is_err_and(|record| seen.contains(&record.fault))
}

#[test]
fn every_shipped_device_passes_as_its_file_says() {
    for file in all_shipped() {
        assert_eq!(checked(&file, |_, _| ()), Ok(()), "{}", file.name);
    }
}

/// A lie, and what makes it true of device and wires.
type Lie = (&'static str, fn(&mut Description, &mut BoardOptions));

const LIES: [Lie; 10] = [
    ("the torque constant is twice the file's", |wired, _| constants(wired, 2.0)),
    ("a gear of 10 was forgotten", |wired, _| constants(wired, 10.0)),
    ("the torque constant is half the file's", |wired, _| constants(wired, 0.5)),
    ("the sensors show 45 %", |_, options| options.sensor_gain = [0.45; 3]),
    ("the sensors show two thirds", |_, options| options.sensor_gain = [0.67; 3]),
    ("a sensor shows two thirds", |_, options| options.sensor_gain[0] = 0.67),
    ("the sensors show half as much again", |_, options| options.sensor_gain = [1.5; 3]),
    ("counts per line instead of per edge", |wired, _| counts(wired, 4.0)),
    ("counts per edge instead of per line", |wired, _| counts(wired, 0.25)),
    ("the first two motors are swapped", |_, options| options.motors.swap(0, 1)),
];

fn constants(wired: &mut Description, factor: f64) {
    for motor in wired.joints.iter_mut().filter_map(|joint| joint.motor.as_mut()) {
        motor.torque_constant *= factor;
        motor.back_emf *= factor;
    }
}

fn counts(wired: &mut Description, factor: f64) {
    wired.joints.iter_mut().filter_map(|joint| joint.encoder.as_mut()).for_each(|it| it.counts_per_turn *= factor);
}

#[test]
fn a_board_does_not_arm_with_a_device_that_is_not_its_files() {
    let mut missed = Vec::new();
    for name in ["coupled-five-bar", "hapkit-paddle", "pantograph-mk2", "woodenhaptics"] {
        let file = shipped(name);
        for (what, lie) in LIES {
            // A paddle has one motor.
            if what.contains("swapped") && file.spec().joints < 2 {
                continue;
            }
            let ended = checked(&file, lie);
            if !is_seen(ended) {
                missed.push(format!("{name}: {what}: {ended:?}"));
            }
        }
    }
    assert!(missed.is_empty(), "{}", missed.join("\n"));
}
