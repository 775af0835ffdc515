//! The page of hard cases, docs/hard-cases.md: one table per section, made of the very rows that are asserted.

use super::rows::singular::{Row, Singularity, Target};
use super::rows::whole::WholeErrors;
use super::rows::{DOUBLE, EXTREMES, FILTERS, SEVERAL, SINGULAR, STEPS, TURNS};
use super::{SATURATED, SLIDING};
use haptic_bridge::render::scene::VelocityTerms;

/// One section: a heading, what it shows, a table.
struct Table {
    title: &'static str,
    text: &'static str,
    header: &'static [&'static str],
    rows: Vec<Vec<String>>,
}

impl Table {
    /// An empty table.
    fn new(title: &'static str, text: &'static str, header: &'static [&'static str]) -> Self {
        Self { title, text, header, rows: Vec::new() }
    }

    /// Appends a row of as many cells as the header has.
    fn push(&mut self, row: Vec<String>) {
        assert_eq!(row.len(), self.header.len());
        self.rows.push(row);
    }

    fn markdown(&self) -> String {
        let line = |cells: &[String]| format!("| {} |\n", cells.join(" | "));
        let header: Vec<String> = self.header.iter().map(ToString::to_string).collect();
        let rule: Vec<String> = self.header.iter().map(|_| "---".into()).collect();
        let rows: String = self.rows.iter().map(|row| line(row)).collect();
        format!("## {}\n\n{}\n\n{}{}{rows}", self.title, self.text, line(&header), line(&rule))
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

/// All of it.
pub fn markdown() -> String {
    let sections =
        [singular(), whole(), extremes(), filters(), steps(), several(), double(), turns(), sliding(), saturated()];
    let sections: Vec<String> = sections.iter().map(Table::markdown).collect();
    format!("{PREFACE}\n{}", sections.join("\n"))
}

const PREFACE: &str = "\
# Hard cases: what the numbers keep where they are hard to keep

Made by `UPDATE_DOCS=1 cargo test -p haptic --test deep hard_cases`; without that the test computes
every row again, asserts the bounds said here, and asserts that this page says what the code gives, each number within a
factor of four. The reference is the library's own generic code in double-double numbers (106 bits), whose routes agree
with each other to 1e-13 or better.

What follows from the tables:

- The board uses no Schur form and inverts no matrix: `Mechanism::shaping` has E, M E and Wrr in closed form. Wherever
  its feed-forward acts in full (sine of a serial singularity at least 0.05, of a parallel one at least 0.15), its
  torques are within 1e-4 of the largest, at rest and moving; from there to 0.02 and 0.06 it fades.
- Nearer still the feed-forward is off and the board commands Jᵀ f. At a serial singularity that stays exact to 1e-4. At
  a parallel one it loses digits as 1/sin²; the board stops with the fault `Singularity` at 0.002. One count of an encoder
  with 16384 a turn moves Jᵀ a thousand times as far as f32 does.
- The Schur form Wrr - Wra Waa⁻¹ War loses all digits at serial singularities; 1/(Jr M⁻¹ Jrᵀ) keeps them. At parallel
  ones every route through M fails, and the one through Λ in task space keeps the most.
- Neither walls at 1e-4 rad nor walls 1e4 times as stiff as their neighbours cost a digit, nor do thousands of turns,
  nor motors at their limit; an elbow and the rods together keep the four digits as each does alone. What velocity terms
  lose, they lose to encoder steps: with 20 000 counts a turn 2000 to 17 000 times what f32 costs, with 2²⁰ 15 to 330.
";

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
        "Into the singularities",
        "Largest relative error in f32 with minimax sines (torques: share of the largest entry) over random poses on \
         the way into a singularity and random normals, against 106 bits; the last two columns in f64. *elbow*: an arm \
         stretches or folds (serial), *axis*: the tip comes onto the turret's axis (serial), *rods*: the closed loop \
         stretches or folds (parallel). Moving: up to 1 rad/s at every joint and 0.5 m/s at the tip. cond J counts φ in mean link lengths. Rows \
         without a pose (f32 angles are further apart than that) are left out.",
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
            "**Wrr, board**",
            "Jᵀ n",
            "**torque, board**",
            "**moving, board**",
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
    let mut table = Table::new(
        "Equation (4) in the analysis",
        "Everything that the analysis computes of (4) for one wall, `Inertia`, in f64 with the sines of `FineTable`, \
         at the poses and normals of the first table and moving: largest errors against 106 bits, of Weff relative to \
         it, of all else as a share of the largest entry.",
        &["device", "singularity", "at", "W", "Weff", "z", "f_a", "torque"],
    );
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
        "Extreme devices",
        "Shipped devices with every length and mass scaled (longest link, heaviest link), and with joint 0 made so heavy \
         that Wrr/Weff reaches the ratio at the worst of 20 normals; random poses with sines above 0.2, moving at 1 \
         rad/s. Errors in f32 against 106 bits.",
        &[
            "device",
            "case",
            "Wrr/Weff",
            "Weff, Schur form",
            "Weff, 1/(Jr M⁻¹ Jrᵀ)",
            "**Wrr, board**",
            "**torque, board**",
            "**moving, board**",
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
        "Velocity filters",
        "The second-order Butterworth estimator at 20 kHz, f32 against 106 bits fed the same f32 positions; errors as \
         shares of the largest velocity, over six swings across 20 cm and at constant speed once settled. The direct form \
         (II transposed) is what textbooks give; the board runs the state-variable form.",
        &["cutoff/rate", "**swing, board**", "**gain, board**", "swing, direct form", "gain, direct form"],
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
        "A wall of 1e6 N/m",
        "The whole control step at 20 kHz, f32 against f64 fed the same encoder counts. *Hit*: ten runs at 10 m/s into a \
         wall of 1e6 N/m and 100 N s/m, 1 cm deep, feed-forward in full with velocity terms and gravity; the torque's \
         error as a share of the run's largest. *Press*: at rest, up to 1 mm deep; the force's error is the tip \
         position's last digit in f32 times the stiffness.",
        &["device", "largest force of the hit, N", "speed seen, m/s", "**hit, torque**", "**press, N**"],
    );
    for row in &*STEPS {
        let cells = [format!("{:.0}", row.force), format!("{:.1}", row.speed), digits(row.hit), digits(row.press)];
        table.push([row.device.to_string()].into_iter().chain(cells).collect());
    }
    table
}

