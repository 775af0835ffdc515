//! Force over penetration, and the rendered stiffness, from rows in which no limit cut the force.

use super::{Analysis, Curve, Panel, Rows, View, column_quantity, named_quantity};
use haptic_bridge::safety::fault::State;
use haptic_host::error::Failure;
use haptic_host::words::{counted, short};

/// Creates the panel of force over penetration, and writes the fitted stiffness into `analysis`.
pub(super) fn force_panel(rows: &Rows<'_>, force: &str, analysis: &mut Analysis) -> Result<Panel, Failure> {
    let (distance, column) = (rows.column("distance_m")?, rows.column(force)?);
    let deepest = rows.rows.iter().fold(0.0_f64, |deepest, row| deepest.max(-row[distance]));
    // Leaves out rows far from the wall, because they would be a line of points along the axis.
    let near = |row: &[f64]| -row[distance] >= -0.1 * deepest;
    let mut pieces = Vec::new();
    for piece in rows.pieces(|i, _| (i as f64, 0.0)) {
        let mut open = Vec::new();
        for (i, _) in piece {
            let row = &rows.rows[i as usize];
            if near(row) {
                open.push((-row[distance], row[column]));
            } else if !open.is_empty() {
                pieces.push(std::mem::take(&mut open));
            }
        }
        pieces.push(open);
    }
    pieces.retain(|piece| piece.len() > 1);
    // Leaves out rows with the motors off, in which no wall is rendered.
    let state = rows.recording.column("state");
    let on = |row: &&Vec<f64>| state.is_none_or(|state| row[state] == State::Armed as usize as f64);
    let ramping = rows.ramp_predicate();
    let pressed = rows.rows.iter().filter(|row| row[distance] < 0.0).filter(on);
    let (early, touched): (Vec<&Vec<f64>>, Vec<&Vec<f64>>) = pressed.partition(|row| ramping(row));
    let cut = rows.limit_predicate();
    let uncut = |row: &&&Vec<f64>| cut.as_ref().is_none_or(|cut| !cut(row.as_slice()));
    let points: Vec<(f64, f64)> = touched.iter().filter(uncut).map(|row| (-row[distance], row[column])).collect();
    analysis.contact_rows = touched.len();
    analysis.saturated_rows = cut.is_some().then_some(touched.len() - points.len());
    let fit = fit_line(&points);
    let (all, kept) = (counted(touched.len(), "row"), counted(points.len(), "row"));
    let kept = match analysis.saturated_rows {
        None => format!("{all} in contact, cut by a limit or not (saturated is not recorded)"),
        Some(0) => format!("{all} in contact"),
        Some(cut) => format!("{kept} in contact, without {cut} that a limit cut"),
    };
    let early = match early.len() {
        0 => String::new(),
        _ => format!(", without {} in which torque ramped up", counted(early.len(), "row")),
    };
    let kept = kept + &early;
    let note = match &fit {
        _ if touched.is_empty() => "no wall was touched".into(),
        Ok(fit) => format!("line through {kept}: {} N/m", short(fit.slope as f32)),
        Err(NoLineReason::TooFew) => format!("no stiffness, too few for a line: {kept}"),
        Err(NoLineReason::Scattered) => format!("no stiffness, the force does not follow the depth: {kept}"),
    };
    analysis.stiffness = fit.as_ref().ok().map(|fit| fit.slope);
    Ok(Panel {
        view: View::Force,
        x: named_quantity("penetration", "m"),
        y: column_quantity(force),
        curves: vec![Curve { name: force.into(), pieces }],
        line: fit.ok().map(|fit| fit.ends),
        note,
        contact: Vec::new(),
    })
}

struct LineFit {
    slope: f64,
    /// Ends of the line, at the lowest and the highest x of the points.
    ends: [(f64, f64); 2],
}

/// Reason why no stiffness can be fitted to the points.
enum NoLineReason {
    TooFew,
    Scattered,
}

/// Smallest number of points for a line.
const MIN_FIT_POINTS: usize = 20;
/// Largest standard error of a slope, as a share of the slope.
const MAX_RELATIVE_SLOPE_ERROR: f64 = 0.2;
/// Relative range of depths below which they differ only by rounding errors of single precision.
const MIN_RELATIVE_DEPTH_RANGE: f64 = 1e-5;

fn fit_line(points: &[(f64, f64)]) -> Result<LineFit, NoLineReason> {
    if points.len() < MIN_FIT_POINTS {
        return Err(NoLineReason::TooFew);
    }
    let count = points.len() as f64;
    let mean = |pick: fn(&(f64, f64)) -> f64| points.iter().map(pick).sum::<f64>() / count;
    let (x, y) = (mean(|p| p.0), mean(|p| p.1));
    let spread: f64 = points.iter().map(|p| (p.0 - x).powi(2)).sum();
    let both: f64 = points.iter().map(|p| (p.0 - x) * (p.1 - y)).sum();
    let slope = both / spread;
    let rest: f64 = points.iter().map(|p| (p.1 - y - slope * (p.0 - x)).powi(2)).sum();
    let error = (rest / ((count - 2.0) * spread)).sqrt();
    let (low, high) = points.iter().fold((x, x), |(low, high), p| (low.min(p.0), high.max(p.0)));
    // Rejects depths that differ only by rounding errors, and NaN, which results without motion.
    if !(slope > 0.0 && error < MAX_RELATIVE_SLOPE_ERROR * slope && high - low > MIN_RELATIVE_DEPTH_RANGE * high.abs())
    {
        return Err(NoLineReason::Scattered);
    }
    Ok(LineFit { slope, ends: [low, high].map(|at| (at, y + slope * (at - x))) })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn depths_that_differ_by_rounding_have_no_stiffness() {
        let at = |spread: f64| {
            let points: Vec<_> = (0..100).map(|i| 1.379e-3 + spread * f64::from(i % 3)).map(|x| (x, 1e3 * x)).collect();
            fit_line(&points).ok().map(|fit| fit.slope.round())
        };
        assert_eq!(at(1e-10), None);
        assert_eq!(at(1e-6), Some(1000.0));
    }
}
