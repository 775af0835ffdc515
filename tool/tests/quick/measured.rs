//! Before a board arms, it measures its device and so detects wrong device files, wires and sensors.

use crate::common::drawn::check_mismatched_device;
use crate::common::injected::{
    INJECTED_ERRORS, InjectedError, Injection, Outcome, check_fault, measure_check, outcome, scale_counts_per_turn,
};
use crate::common::{all_shipped_devices, shipped_device};
use haptic_bridge::model::description::Description;
use haptic_bridge::safety::fault::Fault;
use haptic_bridge::safety::limits::GENTLE_FORCE;

#[test]
fn every_shipped_device_passes_its_check() {
    for file in all_shipped_devices() {
        let nothing = InjectedError { what: "nothing", injection: Injection::Always(|_, _| ()) };
        assert_eq!(check_fault(&file, &nothing), Ok(()), "{}", file.name);
    }
}

/// A slide's check begins with a twentieth of a newton, and stops at 0.1 rad times its lever.
#[test]
fn the_check_of_a_slide_is_gentle_and_finds_a_reversed_motor() {
    let file = shipped_device("fader");
    for what in ["nothing", "leads of the first motor swapped"] {
        let nothing = InjectedError { what: "nothing", injection: Injection::Always(|_, _| ()) };
        let error = INJECTED_ERRORS.iter().find(|error| error.what == what).unwrap_or(&nothing);
        let (result, motion) = measure_check(&file, error);
        let fault = result.err().map(|record| record.fault);
        // The back-EMF of a reversed motor may show before the wrong motion does.
        let is_right = match what {
            "nothing" => fault.is_none(),
            _ => matches!(fault, Some(Fault::PolarityWrong | Fault::MotorModel)),
        };
        assert!(is_right, "{what}: {fault:?}");
        // A computation of the check alone gives 1.6 N, of which friction takes 0.4 N, and 8.01 mm.
        assert!(motion.push < 2.0 && motion.travel < 0.0085, "{what}: {motion:?}");
    }
}

/// Faults that mean that the device differs from its file.
const MISMATCH_FAULTS: [Fault; 7] = [
    Fault::TorqueMismatch,
    Fault::ResistanceMismatch,
    Fault::PolarityWrong,
    Fault::PolarityNoMotion,
    Fault::MotorModel,
    Fault::EncoderLoss,
    Fault::SpeedLimit,
];

#[test]
fn a_board_does_not_arm_if_the_device_differs_from_its_file() {
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
    let errors: Vec<_> = INJECTED_ERRORS.iter().filter(|error| must.contains(&error.what)).collect();
    assert_eq!(errors.len(), must.len());
    let mut missed = Vec::new();
    for name in ["coupled-five-bar", "hapkit-paddle", "pantograph-mk2", "woodenhaptics"] {
        let file = shipped_device(name);
        for error in &errors {
            // A paddle has only one motor.
            if error.what.contains("first two") && file.spec().joints < 2 {
                continue;
            }
            let result = check_fault(&file, error);
            if !result.is_err_and(|record| MISMATCH_FAULTS.contains(&record.fault)) {
                missed.push(format!("{name}: {}: {result:?}", error.what));
            }
        }
    }
    assert!(missed.is_empty(), "{}", missed.join("\n"));
}

#[test]
fn a_check_with_ten_times_the_counts_stops_near_its_start() {
    let error = InjectedError {
        what: "a tenth of the file's counts",
        injection: Injection::Always(|wired, _| scale_counts_per_turn(wired, 0.1)),
    };
    let mut mistakes = Vec::new();
    for name in ["hapkit-paddle", "pantograph-mk2", "woodenhaptics"] {
        let (result, motion) = measure_check(&shipped_device(name), &error);
        if !result.is_err_and(|record| MISMATCH_FAULTS.contains(&record.fault)) || motion.travel > 0.2 {
            mistakes.push(format!("{name}: {result:?}, {motion:?}"));
        }
    }
    assert!(mistakes.is_empty(), "{}", mistakes.join("\n"));
}

#[test]
fn checks_0_2_rad_off_home_push_at_most_1_2_times_the_limit() {
    let file = shipped_device("capstan-pantograph");
    let homed_off =
        |error| measure_check(&file, &InjectedError { what: "not at home", injection: Injection::Always(error) });
    let push_cases = [
        homed_off(|wired, _| displace_home(wired, [0.2, 0.0])),
        homed_off(|wired, _| displace_home(wired, [0.0, -0.2])),
        homed_off(|wired, _| displace_home(wired, [0.1, -0.1])),
        homed_off(|wired, _| displace_home(wired, [-0.2, 0.0])),
    ];
    for (result, motion) in push_cases {
        // From 0.2 rad off home the check stretches the linkage to its stop, where a torque causes the largest force.
        assert!(motion.push > 1.0 && motion.push < 1.2 * f64::from(GENTLE_FORCE), "{result:?}, {motion:?}");
    }
}

/// Displaces a device from home by these angles, rad.
fn displace_home(wired: &mut Description, off: [f64; 2]) {
    let home = wired.home.iter_mut().flatten();
    home.zip(off).for_each(|(home, off)| *home += off);
}

/// The deep part `lies` runs more checks.
#[test]
fn a_few_random_checks_push_no_harder_than_a_finger() {
    for seed in 0..12 {
        let outcome = check_mismatched_device(seed);
        assert!(outcome.motion.push < 5.0 && outcome.motion.travel < 0.15 && outcome.result.is_err(), "{outcome}");
    }
}

/// With this motor an error of 1 V causes a force of 11 N.
#[test]
fn a_failing_sensor_pushes_no_harder_than_its_bound() {
    let mut file = shipped_device("hapkit-paddle");
    let motor = file.description.joints[0].motor.as_mut().unwrap();
    (motor.torque_constant, motor.back_emf, motor.resistance, motor.max_current) = (1.9, 1.9, 2.33, 2.0);
    for what in
        ["first current sensor freezes", "current sensors begin to show half", "first current sensor 0.5 A too low"]
    {
        let error = INJECTED_ERRORS.iter().find(|error| error.what == what).unwrap();
        let harm = match outcome(&file, error) {
            Outcome::Refused(record) => panic!("{what}: {record:?}"),
            Outcome::Detected(_, _, harm) | Outcome::Missed(harm) => harm,
        };
        assert!(harm.push < 1.7 * f64::from(GENTLE_FORCE), "{what}: {harm:?}");
    }
}
