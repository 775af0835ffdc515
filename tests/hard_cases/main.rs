//! Where numbers are hard to keep: f32 against f64 and both against 106 bits.
//!
//! The rows are computed once (page.rs), shown in docs/hard-cases.md and asserted here.

#[path = "page.rs"]
mod page;

use haptic_bridge::render::scene::VelocityTerms;
use page::Rows;
use page::singular::{Row, Singularity, Target};
use page::whole::WholeErrors;
use std::sync::LazyLock;

static ROWS: LazyLock<Rows> = LazyLock::new(Rows::compute);

/// The feed-forward's torques must keep four digits wherever it acts in full.
const USABLE: f64 = 1e-4;

fn serial(row: &&Row) -> bool {
    row.singularity != Singularity::Rods
}

fn conditioned(row: &Row) -> f64 {
    match row.target {
        Target::Condition(condition) => condition,
        Target::Sine(_) => 0.0,
    }
}

#[test]
fn every_singularity_is_met_up_to_cond_1e4() {
    for name in ["five-bar (haply-2diy)", "five-bar-turret", "parallelogram (Phantom)", "serial-3r"] {
        for condition in [1e1, 1e2, 1e3, 1e4, 1e5] {
            let met =
                ROWS.singular.iter().any(|row| row.device == name && conditioned(row) == condition && serial(&row));
            assert!(met, "{name} at cond J {condition:e}");
        }
    }
    for condition in [1e1, 1e2, 1e3, 1e4] {
        let met = ROWS.singular.iter().filter(|row| conditioned(row) == condition && !serial(row)).count();
        assert_eq!(met, 2, "parallel singularities at cond J {condition:e}");
    }
}

#[test]
fn where_the_feed_forward_acts_in_full_its_torque_keeps_four_digits() {
    let mut edges = 0;
    for row in &ROWS.singular {
        if row.target != Target::Sine(row.singularity.fade()[0]) {
            continue;
        }
        edges += 1;
        let board = &row.board;
        for error in [board.w_rr_kernel, board.plain, board.torque, board.torque_moving] {
            assert!(error < USABLE, "{row:?}");
        }
    }
    assert_eq!(edges, 8, "one edge per singularity");
}

#[test]
fn without_feed_forward_a_serial_singularity_costs_nothing() {
    let rows: Vec<_> = ROWS.singular.iter().filter(serial).collect();
    assert_eq!(rows.len(), 42, "six ways into a serial singularity, seven rows each");
    for row in rows {
        assert!(row.board.plain < USABLE, "{row:?}");
    }
}

#[test]
fn the_schur_form_loses_its_digits_at_serial_singularities_and_the_joint_route_keeps_them() {
    let rows: Vec<_> = ROWS.singular.iter().filter(serial).filter(|row| conditioned(row) >= 1e3).collect();
    assert_eq!(rows.len(), 18, "six ways into a serial singularity, three decades each");
    for row in rows {
        assert!(row.board.w_eff_schur > 1e-2, "{row:?}");
        assert!(row.board.w_eff_joint < 2e-4, "{row:?}");
    }
}

#[test]
fn at_parallel_singularities_the_closed_form_in_task_space_keeps_what_joint_space_loses() {
    let rows: Vec<_> = ROWS.singular.iter().filter(|row| !serial(row) && conditioned(row) >= 1e3).collect();
    assert_eq!(rows.len(), 6, "two kinds of closed loop, three decades each");
    for row in rows {
        assert!(row.board.w_rr_kernel * 10.0 < row.board.w_rr_joint, "{row:?}");
        assert!(row.board.w_rr_kernel < 1e-2, "{row:?}");
    }
}

#[test]
fn double_precision_keeps_five_digits_everywhere() {
    assert_eq!(ROWS.singular.len(), 56, "eight ways into a singularity, seven rows each");
    for row in &ROWS.singular {
        for error in [row.double.w_rr_kernel, row.double.torque, row.double.torque_moving] {
            assert!(error < 1e-5, "{row:?}");
        }
    }
}

