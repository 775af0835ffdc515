//! Bounds on the errors of f32, in each route that the board takes, against the reference.

use super::rows::singular::{Row, Singularity, Target};
use super::rows::{DOUBLE_ROWS, EXTREME_ROWS, FILTER_ROWS, SINGULAR_ROWS, STEP_ROWS, TURN_ROWS, TWO_WALL_ROWS};

/// Largest torque error where the feed-forward acts in full, as a share of the largest torque.
const FULL_FEED_FORWARD_TOLERANCE: f64 = 1e-4;

pub fn is_serial(row: &&Row) -> bool {
    row.singularity != Singularity::Rods
}

/// Returns the row's target condition number, or 0 if the target is a sine.
fn condition_number(row: &Row) -> f64 {
    match row.target {
        Target::Condition(condition) => condition,
        Target::Sine(_) => 0.0,
    }
}

#[test]
fn every_singularity_is_reached_up_to_cond_1e4() {
    for name in ["five-bar (haply-2diy)", "five-bar-turret", "parallelogram (Phantom)", "serial-3r"]
        .into_iter()
        .chain(["chain-2", "chain-2 (slide)", "chain-3", "delta"])
    {
        for condition in [1e1, 1e2, 1e3, 1e4, 1e5] {
            let met = SINGULAR_ROWS
                .iter()
                .any(|row| row.device == name && condition_number(row) == condition && is_serial(&row));
            assert!(met, "{name} has no row at cond J {condition:e}");
        }
    }
    for condition in [1e1, 1e2, 1e3, 1e4] {
        let met = SINGULAR_ROWS.iter().filter(|row| condition_number(row) == condition && !is_serial(row)).count();
        assert_eq!(met, 3, "parallel singularities at cond J {condition:e}");
    }
}

#[test]
fn the_full_feed_forward_keeps_four_digits_of_torque() {
    let mut edges = 0;
    for row in &*SINGULAR_ROWS {
        if row.target != Target::Sine(row.singularity.fade_sines()[0]) {
            continue;
        }
        edges += 1;
        let board = &row.board;
        for error in [board.w_rr_kernel, board.plain, board.torque, board.torque_moving] {
            assert!(error < FULL_FEED_FORWARD_TOLERANCE, "{row:?}");
        }
    }
    assert_eq!(edges, 14, "one edge per singularity");
}

#[test]
fn without_feed_forward_a_serial_singularity_loses_no_digits() {
    let rows: Vec<_> = SINGULAR_ROWS.iter().filter(is_serial).collect();
    assert_eq!(rows.len(), 72, "ten ways into a serial singularity, seven rows each, and two of one joint");
    for row in rows {
        assert!(row.board.plain < FULL_FEED_FORWARD_TOLERANCE, "{row:?}");
    }
}

#[test]
fn only_joint_space_keeps_digits_at_serial_singularities() {
    let rows: Vec<_> = SINGULAR_ROWS.iter().filter(is_serial).filter(|row| condition_number(row) >= 1e3).collect();
    assert_eq!(rows.len(), 30, "ten ways into a serial singularity, three decades each");
    for row in rows {
        assert!(row.board.w_eff_schur > 1e-3, "{row:?}");
        assert!(row.board.w_eff_joint < 2e-4, "{row:?}");
    }
}

#[test]
fn only_task_space_keeps_digits_at_parallel_singularities() {
    let rows: Vec<_> = SINGULAR_ROWS.iter().filter(|row| !is_serial(row) && condition_number(row) >= 1e3).collect();
    assert_eq!(rows.len(), 9, "three kinds of closed loop, three decades each");
    for row in rows {
        assert!(row.board.w_rr_kernel * 10.0 < row.board.w_rr_joint, "{row:?}");
        assert!(row.board.w_rr_kernel < 2e-2, "{row:?}");
    }
}

#[test]
fn small_large_thin_and_geared_devices_keep_five_digits() {
    let sized: Vec<_> = EXTREME_ROWS.iter().filter(|row| !row.case.contains("Wrr/Weff")).collect();
    assert_eq!(sized.len(), 13 * 6);
    for row in sized {
        let board = &row.board;
        // The weight of 100 kg and the forces of a fast motion are much larger than the wall's 1 N.
        let most = if row.case.ends_with("1 mg") { 1e-5 } else { 5e-5 };
        assert!(board.w_eff_joint < 1e-5 && board.w_rr_kernel < 1e-5, "{row:?}");
        assert!(board.torque < most && board.torque_moving < most, "{row:?}");
    }
}

