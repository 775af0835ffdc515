//! The rows that bounds.rs asserts and docs/hard-cases/ lists. Results in the board's f32 and in f64 are compared with
//! a reference, which is the library's own code in the `Exact` numbers of the including module.
#![allow(dead_code, reason = "only the tables use all of them")]

use super::{Exact, ExactMath, shipped_device};
use std::sync::LazyLock;

/// Evaluates an expression with the mechanism of a device in f64, in f32 and in the reference's numbers.
macro_rules! in_three_precisions {
    ($description:expr, ($double:ident, $board:ident, $reference:ident) => $result:expr) => {{
        let exact = haptic_bridge::model::mechanism::AnyMechanism::<super::Exact>::new($description);
        haptic_bridge::with_mechanism!(exact.expect("a sound device"), $reference => {
            let ($double, $board) = ($reference.cast::<f64>(), $reference.cast::<f32>());
            $result
        })
    }};
}
pub mod double;
pub mod extremes;
pub mod filters;
pub mod routes;
pub mod several;
pub mod singular;
pub mod steps;
pub mod turns;

/// Name in the tables and device file of one shipped device per mechanism.
const DEVICES: [(&str, &str); 5] = [
    ("paddle", "hapkit-paddle"),
    ("five-bar", "haply-2diy"),
    ("five-bar-turret", "fictive-five-bar-turret"),
    ("parallelogram", "phantom-premium-1.5"),
    ("serial-3r", "serial-3r"),
];

pub static SINGULAR_ROWS: LazyLock<Vec<singular::Row>> = LazyLock::new(singular::all_rows);
pub static EXTREME_ROWS: LazyLock<Vec<extremes::Row>> = LazyLock::new(extremes::all_rows);
pub static FILTER_ROWS: LazyLock<Vec<filters::Row>> = LazyLock::new(filters::all_rows);
pub static STEP_ROWS: LazyLock<Vec<steps::Row>> = LazyLock::new(steps::all_rows);
pub static TWO_WALL_ROWS: LazyLock<Vec<several::Row>> = LazyLock::new(several::all_rows);
pub static TURN_ROWS: LazyLock<Vec<turns::Row>> = LazyLock::new(turns::all_rows);
pub static DOUBLE_ROWS: LazyLock<Vec<double::Row>> = LazyLock::new(double::all_rows);
