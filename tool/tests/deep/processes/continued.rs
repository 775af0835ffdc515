//! Long computations that are interrupted anywhere continue from their file to the same result, bit for bit.

use crate::common::prelude::*;
use crate::common::sim::wait_until;
use crate::common::tuned::question;
use crate::common::{haptic, ideal_loop, send_signal, shipped_device, shipped_path};
use haptic_host::error::Failure;
use haptic_predict::bench::estimators::{Comparison, compare};
use haptic_predict::design::place::places;
use haptic_predict::ripple::{LIGHT_HAND, PUSH_N, PressedWall};
use haptic_predict::tune::{Question, tune};
use haptic_stability::analysis::flexible::Hand;
use haptic_stability::analysis::line::DampingRule;
use haptic_stability::analysis::map::map_swept;
use haptic_stability::analysis::why::explain_boundary;
use std::fmt::Debug;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Compares an uninterrupted computation with one that is interrupted at least `at_least` times.
fn check_interrupted<R: Debug>(at_least: usize, step: usize, ask: impl Fn(&Sweep) -> Result<R, Failure>) {
    // `Debug` prints numbers exactly.
    let uninterrupted = format!("{:?}", ask(&Sweep::quiet()).unwrap());
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("kept.json");
    for run in 0.. {
        assert!(run < 1_000, "no progress between interruptions");
        let looked = Arc::new(AtomicUsize::new(0));
        let stop = move || looked.fetch_add(1, Ordering::SeqCst) >= step;
        let sweep = Sweep::new("test", "question", Some(&path), stop).unwrap();
        match ask(&sweep) {
            Ok(answer) => {
                assert!(run >= at_least, "interrupted {run} times");
                return assert_eq!(format!("{answer:?}"), uninterrupted);
            }
            Err(failure) => assert!(failure.to_string().contains("interrupted"), "{failure}"),
        }
    }
}

#[test]
fn an_interrupted_map_continues() {
    let arm = shipped_device("serial-3r");
    check_interrupted(3, 20, |sweep| map_swept(&arm.description, &[0.6, 0.8], 20_000, Admissible::default(), sweep));
}

#[test]
fn an_interrupted_comparison_continues() {
    let file = shipped_device("hapkit-paddle");
    let comparison =
        Comparison { file: &file, q: &[0.1], normal: &[1.0], rate_hz: 1_000.0, cutoff_hz: 50.0, wall: (100.0, 1.0) };
    check_interrupted(2, 900, |sweep| compare(&comparison, sweep));
}

#[test]
fn an_interrupted_search_for_places_continues() {
    let file = shipped_device("haply-2diy");
    check_interrupted(2, 6, |sweep| {
        places(&file.description, Some(&[0.6, 0.8]), 0.0, 0.4, 300, Admissible::default(), sweep)
    });
}

#[test]
fn an_interrupted_search_for_settings_continues() {
    let file = shipped_device("hapkit-paddle");
    let question = Question { q: vec![0.1], board_ripple_n: Some(0.1), ..question(&file, 1_000.0) };
    check_interrupted(1, 1_000, |sweep| tune(&question, sweep));
}

#[test]
fn an_interrupted_range_continues() {
    let file = shipped_device("coupled-five-bar");
    let (q, normal) = (vec![2.6, 1.75], vec![0.6, 0.8]);
    let hand = Hand { mass: 0.1, damping: 3.0, stiffness: 200.0 };
    let device = Linearised::at(&file.description, &q, &normal).unwrap().with_hand(hand);
    let ideal = ideal_loop(1_000.0, 0.5, LinearEstimator::Butterworth(100.0));
    let around = Loop { drive: Drive::Current { bandwidth_hz: 500.0 }, ..ideal };
    check_interrupted(2, 12, |sweep| explain_boundary(&device, &around, sweep));
    let description = file.description;
    let (hand, push_n) = (LIGHT_HAND, PUSH_N);
    let press = PressedWall { device: &device, description, q, normal, around: &around, hand, push_n };
    check_interrupted(2, 12, |sweep| press.ripple_line(Mode::Full, DampingRule::Ratio(0.7), 0.1, sweep));
}

#[cfg(unix)]
#[test]
fn ctrl_c_stops_a_command_and_the_same_line_continues_it() {
    use std::process::Stdio;
    let folder = tempfile::tempdir().unwrap();
    let map_path = folder.path().join("map.json");
    let device = shipped_path("coupled-five-bar.toml");
    let line = ["map", &device, "--normal", "0.6,0.8", "--points", "400000", "--json"];
    let uninterrupted = haptic(&line).output().unwrap().stdout;
    let line = [&line[..], &["--continue", map_path.to_str().unwrap()]].concat();
    let mut command = std::process::Command::new(assert_cmd::cargo::cargo_bin("haptic"));
    let mut child = command.args(&line).stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
    wait_until("the file", || map_path.exists());
    send_signal(&child, "INT");
    let mut text = String::new();
    std::io::Read::read_to_string(&mut child.stderr.take().unwrap(), &mut text).unwrap();
    assert_eq!(child.wait().unwrap().code(), Some(1), "{text}");
    assert!(text.contains("interrupted with") && text.contains("--continue"), "{text}");
    let other_line = [&line[..4], &["--points", "400001"], &line[6..]].concat();
    let message = String::from_utf8(haptic(&other_line).assert().get_output().stderr.clone()).unwrap();
    if !text.contains("interrupted with 0 of") {
        assert!(message.contains("holds results of `haptic map`"), "{message}");
    }
    let rerun = haptic(&line).output().unwrap();
    assert!(rerun.status.success() && rerun.stdout == uninterrupted, "{}", String::from_utf8_lossy(&rerun.stderr));
    assert!(!map_path.exists());
}
