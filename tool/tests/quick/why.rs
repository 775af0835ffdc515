//! The share that an effect takes from a boundary is computed from the same loop without the effect.

use crate::common::prelude::*;
use crate::common::{ideal_loop, rigid_device, svg_number};
use haptic_show::plot::paper::Paper;
use haptic_show::plot::why::draw;
use haptic_stability::analysis::flexible::{Flexible, Hand};
use haptic_stability::analysis::why::{Limits, explain_boundary};
use haptic_stability::cores;
use std::hint::black_box;
use std::sync::atomic::{AtomicUsize, Ordering};

fn soft_device_in_hand() -> Linearised {
    let give = Transmission { stiffness: 3.0, damping: 5e-4, motor_inertia: 2e-5, encoder_at: EncoderAt::Motor };
    let flexible = Flexible {
        transmissions: vec![Some(give), None],
        hand: Hand { mass: 0.1, damping: 3.0, stiffness: 200.0 },
        tip: DMatrix::from_row_slice(1, 2, &[0.1, 0.06]),
        normal: DVector::from_vec(vec![1.0]),
        ..Flexible::default()
    };
    Linearised { flexible, ..rigid_device(&[3.0e-4, 4.0e-5, 4.0e-5, 1.1e-4], &[1e-3, 4e-4], &[0.1, 0.06], &[7.0, 5.0]) }
}

fn control_loop(bandwidth_hz: f64) -> Loop {
    let ideal = ideal_loop(1000.0, 0.5, LinearEstimator::Butterworth(50.0).with_window(2));
    Loop { drive: Drive::Current { bandwidth_hz }, ..ideal }
}

#[test]
fn every_effect_is_compared_with_the_loop_without_it() {
    let device = soft_device_in_hand();
    let around = control_loop(500.0);
    let found = explain_boundary(&device, &around, &Sweep::quiet()).unwrap();
    let names: Vec<&str> = found.effects.iter().map(|without| without.effect).collect();
    let all = ["sampling", "delay", "drive", "filter", "difference", "compliance", "hand", "joint damping"];
    assert_eq!(names, all);
    let alone = |device: &Linearised, around: &Loop| {
        let domain = domain(device, around, Mode::Off, None).unwrap();
        (domain.top.kp, domain.area)
    };
    let same = |limits: Option<Limits>, known: (f64, f64)| {
        let limits = limits.unwrap();
        assert_eq!((limits.kp_max, limits.area), known);
    };
    let with = alone(&device, &around);
    same(found.limits.off, with);
    let mut stiff = device.clone();
    stiff.flexible.transmissions = vec![None, None];
    let stiff = alone(&stiff, &around);
    same(found.effects[5].limits.off, stiff);
    assert_eq!(found.effects[5].takes.off, Some(1.0 - with.0 / stiff.0));
    assert_eq!(found.effects[5].takes_area.off, Some(1.0 - with.1 / stiff.1));
    let faster = Loop {
        rate_hz: 10_000.0,
        delay_samples: 5.0,
        estimator: LinearEstimator::Butterworth(50.0).with_window(20),
        ..around.clone()
    };
    same(found.effects[0].limits.off, alone(&device, &faster));
    same(found.effects[6].limits.off, alone(&device.clone().with_hand(Hand::default()), &around));
}

#[test]
fn a_rigid_ideal_loop_has_only_sampling_and_a_filter() {
    let mut device = soft_device_in_hand().undamped();
    device.flexible = Flexible::default();
    let around = ideal_loop(1000.0, 0.0, LinearEstimator::Butterworth(50.0));
    let found = explain_boundary(&device, &around, &Sweep::quiet()).unwrap();
    assert_eq!(found.effects.iter().map(|without| without.effect).collect::<Vec<_>>(), ["sampling", "filter"]);
    assert!(found.effects.iter().all(|without| without.takes.off.unwrap() > 0.0));
}

#[test]
fn results_of_several_cores_are_in_order() {
    let things: Vec<u64> = (0..50).collect();
    let report_count = AtomicUsize::new(0);
    let progress = |_: usize, of: usize| {
        assert_eq!(of, 50);
        report_count.fetch_add(1, Ordering::Relaxed);
    };
    let squares = cores::map(&things, &progress, |thing| {
        // The first items take the longest.
        for step in 0..100_000 * (50 - thing) {
            black_box(step);
        }
        thing * thing
    });
    assert_eq!(squares, things.iter().map(|thing| thing * thing).collect::<Vec<_>>());
    assert_eq!(report_count.into_inner(), 50);
}

#[test]
fn every_text_lies_within_the_picture() {
    let around = control_loop(6400.0);
    let found = explain_boundary(&soft_device_in_hand(), &around, &Sweep::quiet()).unwrap();
    let picture = draw("a device", &["pose".into(), "loop".into()], &found, Paper::default());
    let svg = picture.svg();
    let value = |line: &str, key: &str| svg_number(line, key).unwrap_or_else(|| panic!("{key}: {line}"));
    let width = value(svg.lines().next().unwrap(), "width");
    let mut words = 0;
    for line in svg.lines().filter(|line| line.starts_with("<text")) {
        let text = line.split_once('>').unwrap().1.trim_end_matches("</text>");
        // A letter of the picture's font is on average a little wider than half of the font size.
        let text_width = 0.53 * value(line, "font-size") * text.chars().count() as f64;
        let x = value(line, "x");
        let (left, right) = match line {
            _ if line.contains("\"end\"") => (x - text_width, x),
            _ if line.contains("\"middle\"") => (x - text_width / 2.0, x + text_width / 2.0),
            _ => (x, x + text_width),
        };
        assert!(left >= 0.0 && right <= width, "{line}");
        words += 1;
    }
    assert!(words > 20, "{svg}");
}
