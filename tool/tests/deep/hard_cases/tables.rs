//! The tables of docs/hard-cases/, from the same rows that the tests check.

use super::rows::singular::{Row, Singularity, Target};
use super::rows::{DOUBLE_ROWS, EXTREME_ROWS, FILTER_ROWS, SINGULAR_ROWS, STEP_ROWS, TURN_ROWS, TWO_WALL_ROWS};
use super::{SATURATED, SLIDING};
use crate::common::csv;
use haptic_bridge::render::scene::VelocityTerms;

/// Returns errors in one significant digit, separated by ` | `; errors of 1 and more are "lost".
fn digits(errors: impl IntoIterator<Item = f64>) -> String {
    let digits = errors.into_iter().map(|error| match error {
        0.0 => "0".into(),
        error if error < 1.0 => format!("{error:.0e}"),
        _ => "lost".into(),
    });
    digits.collect::<Vec<String>>().join(" | ")
}

/// Returns the device, its singularity, and the distance from it.
fn place_cells(row: &Row) -> String {
    let what = match row.singularity {
        Singularity::Elbow => "elbow",
        Singularity::Axis => "axis",
        Singularity::Rods => "rods",
        Singularity::Serial => "serial",
    };
    match row.target {
        Target::Condition(condition) => format!("{} | {what} | cond {condition:.0e}", row.device),
        Target::Sine(sine) => format!("{} | {what} | sine {sine:.2}", row.device),
    }
}

fn table<R>(head: &str, rows: &[R], format: impl Fn(&R) -> String) -> String {
    csv([head.to_string()].into_iter().chain(rows.iter().map(format)))
}

/// Returns every table with its name in docs/hard-cases/.
pub fn all_tables() -> [(&'static str, String); 10] {
    let singular = table(
        "device | singularity | at | poses | least sine | Weff, Schur form | Weff, 1/(Jr M⁻¹ Jrᵀ) | \
         Weff, 1/(nᵀ Λ⁻¹ n) | Wrr, T⁻¹ by elimination | Wrr, nᵀ Λ n | Wrr, board | Jᵀ n | torque, board | \
         moving, board | f64: Schur | f64: moving",
        &SINGULAR_ROWS,
        |row| {
            let board = row.board.all().chain([row.double.w_eff_schur, row.double.torque_moving]);
            format!("{} | {} | {}", place_cells(row), row.poses, digits([row.regularity].into_iter().chain(board)))
        },
    );
    let singular_table = table("device | singularity | at | W | Weff | z | f_a | torque", &SINGULAR_ROWS, |row| {
        format!("{} | {}", place_cells(row), digits(row.quantities.all()))
    });
    let extremes = table(
        "device | case | Wrr/Weff | Weff, Schur form | Weff, 1/(Jr M⁻¹ Jrᵀ) | Wrr, board | torque, board | \
         moving, board | f64: moving",
        &EXTREME_ROWS,
        |row| {
            let ratio = if row.ratio < 100.0 { format!("{:.1}", row.ratio) } else { format!("{:.0e}", row.ratio) };
            let b = &row.board;
            let errors = [b.w_eff_schur, b.w_eff_joint, b.w_rr_kernel, b.torque, b.torque_moving];
            let errors = digits(errors.into_iter().chain([row.double.torque_moving]));
            format!("{} | {} | {ratio} | {errors}", row.device, row.case)
        },
    );
    let filters = "cutoff/rate | swing, board | gain, board | swing, direct form | gain, direct form";
    let filters = table(filters, &FILTER_ROWS, |row| {
        format!("{:e} | {}", row.ratio, digits([row.swing, row.gain, row.direct_swing, row.direct_gain]))
    });
    let steps = "device | gears | largest force of the hit, N | speed seen, m/s | hit, torque | press, N";
    let steps = table(steps, &STEP_ROWS, |row| {
        let gears = if row.geared { "1:50" } else { "none" };
        let errors = digits([row.hit_error, row.rest_error]);
        format!("{} | {gears} | {:.0} | {:.1} | {errors}", row.device, row.force, row.speed)
    });
    let several = "device | angle, rad | as stiff | 1e2 | 1e4 | changed by the feed-forward";
    let several = table(several, &TWO_WALL_ROWS, |row| {
        let errors = [row.angle].into_iter().chain(row.torque).chain([row.smallest_shaping]);
        format!("{} | {}", row.device, digits(errors))
    });
    let double_header = "device | share | poses | Wrr, board | Jᵀ n | torque, board | moving, board | f64: moving";
    let double_table = table(double_header, &DOUBLE_ROWS, |row| {
        let board = &row.board;
        let errors = [board.w_rr_kernel, board.plain, board.torque, board.torque_moving, row.double.torque_moving];
        format!("{} | {:.1} | {} | {}", row.device, row.share, row.poses, digits(errors))
    });
    let turns = "device | counts per turn | at home | 100 turns | 1000 turns | 10 000 turns";
    let turns =
        table(turns, &TURN_ROWS, |row| format!("{} | {:.2} | {}", row.device, row.counts_per_turn, digits(row.tip)));
    let sliding = "device | velocity terms | size | rounding | against the truth, 20 000 counts | 2²⁰ counts";
    let sliding = table(sliding, &SLIDING, |row| {
        let (terms, _) = VelocityTerms::ALL.into_iter().find(|(_, terms)| *terms == row.terms).expect("a choice");
        let [coarse, fine] = row.estimated;
        format!("{} | {terms} | {}", row.device, digits([row.size, row.rounding, coarse, fine]))
    });
    let saturated = "device | sine | asked/possible | along, plain | across, plain | along, feed-forward";
    let saturated = table(saturated, &SATURATED, |row| {
        let ([low, high], errors) = (row.sines, [row.along[0], row.across, row.along[1]]);
        format!("{} | {low:.2} to {:.2} | {:.0} | {}", row.device, high.min(1.0), row.beyond, digits(errors))
    });
    [
        ("singularities", singular),
        ("analysis", singular_table),
        ("extremes", extremes),
        ("filters", filters),
        ("stiff-wall", steps),
        ("two-walls", several),
        ("two-singularities", double_table),
        ("turns", turns),
        ("velocity-terms", sliding),
        ("motors-at-their-limit", saturated),
    ]
}
