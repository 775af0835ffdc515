//! Numerically hard cases: f32 against f64 and both against 106 bits.
//!
//! The rows are computed once, for the checks here and in tests/hard_cases/bounds.rs and for the tables in
//! docs/hard-cases/. `cargo test` runs the checks of bounds.rs against f64 alone.

#[path = "../../../../tests/hard_cases/bounds.rs"]
mod bounds;
mod double_double;
#[macro_use]
#[path = "../../../../tests/hard_cases/rows/mod.rs"]
mod rows;
mod saturated;
mod sliding;
mod tables;

use crate::common::document;
use bounds::is_serial;
use double_double::{DoubleDouble as Exact, Series as ExactMath};
use haptic_bridge::model::description::Description;
use haptic_bridge::render::scene::VelocityTerms;
use nalgebra::SMatrix;
use rows::routes::inverse;
use rows::singular::{Random, Target};
use rows::{FILTER_ROWS, SINGULAR_ROWS};
use std::sync::LazyLock;

static SLIDING: LazyLock<Vec<sliding::Row>> = LazyLock::new(sliding::all_rows);
static SATURATED: LazyLock<Vec<saturated::Row>> = LazyLock::new(saturated::all_rows);

/// Returns the devices with more than one direction, the strongly coupled five-bar in place of the other.
fn several_directions() -> impl Iterator<Item = (&'static str, Description)> {
    let devices = rows::devices().into_iter().filter(|(_, device)| device.kind.spec().joints > 1);
    devices.map(|(name, device)| (name, if name == "five-bar" { shipped_device("coupled-five-bar") } else { device }))
}

/// Returns the description of a shipped device to the modules in tests/hard_cases.
fn shipped_device(name: &str) -> Description {
    crate::common::shipped_device(name).description
}

/// The reference uses matrix inverses in 106 bits.
#[test]
fn the_reference_inverts_to_thirty_digits() {
    let mut random = Random(5);
    let m = SMatrix::<Exact, 3, 3>::from_fn(|_, _| random.uniform(-1.0, 1.0).into());
    let rest = m * inverse(&m) - SMatrix::identity();
    assert!(rest.iter().all(|x| x.high.abs() < 1e-28), "{rest:?}");
}

#[test]
fn double_precision_keeps_five_digits_everywhere() {
    assert_eq!(SINGULAR_ROWS.len(), 93, "thirteen ways into a singularity, seven rows each, and two of one joint");
    for row in &*SINGULAR_ROWS {
        for error in [row.double.w_rr_kernel, row.double.torque, row.double.torque_moving] {
            assert!(error < 1e-5, "{row:?}");
        }
    }
}

#[test]
fn the_analysis_of_equation_4_keeps_five_digits_everywhere() {
    for row in &*SINGULAR_ROWS {
        // Ten digits are correct where the feed-forward acts.
        let most = if matches!(row.target, Target::Sine(_)) { 1e-10 } else { 1e-5 };
        for error in row.quantities.all() {
            assert!(error < most, "{row:?}");
        }
        // A serial singularity does not affect Weff.
        assert!(!is_serial(&row) || row.quantities.w_eff < 1e-12, "{row:?}");
    }
}

#[test]
fn all_formulas_agree_in_106_bits() {
    // Closer than 1e-6 to a singularity the closed form clamps its reciprocals on purpose.
    let rows: Vec<_> = SINGULAR_ROWS.iter().filter(|row| row.regularity > 2e-6).collect();
    assert!(rows.len() >= 54, "all but the five-bar's last elbow rows: {}", rows.len());
    for row in rows {
        assert!(row.reference < 1e-13, "{row:?}");
    }
}

#[test]
fn in_106_bits_both_forms_of_a_filter_agree() {
    for row in &*FILTER_ROWS {
        assert!(row.reference < 1e-12, "{row:?}");
    }
}

#[test]
fn encoder_steps_cause_larger_errors_than_f32() {
    assert_eq!(SLIDING.len(), 24, "eight mechanisms, three laws");
    for row in &*SLIDING {
        assert!(row.rounding < 1e-5, "{row:?}");
        let [coarse, fine] = row.estimated;
        // Measured errors are up to 0.4 of the terms at 20 000 counts, mostly from slow joints, because the terms
        // subtract the uncertainty of a count. The error falls with the square of the size of a count. The error of the
        // pose, one count (3e-4 rad), changes torques by a few times 3e-4.
        let off = row.terms == VelocityTerms::Off;
        assert!(if off { row.size == 0.0 } else { row.size > 0.03 }, "{row:?}");
        assert!(coarse < 0.5 * row.size + 3e-3, "{row:?}");
        assert!(fine < 0.005 * row.size + 6e-5, "{row:?}");
        // docs/hard-cases.md states these ratios to the rounding error with the same bounds.
        let times = [coarse, fine].map(|error| error / row.rounding);
        assert!(off || (1e3..7e4).contains(&times[0]) && (5.0..1.3e3).contains(&times[1]), "{row:?}");
    }
}

#[test]
fn motors_at_their_limit_push_along_the_normal_only() {
    assert_eq!(SATURATED.len(), 18, "eight mechanisms in the open and near a serial singularity, and paddles");
    for row in &*SATURATED {
        assert!(row.beyond > 5.0, "{row:?}");
        // The rounding of a torque (6e-8) causes an error of the force of 6e-8/sine. Jᵀ n adds a few roundings.
        let most = 1e-6 / row.sines[0];
        for error in [row.along[0], row.along[1], row.across] {
            assert!(error < most, "{row:?}");
        }
    }
}

/// Largest ratio between a number in a table and the computed number. Errors are maxima over random poses in one digit.
/// A change that only rounds differently changes the errors by a smaller factor.
const MAX_RATIO: f64 = 4.0;

/// Returns true if two words of a table are equal or are numbers within a factor of [`MAX_RATIO`] ("lost" counts as 1).
fn words_agree(shown: &str, computed: &str) -> bool {
    let number = |text: &str| if text == "lost" { Some(1.0) } else { text.parse::<f64>().ok() };
    match (number(shown), number(computed)) {
        (Some(a), Some(b)) => a == b || (a > 0.0 && b > 0.0 && a < MAX_RATIO * b && b < MAX_RATIO * a),
        _ => shown == computed,
    }
}

/// `UPDATE_DOCS=1 cargo xtask test --deep hard_cases` updates the tables in docs/hard-cases/.
#[test]
fn the_tables_hold_the_computed_errors() {
    for (name, computed) in tables::all_tables() {
        let path = format!("docs/hard-cases/{name}.csv");
        let published = document(&path, &computed);
        assert_eq!(published.lines().count(), computed.lines().count(), "{path}");
        for (number, (shown, computed)) in published.lines().zip(computed.lines()).enumerate() {
            let [a, b] = [shown, computed].map(|line| line.split([' ', ',']).collect::<Vec<_>>());
            let agree = a.len() == b.len() && a.iter().zip(&b).all(|(a, b)| words_agree(a, b));
            assert!(agree, "line {} of {path}:\n{shown}\n{computed}", number + 1);
        }
    }
}
