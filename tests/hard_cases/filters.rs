//! Velocity estimators with cutoffs from a ten-thousandth to almost half of the rate, in f32.
//!
//! The library's state-variable form against the usual direct form of the same transfer function, both in f32, both fed
//! the same positions as f32 holds them; the reference is the direct form in 106 bits.

use super::double_double::{DoubleDouble, Series};
use super::{Table, digits};
use haptic_bridge::math::{Math, Real};
use haptic_bridge::render::velocity::{Coefficients, Estimator, Velocity};

/// One row of the table.
#[derive(Clone, Debug)]
pub struct Row {
    /// cutoff/rate
    pub ratio: f64,
    /// Share of the largest velocity by which the board's estimate is off, in a swing across the workspace.
    pub swing: f64,
    /// The same at constant speed, once settled: the error of the gain.
    pub gain: f64,
    /// What the direct form in f32 makes of them.
    pub direct_swing: f64,
    pub direct_gain: f64,
    /// How far the two forms differ in 106 bits.
    pub reference: f64,
}

/// Control rate, Hz.
const RATE: f64 = 20_000.0;

/// Butterworth's second order by the bilinear transform, prewarped, in direct form II transposed.
struct Direct<T> {
    b: [T; 3],
    a: [T; 2],
    s: [T; 2],
    last: Option<T>,
}

impl<T: Real> Direct<T> {
    fn new(ratio: f64) -> Self {
        let one: DoubleDouble = 1.0.into();
        let (s, c) = Series::sin_cos(DoubleDouble::from(std::f64::consts::PI) * ratio.into());
        let k = s / c;
        let norm = one / (one + k * (k + std::f64::consts::SQRT_2.into()));
        let b0 = k * k * norm;
        let two: DoubleDouble = 2.0.into();
        let a1 = two * (k * k - one) * norm;
        let a2 = (one + k * (k - std::f64::consts::SQRT_2.into())) * norm;
        let round = |x: DoubleDouble| T::from_f64(x.high) + T::from_f64(x.low);
        Self { b: [round(b0), round(two * b0), round(b0)], a: [round(a1), round(a2)], s: [T::zero(); 2], last: None }
    }

    fn step(&mut self, position: T) -> T {
        let input = (position - self.last.replace(position).unwrap_or(position)) * T::from_f64(RATE);
        let output = self.b[0] * input + self.s[0];
        self.s[0] = self.b[1] * input - self.a[0] * output + self.s[1];
        self.s[1] = self.b[2] * input - self.a[1] * output;
        output
    }
}

/// Largest errors over the last half of a motion, as shares of the largest velocity: (state variable in f32, direct
/// form in f32, state variable in 106 bits).
fn errors(ratio: f64, motion: impl Fn(f64) -> f64) -> [f64; 3] {
    let steps = (20.0 / ratio).clamp(4_000.0, 100_000.0) as u32;
    let kind = Estimator::Butterworth;
    let valid = "a cutoff below half the rate";
    let board = Coefficients::<f32>::new(kind, RATE as f32, (ratio * RATE) as f32).expect(valid);
    let exact =
        Coefficients::<DoubleDouble>::new(kind, DoubleDouble::from_f64(RATE), DoubleDouble::from_f64(ratio * RATE))
            .expect(valid);
    let begin = motion(0.0) as f32;
    let (mut v, mut check) = (Velocity::resting_at(begin), Velocity::resting_at(DoubleDouble::from(f64::from(begin))));
    let (mut direct, mut reference) = (Direct::<f32>::new(ratio), Direct::<DoubleDouble>::new(ratio));
    let (mut worst, mut largest) = ([0.0_f64; 3], 0.0_f64);
    for k in 0..steps {
        let x = motion(f64::from(k) / f64::from(steps)) as f32;
        let precise: DoubleDouble = f64::from(x).into();
        let truth = reference.step(precise);
        let found = [f64::from(v.step(&board, x)), f64::from(direct.step(x)), check.step(&exact, precise).high];
        if k >= steps / 2 {
            largest = largest.max(truth.high.abs());
            for (worst, found) in worst.iter_mut().zip(found) {
                *worst = worst.max((found - truth.high).abs());
            }
        }
    }
    worst.map(|error| error / largest)
}

/// Every row.
pub fn all() -> Vec<Row> {
    [1e-4, 3e-4, 1e-3, 1e-2, 0.025, 0.1, 0.3, 0.45]
        .into_iter()
        .map(|ratio| {
            let [swing, direct_swing, a] = errors(ratio, |t| 0.05 + 0.1 * libm::sin(40.0 * t));
            let [gain, direct_gain, b] = errors(ratio, |t| -0.1 + 0.2 * t);
            Row { ratio, swing, gain, direct_swing, direct_gain, reference: a.max(b) }
        })
        .collect()
}

/// The rows as the page shows them.
pub fn table(rows: &[Row]) -> Table {
    let mut table = Table::new(
        "Velocity filters",
        "The second-order Butterworth estimator at 20 kHz, f32 against 106 bits fed the same f32 positions; errors as \
         shares of the largest velocity, over six swings across 20 cm and at constant speed once settled. The direct form \
         (II transposed) is what textbooks give; the board runs the state-variable form.",
        &["cutoff/rate", "**swing, board**", "**gain, board**", "swing, direct form", "gain, direct form"],
    );
    for row in rows {
        let mut cells = vec![format!("{:e}", row.ratio)];
        cells.extend([row.swing, row.gain, row.direct_swing, row.direct_gain].map(digits));
        table.push(cells);
    }
    table
}
