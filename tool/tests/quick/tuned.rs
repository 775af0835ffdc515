//! `haptic tune` and `haptic tune estimators` on random devices (more in deep/tune/settings.rs) and compliant joints.

use crate::common::prelude::*;
use crate::common::tuned::{question, random_device, tune_and_check};
use crate::common::{Folder, json, read, run, shipped_device, type_lines};
use haptic_bridge::render::velocity::Estimator;
use haptic_host::error::Failure;
use haptic_predict::bench::estimators::{Comparison, compare, comparison_wall};
use haptic_predict::bench::wall::{RenderedWall, WallSimulation};
use haptic_predict::tune::{MAX_REBOUNDS, Margins, Question, Settings, accepted_wall, ripple, tune};
use std::collections::BTreeSet;
use std::sync::atomic::{AtomicUsize, Ordering};

fn estimator_of(name: &str) -> Estimator {
    Estimator::ALL.iter().find(|(other, _)| *other == name).unwrap().1
}

/// Returns the file of the coupled-five-bar with cables and with its encoders on this side of the cables.
fn with_cables(encoder_at: &str) -> String {
    let text = read("devices/coupled-five-bar.toml");
    let cable = format!("[joint.transmission]\nstiffness = 250.0\ndamping = 0.01\nencoder_at = \"{encoder_at}\"\n");
    text.replace("transmission = \"rigid\"\n", "").replace("[joint.encoder]", &format!("{cable}\n[joint.encoder]"))
}

fn wall(kind: Estimator, cutoff_hz: f64, (stiffness, damping): (f64, f64)) -> Settings {
    Settings {
        rate_hz: 5_000.0,
        kind,
        estimator: kind.name(),
        value: kind.chosen().map_or(0, |chosen| chosen.value),
        cutoff_hz,
        feed_forward: FeedForward::Off,
        washout_hz: 2.0,
        damping_compensation: false,
        stiffness,
        damping,
    }
}

#[test]
fn a_wall_behind_cables_depends_on_the_encoders_side() {
    let of = |side: &str| {
        let file = DeviceFile::parse(&with_cables(side), side).unwrap();
        ripple(&question(&file, 5_000.0), &wall(estimator_of("butterworth"), 200.0, (5_000.0, 20.0))).unwrap().ripple_n
    };
    let (motor, joint) = (of("motor"), of("joint"));
    assert!(motor.is_some_and(|ripple| ripple < 0.5), "{motor:?}");
    assert!(joint.is_none_or(|ripple| ripple > 2.0), "theory has no stable wall for encoders at the joints: {joint:?}");
}

#[test]
fn estimators_are_compared_on_a_wall_that_range_finds_stable() {
    let folder = Folder::new();
    let path = folder.write("cables.toml", with_cables("motor"));
    let file = DeviceFile::load(&path).unwrap();
    assert!(file.description.joints[0].transmission.is_some_and(|cable| cable.encoder_at == EncoderAt::Motor));
    let (stiffness, damping) = comparison_wall(&file, &[2.6, 1.75], &[0.6, 0.8], 5_000.0, 200.0).unwrap();
    let words = ["--q", "2.6,1.75", "--normal", "0.6,0.8", "--rate", "5000", "--cutoff", "200", "--board", "odrive-v3"];
    let kd = damping.to_string();
    let report = json(&[&["range", &path, "--kd", &kd], &words[..]].concat());
    let max_stiffness = report["off"]["boundary"][0]["kp"].as_f64().unwrap();
    assert!((4.0 * stiffness / max_stiffness - 1.0).abs() < 1e-9, "{stiffness} of {max_stiffness} N/m");
    assert!((2.0 * damping / report["off"]["kd_max"].as_f64().unwrap() - 1.0).abs() < 1e-9, "{damping} N s/m");
    let soft_cable = "stiffness = 40.0\ndamping = 0.0";
    let text = with_cables("joint").replace("stiffness = 250.0\ndamping = 0.01", soft_cable);
    folder.write("cables.toml", text.replace("viscous = 0.001", "viscous = 0.0"));
    let line = format!("tune estimators {path} --normal 0.6,0.8 --rate 5000 --cutoff 200");
    type_lines(&format!("1: {line} => no wall here is predicted stable | (--wall)"), &[]);
}

fn check_small_search(number: u64, estimator: &str, dampings: &[f64]) {
    let file = random_device(number);
    let question = Question { estimators: vec![estimator_of(estimator)], ..question(&file, 5_000.0) };
    let (found, tried) = tune_and_check(&question, dampings, &[1.06]);
    assert!(tried >= 5, "{tried}");
    // The result must also meet the ripple limit on devices that differ from their file by the margins.
    for (share, loose) in [(0.9, 0.97), (1.1, 1.03)] {
        let mut other_file = file.clone();
        for joint in &mut other_file.description.joints {
            joint.inertia *= share;
            joint.viscous *= 1.0 + 2.5 * (share - 1.0);
            joint.coulomb *= 1.0 + 2.5 * (share - 1.0);
            if let Some(encoder) = &mut joint.encoder {
                encoder.counts_per_turn *= loose;
            }
            if let Some(transmission) = &mut joint.transmission {
                transmission.motor_inertia *= share;
            }
        }
        let off = Question { file: &other_file, margins: Margins::NONE, ..question.clone() };
        let ripple_n = ripple(&off, &found.settings).unwrap().ripple_n;
        let ripple_limit = 0.1_f64.min(1.0001 * found.ripple_n);
        assert!(ripple_n.is_some_and(|ripple| ripple <= ripple_limit), "{ripple_n:?} {found:?}");
    }
}

