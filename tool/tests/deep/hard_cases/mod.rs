//! Where numbers are hard to keep: f32 against f64 and both against 106 bits.
//!
//! The rows are computed once and asserted here and in tests/hard_cases/bounds.rs, which `cargo test` holds to f64 alone;
//! the tables in docs/hard-cases/ hold them.

#[path = "../../../../tests/hard_cases/bounds.rs"]
mod bounds;
mod double_double;
#[macro_use]
#[path = "../../../../tests/hard_cases/rows/mod.rs"]
mod rows;
mod saturated;
mod sliding;
mod tables;

use crate::common::root;
use bounds::serial;
use double_double::{DoubleDouble as Exact, Series as ExactMath};
use haptic_bridge::model::description::Description;
use haptic_bridge::render::scene::VelocityTerms;
use haptic_host::device_file::DeviceFile;
use nalgebra::SMatrix;
use rows::routes::inverse;
use rows::singular::{Random, Target};
use rows::whole::WholeErrors;
use rows::{FILTERS, SINGULAR};
use std::sync::LazyLock;

static SLIDING: LazyLock<Vec<sliding::Row>> = LazyLock::new(sliding::all);
static SATURATED: LazyLock<Vec<saturated::Row>> = LazyLock::new(saturated::all);

/// Every mechanism that has more than one direction, with a device that ships.
const MECHANISMS: [(&str, &str); 4] = [
    ("five-bar", "coupled-five-bar"),
    ("five-bar-turret", "fictive-five-bar-turret"),
    ("parallelogram", "phantom-premium-1.5"),
    ("serial-3r", "serial-3r"),
];

/// A device that ships.
fn shipped(name: &str) -> Description {
    let path = format!("{}/../devices/{name}.toml", env!("CARGO_MANIFEST_DIR"));
    DeviceFile::load(path).unwrap_or_else(|error| panic!("{error}")).description
}

/// A matrix of any precision is its own inverse's inverse: what the reference stands on.
#[test]
fn the_reference_inverts_to_thirty_digits() {
    let mut random = Random(5);
    let m = SMatrix::<Exact, 3, 3>::from_fn(|_, _| random.within(-1.0, 1.0).into());
    let rest = m * inverse(&m) - SMatrix::identity();
    assert!(rest.iter().all(|x| x.high.abs() < 1e-28), "{rest:?}");
}

#[test]
fn double_precision_keeps_five_digits_everywhere() {
    assert_eq!(SINGULAR.len(), 56, "eight ways into a singularity, seven rows each");
    for row in &*SINGULAR {
        for error in [row.double.w_rr_kernel, row.double.torque, row.double.torque_moving] {
            assert!(error < 1e-5, "{row:?}");
        }
    }
}

#[test]
fn the_analysis_keeps_the_whole_of_equation_4_to_five_digits_everywhere() {
    for row in &*SINGULAR {
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
    let rows: Vec<_> = SINGULAR.iter().filter(|row| row.regularity > 2e-6).collect();
    assert!(rows.len() >= 54, "all but the five-bar's last elbow rows: {}", rows.len());
    for row in rows {
        assert!(row.reference < 1e-13, "{row:?}");
    }
}

#[test]
fn in_106_bits_both_forms_of_a_filter_agree() {
    for row in &*FILTERS {
        assert!(row.reference < 1e-12, "{row:?}");
    }
}

#[test]
fn velocity_terms_lose_to_encoder_steps_and_not_to_single_precision() {
    assert_eq!(SLIDING.len(), 12, "four mechanisms, three laws");
    for row in &*SLIDING {
        assert!(row.rounding < 1e-5, "{row:?}");
        let [coarse, fine] = row.estimated;
        // Measured: up to four tenths of what the terms add at 20 000 counts, most of it of joints so slow that the
        // velocity terms leave their doubt of a count out; and as many times less as the counts are finer, squared. The
        // pose alone costs a count (3e-4 rad) times the few units by which torques change in a radian.
        let off = row.terms == VelocityTerms::Off;
        assert!(if off { row.size == 0.0 } else { row.size > 0.03 }, "{row:?}");
        assert!(coarse < 0.5 * row.size + 3e-3, "{row:?}");
        assert!(fine < 0.005 * row.size + 6e-5, "{row:?}");
        // What docs/hard-cases.md says of both in times of what f32 costs, as far apart as numbers may be there.
        let times = [coarse, fine].map(|error| error / row.rounding);
        assert!(off || (1e3..7e4).contains(&times[0]) && (5.0..1.3e3).contains(&times[1]), "{row:?}");
    }
}

#[test]
fn motors_at_their_limit_hold_the_largest_force_that_fits_and_pull_nowhere_else() {
    assert_eq!(SATURATED.len(), 8, "four mechanisms, in the open and near an elbow's singularity");
    for row in &*SATURATED {
        assert!(row.beyond > 5.0, "{row:?}");
        // A rounding of the torques (6e-8) becomes a force over the sine, and Jᵀ n has a few more.
        let most = 1e-6 / row.sines[0];
        for error in [row.along[0], row.along[1], row.across] {
            assert!(error < most, "{row:?}");
        }
    }
}

/// How many times larger or smaller a number in a table may be than what the code gives: errors are maxima over random
/// poses in one digit, and a change that only rounds differently moves them by less.
const SAME: f64 = 4.0;

/// Whether two words of a table say the same: equal, or numbers within [`SAME`] of each other ("lost" is anything
/// above a half).
fn same(shown: &str, computed: &str) -> bool {
    let number = |text: &str| if text == "lost" { Some(1.0) } else { text.parse::<f64>().ok() };
    match (number(shown), number(computed)) {
        (Some(a), Some(b)) => a == b || (a > 0.0 && b > 0.0 && a < SAME * b && b < SAME * a),
        _ => shown == computed,
    }
}

/// `UPDATE_DOCS=1 cargo test -p haptic --test deep hard_cases` writes them anew.
#[test]
fn the_tables_hold_what_the_code_gives() {
    for table in tables::all() {
        let path = root().join(format!("docs/hard-cases/{}.csv", table.name));
        let computed = table.csv();
        if std::env::var_os("UPDATE_DOCS").is_some() {
            std::fs::write(&path, computed).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
            continue;
        }
        let kept = std::fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
        assert_eq!(kept.lines().count(), computed.lines().count(), "{}", path.display());
        let words = |line: &str| line.split([' ', ',']).map(String::from).collect::<Vec<_>>();
        for (number, (shown, computed)) in kept.lines().zip(computed.lines()).enumerate() {
            let (a, b) = (words(shown), words(computed));
            let agree = a.len() == b.len() && a.iter().zip(&b).all(|(a, b)| same(a, b));
            assert!(agree, "line {} of {}:\n{shown}\n{computed}", number + 1, path.display());
        }
    }
}
