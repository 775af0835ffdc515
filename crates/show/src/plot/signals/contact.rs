//! Force over penetration, and the stiffness that was there: of rows in which the motors gave what the wall asked for.

use super::{Curve, Found, Panel, Rows, View, named, quantity};
use haptic_bridge::safety::fault::State;
use haptic_host::error::Failure;
use haptic_host::words::{counted, short};

/// The panel of a recording's force; what it says of stiffness goes into `found`.
pub(super) fn over_penetration(rows: &Rows<'_>, force: &str, found: &mut Found) -> Result<Panel, Failure> {
    let (distance, column) = (rows.column("distance_m")?, rows.column(force)?);
    let deepest = rows.rows.iter().fold(0.0_f64, |deepest, row| deepest.max(-row[distance]));
    // Rows far from the wall are no part of this picture: they would be an empty row of points along the axis.
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
    // With the motors off there is no wall, however deep the tip is in it.
    let state = rows.recording.column("state");
    let on = |row: &&Vec<f64>| state.is_none_or(|state| row[state] == State::Armed as usize as f64);
    let ramping = rows.ramping();
    let pressed = rows.rows.iter().filter(|row| row[distance] < 0.0).filter(on);
    let (early, touched): (Vec<&Vec<f64>>, Vec<&Vec<f64>>) = pressed.partition(|row| ramping(row));
    let cut = rows.cut();
    let whole = |row: &&&Vec<f64>| cut.as_ref().is_none_or(|cut| !cut(row.as_slice()));
    let points: Vec<(f64, f64)> = touched.iter().filter(whole).map(|row| (-row[distance], row[column])).collect();
    found.contact_rows = touched.len();
    found.saturated_rows = cut.is_some().then_some(touched.len() - points.len());
    let fit = fitted(&points);
    let (all, kept) = (counted(touched.len(), "row"), counted(points.len(), "row"));
    let kept = match found.saturated_rows {
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
        Err(NoLine::TooFew) => format!("no stiffness, too few for a line: {kept}"),
        Err(NoLine::Scattered) => format!("no stiffness, the force does not follow the depth: {kept}"),
    };
    found.stiffness = fit.as_ref().ok().map(|fit| fit.slope);
    Ok(Panel {
        view: View::Force,
        x: named("penetration", "m"),
        y: quantity(force),
        curves: vec![Curve { name: force.into(), pieces }],
        line: fit.ok().map(|fit| fit.ends),
        note,
    })
}

/// The straight line of least squares through some points.
struct Fit {
    slope: f64,
    /// Ends of the line, at the lowest and the highest x of the points.
    ends: [(f64, f64); 2],
}

/// The reason why no line has a slope that is a stiffness.
enum NoLine {
    TooFew,
    Scattered,
}

/// Points below which a line through them says little.
const FEW: usize = 20;
/// Standard error of a slope, as a share of it, above which it says nothing.
const UNSURE: f64 = 0.2;
/// Depths that differ by less than this share are one depth: single precision has seven digits.
const ROUNDINGS: f64 = 1e-5;

fn fitted(points: &[(f64, f64)]) -> Result<Fit, NoLine> {
    if points.len() < FEW {
        return Err(NoLine::TooFew);
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
    // Depths that differ by roundings alone have a line as well. Written so that no motion at all is refused, too.
    if !(slope > 0.0 && error < UNSURE * slope && high - low > ROUNDINGS * high.abs()) {
        return Err(NoLine::Scattered);
    }
    Ok(Fit { slope, ends: [low, high].map(|at| (at, y + slope * (at - x))) })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn depths_that_differ_by_roundings_have_no_stiffness() {
        let at = |spread: f64| {
            let points: Vec<_> = (0..100).map(|i| 1.379e-3 + spread * f64::from(i % 3)).map(|x| (x, 1e3 * x)).collect();
            fitted(&points).ok().map(|fit| fit.slope.round())
        };
        assert_eq!(at(1e-10), None);
        assert_eq!(at(1e-6), Some(1000.0));
    }
}