#[test]
fn the_analysis_keeps_the_whole_of_equation_4_to_five_digits_everywhere() {
    for row in &ROWS.singular {
        let WholeErrors { w, w_eff, z, f_a, torque } = row.whole;
        // Ten digits wherever the feed-forward acts.
        let most = if matches!(row.target, Target::Sine(_)) { 1e-10 } else { 1e-5 };
        for error in [w, w_eff, z, f_a, torque] {
            assert!(error < most, "{row:?}");
        }
        // Of Weff a serial singularity takes nothing.
        assert!(!serial(&row) || w_eff < 1e-12, "{row:?}");
    }
}

#[test]
fn in_106_bits_all_routes_agree_so_that_the_reference_is_one() {
    // Closer than 1e-6 the closed form clamps its reciprocals on purpose.
    let rows: Vec<_> = ROWS.singular.iter().filter(|row| row.regularity > 2e-6).collect();
    assert!(rows.len() >= 54, "all but the five-bar's last elbow rows: {}", rows.len());
    for row in rows {
        assert!(row.reference < 1e-13, "{row:?}");
    }
}

#[test]
fn a_millimetre_or_ten_metres_a_milligram_or_a_hundredweight_keep_five_digits() {
    let sized: Vec<_> = ROWS.extremes.iter().filter(|row| !row.case.contains("Wrr/Weff")).collect();
    assert_eq!(sized.len(), 20);
    for row in sized {
        let board = &row.board;
        for error in [board.w_eff_joint, board.w_rr_kernel, board.torque, board.torque_moving] {
            assert!(error < 1e-5, "{row:?}");
        }
    }
}

#[test]
fn a_million_times_the_effective_inertia_is_rendered_to_five_digits() {
    let ratios: Vec<_> = ROWS.extremes.iter().filter(|row| row.case.contains("Wrr/Weff")).collect();
    assert_eq!(ratios.len(), 12);
    for row in ratios {
        let asked: f64 = row.case.rsplit(' ').next().and_then(|text| text.parse().ok()).expect("a ratio");
        assert!((row.ratio / asked - 1.0).abs() < 0.05, "{row:?}");
        assert!(row.board.w_eff_joint < 1e-5 && row.board.w_rr_kernel < 1e-5 && row.board.torque < 1e-5, "{row:?}");
        // Moving, the heavy joint's velocity terms cancel: their rounding is its share of the ratio's root.
        assert!(row.board.torque_moving < 3e-6 * asked.sqrt(), "{row:?}");
    }
}

#[test]
fn velocity_filters_keep_four_digits_at_any_cutoff() {
    assert_eq!(ROWS.filters.len(), 8);
    for row in &ROWS.filters {
        assert!(row.swing < 1e-4 && row.gain < 1e-4, "{row:?}");
        assert!(row.ratio < 1e-3 || (row.swing < 4e-6 && row.gain < 4e-6), "{row:?}");
        assert!(row.reference < 1e-12, "{row:?}");
    }
    let slowest = &ROWS.filters[0];
    assert!(slowest.direct_gain > 1e-2, "the direct form is not the one to use: {slowest:?}");
}

#[test]
fn a_hit_at_ten_metres_a_second_keeps_four_digits_and_never_pulls() {
    assert_eq!(ROWS.steps.len(), 5);
    for row in &ROWS.steps {
        assert!(row.hit < 1e-4, "{row:?}");
        assert!(row.least >= 0.0, "{row:?}");
        assert!(row.force > 1e3 && (9.0..12.0).contains(&row.speed), "{row:?}");
    }
}

#[test]
fn a_wall_of_a_million_newtons_per_metre_is_held_to_the_last_digit_of_the_tips_position() {
    // A tip at 0.4 m is known to 0.1 µm: two units in f32's last place, and the sines' own error.
    assert_eq!(ROWS.steps.len(), 5);
    for row in &ROWS.steps {
        assert!(row.press < 1e-7 * 1e6, "{row:?}");
    }
}

#[test]
fn walls_at_a_small_angle_or_of_very_different_stiffness_keep_five_digits() {
    assert_eq!(ROWS.several.len(), 16, "four mechanisms, four angles");
    for row in &ROWS.several {
        for error in row.torque {
            assert!(error < 1e-5, "{row:?}");
        }
        // Jᵀ F alone would be wrong by a hundred times that.
        assert!(row.shaped > 1e-3, "{row:?}");
    }
}

