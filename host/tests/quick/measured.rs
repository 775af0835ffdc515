//! What a device file says is measured before a board arms: files, wires and sensors that lie.

use crate::common::lies::{LIES, Lie, When, refused};
use crate::common::{all_shipped, shipped};
use haptic_bridge::safety::fault::Fault;

#[test]
fn every_shipped_device_passes_as_its_file_says() {
    for file in all_shipped() {
        let nothing = Lie { what: "nothing", when: When::Always(|_, _| ()) };
        assert_eq!(refused(&file, &nothing), Ok(()), "{}", file.name);
    }
}

/// The faults that say that something is not as the file has it.
const SAYING: [Fault; 7] = [
    Fault::TorqueMismatch,
    Fault::ResistanceMismatch,
    Fault::PolarityWrong,
    Fault::PolarityNoMotion,
    Fault::MotorModel,
    Fault::EncoderLoss,
    Fault::SpeedLimit,
];

#[test]
fn a_board_does_not_arm_with_a_device_that_is_not_its_files() {
    let must = [
        "torque constant twice the file's",
        "torque constant half the file's",
        "a gear of 10 that the file forgets",
        "counts per line instead of per edge",
        "counts per edge instead of per line",
        "first two motors swapped",
        "current sensors show 45 %",
        "current sensors show two thirds",
        "first current sensor shows two thirds",
        "current sensors show 150 %",
    ];
    let lies: Vec<_> = LIES.iter().filter(|lie| must.contains(&lie.what)).collect();
    assert_eq!(lies.len(), must.len());
    let mut missed = Vec::new();
    for name in ["coupled-five-bar", "hapkit-paddle", "pantograph-mk2", "woodenhaptics"] {
        let file = shipped(name);
        for lie in &lies {
            // A paddle has one motor.
            if lie.what.contains("first two") && file.spec().joints < 2 {
                continue;
            }
            let ended = refused(&file, lie);
            if !ended.is_err_and(|record| SAYING.contains(&record.fault)) {
                missed.push(format!("{name}: {}: {ended:?}", lie.what));
            }
        }
    }
    assert!(missed.is_empty(), "{}", missed.join("\n"));
}
