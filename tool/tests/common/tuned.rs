//! Random devices, and a grid search over walls that checks the results of `haptic tune`.

use super::prelude::*;
use super::shipped_device;
use haptic_bridge::render::velocity::{Chosen, CutoffMeaning, Estimator};
use haptic_predict::tune::{Margins, Question, Settings, TunedWall, accepted_wall, estimators, tune};
use std::f64::consts::TAU;

/// Returns a shipped device with random inertias, friction and counts. Devices with odd numbers have cables.
pub fn random_device(number: u64) -> DeviceFile {
    let mut random = Random::new(36 + number);
    let kinds = ["hapkit-paddle", "coupled-five-bar", "haply-2diy", "capstan-pantograph", "phantom-premium-1.5"];
    let mut file = shipped_device(kinds[number as usize % kinds.len()]);
    let mut about = |low: f64, high: f64| low * (high / low).powf(random.between(0.0, 1.0));
    let (joints, paddle) = (file.spec().joints, file.spec().are_links_optional);
    for link in &mut file.description.links {
        let factor = about(0.7, 1.5);
        (link.mass, link.inertia) = (factor * link.mass, factor * link.inertia);
    }
    for joint in &mut file.description.joints[..joints] {
        joint.inertia *= about(0.6, 1.8);
        joint.viscous *= about(0.3, 3.0);
        joint.coulomb *= about(0.3, 2.0);
        if let Some(encoder) = &mut joint.encoder {
            encoder.counts_per_turn = (encoder.counts_per_turn * about(0.5, 2.5)).round();
        }
        if number % 2 == 1 {
            let motor_inertia = if paddle { 0.3 } else { 1.0 } * joint.inertia;
            let stiffness = motor_inertia * (TAU * about(80.0, 300.0)).powi(2);
            let damping = 2.0 * about(0.01, 0.05) * (stiffness * motor_inertia).sqrt();
            joint.transmission = Some(Transmission { stiffness, damping, motor_inertia, encoder_at: EncoderAt::Motor });
        }
    }
    file
}

/// Returns a request for the stiffest wall at home, at one rate, with an arbitrary normal.
pub fn question(file: &DeviceFile, rate_hz: f64) -> Question<'_> {
    let spec = file.spec();
    Question {
        file,
        q: file.description.home.unwrap()[..spec.joints].to_vec(),
        normal: [&[1.0][..], &[0.6, 0.8], &[0.6, 0.8, 0.0]][spec.task - 1].to_vec(),
        admissible: Admissible::default(),
        margins: Margins::default(),
        ripple_n: 0.1,
        board_ripple_n: None,
        counts: 1.0,
        speed: 0.1,
        rates_hz: vec![rate_hz],
        estimators: estimators(),
        feed_forwards: vec![FeedForward::Off],
        known: None,
    }
}

/// Tunes a wall. Checks that no wall with `stiffer` times the stiffness and another estimator, cutoff or damping meets
/// the same limits. Returns the result and the number of walls checked.
pub fn tune_and_check(question: &Question<'_>, dampings: &[f64], stiffer: &[f64]) -> (TunedWall, usize) {
    let found = tune(question, &Sweep::quiet()).unwrap();
    let best = found.best.settings;
    assert_eq!(accepted_wall(question, &best).unwrap(), Some(found.best), "the result does not meet its own limits");
    let mut candidates: Vec<Settings> = Vec::new();
    let mut add = |kind: Estimator, cutoff_hz: f64| {
        let value = kind.chosen().map_or(0, |chosen| chosen.value);
        candidates.push(Settings { kind, estimator: kind.name(), value, cutoff_hz, ..best });
    };
    for &kind in &question.estimators {
        let cutoffs = [15.0, 35.0, 70.0, 140.0, 300.0, 700.0, 1500.0];
        let below = cutoffs.iter().filter(|hz| **hz <= 0.4 * best.rate_hz);
        match kind.spec() {
            Some(spec) if spec.cutoff == CutoffMeaning::LowPassAfter => [6, 12, 24]
                .iter()
                .for_each(|value| add(kind.with_options(Chosen { value: *value, filtered: false }), best.cutoff_hz)),
            None if kind == Estimator::BackwardDifference => add(kind, best.cutoff_hz),
            _ => below.for_each(|hz| add(kind, *hz)),
        }
    }
    let walls: Vec<Settings> = candidates
        .iter()
        .flat_map(|settings| dampings.iter().map(|share| Settings { damping: share * best.damping, ..*settings }))
        .flat_map(|wall| stiffer.iter().map(move |share| Settings { stiffness: share * best.stiffness, ..wall }))
        .collect();
    let swept =
        Sweep::quiet().map("grid", &walls, |wall| Ok(accepted_wall(question, wall)?.map(|_| format!("{wall:?}"))));
    let better_walls: Vec<String> = swept.unwrap().into_iter().flatten().collect();
    assert!(better_walls.is_empty(), "{}: {best:?} is softer than {}", question.file.name, better_walls.join("\n"));
    (found.best, walls.len())
}