#[test]
fn a_million_times_the_effective_inertia_keeps_five_digits() {
    let ratios: Vec<_> = EXTREME_ROWS.iter().filter(|row| row.case.contains("Wrr/Weff")).collect();
    assert_eq!(ratios.len(), 10 * 3);
    for row in ratios {
        let requested: f64 = row.case.rsplit(' ').next().and_then(|text| text.parse().ok()).expect("a ratio");
        assert!((row.ratio / requested - 1.0).abs() < 0.05, "{row:?}");
        assert!(row.board.w_eff_joint < 1e-5 && row.board.w_rr_kernel < 1e-5 && row.board.torque < 1e-5, "{row:?}");
        // The velocity terms of the heavy joint cancel, and the rounding error grows with the root of Wrr/Weff.
        assert!(row.board.torque_moving < 5e-6 * requested.sqrt(), "{row:?}");
    }
}

#[test]
fn velocity_filters_keep_four_digits_at_any_cutoff() {
    assert_eq!(FILTER_ROWS.len(), 8);
    for row in &*FILTER_ROWS {
        assert!(row.swing < 1e-4 && row.gain < 1e-4, "{row:?}");
        assert!(row.ratio < 1e-3 || (row.swing < 4e-6 && row.gain < 4e-6), "{row:?}");
    }
    let slowest = &FILTER_ROWS[0];
    assert!(slowest.direct_gain > 1e-2, "the direct form must be inaccurate here: {slowest:?}");
}

#[test]
fn a_hit_at_10_m_per_s_keeps_four_digits_and_never_pulls() {
    assert_eq!(STEP_ROWS.len(), 13 * 2);
    for row in &*STEP_ROWS {
        assert!(row.hit_error < 1e-4, "{row:?}");
        assert!(row.smallest_force >= 0.0, "{row:?}");
        assert!(row.force > 1e3 && (9.0..12.0).contains(&row.speed), "{row:?}");
    }
}

#[test]
fn a_stiff_wall_is_exact_to_the_last_digit_of_the_tip_position() {
    // The position of a tip at 0.4 m has an error of 0.1 µm, two units in the last place of f32 and the error of the
    // sines. The stiffness is 1e6 N/m.
    assert_eq!(STEP_ROWS.len(), 13 * 2);
    for row in &*STEP_ROWS {
        assert!(row.rest_error < 1e-7 * 1e6, "{row:?}");
    }
}

#[test]
fn walls_at_small_angles_or_unequal_stiffness_keep_five_digits() {
    assert_eq!(TWO_WALL_ROWS.len(), 10 * 4, "four angles");
    for row in &*TWO_WALL_ROWS {
        for error in row.torque {
            assert!(error < 1e-5, "{row:?}");
        }
        // Without the feed-forward (Jᵀ F alone) the error would be a hundred times larger.
        assert!(row.smallest_shaping > 1e-3, "{row:?}");
    }
}

#[test]
fn thousands_of_turns_of_a_fractional_encoder_lose_no_digits() {
    assert_eq!(TURN_ROWS.len(), 25, "five mechanisms, five encoders");
    for row in &*TURN_ROWS {
        // An angle below 2π has a last digit of 4.8e-7. Three joints round twice each, and arms have up to three mean
        // lengths.
        for error in row.tip {
            assert!(error < 5e-6, "{row:?}");
        }
    }
}

#[test]
fn two_singularities_at_once_keep_four_digits() {
    assert_eq!(DOUBLE_ROWS.len(), 9, "three closed loops, three distances");
    for row in &*DOUBLE_ROWS {
        let (board, double) = (&row.board, &row.double);
        assert!(row.poses >= 20, "{row:?}");
        assert!(double.torque < 1e-10 && double.torque_moving < 1e-10, "{row:?}");
        let worst = [board.w_rr_kernel, board.plain, board.torque, board.torque_moving].into_iter().fold(0.0, f64::max);
        assert!(worst < if row.share == 1.0 { FULL_FEED_FORWARD_TOLERANCE } else { 0.1 }, "{row:?}");
    }
}