fn several() -> Table {
    let mut table = Table::new(
        "Two walls at a small angle, or of very different stiffness",
        "Largest error of the control step's torques in f32, as a share of the largest, at 40 random poses and normals; the \
         reference is the law for several walls (docs/model.md section 2) written down a second time, in accelerations, with \
         the walls' principal directions in closed form. Columns: how much stiffer the first wall is. The last column is the \
         least share of a torque that the feed-forward changed.",
        &["device", "angle, rad", "**as stiff**", "**1e2**", "**1e4**", "changed by the feed-forward"],
    );
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
        "Two singularities at once",
        "As the first table, at poses where an elbow is near stretched or folded and the rods are near one line together: \
         both sines within 5 % of this share of those at which the feed-forward begins to fade (0.05 and 0.15).",
        &[
            "device",
            "share",
            "poses",
            "**Wrr, board**",
            "Jᵀ n",
            "**torque, board**",
            "**moving, board**",
            "f64: moving",
        ],
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
    let mut table = Table::new(
        "Fractional counts over thousands of turns",
        "Largest error of the tip's coordinates in f32, in mean link lengths, at 60 random poses so many whole turns from \
         home (every other one backwards), against angles in 106 bits from which no turn is taken off.",
        &["device", "counts per turn", "at home", "100 turns", "1000 turns", "10 000 turns"],
    );
    for row in &*TURNS {
        let mut cells = vec![row.device.to_string(), format!("{:.2}", row.counts_per_turn)];
        cells.extend(row.tip.map(digits));
        table.push(cells);
    }
    table
}

fn sliding() -> Table {
    let mut table = Table::new(
        "Velocity terms from estimated velocities",
        "A tip sliding at 0.5 m/s along a wall that holds it with 5 N, at 20 kHz and a cutoff of 500 Hz, ten runs; all as shares \
         of the largest torque. *Size*: what the velocity terms add. *Rounding*: f32 against f64 fed the same counts. *Against \
         the truth*: f32 against (4) with the joints' true angles and velocities and velocity terms differentiated from M and J \
         in 106 bits, so with what encoder steps make of the estimate and with what the terms leave out of it for the doubt of a \
         count ([model.md](model.md)).",
        &["device", "velocity terms", "size", "**rounding**", "against the truth, 20 000 counts", "2²⁰ counts"],
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
        "Motors at their limit",
        "A wall of 20 kN/m pressed up to 2 mm, in the whole servo, with motors that have room for the device's weight and 5 N \
         along a random normal; twelve poses each in the open and near a singularity of an elbow. Errors against the largest \
         force that fits, worked out joint by joint in f64, as a share of it; with the feed-forward it may be as much less as a \
         64th of a motor's torque makes, which is kept for that. Across the normal nothing is asked for.",
        &["device", "sine", "asked/possible", "**along, plain**", "**across, plain**", "**along, feed-forward**"],
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