#[test]
fn no_wall_on_a_rigid_device_is_stiffer_than_the_result() {
    check_small_search(0, "first-order", &[0.6, 1.0, 1.7]);
}

#[test]
fn no_wall_on_a_cable_device_is_stiffer_than_the_result() {
    check_small_search(5, "backward-difference", &[0.5, 0.7, 1.0, 1.4, 2.0]);
}

/// Counts how often a mass that a hand pushes leaves a wall, a spring and damper that cannot pull.
fn count_rebounds(mass: f64, stiffness: f64, damping: f64) -> usize {
    let (mut x, mut v, mut inside, mut left) = (0.0, -0.2, false, 0);
    let h = 1e-6;
    for _ in 0..300_000 {
        let wall = if x < 0.0 { (-stiffness * x - damping * v).max(0.0) } else { 0.0 };
        v += h / mass * (wall - 3.0 - 200.0 * x - 3.0 * v);
        x += h * v;
        left += usize::from(inside && x > 0.0);
        inside = x < 0.0;
    }
    left
}

#[test]
fn taps_rebound_like_a_mass_on_a_spring() {
    let mut file = shipped_device("hapkit-paddle");
    for joint in &mut file.description.joints {
        (joint.viscous, joint.coulomb) = (0.0, 0.0);
        joint.encoder.iter_mut().for_each(|encoder| encoder.counts_per_turn = 1e7);
    }
    let mass = 0.0008 / (0.07 * 0.07) + 0.05;
    let question = Question { speed: 0.01, ..question(&file, 20_000.0) };
    let simulation = WallSimulation::new(&file.description, &file.description, &[0.0], &[1.0], 20_000.0).unwrap();
    let mut counts = BTreeSet::new();
    for stiffness in [2_000.0_f64, 10_000.0] {
        for ratio in [0.02, 0.06, 0.13, 0.3, 0.8] {
            let damping = 2.0 * ratio * (stiffness * mass).sqrt();
            let kind = estimator_of("backward-difference");
            let wall = Settings { rate_hz: 20_000.0, ..wall(kind, 500.0, (stiffness, damping)) };
            let (found, known) = (
                simulation.rebounds(&rendered_wall(&wall)).unwrap().unwrap(),
                count_rebounds(mass, stiffness, damping),
            );
            // The delay of half a carrier period reduces a small damping, so many rebounds may differ by one.
            let near = found.abs_diff(known) <= usize::from(known > 2);
            assert!(near, "{stiffness} N/m at {ratio} of critical damping: {found}, not {known}");
            let keeps = accepted_wall(&question, &wall).unwrap().is_some();
            assert_eq!(keeps, known <= MAX_REBOUNDS, "{known} rebounds: {wall:?}");
            counts.insert(known);
        }
    }
    assert!(counts.contains(&0) && counts.contains(&1) && counts.len() > 3, "{counts:?}");
}

fn rendered_wall(wall: &Settings) -> RenderedWall {
    RenderedWall {
        kind: wall.kind,
        cutoff_hz: wall.cutoff_hz,
        feed_forward: wall.feed_forward,
        washout_hz: wall.washout_hz,
        damping_compensation: wall.damping_compensation,
        admissible: Admissible::default(),
        stiffness: wall.stiffness,
        damping: wall.damping,
    }
}

/// The stop flag is checked after every press or curve, so a stopped search ends within its first candidates.
#[test]
fn long_searches_end_at_the_next_press_after_ctrl_c() {
    let file = random_device(0);
    let question = Question { estimators: vec![estimator_of("first-order")], ..question(&file, 5_000.0) };
    let comparison =
        Comparison { file: &file, q: &[0.0], normal: &[1.0], rate_hz: 1_000.0, cutoff_hz: 50.0, wall: (100.0, 1.0) };
    let run_sweep = |work: &dyn Fn(&Sweep) -> Option<Failure>| {
        let looked = AtomicUsize::new(0);
        let stop = move || looked.fetch_add(1, Ordering::SeqCst) >= 75;
        work(&Sweep::new("test", "question", None, stop).unwrap()).unwrap().to_string()
    };
    let failure = run_sweep(&|sweep| tune(&question, sweep).err());
    assert!(failure.contains("interrupted with 0 of 7 done (ripple, feed-forward off, round 1)"), "{failure}");
    let failure = run_sweep(&|sweep| compare(&comparison, sweep).err());
    assert!(failure.contains("interrupted with 0 of"), "{failure}");
}

#[test]
fn every_stage_is_reported_without_a_terminal() {
    let words = ["tune", "devices/hapkit-paddle.toml", "--normal", "1", "--rates", "1000", "--feed-forward", "off"];
    let (_, _, stages) = run(&[&words[..], &["--json"]].concat());
    for stage in ["walls, feed-forward off: ", "ripple, feed-forward off, round 1: ", "stiffer, round 1: "] {
        assert!(stages.lines().any(|line| line.starts_with(stage)), "{stage}\n{stages}");
    }
}