#[test]
fn thousands_of_turns_of_a_fractional_encoder_cost_nothing() {
    assert_eq!(ROWS.turns.len(), 8, "two mechanisms, four encoders");
    for row in &ROWS.turns {
        // An angle below 2π has its last digit at 4.8e-7: three joints, two roundings each, arms of up to three mean
        // lengths; far from home the same.
        for error in row.tip {
            assert!(error < 5e-6, "{row:?}");
        }
    }
}

#[test]
fn an_elbow_and_the_rods_together_keep_four_digits_where_the_feed_forward_acts_in_full() {
    assert_eq!(ROWS.double.len(), 6, "two closed loops, three distances");
    for row in &ROWS.double {
        let (board, double) = (&row.board, &row.double);
        assert!(row.poses >= 20, "{row:?}");
        assert!(double.torque < 1e-10 && double.torque_moving < 1e-10, "{row:?}");
        let worst = [board.w_rr_kernel, board.plain, board.torque, board.torque_moving].into_iter().fold(0.0, f64::max);
        assert!(worst < if row.share == 1.0 { USABLE } else { 0.1 }, "{row:?}");
    }
}

#[test]
fn velocity_terms_lose_to_encoder_steps_and_not_to_single_precision() {
    assert_eq!(ROWS.sliding.len(), 12, "four mechanisms, three laws");
    for row in &ROWS.sliding {
        assert!(row.rounding < 1e-5, "{row:?}");
        let [coarse, fine] = row.estimated;
        // Measured: up to four tenths of what the terms add at 20 000 counts, most of it of joints so slow that the
        // velocity terms leave their doubt of a count out; and as many times less as the counts are finer, squared. The
        // pose alone costs a count (3e-4 rad) times the few units by which torques change in a radian.
        let off = row.terms == VelocityTerms::Off;
        assert!(if off { row.size == 0.0 } else { row.size > 0.03 }, "{row:?}");
        assert!(coarse < 0.5 * row.size + 3e-3, "{row:?}");
        assert!(fine < 0.005 * row.size + 6e-5, "{row:?}");
        // What the page says of both in times of what f32 costs, as far apart as the page's numbers may be.
        let times = [coarse, fine].map(|error| error / row.rounding);
        assert!(off || (1e3..7e4).contains(&times[0]) && (5.0..1.3e3).contains(&times[1]), "{row:?}");
    }
}

#[test]
fn motors_at_their_limit_hold_the_largest_force_that_fits_and_pull_nowhere_else() {
    assert_eq!(ROWS.saturated.len(), 8, "four mechanisms, in the open and near an elbow's singularity");
    for row in &ROWS.saturated {
        assert!(row.beyond > 5.0, "{row:?}");
        // A rounding of the torques (6e-8) becomes a force over the sine, and Jᵀ n has a few more.
        let most = 1e-6 / row.sines[0];
        for error in [row.along[0], row.along[1], row.across] {
            assert!(error < most, "{row:?}");
        }
    }
}

/// How many times larger or smaller a number on the page may be than what the code gives: errors are maxima over random
/// poses in one digit, and a change that only rounds differently moves them by less.
const SAME: f64 = 4.0;

/// Whether two words of the page say the same: equal, or numbers within [`SAME`] of each other ("lost" is anything
/// above a half).
fn same(shown: &str, computed: &str) -> bool {
    let number = |text: &str| if text == "lost" { Some(1.0) } else { text.parse::<f64>().ok() };
    match (number(shown), number(computed)) {
        (Some(a), Some(b)) => a == b || (a > 0.0 && b > 0.0 && a < SAME * b && b < SAME * a),
        _ => shown == computed,
    }
}

#[test]
fn the_page_shows_what_the_code_gives() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/docs/hard-cases.md");
    let page = std::fs::read_to_string(path).expect("docs/hard-cases.md is there");
    let computed = ROWS.markdown();
    if std::env::var_os("UPDATE_DOCS").is_some() {
        std::fs::write(path, computed).expect("docs/hard-cases.md can be written");
        return;
    }
    for (number, (shown, computed)) in page.lines().zip(computed.lines()).enumerate() {
        let agree = shown.split_whitespace().count() == computed.split_whitespace().count()
            && shown.split_whitespace().zip(computed.split_whitespace()).all(|(a, b)| same(a, b));
        let line = number + 1;
        assert!(
            agree,
            "line {line} of docs/hard-cases.md (its first paragraph says how it is made):\n{shown}\n{computed}"
        );
    }
    assert_eq!(page.lines().count(), computed.lines().count());
}
