//! The tables of docs/hard-cases/, made of the very rows that are asserted.

use super::rows::singular::{Row, Singularity, Target};
use super::rows::whole::WholeErrors;
use super::rows::{DOUBLE, EXTREMES, FILTERS, SEVERAL, SINGULAR, STEPS, TURNS};
use super::{SATURATED, SLIDING};
use haptic_bridge::render::scene::VelocityTerms;
use haptic_host::output::csv_line;

/// A table, and its name in docs/hard-cases/.
pub struct Table {
    pub name: &'static str,
    header: &'static [&'static str],
    rows: Vec<Vec<String>>,
}

impl Table {
    /// An empty table.
    fn new(name: &'static str, header: &'static [&'static str]) -> Self {
        Self { name, header, rows: Vec::new() }
    }

    /// Appends a row of as many cells as the header has.
    fn push(&mut self, row: Vec<String>) {
        assert_eq!(row.len(), self.header.len());
        self.rows.push(row);
    }

    pub fn csv(&self) -> String {
        csv_line(self.header) + &self.rows.iter().map(csv_line).collect::<String>()
    }
}

/// An error in one significant digit; what is wrong by more than itself reads "lost".
fn digits(error: f64) -> String {
    if error == 0.0 {
        "0".into()
    } else if error < 1.0 {
        format!("{error:.0e}")
    } else {
        "lost".into()
    }
}

/// All of them.
pub fn all() -> [Table; 10] {
    [singular(), whole(), extremes(), filters(), steps(), several(), double(), turns(), sliding(), saturated()]
}

/// The device, and into which singularity how far.
fn words(row: &Row) -> [String; 3] {
    let at = match row.target {
        Target::Condition(condition) => format!("cond {condition:.0e}"),
        Target::Sine(sine) => format!("sine {sine:.2}"),
    };
    let what = match row.singularity {
        Singularity::Elbow => "elbow",
        Singularity::Axis => "axis",
        Singularity::Rods => "rods",
    };
    [row.device.into(), what.into(), at]
}

fn singular() -> Table {
    let mut table = Table::new(
        "singularities",
        &[
            "device",
            "singularity",
            "at",
            "poses",
            "least sine",
            "Weff, Schur form",
            "Weff, 1/(Jr M⁻¹ Jrᵀ)",
            "Weff, 1/(nᵀ Λ⁻¹ n)",
            "Wrr, T⁻¹ by elimination",
            "Wrr, nᵀ Λ n",
            "Wrr, board",
            "Jᵀ n",
            "torque, board",
            "moving, board",
            "f64: Schur",
            "f64: moving",
        ],
    );
    for row in &*SINGULAR {
        let mut cells = words(row).to_vec();
        cells.extend([row.poses.to_string(), digits(row.regularity)]);
        cells.extend(row.board.all().map(digits));
        cells.extend([row.double.w_eff_schur, row.double.torque_moving].map(digits));
        table.push(cells);
    }
    table
}

fn whole() -> Table {
    let mut table = Table::new("analysis", &["device", "singularity", "at", "W", "Weff", "z", "f_a", "torque"]);
    for row in &*SINGULAR {
        let WholeErrors { w, w_eff, z, f_a, torque } = row.whole;
        let mut cells = words(row).to_vec();
        cells.extend([w, w_eff, z, f_a, torque].map(digits));
        table.push(cells);
    }
    table
}

fn extremes() -> Table {
    let mut table = Table::new(
        "extremes",
        &[
            "device",
            "case",
            "Wrr/Weff",
            "Weff, Schur form",
            "Weff, 1/(Jr M⁻¹ Jrᵀ)",
            "Wrr, board",
            "torque, board",
            "moving, board",
            "f64: moving",
        ],
    );
    for row in &*EXTREMES {
        let mut cells = vec![row.device.into(), row.case.clone(), format!("{:.3}", Short(row.ratio))];
        let b = &row.board;
        cells.extend([b.w_eff_schur, b.w_eff_joint, b.w_rr_kernel, b.torque, b.torque_moving].map(digits));
        cells.push(digits(row.double.torque_moving));
        table.push(cells);
    }
    table
}

fn filters() -> Table {
    let mut table = Table::new(
        "filters",
        &["cutoff/rate", "swing, board", "gain, board", "swing, direct form", "gain, direct form"],
    );
    for row in &*FILTERS {
        let mut cells = vec![format!("{:e}", row.ratio)];
        cells.extend([row.swing, row.gain, row.direct_swing, row.direct_gain].map(digits));
        table.push(cells);
    }
    table
}

fn steps() -> Table {
    let mut table = Table::new(
        "stiff-wall",
        &["device", "largest force of the hit, N", "speed seen, m/s", "hit, torque", "press, N"],
    );
    for row in &*STEPS {
        let cells = [format!("{:.0}", row.force), format!("{:.1}", row.speed), digits(row.hit), digits(row.press)];
        table.push([row.device.to_string()].into_iter().chain(cells).collect());
    }
    table
}

fn several() -> Table {
    let mut table =
        Table::new("two-walls", &["device", "angle, rad", "as stiff", "1e2", "1e4", "changed by the feed-forward"]);
    for row in &*SEVERAL {
        let mut cells = vec![row.device.to_string(), digits(row.angle)];
        cells.extend(row.torque.map(digits));
        cells.push(digits(row.shaped));
        table.push(cells);
    }
    table
}

fn double() -> Table {
    let mut table = Table::new(
        "two-singularities",
        &["device", "share", "poses", "Wrr, board", "Jᵀ n", "torque, board", "moving, board", "f64: moving"],
    );
    for row in &*DOUBLE {
        let mut cells = vec![row.device.to_string(), format!("{:.1}", row.share), row.poses.to_string()];
        let board = &row.board;
        cells.extend([board.w_rr_kernel, board.plain, board.torque, board.torque_moving].map(digits));
        cells.push(digits(row.double.torque_moving));
        table.push(cells);
    }
    table
}

fn turns() -> Table {
    let mut table =
        Table::new("turns", &["device", "counts per turn", "at home", "100 turns", "1000 turns", "10 000 turns"]);
    for row in &*TURNS {
        let mut cells = vec![row.device.to_string(), format!("{:.2}", row.counts_per_turn)];
        cells.extend(row.tip.map(digits));
        table.push(cells);
    }
    table
}

fn sliding() -> Table {
    let mut table = Table::new(
        "velocity-terms",
        &["device", "velocity terms", "size", "rounding", "against the truth, 20 000 counts", "2²⁰ counts"],
    );
    for row in &*SLIDING {
        let (terms, _) = VelocityTerms::ALL.into_iter().find(|(_, terms)| *terms == row.terms).expect("a choice");
        let cells = [row.size, row.rounding, row.estimated[0], row.estimated[1]].map(digits);
        table.push([row.device.to_string(), terms.to_string()].into_iter().chain(cells).collect());
    }
    table
}

fn saturated() -> Table {
    let mut table = Table::new(
        "motors-at-their-limit",
        &["device", "sine", "asked/possible", "along, plain", "across, plain", "along, feed-forward"],
    );
    for row in &*SATURATED {
        let sines = format!("{:.2} to {:.2}", row.sines[0], row.sines[1].min(1.0));
        let errors = [row.along[0], row.across, row.along[1]].map(digits);
        table.push([row.device.to_string(), sines, format!("{:.0}", row.beyond)].into_iter().chain(errors).collect());
    }
    table
}

/// A ratio in plain digits while it is small.
struct Short(f64);

impl std::fmt::Display for Short {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        if self.0 < 100.0 { write!(f, "{:.1}", self.0) } else { write!(f, "{:.0e}", self.0) }
    }
}
