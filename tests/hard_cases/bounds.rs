//! Bounds on the error of f32, and of the board's routes with it, against the reference.

use super::rows::singular::{Row, Singularity, Target};
use super::rows::{DOUBLE, EXTREMES, FILTERS, SEVERAL, SINGULAR, STEPS, TURNS};

/// The feed-forward's torques must keep four digits wherever it acts in full.
const USABLE: f64 = 1e-4;

pub fn serial(row: &&Row) -> bool {
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
            let met = SINGULAR.iter().any(|row| row.device == name && conditioned(row) == condition && serial(&row));
            assert!(met, "{name} at cond J {condition:e}");
        }
    }
    for condition in [1e1, 1e2, 1e3, 1e4] {
        let met = SINGULAR.iter().filter(|row| conditioned(row) == condition && !serial(row)).count();
        assert_eq!(met, 2, "parallel singularities at cond J {condition:e}");
    }
}

#[test]
fn where_the_feed_forward_acts_in_full_its_torque_keeps_four_digits() {
    let mut edges = 0;
    for row in &*SINGULAR {
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
    let rows: Vec<_> = SINGULAR.iter().filter(serial).collect();
    assert_eq!(rows.len(), 42, "six ways into a serial singularity, seven rows each");
    for row in rows {
        assert!(row.board.plain < USABLE, "{row:?}");
    }
}

#[test]
fn the_schur_form_loses_its_digits_at_serial_singularities_and_the_joint_route_keeps_them() {
    let rows: Vec<_> = SINGULAR.iter().filter(serial).filter(|row| conditioned(row) >= 1e3).collect();
    assert_eq!(rows.len(), 18, "six ways into a serial singularity, three decades each");
    for row in rows {
        assert!(row.board.w_eff_schur > 1e-2, "{row:?}");
        assert!(row.board.w_eff_joint < 2e-4, "{row:?}");
    }
}

#[test]
fn at_parallel_singularities_the_closed_form_in_task_space_keeps_what_joint_space_loses() {
    let rows: Vec<_> = SINGULAR.iter().filter(|row| !serial(row) && conditioned(row) >= 1e3).collect();
    assert_eq!(rows.len(), 6, "two kinds of closed loop, three decades each");
    for row in rows {
        assert!(row.board.w_rr_kernel * 10.0 < row.board.w_rr_joint, "{row:?}");
        assert!(row.board.w_rr_kernel < 1e-2, "{row:?}");
    }
}

#[test]
fn a_millimetre_or_ten_metres_a_milligram_or_a_hundredweight_keep_five_digits() {
    let sized: Vec<_> = EXTREMES.iter().filter(|row| !row.case.contains("Wrr/Weff")).collect();
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
    let ratios: Vec<_> = EXTREMES.iter().filter(|row| row.case.contains("Wrr/Weff")).collect();
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
    assert_eq!(FILTERS.len(), 8);
    for row in &*FILTERS {
        assert!(row.swing < 1e-4 && row.gain < 1e-4, "{row:?}");
        assert!(row.ratio < 1e-3 || (row.swing < 4e-6 && row.gain < 4e-6), "{row:?}");
    }
    let slowest = &FILTERS[0];
    assert!(slowest.direct_gain > 1e-2, "the direct form is not the one to use: {slowest:?}");
}

#[test]
fn a_hit_at_ten_metres_a_second_keeps_four_digits_and_never_pulls() {
    assert_eq!(STEPS.len(), 5);
    for row in &*STEPS {
        assert!(row.hit < 1e-4, "{row:?}");
        assert!(row.least >= 0.0, "{row:?}");
        assert!(row.force > 1e3 && (9.0..12.0).contains(&row.speed), "{row:?}");
    }
}

#[test]
fn a_wall_of_a_million_newtons_per_metre_is_held_to_the_last_digit_of_the_tips_position() {
    // A tip at 0.4 m is known to 0.1 µm: two units in f32's last place, and the sines' own error.
    assert_eq!(STEPS.len(), 5);
    for row in &*STEPS {
        assert!(row.press < 1e-7 * 1e6, "{row:?}");
    }
}

#[test]
fn walls_at_a_small_angle_or_of_very_different_stiffness_keep_five_digits() {
    assert_eq!(SEVERAL.len(), 16, "four mechanisms, four angles");
    for row in &*SEVERAL {
        for error in row.torque {
            assert!(error < 1e-5, "{row:?}");
        }
        // Jᵀ F alone would be wrong by a hundred times that.
        assert!(row.shaped > 1e-3, "{row:?}");
    }
}

#[test]
fn thousands_of_turns_of_a_fractional_encoder_cost_nothing() {
    assert_eq!(TURNS.len(), 8, "two mechanisms, four encoders");
    for row in &*TURNS {
        // An angle below 2π has its last digit at 4.8e-7: three joints, two roundings each, arms of up to three mean
        // lengths; far from home the same.
        for error in row.tip {
            assert!(error < 5e-6, "{row:?}");
        }
    }
}

#[test]
fn an_elbow_and_the_rods_together_keep_four_digits_where_the_feed_forward_acts_in_full() {
    assert_eq!(DOUBLE.len(), 6, "two closed loops, three distances");
    for row in &*DOUBLE {
        let (board, double) = (&row.board, &row.double);
        assert!(row.poses >= 20, "{row:?}");
        assert!(double.torque < 1e-10 && double.torque_moving < 1e-10, "{row:?}");
        let worst = [board.w_rr_kernel, board.plain, board.torque, board.torque_moving].into_iter().fold(0.0, f64::max);
        assert!(worst < if row.share == 1.0 { USABLE } else { 0.1 }, "{row:?}");
    }
}
