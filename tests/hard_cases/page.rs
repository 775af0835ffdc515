//! The page of hard cases: one table per section, made of the very rows that the test asserts.

/// What a device gives in f64, in f32 with the coefficients that a board is sent, and in 106 bits.
macro_rules! in_three_precisions {
    ($description:expr, ($double:ident, $board:ident, $reference:ident) => $what:expr) => {{
        let exact = haptic_bridge::model::mechanism::AnyMechanism::<DoubleDouble>::new($description);
        haptic_bridge::with_mechanism!(exact.expect("a sound device"), $reference => {
            let ($double, $board) = ($reference.cast::<f64>(), $reference.cast::<f32>());
            $what
        })
    }};
}

pub mod double;
pub mod double_double;
pub mod extremes;
pub mod filters;
pub mod routes;
pub mod saturated;
pub mod several;
pub mod singular;
pub mod sliding;
pub mod steps;
pub mod turns;
pub mod whole;

use haptic::device_file::DeviceFile;
use haptic_bridge::model::description::Description;

/// One section: a heading, what it shows, a table.
#[derive(Clone, Debug)]
pub struct Table {
    title: &'static str,
    text: &'static str,
    header: &'static [&'static str],
    rows: Vec<Vec<String>>,
}

impl Table {
    /// An empty table.
    pub fn new(title: &'static str, text: &'static str, header: &'static [&'static str]) -> Self {
        Self { title, text, header, rows: Vec::new() }
    }

    /// Appends a row of as many cells as the header has.
    pub fn push(&mut self, row: Vec<String>) {
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
pub fn digits(error: f64) -> String {
    if error == 0.0 {
        "0".into()
    } else if error < 1.0 {
        format!("{error:.0e}")
    } else {
        "lost".into()
    }
}

/// A device that ships.
pub fn shipped(name: &str) -> Description {
    let path = format!("{}/devices/{name}.toml", env!("CARGO_MANIFEST_DIR"));
    DeviceFile::load(path).unwrap_or_else(|error| panic!("{error}")).description
}

/// Everything the page shows.
#[derive(Clone, Debug)]
pub struct Rows {
    pub singular: Vec<singular::Row>,
    pub extremes: Vec<extremes::Row>,
    pub filters: Vec<filters::Row>,
    pub steps: Vec<steps::Row>,
    pub several: Vec<several::Row>,
    pub turns: Vec<turns::Row>,
    pub double: Vec<double::Row>,
    pub sliding: Vec<sliding::Row>,
    pub saturated: Vec<saturated::Row>,
}

impl Rows {
    /// Computes all of them.
    pub fn compute() -> Self {
        Self {
            singular: singular::all(),
            extremes: extremes::all(),
            filters: filters::all(),
            steps: steps::all(),
            several: several::all(),
            turns: turns::all(),
            double: double::all(),
            sliding: sliding::all(),
            saturated: saturated::all(),
        }
    }

    /// The page, docs/hard-cases.md.
    pub fn markdown(&self) -> String {
        let sections = [
            singular::table(&self.singular),
            whole::table(&self.singular),
            extremes::table(&self.extremes),
            filters::table(&self.filters),
            steps::table(&self.steps),
            several::table(&self.several),
            double::table(&self.double),
            turns::table(&self.turns),
            sliding::table(&self.sliding),
            saturated::table(&self.saturated),
        ];
        let sections: Vec<String> = sections.iter().map(Table::markdown).collect();
        format!("{PREFACE}\n{}", sections.join("\n"))
    }
}

const PREFACE: &str = "\
# Hard cases: what the numbers keep where they are hard to keep

Made by `UPDATE_DOCS=1 cargo test --test hard_cases`; without that the test computes every
row again, asserts the bounds said here, and asserts that this page says what the code gives, each number within a
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
