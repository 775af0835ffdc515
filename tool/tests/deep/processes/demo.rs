//! `haptic demo` prints the results of its runs, which are the same on every machine.

use crate::common::type_lines;
use crate::common::{Folder, json, output};
use haptic_bridge::render::scene::FeedForward;
use haptic_show::demo::{Demo, crossing, stiffness};

#[test]
fn the_feed_forward_raises_stiffness_as_predicted() {
    let demo = Demo::shipped(1).unwrap();
    let inertia = demo.inertia().unwrap();
    assert!(inertia.rendered > 1.2 * inertia.effective, "the feed-forward hardly matters on this device: {inertia:?}");
    let limits = [FeedForward::Off, FeedForward::Washout].map(|mode| stiffness::stiffness_limit(&demo, mode).unwrap());
    for limit in limits {
        assert!((limit.measured / limit.predicted - 1.0).abs() < 0.01, "{limit:?}");
    }
    // With the washout the stiffness still grows almost in proportion to the inertia that (4) gains.
    let gained = limits[1].measured / limits[0].measured - 1.0;
    let most = inertia.rendered / inertia.effective - 1.0;
    assert!(gained > 0.9 * most && gained < 1.05 * most, "{gained} of {most}");
    assert!(limits[0].measured < demo.stiffness && demo.stiffness < limits[1].measured);
}

#[test]
fn the_feed_forward_reduces_vibration_for_every_tremor() {
    for seed in [1, 2, 3] {
        let demo = Demo::shipped(seed).unwrap();
        let run = |mode| crossing::run(&demo, mode, &mut |_| {}).unwrap();
        let (without, with) = (run(FeedForward::Off), run(FeedForward::Washout));
        // The wall is stable only with the feed-forward, so the difference is large.
        assert!(with.ripple < 0.5 * without.ripple, "seed {seed}: {} {}", with.ripple, without.ripple);
        for crossing in [&without, &with] {
            assert_eq!((crossing.lost, &crossing.fault), (0, &None));
            // About 5 N on 22 kN/m is 0.23 mm; at the landing the penetration is three times as large.
            assert!((1e-4..1e-3).contains(&crossing.penetration), "{}", crossing.penetration);
            // The drawn force drops to zero at every counted bounce, and once more at lift-off.
            let drops = crossing.moments.windows(2).filter(|pair| pair[0].force > 0.0 && pair[1].force == 0.0).count();
            assert!(drops > crossing.bounces, "{drops}, {}", crossing.bounces);
        }
        assert_eq!(run(FeedForward::Off), without, "the same seed must repeat the run");
    }
}

#[test]
fn the_command_prints_its_table_and_draws_its_picture() {
    let folder = Folder::new();
    let svg = folder.path("demo.svg");
    let text = output(&["demo", "--svg", &svg]);
    assert!(text.contains(&format!("picture: {svg}")));
    let picture = std::fs::read_to_string(&svg).unwrap();
    assert!(picture.starts_with("<svg") && picture.trim_end().ends_with("</svg>"));
    assert_eq!(picture.matches("<polyline").count(), 6, "three phases, at rest and moving");
    assert!(
        picture.contains("repeatCount") && picture.contains("prefers-reduced-motion") && !picture.contains("<script")
    );
    // The wall buzzes, rests, and buzzes again.
    let ripples: Vec<f64> =
        picture.split(" N rms</text>").take(3).map(|text| text.rsplit('>').next().unwrap().parse().unwrap()).collect();
    assert!(ripples[0] > 5.0 * ripples[1] && ripples[2] > 5.0 * ripples[1], "{ripples:?}");

    type_lines(&format!("1: demo --svg {svg}"), &[]);
    let json = json(&["demo", "--svg", &svg, "--force"]);
    for (side, column) in [("without", 0), ("with", 1)] {
        let value = |pointer: &str| json[side].pointer(pointer).unwrap().as_f64().unwrap();
        // The table shows the numbers of the JSON, rounded.
        for (row, number) in [
            ("penetration, mm", format!("{:.3}", 1e3 * value("/penetration_m"))),
            ("peak force, N", format!("{:.2}", value("/peak_force_n"))),
            ("inertia that the wall meets, g", format!("{:.1}", 1e3 * value("/inertia_kg"))),
            ("measured", format!("{:.2}", 1e-3 * value("/highest_stable_stiffness_n_per_m/measured"))),
        ] {
            let line = text.lines().find(|line| line.contains(row)).unwrap();
            assert_eq!(line.split_whitespace().rev().nth(1 - column), Some(number.as_str()), "{line}");
        }
    }
    // Text and picture name benefit and cost.
    for sentence in ["Better with it: ", "Worse with it: "] {
        let line = text.lines().find(|line| line.starts_with(sentence)).unwrap_or_else(|| panic!("{sentence}\n{text}"));
        assert!(picture.contains(line), "{line}");
    }
    for (what, worse) in [("penetration, mm", "deeper penetration"), ("peak force, N", "higher peak force")] {
        let [without, with] = *row_numbers(&text, what) else { panic!("{what}") };
        assert_eq!(text.contains(worse), with > without * 1.005, "{worse}: {without}, {with}");
    }
}

/// Returns the numbers in the table's row that begins with `row`.
fn row_numbers(text: &str, row: &str) -> Vec<f64> {
    let line = text.lines().find_map(|line| line.trim_start().strip_prefix(row)).unwrap();
    line.split_whitespace().filter_map(|word| word.parse().ok()).collect()
}

#[test]
fn the_printed_lines_compute_the_printed_numbers() {
    let text = output(&["demo", "--svg", &Folder::new().path("demo.svg")]);
    let run = |subcommand: &str| {
        let line = text.lines().find_map(|line| line.strip_prefix(&format!("    haptic {subcommand} "))).unwrap();
        json(&[subcommand].into_iter().chain(line.split_whitespace()).collect::<Vec<_>>())
    };
    // Numbers agree to the last printed digit.
    let agree = |row: &str, lines: [f64; 2], digits: f64| {
        let printed = row_numbers(&text, row);
        for (printed, line) in printed.iter().zip(lines) {
            assert!((printed - line).abs() < 0.6 * digits, "{row}: {printed} is printed, the line computes {line}");
        }
        assert_eq!(printed.len(), 2, "{row}");
    };
    let model = run("model");
    let grams = |name: &str| 1e3 * model[name][0][0].as_f64().unwrap();
    agree("inertia that the wall meets, g", [grams("w_eff"), grams("w_rr")], 0.1);
    let range = run("range");
    let stiffness = |mode: &str| range[mode]["boundary"][0]["kp"].as_f64().unwrap() / 1000.0;
    agree("predicted", [stiffness("off"), stiffness("washout")], 0.01);
}
