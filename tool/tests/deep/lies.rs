//! Reactions of a board to wrong device files, wires and sensors, as listed in docs/results/lies.csv.

use crate::common::drawn::{CheckResult, check_correct_device, check_mismatched_device};
use crate::common::forces::runs_beyond_limit;
use crate::common::injected::{INJECTED_ERRORS, InjectedError, Injection, Outcome, needs_phases, outcome};
use crate::common::{document, shipped_device};
use haptic_bridge::model::motor::Winding;
use haptic_bridge::safety::limits::GENTLE_FORCE;
use haptic_host::device_file::DeviceFile;
use haptic_host::output::csv_line;

const DEVICES: [&str; 5] = ["coupled-five-bar", "hapkit-paddle", "pantograph-mk2", "woodenhaptics", "gimbal-five-bar"];

/// Returns the table cell for one injected error on one device.
fn outcome_cell(file: &DeviceFile, error: &InjectedError) -> String {
    let is_brushed = file.description.joints[0].motor.is_none_or(|motor| motor.winding == Winding::Brushed);
    // A paddle has only one joint.
    if error.what.contains("first two") && file.spec().joints < 2 || needs_phases(error) && is_brushed {
        return String::new();
    }
    match outcome(file, error) {
        Outcome::Refused(record) => format!("check: {}", record.fault.name()),
        Outcome::Detected(record, after, harm) if harm.push > 0.0 => {
            format!("{:.2} ms: {}; {:.1} N, {:.1} rad/s", after * 1e3, record.fault.name(), harm.push, harm.speed)
        }
        Outcome::Detected(record, after, _) => format!("{:.2} ms: {}", after * 1e3, record.fault.name()),
        Outcome::Missed(harm) => format!("no: {:.1} N, {:.1} A, {:.1} rad/s", harm.push, harm.current, harm.speed),
    }
}

/// `UPDATE_DOCS=1 cargo xtask test --deep lies` updates the table.
#[test]
fn the_table_holds_the_outcome_of_every_injected_error() {
    let row = |what: &str, cells: [String; DEVICES.len()]| csv_line(std::iter::once(what.into()).chain(cells));
    let mut made = row("what is wrong", DEVICES.map(String::from));
    let nothing = InjectedError { what: "nothing", injection: Injection::Always(|_, _| ()) };
    for error in std::iter::once(&nothing).chain(&INJECTED_ERRORS) {
        made += &row(error.what, DEVICES.map(|name| outcome_cell(&shipped_device(name), error)));
    }
    let published = document("docs/results/lies.csv", &made);
    assert_eq!(published, made, "run UPDATE_DOCS=1 cargo xtask test --deep lies");
}

/// Checks that at most `permille` of 1,000 checks exceed a bound; docs/safety.md lists the shares.
fn assert_rarely_beyond(checked: &[CheckResult], permille: usize, beyond: impl Fn(&CheckResult) -> bool) {
    let beyond: Vec<_> = checked.iter().filter(|checked| beyond(checked)).map(ToString::to_string).collect();
    println!("{} of {}:\n{}", beyond.len(), checked.len(), beyond.join("\n"));
    assert!(1000 * beyond.len() <= permille * checked.len());
}

/// Returns the number of checks: HAPTIC_CHECKS, by default `most`.
fn number_of_checks(most: u64) -> u64 {
    std::env::var("HAPTIC_CHECKS").ok().and_then(|text| text.parse().ok()).unwrap_or(most)
}

#[test]
fn a_check_with_a_wrong_file_pushes_no_harder_than_a_finger() {
    let outcomes: Vec<_> = (0..number_of_checks(500)).map(check_mismatched_device).collect();
    let most = |of: fn(&CheckResult) -> f64| outcomes.iter().map(of).fold(0.0, f64::max);
    println!("most: {:.2} N, {:.3} rad", most(|it| it.motion.push), most(|it| it.motion.travel));
    assert_rarely_beyond(&outcomes, 12, |outcome| outcome.motion.push > 5.0 || outcome.motion.travel > 0.15);
}

#[test]
fn a_correct_device_passes_its_check() {
    let outcomes: Vec<_> = (10_000..10_000 + number_of_checks(300)).map(check_correct_device).collect();
    assert_rarely_beyond(&outcomes, 90, |outcome| outcome.result.is_err());
}

/// Runs new random scenes and motions, HAPTIC_SEQUENCES for each device (default 20).
#[test]
fn no_shipped_device_pushes_harder_than_its_limit_allows() {
    let count = std::env::var("HAPTIC_SEQUENCES").ok().and_then(|text| text.parse().ok()).unwrap_or(20);
    let first = std::time::UNIX_EPOCH.elapsed().map_or(0, |since| since.as_secs()) << 20;
    println!("seeds from {first}");
    let failed_runs = runs_beyond_limit(first..first + count);
    assert!(failed_runs.is_empty(), "{}", failed_runs.join("\n"));
}

/// Breaks a three-phase motor, its sensors or its encoder 1,000 times while a hand presses a wall.
#[test]
fn a_broken_three_phase_motor_pushes_at_most_half_harder_than_its_limit() {
    let devices = ["gimbal-paddle", "gimbal-five-bar"].map(shipped_device);
    let (mut most, mut fastest, mut detected, mut beyond) = (0.0_f64, 0.0_f64, 0, Vec::new());
    let count = number_of_checks(1_000);
    for seed in 0..count {
        let file = &devices[seed as usize % devices.len()];
        let error = InjectedError { what: "drawn", injection: Injection::DrawnInContact(seed) };
        let harm = match outcome(file, &error) {
            Outcome::Detected(_, _, harm) => {
                detected += 1;
                harm
            }
            Outcome::Missed(harm) => {
                fastest = fastest.max(harm.speed);
                harm
            }
            Outcome::Refused(record) => panic!("{seed}: {record:?}"),
        };
        most = most.max(harm.push);
        if harm.push > 1.5 * f64::from(GENTLE_FORCE) {
            beyond.push(format!("{} seed {seed}: {:.2} N", file.name, harm.push));
        }
    }
    println!("most: {most:.2} N; motors off in {detected} of {count}, in the others at most {fastest:.1} rad/s");
    assert!(beyond.is_empty(), "{}", beyond.join("\n"));
    assert!(fastest < 12.0, "{fastest} rad/s");
}
